"""A panelled room door in its frame. Lengths in m; the root is on the floor, the door opens to +x."""

from __future__ import annotations

import math
from itertools import pairwise

from robot_models.shapes import Mesh, box, cylinder, join, prism, rod, span, tube
from robot_models.urdf import Joint, Link, Robot

LEAF_WIDTH, LEAF_HEIGHT, LEAF_THICKNESS = 0.826, 2.040, 0.044
LEAF_BOTTOM, LEAF_GAP = 0.006, 0.003
LINING_DEPTH, LINING = 0.132, 0.032
HINGE_OFFSET = 0.006
BACKSET, HANDLE_HEIGHT = 0.060, 1.000


def build() -> Robot:
    face = LINING_DEPTH / 2.0
    axis = (face + HINGE_OFFSET, -LEAF_WIDTH / 2.0 - LEAF_GAP / 2.0)
    to_leaf = (-axis[0], -axis[1], 0.0)
    spindle = (face - LEAF_THICKNESS / 2.0, LEAF_WIDTH / 2.0 - BACKSET, HANDLE_HEIGHT)
    links = [
        Link("frame", _frame(face, axis)),
        Link("leaf", {name: mesh.at(*to_leaf) for name, mesh in _leaf(face, spindle).items()}),
        Link("handle", {"steel": _levers()}),
    ]
    joints = [
        Joint(
            "leaf_hinge",
            "revolute",
            "frame",
            "leaf",
            (*axis, 0.0),
            axis=(0.0, 0.0, -1.0),
            limits=(0.0, math.radians(110.0)),
            effort=50.0,
        ),
        Joint(
            "handle_turn",
            "revolute",
            "leaf",
            "handle",
            [s + t for s, t in zip(spindle, to_leaf, strict=True)],
            axis=(1.0, 0.0, 0.0),
            limits=(0.0, math.radians(40.0)),
        ),
    ]
    materials = {
        "paint": (0.93, 0.92, 0.88, 1.0),
        "oak": (0.72, 0.55, 0.36, 1.0),
        "steel": (0.62, 0.64, 0.66, 1.0),
    }
    comment = "A panelled room door in its frame, opening towards +x"
    return Robot("door", comment, materials, links, joints)


def _portal(inner: float, outer: float, top: float, outer_top: float, x: tuple[float, float]) -> Mesh:
    """Return three sides of a door frame: half widths, heights and extent in x."""
    outline = [
        (-outer, 0.0),
        (-inner, 0.0),
        (-inner, top),
        (inner, top),
        (inner, 0.0),
        (outer, 0.0),
        (outer, outer_top),
        (-outer, outer_top),
    ]
    return prism(outline, x[1] - x[0], along="x").at((x[0] + x[1]) / 2.0, 0.0, 0.0)


def _frame(face: float, axis: tuple[float, float]) -> dict[str, Mesh]:
    inner = LEAF_WIDTH / 2.0 + LEAF_GAP
    head = LEAF_BOTTOM + LEAF_HEIGHT + LEAF_GAP
    stop = face - LEAF_THICKNESS - 0.003
    wood = [
        _portal(inner, inner + LINING, head, head + LINING, (-face, face)),
        _portal(inner - 0.012, inner + 0.001, head - 0.012, head + 0.001, (stop - 0.032, stop)),
        _portal(inner + 0.010, inner + 0.079, head + 0.010, head + 0.079, (face, face + 0.018)),
        _portal(inner + 0.006, inner + 0.050, head + 0.006, head + 0.050, (-face - 0.014, -face)),
    ]
    metal = [
        span((-0.040, -inner + 0.012, 0.0), (0.040, inner - 0.012, 0.005)),
        span(
            (face - 0.040, inner - 0.002, HANDLE_HEIGHT - 0.08),
            (face - 0.012, inner + 0.001, HANDLE_HEIGHT + 0.04),
        ),
    ]
    # Knuckles alternate between frame and leaf along the pin; the frame carries the outer two of each hinge.
    for z in _hinge_heights():
        metal += [cylinder(0.0058, 0.028, 12).at(*axis, z + dz) for dz in (-0.032, 0.032)]
    return {"paint": join(wood), "steel": join(metal)}


def _hinge_heights() -> tuple[float, float, float]:
    return (0.25, 0.97, 1.85)


def _leaf(face: float, spindle: tuple[float, float, float]) -> dict[str, Mesh]:
    back, half = face - LEAF_THICKNESS, LEAF_WIDTH / 2.0
    low, high = LEAF_BOTTOM, LEAF_BOTTOM + LEAF_HEIGHT
    stile, muntin = 0.100, 0.050
    rails = [(low, low + 0.21), (0.88, 1.10), (high - 0.11, high)]
    wood = [span((back, y, low), (face, y + stile, high)) for y in (-half, half - stile)]
    wood += [span((back, -half + stile, z0), (face, half - stile, z1)) for z0, z1 in rails]
    for (_, z0), (z1, _) in pairwise(rails):
        wood.append(span((back, -muntin, z0), (face, muntin, z1)))
        for y0, y1 in ((-half + stile, -muntin), (muntin, half - stile)):
            wood.append(span((back + 0.014, y0, z0), (face - 0.014, y1, z1)))
            # Only the front has raised fields; the back shows flat panels.
            wood.append(span((face - 0.015, y0 + 0.045, z0 + 0.045), (face - 0.006, y1 - 0.045, z1 - 0.045), 0.003))
    hinge_axis = (face + HINGE_OFFSET, -half - LEAF_GAP / 2.0)
    metal = [cylinder(0.0058, 0.034, 12).at(*hinge_axis, z) for z in _hinge_heights()]
    _, y, z = spindle
    metal += [
        span((face, y - 0.022, z - 0.12), (face + 0.008, y + 0.022, z + 0.05), 0.0025),
        span((back - 0.008, y - 0.022, z - 0.12), (back, y + 0.022, z + 0.05), 0.0025),
        cylinder(0.014, 0.016, 14).turned("y", math.pi / 2.0).at(face + 0.014, y, z - 0.085),
        span((back - 0.002, -half + 0.03, low + 0.01), (back, half - 0.03, low + 0.19)),
        span((back - 0.008, -0.13, 1.155), (face + 0.010, 0.13, 1.215), 0.003),
        cylinder(0.013, LEAF_THICKNESS + 0.012, 14).turned("y", math.pi / 2.0).at((face + back) / 2.0, 0.0, 1.52),
    ]
    return {"oak": join(wood), "steel": join(metal)}


def _levers() -> Mesh:
    """Return both levers in the frame of their spindle, pointing to the hinge side (-y)."""
    half = LEAF_THICKNESS / 2.0
    front = tube(
        [(half + 0.004, 0, 0), (half + 0.050, 0, 0), (half + 0.050, -0.115, 0), (half + 0.012, -0.128, 0)],
        0.0095,
        12,
    )
    back = [
        rod((-half - 0.004, 0, 0), (-half - 0.056, 0, 0), 0.010, 12),
        box((0.012, 0.135, 0.022), (-half - 0.050, -0.060, 0.0), 0.004),
    ]
    return join([front, *back])
