"""A two-tonne excavator. Lengths in m, x forwards, z up; the root is on the ground under the slewing axis."""

from __future__ import annotations

import math

import numpy as np

from robot_models.shapes import Mesh, box, cylinder, join, lathe, prism, rod, span, tube
from robot_models.urdf import Joint, Link, Robot

TRACK_LENGTH, TRACK_HEIGHT, TRACK_WIDTH, TRACK_GAUGE = 1.56, 0.38, 0.23, 0.75
SLEW_HEIGHT = 0.52
BOOM_FOOT, BOOM_LENGTH = (0.56, -0.12, 0.24), 1.75
BOOM_REST = 0.6
"""Elevation (rad) of the boom's chord at joint value 0, which holds the bucket above the ground."""
STICK_LENGTH = 1.05
ROCKER_SETBACK, ROCKER_LENGTH = 0.25, 0.17

MATERIALS = {
    "yellow": (0.93, 0.69, 0.13, 1.0),
    "dark": (0.17, 0.17, 0.18, 1.0),
    "grey": (0.45, 0.46, 0.48, 1.0),
}


def build() -> Robot:
    links = [
        Link("undercarriage", _undercarriage()),
        Link("blade", _blade()),
        Link("house", _house()),
        Link("boom", _boom()),
        Link("stick", _stick()),
        Link("bucket", _bucket()),
        Link("rocker", {"grey": _rocker()}),
        Link("bucket_link", {"grey": _bucket_link()}),
    ]
    joints = [
        Joint(
            "blade_lift",
            "revolute",
            "undercarriage",
            "blade",
            (0.52, 0.0, 0.28),
            axis=(0.0, -1.0, 0.0),
            limits=(-0.35, 0.40),
            effort=1e4,
        ),
        Joint("swing", "continuous", "undercarriage", "house", (0.0, 0.0, SLEW_HEIGHT), effort=1e4),
        Joint(
            "boom_lift",
            "revolute",
            "house",
            "boom",
            BOOM_FOOT,
            (0.0, -BOOM_REST, 0.0),
            axis=(0.0, -1.0, 0.0),
            limits=(-1.05, 0.60),
            effort=1e4,
        ),
        Joint(
            "stick_reach",
            "revolute",
            "boom",
            "stick",
            (BOOM_LENGTH, 0.0, 0.0),
            (0.0, math.pi / 2.0, 0.0),
            axis=(0.0, -1.0, 0.0),
            limits=(-1.05, 0.95),
            effort=1e4,
        ),
        Joint(
            "bucket_curl",
            "revolute",
            "stick",
            "bucket",
            (STICK_LENGTH, 0.0, 0.0),
            axis=(0.0, 1.0, 0.0),
            limits=(-0.90, 1.20),
            effort=1e4,
        ),
        # Rocker, link, bucket and stick make a parallelogram: constant multipliers close the loop exactly.
        Joint(
            "rocker_turn",
            "revolute",
            "stick",
            "rocker",
            (STICK_LENGTH - ROCKER_SETBACK, 0.0, 0.0),
            axis=(0.0, 1.0, 0.0),
            limits=(-0.90, 1.20),
            mimic=("bucket_curl", 1.0, 0.0),
            effort=1e4,
        ),
        Joint(
            "bucket_link_turn",
            "revolute",
            "rocker",
            "bucket_link",
            (0.0, 0.0, ROCKER_LENGTH),
            axis=(0.0, 1.0, 0.0),
            limits=(-1.20, 0.90),
            mimic=("bucket_curl", -1.0, 0.0),
            effort=1e4,
        ),
    ]
    comment = "A two-tonne excavator with dozer blade; the bucket's rocker and link mimic the bucket"
    return Robot("excavator", comment, MATERIALS, links, joints)


def _stadium(length: float, height: float, steps: int = 8) -> list[tuple[float, float]]:
    """Outline (x, z) of a track about its centre, counter-clockwise."""
    radius = height / 2.0
    arc = np.pi * np.arange(steps + 1) / steps - np.pi / 2.0
    right = [(length / 2.0 - radius + radius * math.cos(a), radius * math.sin(a)) for a in arc]
    return right + [(-x, -z) for x, z in right]


