"""Answers that the scan cannot tell from the best one, made from the model's own symmetry.

A large part is turned so that its surface covers itself. The other parts follow: each takes a place where a part that
looks like it was, whichever brings its joint together within the limits. What comes out has the same surface as the
answer, with limbs in each other's places or parts the other way round.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.candidates import Candidates
from pwralign_kin.estimation.tree_search import TreeSearch
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.model.part_graph import MovingJoint
from pwralign_kin.se3 import Array, inverse, skew

SEEDS = 12
"""Turns of parts that are followed, of the largest parts first."""
MOST = 6
"""Equal answers that are made."""
OPEN_TURN, OPEN_SLIDE = 0.12, 0.015
"""How far a joint may be open (rad, model diagonals) before refinement: parts only nearly look alike."""
BEYOND = 0.05
"""How far beyond its limits (rad, model diagonals) a joint may be before refinement."""


def equal_answers(model: ArticulatedModel, search: TreeSearch, final: Candidates) -> Candidates:
    """Return distinct configurations (unscored, at most `MOST`) whose surface is that of the `final` one."""
    symmetry, places = model.symmetry, search.part_placements(final)[0]
    follower, found = _Follower(model, search, final), final
    seeds = [
        (part, turn) for part in search.largest_parts(len(places)) for turn in symmetry.replacements(part, part)[1:]
    ]
    for part, turn in seeds[:SEEDS]:
        values = follower.follow(int(part), places[part] @ turn)
        if values is None:
            continue
        at_origin = search.part_placements(Candidates(np.eye(4)[None], values[None], np.zeros(1, np.float32)))[0]
        base = places[part] @ turn @ inverse(at_origin[part])
        other = Candidates(base[None], values[None], np.full(1, -np.inf, np.float32))
        found = search.distinct(Candidates.concatenate([found, other]), MOST + 1, search.options.distinct)
        if len(found) > MOST:
            break
    return found.take(slice(1, None))


@dataclass(frozen=True)
class _Chain:
    """One or two joints between two parts with surface; the part between two joints has none."""

    above: int
    below: int
    joints: tuple[MovingJoint, ...]

    def other(self, part: int) -> int:
        """Return the part at the other end."""
        return self.below if part == self.above else self.above


class _Follower:
    """Lets all parts follow one that was turned."""

    def __init__(self, model: ArticulatedModel, search: TreeSearch, final: Candidates) -> None:
        self.model, self.symmetry = model, model.symmetry
        self.places = search.part_placements(final)[0]
        self.values = final.values[0]
        self.lower, self.upper = (np.asarray(limit) for limit in search.model.limits)
        self.chains = _chains(model)
        self.looks: dict[tuple[int, int], Array] = {}

    def follow(self, seed: int, placement: Array) -> Array | None:
        """Return the joint values (k,) that bring all surface back onto that of the answer; None where none do."""
        placed, taken, front = {seed: placement}, {seed}, [seed]
        values, told = self.values.copy(), np.zeros(len(self.values), bool)
        while front:
            origin = front.pop(0)
            for chain in self.chains:
                if origin not in (chain.above, chain.below) or chain.other(origin) in placed:
                    continue
                part = chain.other(origin)
                several = [(place, self._looking_as(part, place)) for place in self._places_for(part, taken)]
                if not several:
                    return None
                placements = np.concatenate([own for _, own in several])
                ends = (placed[origin], placements) if part == chain.below else (placements, placed[origin])
                found, fits = self._joint_values(chain.joints, *ends)
                actuated = [joint.actuated for joint in chain.joints]
                fits &= ((np.abs(found - values[actuated]) < BEYOND) | ~told[actuated]).all(axis=1)
                if not fits.any():
                    return None
                chosen = int(np.argmax(fits))
                values[actuated], told[actuated] = found[chosen], True
                placed[part] = placements[chosen]
                taken.add(np.repeat([place for place, _ in several], [len(own) for _, own in several])[chosen])
                front.append(part)
        return values if len(placed) == int((self.symmetry.kind >= 0).sum()) else None

    def _looking_as(self, part: int, place: int) -> Array:
        """Return the placements (m, 4, 4) of `part` that look as the answer's part `place` does."""
        if (part, place) not in self.looks:
            self.looks[part, place] = self.places[place] @ self.symmetry.replacements(part, place)
        return self.looks[part, place]

    def _places_for(self, part: int, taken: set[int]) -> list[int]:
        """Return the free places of parts that look like `part`, its own first."""
        kind = self.symmetry.kind
        others = [int(i) for i in np.flatnonzero(kind == kind[part]) if i != part]
        return [place for place in (part, *others) if place not in taken]

    def _joint_values(
        self, joints: tuple[MovingJoint, ...], above: Array, below: Array
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Return the actuated values (m, joints), search units, that the placements of the parts above and below take
        (one of them (m, 4, 4)), and whether (m,) the joints close within their limits."""
        motion = inverse(above @ self._offset(joints[0])) @ below
        motion = motion[None] if motion.ndim == 2 else motion
        found, fits = np.zeros((len(motion), len(joints))), np.ones(len(motion), bool)
        if len(joints) == 2:
            between = self._offset(joints[1])
            angle = _bringing(joints[0].axis, between[:3, :3] @ joints[1].axis, motion[:, :3, :3] @ joints[1].axis)
            found[:, 0], fits = self._actuated(joints[0], angle)
            motion = inverse(_turns(joints[0].axis, angle) @ between) @ motion
        joint, t = joints[-1], motion[:, :3, 3]
        angle, turned = turned_about(motion[:, :3, :3], joint.axis)
        if joint.kind == "prismatic":
            along = t @ joint.axis
            found[:, -1], within = self._actuated(joint, along * self.model.diagonal)
            turned, t = np.hypot(turned, angle), t - along[:, None] * joint.axis
        else:
            found[:, -1], within = self._actuated(joint, angle)
        return found, fits & within & (turned < OPEN_TURN) & (np.linalg.norm(t, axis=1) < OPEN_SLIDE)

    def _offset(self, joint: MovingJoint) -> Array:
        """Return the joint's placement in the part above, search units."""
        T = joint.T_parent_joint.copy()
        T[:3, 3] /= self.model.diagonal
        return T

    def _actuated(self, joint: MovingJoint, value: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the actuated values (m,), search units, of joint values (rad or m), and whether limits allow them."""
        lower, upper = self.lower[joint.actuated], self.upper[joint.actuated]
        slides = self.model.units[self.model.joint_names[joint.actuated]] == "m"
        unit = self.model.diagonal if slides else 1.0
        u = (value - joint.offset) / joint.multiplier / unit
        if joint.kind != "prismatic":
            # Of all full turns the one nearest to the middle of the limits.
            period = 2 * np.pi / abs(joint.multiplier) / unit
            u = u - period * np.round((u - (lower + upper) / 2) / period)
        return np.clip(u, lower, upper), (u > lower - BEYOND) & (u < upper + BEYOND)


def _chains(model: ArticulatedModel) -> tuple[_Chain, ...]:
    """Return the connections between parts with surface that can be solved for their joints."""
    chains = []
    for below, part in enumerate(model.parts):
        if model.symmetry.kind[below] < 0 or part.joint is None:
            continue
        joints: tuple[MovingJoint, ...] = (part.joint,)
        above = part.parent
        between = model.parts[above].joint
        if model.symmetry.kind[above] < 0 and between is not None:
            joints, above = (between, *joints), model.parts[above].parent
        turning = all(joint.kind != "prismatic" for joint in joints)
        if model.symmetry.kind[above] >= 0 and (len(joints) == 1 or turning):
            chains.append(_Chain(above, below, joints))
    return tuple(chains)


def _bringing(axis: Array, source: Array, target: Array) -> Array:
    """Return the angles (m,) about `axis` that bring the direction `source` (3,) nearest to `target` (m, 3)."""
    return np.asarray(np.arctan2(np.cross(source, target) @ axis, target @ source - (axis @ source) * (target @ axis)))


def _turns(axis: Array, angle: Array) -> Array:
    """Return the placements (m, 4, 4) turned by `angle` (m,) about `axis` (Rodrigues' formula)."""
    K = skew(axis)
    T = np.tile(np.eye(4), (len(angle), 1, 1))
    T[:, :3, :3] += np.sin(angle)[:, None, None] * K + (1.0 - np.cos(angle))[:, None, None] * (K @ K)
    return T


def turned_about(R: Array, axis: Array) -> tuple[Array, Array]:
    """Return the angles (m,) of the rotations (m, 3, 3) about `axis`, and what of them is not about it."""
    # In terms of the quaternion (w, v) with c = v . axis: 4 w c over 2 (w^2 - c^2), and 2 (w^2 + c^2) - 1.
    sine = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1) @ axis
    kept = np.einsum("i,mij,j->m", axis, R, axis)
    return np.arctan2(sine, np.trace(R, axis1=1, axis2=2) - kept), np.arccos(np.clip(kept, -1.0, 1.0))
