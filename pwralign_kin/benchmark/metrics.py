"""Right or wrong, by the truth.

A case is a success when every observed part is found: the mean distance of its surface, placed by the
estimate, to its surface in truth (ADD-S of Hinterstoisser et al., ACCV 2012, but to the surface instead of to
vertices) is below 2% of the model's diagonal. A turn about a part's own symmetry axis costs nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.model import ArticulatedModel
from pwralign_kin.render import RayScene
from pwralign_kin.se3 import Array, inverse, transform
from pwralign_kin.state import State

FOUND = 0.02
"""Mean surface distance below which a part is found, model diagonals; ..."""
FINE = FOUND / 4
"""... found finely, ..."""
OVERLAID = FOUND / 2
"""... or overlaid, whichever part it is taken for."""

LEAST_POINTS, LEAST_SHARE = 15, 0.005
"""A part is observed with at least so many points and this share of the scan."""

SAMPLES = 300
"""Surface points a part is measured by."""

PROBE_TURN = float(np.radians(5.0))
"""A scan can tell a joint when turning it by this much (rad) ..."""
PROBE_SLIDE = 0.05
"""... or sliding it by this share of its range ..."""
TOLD = 0.003
"""... moves the surface of an observed part by more than this on average, model diagonals."""


@dataclass(frozen=True)
class Reference:
    """What a scan should lead to."""

    truth: State
    placements: Array
    """(parts, 4, 4) true placements in the scan frame."""

    observed: tuple[int, ...]
    """Indices of the parts that the scan shows."""

    told: tuple[str, ...]
    """Joints that the scan can tell."""


@dataclass(frozen=True)
class Score:
    """How right one answer is."""

    success: bool
    """Every observed part is found."""

    overlay: bool
    """A success, or equal to one up to interchangeable limbs."""

    fine: bool
    """Every observed part is found finely."""

    part_errors: Mapping[str, float]
    """Mean surface distance of each observed part, model diagonals; infinite without an answer."""

    joint_errors: Mapping[str, float]
    """Error of each joint: degrees, or percent of a slide's range; empty without an answer."""

    @property
    def recall(self) -> float:
        """Share of the observed parts that are found."""
        return float(np.mean([error < FOUND for error in self.part_errors.values()]))

    @property
    def mean_error(self) -> float:
        """Mean over the observed parts of their errors, each at most 1, model diagonals."""
        return float(np.mean([min(error, 1.0) for error in self.part_errors.values()]))


