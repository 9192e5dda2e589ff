"""A Viking-style Mars lander. Lengths in m, x forwards, z up; the root is on the ground under the body.

The long side with the cameras and the sampler faces +x; the legs stand at 60, 180 and 300 degrees about z.
"""

from __future__ import annotations

import math
from collections import defaultdict

import numpy as np

from robot_models.shapes import Mesh, box, cylinder, join, lathe, prism, rod, span, sphere, tube
from robot_models.urdf import Joint, Link, Robot

Coloured = defaultdict[str, list[Mesh]]
"""Meshes by the colour that they are painted in, of `MATERIALS`."""

THIRD = 2.0 * math.pi / 3.0
"""Of a turn, rad."""
LONG_SIDE, SHORT_SIDE = 1.09, 0.56
FOOTPAD_TRIANGLE = 2.21
DECK, KEEL = 0.90, 0.44
LONG_INRADIUS = FOOTPAD_TRIANGLE / (2.0 * math.sqrt(3.0))
FOOTPAD_REACH = FOOTPAD_TRIANGLE / math.sqrt(3.0)
SHORT_INRADIUS = FOOTPAD_REACH - SHORT_SIDE * math.sqrt(3.0) / 2.0
FOOTPAD_RADIUS = 0.1525
LEG_ANGLES = {"leg_1": math.pi, "leg_2": math.pi / 3.0, "leg_3": -math.pi / 3.0}
DISH_RADIUS, DISH_FOCUS = 0.38, 0.27
MAST, MAST_TOP, DISH_AXIS = (-0.66, -0.12), 1.55, 0.20
SHOULDER, SHOULDER_HEIGHT = (0.60, 0.0), 0.15
BOOM_STROKE, BOOM_SECTIONS, SECTION_LENGTH = 3.0, 5, 0.66
CAMERA_X, CAMERA_SPACING, CAMERA_EYE = 0.47, 0.80, 1.30
BOOM_STOWED = math.atan2(0.80 - 0.05, FOOTPAD_REACH - 0.80)

MATERIALS = {
    "white": (0.86, 0.86, 0.84, 1.0),
    "grey": (0.55, 0.57, 0.60, 1.0),
    "dark": (0.20, 0.21, 0.23, 1.0),
    "titanium": (0.68, 0.66, 0.62, 1.0),
    "orange": (0.80, 0.45, 0.18, 1.0),
}


def build() -> Robot:
    links = [Link("body", _body())]
    joints: list[Joint] = []
    for name, angle in LEG_ANGLES.items():
        links.append(Link(name, _leg()))
        joints.append(Joint(f"{name}_mount", "fixed", "body", name, rpy=(0.0, 0.0, angle)))
    for add in (_dish, _sampler, _meteorology):
        more_links, more_joints = add()
        links += more_links
        joints += more_joints
    comment = "A Viking-style lander in metres, root on the ground under the body"
    return Robot("viking_lander", comment, MATERIALS, links, joints)


def hexagon() -> np.ndarray:
    """Return the (6, 2) outline of the body; its long sides, prolonged, make the triangle of the footpads."""
    points = []
    for angle in (0.0, 2.0 * math.pi / 3.0, 4.0 * math.pi / 3.0):
        normal, along = _directions(angle)
        points += [
            LONG_INRADIUS * normal - LONG_SIDE / 2.0 * along,
            LONG_INRADIUS * normal + LONG_SIDE / 2.0 * along,
        ]
    return np.array(points)