def _undercarriage() -> dict[str, Mesh]:
    dark: list[Mesh] = []
    grey: list[Mesh] = []
    radius, straight = TRACK_HEIGHT / 2.0, TRACK_LENGTH - TRACK_HEIGHT
    for side in (-1.0, 1.0):
        y = side * TRACK_GAUGE / 2.0
        dark.append(prism(_stadium(TRACK_LENGTH, TRACK_HEIGHT - 0.03), TRACK_WIDTH, along="y").at(0.0, y, radius))
        bar = box((0.035, TRACK_WIDTH, 0.03))
        for k in range(9):
            x = -straight / 2.0 + straight * k / 8.0
            dark += [bar.at(x, y, 0.015), bar.at(x, y, TRACK_HEIGHT - 0.015)]
        for k in range(1, 4):
            angle = math.pi * k / 4.0
            for end in (-1.0, 1.0):
                lug = bar.at(0.0, 0.0, radius - 0.015).turned("y", end * angle)
                dark.append(lug.at(end * straight / 2.0, y, radius))
        # Seen from the side: a toothed sprocket behind, a plain idler in front, three rollers below.
        out = y + side * (TRACK_WIDTH / 2.0 + 0.012)
        grey.append(_wheel(0.09, 0.05).at(straight / 2.0, out, radius))
        angles = 2.0 * np.pi * np.arange(24) / 24.0
        teeth = [
            ((0.125 if k % 2 else 0.095) * math.cos(a), (0.125 if k % 2 else 0.095) * math.sin(a))
            for k, a in enumerate(angles)
        ]
        grey.append(prism(teeth, 0.05, along="y").at(-straight / 2.0, out, radius))
        grey += [_wheel(0.05, 0.04).at(x, out, 0.10) for x in (-0.30, 0.0, 0.30)]
        grey.append(span((-0.40, out - 0.015, 0.16), (0.42, out + 0.015, 0.24), 0.005))
    inner = TRACK_GAUGE / 2.0 - TRACK_WIDTH / 2.0
    grey += [
        span((-0.32, -inner - 0.02, 0.17), (0.34, inner + 0.02, 0.36), 0.02),
        cylinder(0.27, 0.14, 28).at(0.0, 0.0, SLEW_HEIGHT - 0.08),
        *(span((0.30, y - 0.03, 0.22), (0.54, y + 0.03, 0.33)) for y in (-0.20, 0.20)),
    ]
    return {"dark": join(dark), "grey": join(grey)}


def _wheel(radius: float, width: float) -> Mesh:
    return cylinder(radius, width, 18).turned("x", math.pi / 2.0)


def _blade() -> dict[str, Mesh]:
    """Return the dozer blade in the frame of its hinge, which lies 0.28 m above the ground."""
    inner = [(0.46 - 0.05 * math.cos(a), -0.10 - 0.16 * math.sin(a)) for a in np.linspace(-1.2, 1.2, 7)]
    outline = inner + [(x + 0.025, z) for x, z in reversed(inner)]
    plate = prism([(x, z) for x, z in outline], 0.98, along="y")
    arms = [
        prism([(-0.02, -0.03), (0.43, -0.15), (0.43, -0.05), (-0.02, 0.03)], 0.07, along="y").at(0.0, y, 0.0)
        for y in (-0.20, 0.20)
    ]
    pins = rod((0.0, -0.26, 0.0), (0.0, 0.26, 0.0), 0.022)
    edge = box((0.02, 0.98, 0.05), (0.47, 0.0, -0.255))
    return {"yellow": join([plate, *arms]), "grey": join([pins, edge])}


