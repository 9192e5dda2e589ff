"""A sideboard. Lengths in m; the root is on the floor under its middle, the front faces +x."""

from __future__ import annotations

import math

from robot_models.shapes import Mesh, cylinder, join, lathe, rod, span
from robot_models.urdf import Joint, Link, Robot

WIDTH, DEPTH, HEIGHT, LEGS = 1.00, 0.40, 0.80, 0.12
PANEL = 0.018
DIVIDER = 0.127
DRAWERS = {"upper_drawer": (0.600, 0.778), "lower_drawer": (0.364, 0.597)}
DRAWER_STROKE = 0.30


def build() -> Robot:
    front = DEPTH / 2.0
    half = WIDTH / 2.0
    links = [Link("carcass", _carcass(front, half))]
    joints: list[Joint] = []
    doors = {"left_door": (-half + 0.001, 0.311, 1.0), "right_door": (DIVIDER - 0.001, 0.311, -1.0)}
    for name, (hinge_y, width, sign) in doors.items():
        links.append(Link(name, _door(width, sign)))
        joints.append(
            Joint(
                f"{name}_hinge", "revolute", "carcass", name, (front + PANEL, hinge_y, LEGS + 0.004),
                axis=(0.0, 0.0, -sign), limits=(0.0, math.radians(110.0)),
            )
        )  # fmt: skip
    for name, (z0, z1) in DRAWERS.items():
        links.append(Link(name, _drawer(z1 - z0, half - 0.001 - DIVIDER - 0.002)))
        centre = (DIVIDER + 0.002 + half - 0.001) / 2.0
        joints.append(
            Joint(
                f"{name}_slide", "prismatic", "carcass", name, (front, centre, z0), axis=(1.0, 0.0, 0.0),
                limits=(0.0, DRAWER_STROKE), effort=50.0, velocity=0.5,
            )
        )  # fmt: skip
    materials = {
        "walnut": (0.45, 0.31, 0.21, 1.0),
        "white": (0.90, 0.89, 0.86, 1.0),
        "brass": (0.78, 0.62, 0.32, 1.0),
    }
    comment = "A sideboard with two doors, two drawers and an open niche, front towards +x"
    return Robot("cabinet", comment, materials, links, joints)


def _carcass(front: float, half: float) -> dict[str, Mesh]:
    low, high = LEGS, HEIGHT
    inside_back = -front + 0.006
    panels = [
        span((-front, -half, low), (front, -half + PANEL, high - PANEL)),
        span((-front, half - PANEL, low), (front, half, high - PANEL)),
        span((-front, -half - 0.012, high - PANEL), (front + PANEL + 0.012, half + 0.012, high), 0.003),
        span((inside_back, -half + PANEL, low), (front, half - PANEL, low + PANEL)),
        span((inside_back, DIVIDER - PANEL / 2.0, low + PANEL), (front, DIVIDER + PANEL / 2.0, high - PANEL)),
        span((inside_back, -half + PANEL, 0.44), (front - 0.04, DIVIDER - PANEL / 2.0, 0.44 + PANEL)),
        span((inside_back, DIVIDER + PANEL / 2.0, 0.342), (front, half - PANEL, 0.342 + PANEL)),
    ]
    back = [
        span((-front, -half + PANEL, low), (inside_back, half - PANEL, high - PANEL)),
        # A rail behind, on one side only: the fixing to the wall.
        span((-front - 0.012, -half + 0.08, high - 0.16), (-front, DIVIDER, high - 0.10)),
    ]
    leg = lathe([(0, 0), (0.011, 0), (0.019, LEGS), (0, LEGS)], 14)
    legs = [leg.at(x, y, 0.0) for x in (-front + 0.05, front - 0.04) for y in (-half + 0.06, half - 0.06)]
    stretcher = rod((-front + 0.05, -half + 0.06, 0.06), (-front + 0.05, half - 0.06, 0.06), 0.008)
    return {"walnut": join([*panels, *legs, stretcher]), "white": join(back)}


def _door(width: float, sign: float) -> dict[str, Mesh]:
    """Return a framed door in the frame of its hinge; it reaches to +y for sign 1 and to -y for sign -1."""
    height, stile = 0.654, 0.055
    wood = [
        span((-PANEL, 0.0, 0.0), (0.0, stile, height)),
        span((-PANEL, width - stile, 0.0), (0.0, width, height)),
        span((-PANEL, stile, 0.0), (0.0, width - stile, stile)),
        span((-PANEL, stile, height - stile), (0.0, width - stile, height)),
        span((-PANEL + 0.001, stile, stile), (-0.008, width - stile, height - stile)),
    ]
    y = width - 0.028
    metal = [
        rod((0.028, y, 0.40), (0.028, y, 0.56), 0.006),
        rod((0.0, y, 0.42), (0.028, y, 0.42), 0.005),
        rod((0.0, y, 0.54), (0.028, y, 0.54), 0.005),
    ]
    if sign < 0.0:
        # The right door closes over the left one and holds the lock.
        metal.append(cylinder(0.012, 0.008, 14).turned("y", math.pi / 2.0).at(0.004, y, 0.32))
    else:
        metal.append(span((-PANEL - 0.012, y - 0.02, 0.30), (-PANEL, y + 0.02, 0.34)))
    meshes = {"white": join(wood), "brass": join(metal)}
    return meshes if sign > 0.0 else {name: mesh.mirrored("y") for name, mesh in meshes.items()}


def _drawer(height: float, width: float) -> dict[str, Mesh]:
    """Return a drawer, closed with its front's inner face at x = 0, from z = 0 up, centred in y."""
    length, side, wall = 0.36, width / 2.0 - 0.030, 0.012
    top = height - 0.045
    tray = [
        span((-length, -side, 0.030), (0.0, -side + wall, top)),
        span((-length, side - wall, 0.030), (0.0, side, top)),
        span((-length, -side + wall, 0.030), (-length + wall, side - wall, top)),
        span((-length + wall, -side + wall, 0.036), (0.0, side - wall, 0.042)),
    ]
    face = span((0.0, -width / 2.0, 0.0), (PANEL, width / 2.0, height), 0.002)
    z = height / 2.0 + 0.02
    metal = [
        rod((PANEL + 0.028, -0.07, z), (PANEL + 0.028, 0.07, z), 0.006),
        rod((PANEL, -0.055, z), (PANEL + 0.028, -0.055, z), 0.005),
        rod((PANEL, 0.055, z), (PANEL + 0.028, 0.055, z), 0.005),
    ]
    return {"walnut": join([*tray, face]), "brass": join(metal)}