def _directions(angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the outward normal and the counter-clockwise tangent of the side that faces `angle`."""
    return np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])


def _on_side(mesh: Mesh, angle: float, out: float, along: float, z: float) -> Mesh:
    """Place a mesh built with x outwards and y along a side."""
    return mesh.at(out, along, z).turned("z", angle)


def _body() -> dict[str, Mesh]:
    parts: Coloured = defaultdict(list)
    parts["white"].append(prism(hexagon(), DECK - KEEL).at(0.0, 0.0, (DECK + KEEL) / 2.0))
    for group in (
        _side_panels(),
        _propulsion(),
        _under_the_keel(),
        _generators(),
        _cameras(),
        _sample_inlets(),
        _instruments(),
        _mast(),
        _brackets(),
    ):
        for colour, meshes in group.items():
            parts[colour] += meshes
    return {colour: join(parts[colour]) for colour in MATERIALS}


def _side_panels() -> Coloured:
    """Return the side panels: each side has its own, so that the sixfold outline is not mistaken for itself."""
    parts: Coloured = defaultdict(list)
    parts["white"] += [
        _on_side(box((0.03, 0.34, 0.30), bevel=0.008), 0.0, LONG_INRADIUS, -0.31, 0.68),
        _on_side(box((0.05, 0.22, 0.20), bevel=0.008), 0.0, LONG_INRADIUS, 0.36, 0.62),
        _on_side(box((0.04, 0.30, 0.14), bevel=0.008), THIRD, LONG_INRADIUS, -0.33, 0.80),
        _on_side(box((0.06, 0.16, 0.30), bevel=0.008), -THIRD, LONG_INRADIUS, 0.40, 0.66),
    ]
    parts["grey"] += [
        _on_side(box((0.08, 0.20, 0.16), bevel=0.01), 1.5 * THIRD, SHORT_INRADIUS, -0.16, 0.56),
        _on_side(box((0.05, 0.30, 0.10), bevel=0.01), 0.5 * THIRD, SHORT_INRADIUS, 0.08, 0.52),
    ]
    return parts


def _propulsion() -> Coloured:
    """Return three engines 120 degrees apart on the long sides, with two spherical tanks behind the rear ones."""
    parts: Coloured = defaultdict(list)
    for angle in (0.0, THIRD, -THIRD):
        engine = [
            lathe([(0, 0.10), (0.10, 0.10), (0.10, 0.14), (0.06, 0.22), (0.06, 0.34), (0, 0.34)], 18),
            *(
                cylinder(0.014, 0.06, 8, 0.010).turned("x", math.pi).at(0.075 * math.cos(a), 0.075 * math.sin(a), 0.08)
                for a in 2.0 * math.pi * np.arange(9) / 9.0
            ),
        ]
        parts["grey"].append(_on_side(join(engine), angle, LONG_INRADIUS + 0.07, 0.0, 0.22))
        parts["grey"].append(_on_side(box((0.10, 0.10, 0.06)), angle, LONG_INRADIUS + 0.03, 0.0, 0.58))
    parts["titanium"].append(_on_side(sphere(0.23), THIRD, LONG_INRADIUS + 0.06, 0.34, 0.62))
    parts["titanium"].append(_on_side(sphere(0.23), -THIRD, LONG_INRADIUS + 0.06, -0.34, 0.62))
    return parts


def _under_the_keel() -> Coloured:
    """Return the landing radar's plate and the round antenna of the altimeter, under the keel."""
    parts: Coloured = defaultdict(list)
    parts["grey"].append(box((0.46, 0.40, 0.07), (-0.12, 0.10, KEEL - 0.03), 0.01))
    parts["white"].append(cylinder(0.13, 0.08, 20).at(0.22, -0.25, KEEL - 0.04))
    parts["orange"].append(box((0.20, 0.14, 0.09), (-0.35, -0.32, KEEL - 0.04), 0.01))
    return parts


def _generators() -> Coloured:
    """Return the wind covers of the two generators, each 0.58 m across and 0.28 m tall, over the tanks."""
    parts: Coloured = defaultdict(list)
    cover = lathe([(0, 0), (0.29, 0), (0.29, 0.19), (0.20, 0.28), (0, 0.28)], 12)
    parts["white"].append(cover.at(-0.322, 0.357, DECK))
    parts["white"].append(cover.at(-0.322, -0.357, DECK))
    parts["grey"].append(cylinder(0.07, 0.06, 16).at(-0.322, -0.357, DECK + 0.30))
    parts["grey"].append(
        tube(
            [
                (-0.22, 0.34, DECK + 0.26),
                (-0.22, 0.34, DECK + 0.40),
                (-0.02, 0.48, DECK + 0.40),
                (0.10, 0.60, DECK - 0.01),
            ],
            0.022,
        )
    )
    parts["grey"].append(
        tube(
            [
                (-0.16, 0.28, DECK + 0.26),
                (-0.16, 0.28, DECK + 0.34),
                (0.04, 0.42, DECK + 0.34),
                (0.16, 0.54, DECK - 0.01),
            ],
            0.022,
        )
    )
    return parts


def _cameras() -> Coloured:
    """Return two cylindrical cameras 0.8 m apart near the front, their windows 1.3 m above the ground."""
    parts: Coloured = defaultdict(list)
    for y, window_turn in ((CAMERA_SPACING / 2.0, 0.0), (-CAMERA_SPACING / 2.0, -0.5)):
        camera = lathe([(0, 0), (0.085, 0), (0.085, 0.20), (0.062, 0.23), (0.062, 0.47), (0.045, 0.52), (0, 0.52)], 18)
        parts["white"].append(camera.at(CAMERA_X, y, DECK))
        slit = box((0.03, 0.035, 0.12), (0.055, 0.0, CAMERA_EYE - DECK)).turned("z", window_turn)
        parts["dark"].append(slit.at(CAMERA_X, y, DECK))
    return parts


def _sample_inlets() -> Coloured:
    """Return the sample inlets between the cameras, with the biology box on the right and the funnel on the left."""
    parts: Coloured = defaultdict(list)
    parts["orange"].append(box((0.22, 0.20, 0.17), (0.24, -0.19, DECK + 0.08), 0.01))
    parts["grey"].append(
        lathe([(0, 0), (0.035, 0), (0.035, 0.10), (0.075, 0.17), (0.065, 0.17), (0, 0.09)], 16).at(0.30, 0.16, DECK)
    )
    parts["grey"].append(cylinder(0.05, 0.10, 14).at(0.24, -0.19, DECK + 0.21))
    parts["white"].append(box((0.14, 0.16, 0.09), (0.12, 0.06, DECK + 0.04), 0.01))
    return parts


def _instruments() -> Coloured:
    """Return the seismometer, test targets, relay antenna on the left, low-gain antenna on the right."""
    parts: Coloured = defaultdict(list)
    parts["grey"].append(box((0.17, 0.15, 0.12), (-0.40, 0.0, DECK + 0.06), 0.015))
    for x, y, turn in ((-0.03, -0.33, 0.3), (0.07, 0.26, -0.3), (-0.10, 0.02, 0.0)):
        target = box((0.012, 0.16, 0.12)).turned("y", -0.5).at(0.0, 0.0, 0.11) + rod(
            (-0.01, 0, -0.01), (-0.01, 0, 0.10), 0.012
        )
        parts["white"].append(target.turned("z", turn).at(x, y, DECK))
    parts["dark"].append(cylinder(0.03, 0.26, 12).at(0.10, 0.66, DECK + 0.13))
    parts["dark"].append(lathe([(0, 0), (0.12, 0), (0.12, 0.02), (0, 0.02)], 8).at(0.10, 0.66, DECK + 0.10))
    parts["dark"] += [
        box((0.26, 0.02, 0.02), (0.10, 0.66, DECK + 0.25)).turned("z", 0.0),
        box((0.02, 0.26, 0.02), (0.10, 0.66, DECK + 0.25)),
    ]
    parts["grey"].append(rod((0.16, -0.66, DECK - 0.01), (0.16, -0.66, DECK + 0.42), 0.016))
    parts["white"].append(
        lathe([(0, 0), (0.03, 0), (0.07, 0.10), (0.055, 0.10), (0, 0.03)], 16).at(0.16, -0.66, DECK + 0.42)
    )
    return parts


def _mast() -> Coloured:
    """Return the mast of the high-gain dish near the rear edge, with its brace."""
    parts: Coloured = defaultdict(list)
    x, y = MAST
    parts["grey"].append(rod((x, y, DECK - 0.02), (x, y, MAST_TOP - 0.04), 0.035, 14))
    parts["grey"].append(rod((x + 0.02, y + 0.26, DECK - 0.01), (x, y, MAST_TOP - 0.25), 0.016))
    parts["grey"].append(box((0.14, 0.14, 0.05), (x, y, DECK + 0.02), 0.01))
    return parts


def _brackets() -> Coloured:
    """Return the foot of the sampler and bracket of the meteorology boom."""
    parts: Coloured = defaultdict(list)
    parts["grey"].append(cylinder(0.08, 0.05, 18).at(*SHOULDER, DECK + 0.015))
    parts["grey"].append(
        _on_side(box((0.12, 0.07, 0.05), bevel=0.006), math.pi / 3.0, SHORT_INRADIUS + 0.03, 0.16, DECK - 0.045)
    )
    return parts


def _leg() -> dict[str, Mesh]:
    """Return a leg in the frame of its short side: main strut, two braces, round footpad."""
    hip, ankle = np.array([SHORT_INRADIUS + 0.01, 0.0, 0.80]), np.array([FOOTPAD_REACH, 0.0, 0.07])
    knee = hip + 0.6 * (ankle - hip)
    struts = [
        rod(hip, knee, 0.045, 14),
        rod(knee, ankle, 0.028, 12),
        box((0.08, 0.14, 0.12), hip - np.array([0.01, 0.0, -0.02]), 0.01),
    ]
    for side in (-1.0, 1.0):
        corner = np.array([SHORT_INRADIUS - 0.01, side * 0.24, KEEL + 0.04])
        struts += [rod(corner, knee, 0.022), box((0.05, 0.06, 0.06), corner)]
    pad = lathe(
        [
            (0, 0),
            (0.10, 0),
            (FOOTPAD_RADIUS, 0.035),
            (FOOTPAD_RADIUS, 0.055),
            (0.10, 0.045),
            (0.05, 0.085),
            (0, 0.085),
        ],
        20,
    )
    return {"grey": join(struts), "titanium": pad.at(FOOTPAD_REACH, 0.0, 0.0)}


def _dish() -> tuple[list[Link], list[Joint]]:
    yoke = [
        cylinder(0.06, 0.08, 18),
        box((0.12, 0.20, 0.03), (0.0, 0.0, 0.055)),
        span((-0.04, 0.075, 0.05), (0.04, 0.10, DISH_AXIS + 0.04)),
        span((-0.04, -0.10, 0.05), (0.04, -0.075, DISH_AXIS + 0.04)),
        box((0.07, 0.08, 0.09), (0.0, 0.14, DISH_AXIS), 0.008),
    ]
    depth = DISH_RADIUS**2 / (4.0 * DISH_FOCUS)
    radii = np.linspace(0.0, DISH_RADIUS, 9)
    curve = radii**2 / (4.0 * DISH_FOCUS)
    back = [(r, z - 0.012) for r, z in zip(radii, curve, strict=True)]
    front = [(r, z) for r, z in zip(radii[::-1], curve[::-1], strict=True)]
    reflector = lathe(back + front, 36).turned("y", math.pi / 2.0).at(0.10, 0.0, 0.0)
    rim = [(0.10 + depth, DISH_RADIUS * 0.98 * math.cos(a), DISH_RADIUS * 0.98 * math.sin(a)) for a in (0.5, 2.6, 4.7)]
    feed = (0.10 + DISH_FOCUS, 0.0, 0.0)
    feed_mount = [rod(np.array(point) - (0.01, 0.0, 0.0), feed, 0.009, 8) for point in rim]
    hub = [
        box((0.12, 0.13, 0.12), (0.03, 0.0, 0.0), 0.01),
        rod((0.0, -0.11, 0.0), (0.0, 0.11, 0.0), 0.02),
        span((-0.14, -0.05, -0.05), (-0.03, 0.03, 0.03)),
        cylinder(0.045, 0.07, 16).turned("y", math.pi / 2.0).at(*feed),
        *feed_mount,
    ]
    x, y = MAST
    links = [
        Link("antenna_yoke", {"grey": join(yoke)}),
        Link("antenna_dish", {"white": reflector, "grey": join(hub)}),
    ]
    joints = [
        Joint(
            "antenna_azimuth",
            "revolute",
            "body",
            "antenna_yoke",
            (x, y, MAST_TOP),
            limits=_degrees(-175.0, 175.0),
        ),
        Joint(
            "antenna_elevation",
            "revolute",
            "antenna_yoke",
            "antenna_dish",
            (0.0, 0.0, DISH_AXIS),
            axis=(0.0, -1.0, 0.0),
            limits=_degrees(-20.0, 95.0),
        ),
    ]
    return links, joints


def _sampler() -> tuple[list[Link], list[Joint]]:
    turret = [
        cylinder(0.065, 0.06, 18).at(0.0, 0.0, 0.07),
        span((-0.05, 0.07, 0.06), (0.05, 0.09, SHOULDER_HEIGHT + 0.05)),
        span((-0.05, -0.09, 0.06), (0.05, -0.07, SHOULDER_HEIGHT + 0.05)),
        box((0.10, 0.18, 0.03), (0.0, 0.0, 0.085)),
        rod((0.0, -0.16, 0.075), (0.0, -0.07, 0.075), 0.03, 12),
    ]
    housing = [
        prism([(-0.02, -0.055), (0.68, -0.055), (0.68, 0.055), (-0.02, 0.075)], 0.12, 0.008, along="y"),
        cylinder(0.085, 0.10, 20).turned("x", math.pi / 2.0),
        rod((0.0, -0.10, 0.0), (0.0, 0.10, 0.0), 0.02),
        box((0.16, 0.06, 0.07), (0.20, 0.075, 0.0), 0.008),
        box((0.03, 0.14, 0.13), (0.665, 0.0, 0.0), 0.006),
    ]
    links = [
        Link("sampler_turret", {"grey": join(turret)}),
        Link("sampler_housing", {"white": join(housing)}),
    ]
    joints = [
        Joint(
            "sampler_azimuth",
            "revolute",
            "body",
            "sampler_turret",
            (*SHOULDER, DECK),
            limits=_degrees(-144.0, 144.0),
        ),
        Joint(
            "sampler_elevation",
            "revolute",
            "sampler_turret",
            "sampler_housing",
            (0.0, 0.0, SHOULDER_HEIGHT),
            axis=(0.0, -1.0, 0.0),
            limits=_degrees(-40.0, 34.0),
        ),
    ]
    for k in range(1, BOOM_SECTIONS + 1):
        section = rod((0.0, 0.0, 0.0), (SECTION_LENGTH, 0.0, 0.0), 0.052 - 0.007 * k, 14)
        share = k / BOOM_SECTIONS
        last = k == BOOM_SECTIONS
        name = "sampler_boom" if last else f"sampler_boom_{k}"
        links.append(Link(name, {"titanium": section}))
        joints.append(
            Joint(
                "sampler_extension" if last else f"sampler_extension_{k}",
                "prismatic",
                "sampler_housing",
                name,
                axis=(1.0, 0.0, 0.0),
                limits=(0.0, round(BOOM_STROKE * share, 6)),
                mimic=None if last else ("sampler_extension", share, 0.0),
                effort=100.0,
                velocity=0.1,
            )
        )
    head = [
        prism(
            [(0.0, -0.04), (0.13, -0.04), (0.27, -0.005), (0.27, 0.005), (0.13, 0.045), (0.0, 0.045)],
            0.085,
            along="y",
        ),
        prism([(0.02, -0.14), (0.05, -0.14), (0.10, -0.03), (0.02, -0.03)], 0.065, along="y"),
        box((0.08, 0.04, 0.06), (0.06, -0.058, 0.01), 0.004),
    ]
    links.append(Link("collector_head", {"orange": join(head)}))
    joints.append(Joint("collector_head_mount", "fixed", "sampler_boom", "collector_head", (SECTION_LENGTH, 0.0, 0.0)))
    return links, joints


def _meteorology() -> tuple[list[Link], list[Joint]]:
    boom = [
        cylinder(0.03, 0.09, 14).turned("x", math.pi / 2.0),
        rod((0.0, 0.0, 0.0), (0.72, 0.0, 0.0), 0.018, 12),
    ]
    sensors = [
        box((0.09, 0.07, 0.11), (0.74, 0.0, 0.0), 0.008),
        rod((0.76, 0.0, 0.0), (0.76, 0.0, 0.17), 0.012, 8),
        box((0.10, 0.05, 0.02), (0.78, 0.0, 0.17)),
        rod((0.75, 0.0, -0.02), (0.88, 0.0, -0.09), 0.010, 8),
    ]
    link = Link("meteorology_boom", {"grey": join(boom), "white": join(sensors)})
    normal, along = _directions(math.pi / 3.0)
    x, y = (SHORT_INRADIUS + 0.07) * normal + 0.16 * along
    hinge = Joint(
        "meteorology_hinge",
        "revolute",
        "body",
        link.name,
        (x, y, DECK + 0.01),
        (0.0, BOOM_STOWED, math.pi / 3.0),
        axis=(0.0, -1.0, 0.0),
        limits=_degrees(0.0, 130.0),
    )
    return [link], [hinge]


def _degrees(lower: float, upper: float) -> tuple[float, float]:
    return math.radians(lower), math.radians(upper)