def _house() -> dict[str, Mesh]:
    """Return the upper structure: engine behind, canopy on the left (+y), tank on the right."""
    deck = [
        (-0.52, -0.47),
        (0.44, -0.47),
        (0.50, -0.40),
        (0.50, 0.47),
        (-0.52, 0.47),
        (-0.66, 0.30),
        (-0.72, 0.0),
        (-0.66, -0.30),
    ]
    rear = [
        (-0.50, -0.46),
        (-0.22, -0.46),
        (-0.22, 0.46),
        (-0.50, 0.46),
        (-0.64, 0.30),
        (-0.70, 0.0),
        (-0.64, -0.30),
    ]
    x, y, z = BOOM_FOOT
    yellow = [
        prism(deck, 0.10, 0.015).at(0.0, 0.0, 0.09),
        prism(rear, 0.46, 0.03).at(0.0, 0.0, 0.36),
        span((-0.21, -0.46, 0.13), (0.30, -0.24, 0.50), 0.03),
        *(
            prism(
                [
                    (0.36, 0.10),
                    (x + 0.05, z - 0.06),
                    (x + 0.05, z + 0.06),
                    (x - 0.05, z + 0.06),
                    (0.36, 0.30),
                ],
                0.03,
                along="y",
            ).at(0.0, y + dy, 0.0)
            for dy in (-0.105, 0.105)
        ),
    ]
    dark = [
        cylinder(0.26, 0.05, 24).at(0.0, 0.0, 0.02),
        # Seat, console and pillars of the canopy.
        span((-0.12, 0.10, 0.13), (0.20, 0.42, 0.34), 0.02),
        prism([(-0.16, 0.34), (-0.07, 0.34), (-0.12, 0.82), (-0.20, 0.82)], 0.34, 0.02, along="y").at(0.0, 0.26, 0.0),
        span((0.10, 0.02, 0.34), (0.22, 0.09, 0.46)),
        rod((0.19, 0.055, 0.45), (0.22, 0.055, 0.60), 0.014),
        rod((0.36, 0.20, 0.13), (0.34, 0.20, 0.55), 0.014),
        rod((0.36, 0.32, 0.13), (0.34, 0.32, 0.55), 0.014),
        *(
            span((px - 0.025, py - 0.02, 0.13), (px + 0.025, py + 0.02, 1.70))
            for px, py in ((0.44, 0.44), (0.44, 0.02), (-0.24, 0.44), (-0.24, 0.02))
        ),
        span((-0.26, 0.425, 0.13), (0.46, 0.445, 0.52)),
        tube([(-0.38, -0.26, 0.58), (-0.38, -0.26, 0.80), (-0.44, -0.26, 0.86)], 0.030, 12),
        span((-0.16, -0.475, 0.22), (0.02, -0.458, 0.40)),
        rod((0.42, 0.46, 1.05), (0.52, 0.56, 1.05), 0.010),
        span((0.51, 0.52, 0.98), (0.53, 0.62, 1.20)),
        cylinder(0.05, 0.05, 14).at(0.16, -0.35, 0.52),
    ]
    roof = span((-0.32, -0.03, 1.68), (0.52, 0.49, 1.76), 0.025)
    light = lathe([(0, 0), (0.05, 0), (0.04, 0.08), (0, 0.10)], 14).at(-0.20, 0.36, 1.75)
    return {"yellow": join([*yellow, roof]), "dark": join([*dark, light])}


def _boom() -> dict[str, Mesh]:
    """Return the boom in the frame of its foot; the chord to the stick's pin lies along x."""
    outline = [
        (-0.06, -0.05),
        (0.02, -0.08),
        (0.70, 0.20),
        (0.82, 0.20),
        (1.68, -0.07),
        (1.79, -0.05),
        (1.80, 0.04),
        (1.66, 0.09),
        (0.86, 0.44),
        (0.64, 0.44),
        (-0.05, 0.06),
    ]
    body = prism(outline, 0.15, 0.012, along="y")
    lugs = [
        prism([(0.66, 0.40), (0.84, 0.40), (0.77, 0.54), (0.71, 0.54)], 0.03, along="y").at(0.0, y, 0.0)
        for y in (-0.05, 0.05)
    ]
    pipes = [
        tube([(0.06, y, 0.10), (0.66, y, 0.40), (0.86, y, 0.40), (1.60, y, 0.08)], 0.014, 8) for y in (0.09, 0.125)
    ]
    lamp = [
        box((0.06, 0.07, 0.08), (0.62, -0.115, 0.33), 0.008),
        rod((0.0, -0.135, 0.0), (0.0, 0.135, 0.0), 0.035, 14),
        rod((BOOM_LENGTH, -0.12, 0.0), (BOOM_LENGTH, 0.12, 0.0), 0.032, 14),
    ]
    return {"yellow": join([body, *lugs]), "dark": join(pipes), "grey": join(lamp)}