class Ruler:
    """Measures answers for one model against the truth."""

    def __init__(self, model: ArticulatedModel) -> None:
        """Sample the surface of every part that has one (seeded: always the same samples)."""
        self.model = model
        solid = {index: part for index, part in enumerate(model.parts) if len(part.faces)}
        self.samples = {i: surface_samples(p.vertices, p.faces, SAMPLES, i) for i, p in solid.items()}
        self.scenes = {i: RayScene(p.vertices, p.faces) for i, p in solid.items()}

    def placements(self, state: State) -> Array:
        """Return (parts, 4, 4) the placements of all parts in the scan frame."""
        return np.asarray(
            self.model.root_placement(state) @ self.model.part_placements(self.model.values(state.joints))
        )

    def reference(self, truth: State, labels: NDArray[np.int64]) -> Reference:
        """Return what the scan of `truth` should lead to; `labels` (n,) name the part of every scan point."""
        counts = np.bincount(labels[labels >= 0], minlength=len(self.model.parts))
        least = max(LEAST_POINTS, LEAST_SHARE * len(labels))
        observed = tuple(i for i in self.samples if counts[i] >= least)
        return Reference(truth, self.placements(truth), observed, self._told(truth, observed))

    def score(self, reference: Reference, answer: State | None) -> Score:
        """Return how right `answer` is; None is as wrong as can be."""
        if answer is None:
            names = [self.model.parts[i].name for i in reference.observed]
            return Score(False, False, False, dict.fromkeys(names, float("inf")), {})
        return replace(
            self.score_parts(reference, self.placements(answer)), joint_errors=self.joint_errors(reference, answer)
        )

    def score_parts(self, reference: Reference, placements: Array) -> Score:
        """Return how right parts placed one by one (parts, 4, 4) are, without joint errors."""
        errors = self.part_errors(reference, placements)
        names = [self.model.parts[i].name for i in reference.observed]
        success = bool((errors < FOUND).all())
        return Score(
            success=success,
            overlay=success or self.overlaid(reference, placements),
            fine=bool((errors < FINE).all()),
            part_errors=dict(zip(names, errors.tolist(), strict=True)),
            joint_errors={},
        )

    def part_errors(self, reference: Reference, placements: Array) -> Array:
        """Return the mean surface distance of each observed part, model diagonals."""
        moved = inverse(reference.placements) @ placements
        return np.array([self._displacement(i, moved[i]) for i in reference.observed])

    def surface_errors(self, reference: Reference, placed: Mapping[int, Array]) -> Array:
        """Return the same for a surface that need not be rigid: by part, where its samples (n, 3) are, m."""
        back = inverse(reference.placements)
        return np.array([self._distance(i, transform(back[i], placed[i])).mean() for i in reference.observed])

    def overlaid(self, reference: Reference, placements: Array) -> bool:
        """Return whether the answer looks right, whichever part is called which.

        Every observed part's true surface must lie on the posed model, and as many parts of the posed model
        on the true one.
        """
        if not all(self.overlaid_parts(reference, placements)):
            return False
        true = reference.placements
        right = sum(self._distance_to_all(i, placements, true) < OVERLAID for i in self.samples)
        return right >= len(reference.observed)

    def overlaid_parts(self, reference: Reference, placements: Array) -> Iterator[bool]:
        """Yield for each observed part whether its true surface lies on the posed model, whichever part is there."""
        for part in reference.observed:
            yield self._distance_to_all(part, reference.placements, placements) < OVERLAID

    def joint_errors(self, reference: Reference, answer: State) -> dict[str, float]:
        """Return the error of each joint: degrees, or percent of a slide's range."""
        model = self.model
        offsets = model.values(answer.joints) - model.values(reference.truth.joints)
        ranges = model.upper - model.lower
        shares = np.divide(100.0 * offsets, ranges, out=np.zeros_like(offsets), where=ranges > 0.0)
        errors = np.where(model.prismatic, shares, np.degrees([wrapped(o) for o in offsets]))
        return dict(zip(model.joint_names, np.abs(errors).tolist(), strict=True))

    def _told(self, truth: State, observed: tuple[int, ...]) -> tuple[str, ...]:
        model = self.model
        values = model.values(truth.joints)
        back = inverse(model.part_placements(values))
        told = []
        for index, name in enumerate(model.joint_names):
            span = model.upper[index] - model.lower[index]
            moved = values.copy()
            moved[index] += PROBE_SLIDE * span if model.units[name] == "m" else PROBE_TURN
            motions = back @ model.part_placements(moved)
            carried = [i for i in observed if not np.allclose(motions[i], np.eye(4), atol=1e-9)]
            if any(self._displacement(i, motions[i]) > TOLD for i in carried):
                told.append(name)
        return tuple(told)

    def _displacement(self, part: int, motion: Array) -> float:
        """Return the mean distance of a part's surface to itself after `motion` (4, 4), model diagonals."""
        return float(self._distance(part, transform(motion, self.samples[part])).mean())

    def _distance_to_all(self, part: int, placements: Array, others: Array) -> float:
        """Return the mean distance of one placed part's surface to all parts placed by `others`."""
        placed = transform(placements[part], self.samples[part])
        nearest = np.min([self._distance(i, transform(inverse(others[i]), placed)) for i in self.samples], axis=0)
        return float(nearest.mean())

    def _distance(self, part: int, points: Array) -> Array:
        """Return the distances (n,) of points (n, 3) in a part's frame to its surface, model diagonals."""
        closest, _, _ = self.scenes[part].closest(points)
        return np.asarray(np.linalg.norm(points - closest, axis=1) / self.model.diagonal)


def surface_samples(vertices: Array, faces: NDArray[np.int64], count: int, seed: int) -> Array:
    """Return (count, 3) points uniform on the triangles."""
    random = np.random.default_rng(seed)
    corners = vertices[faces]
    edges = corners[:, 1:] - corners[:, :1]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    face = random.choice(len(faces), count, p=area / area.sum())
    weights = random.dirichlet([1.0, 1.0, 1.0], count)
    return np.asarray(np.einsum("nc,nci->ni", weights, corners[face]))


def wrapped(angle: float) -> float:
    """Return the angle (rad) in [-pi, pi) that is equal up to full turns."""
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)