def _stick() -> dict[str, Mesh]:
    """Return the stick in the frame of its pin: x towards the bucket, z to the outer side."""
    outline = [
        (-0.24, 0.06),
        (-0.10, -0.06),
        (0.04, -0.10),
        (0.30, -0.075),
        (1.02, -0.045),
        (1.08, 0.0),
        (1.02, 0.045),
        (0.40, 0.075),
        (-0.10, 0.17),
        (-0.22, 0.16),
    ]
    body = prism(outline, 0.11, 0.010, along="y")
    barrel = [
        rod((0.06, 0.0, 0.19), (0.58, 0.0, 0.155), 0.034, 14),
        *(
            prism([(0.02, 0.12), (0.12, 0.10), (0.09, 0.22), (0.03, 0.22)], 0.018, along="y").at(0.0, y, 0.0)
            for y in (-0.045, 0.045)
        ),
        box((0.05, 0.10, 0.10), (0.54, 0.0, 0.10)),
    ]
    plates = [
        prism([(-0.06, -0.07), (0.10, -0.07), (0.10, 0.09), (-0.06, 0.12)], 0.02, along="y").at(0.0, y, 0.0)
        for y in (-0.098, 0.098)
    ]
    valve = [
        box((0.14, 0.05, 0.07), (0.22, 0.075, 0.02), 0.006),
        rod((-0.19, -0.08, 0.11), (-0.19, 0.08, 0.11), 0.025, 12),
    ]
    return {"yellow": join([body, *plates]), "dark": join(barrel), "grey": join(valve)}


def _bucket() -> dict[str, Mesh]:
    """Return the bucket in the frame of its pin, uncurled: x along the stick, its mouth to the machine."""
    outer = [
        (0.52, -0.20),
        (0.48, 0.02),
        (0.43, 0.18),
        (0.34, 0.28),
        (0.23, 0.31),
        (0.13, 0.27),
        (0.07, 0.19),
        (0.07, -0.13),
    ]
    inner = [
        (0.085, -0.13),
        (0.085, 0.18),
        (0.14, 0.255),
        (0.23, 0.293),
        (0.33, 0.265),
        (0.416, 0.172),
        (0.465, 0.018),
        (0.503, -0.20),
    ]
    width = 0.42
    shell = prism(outer + inner, width, along="y")
    cheeks = [prism(outer, 0.014, along="y").at(0.0, y, 0.0) for y in (-width / 2.0 + 0.007, width / 2.0 - 0.007)]
    ears = [
        prism([(-0.045, -0.03), (0.08, -0.10), (0.08, 0.20), (-0.035, 0.205), (-0.045, 0.15)], 0.022, along="y").at(
            0.0, y, 0.0
        )
        for y in (-0.072, 0.072)
    ]
    tooth = prism([(0.535, -0.29), (0.545, -0.29), (0.525, -0.16), (0.495, -0.16)], 0.045, along="y")
    teeth = [tooth.at(0.0, y, 0.0) for y in (-0.18, -0.06, 0.06, 0.18)]
    pins = [rod((0.0, -0.10, z), (0.0, 0.10, z), 0.024, 12) for z in (0.0, ROCKER_LENGTH)]
    return {"yellow": join([shell, *cheeks, *ears]), "grey": join([*teeth, *pins])}


def _rocker() -> Mesh:
    """Return the rocker in the frame of its pin on the stick: two plates and the pin that holds the link."""
    plates = [box((0.07, 0.016, ROCKER_LENGTH + 0.07), (0.0, y, ROCKER_LENGTH / 2.0), 0.004) for y in (-0.068, 0.068)]
    pins = [
        rod((0.0, -0.085, 0.0), (0.0, 0.085, 0.0), 0.022, 12),
        rod((0.0, -0.12, ROCKER_LENGTH), (0.0, 0.12, ROCKER_LENGTH), 0.022, 12),
    ]
    return join([*plates, *pins])


def _bucket_link() -> Mesh:
    """Return the link from rocker to bucket in the frame of its rocker end, reaching along x."""
    bars = [box((ROCKER_SETBACK + 0.07, 0.018, 0.06), (ROCKER_SETBACK / 2.0, y, 0.0), 0.004) for y in (-0.108, 0.108)]
    brace = box((0.05, 0.20, 0.03), (ROCKER_SETBACK / 2.0, 0.0, 0.012))
    return join([*bars, brace])
