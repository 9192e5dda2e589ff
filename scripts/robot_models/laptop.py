"""A 14-inch laptop. Lengths in m; the root is under the middle of the base, +x towards the user."""

from __future__ import annotations

import math

from robot_models.shapes import Mesh, box, join, lathe, prism, rod, span
from robot_models.urdf import Joint, Link, Robot

WIDTH, DEPTH, DECK = 0.326, 0.222, 0.0170
HINGE = (-0.1035, 0.0215)


def build() -> Robot:
    x, z = HINGE
    links = [Link("base", _base()), Link("lid", _lid())]
    joints = [
        Joint(
            "lid_hinge", "revolute", "base", "lid", (x, 0.0, z), axis=(0.0, -1.0, 0.0),
            limits=(0.0, math.radians(135.0)), effort=2.0,
        )
    ]  # fmt: skip
    materials = {
        "aluminium": (0.66, 0.68, 0.71, 1.0),
        "black": (0.10, 0.10, 0.11, 1.0),
        "glass": (0.16, 0.18, 0.22, 1.0),
    }
    comment = "A 14-inch laptop, +x towards the user; the lid is closed at 0"
    return Robot("laptop", comment, materials, links, joints)


def _base() -> dict[str, Mesh]:
    half_x, half_y = DEPTH / 2.0, WIDTH / 2.0
    floor = 0.0140
    keys = (-0.086, 0.016)
    pad_x, pad_y = (0.026, 0.100), (-0.066, 0.046)
    metal = [
        span((-half_x, -half_y, 0.0025), (half_x, half_y, 0.0055), 0.0012),
        _port_layer(half_x, half_y, 0.0055, floor),
        # The deck stands around the wells of the keyboard and of the touchpad, left of the middle.
        span((-half_x, -half_y, floor), (keys[0], half_y, DECK)),
        span((keys[0], -half_y, floor), (keys[1], -half_y + 0.019, DECK)),
        span((keys[0], half_y - 0.019, floor), (keys[1], half_y, DECK)),
        span((keys[1], -half_y, floor), (pad_x[0], half_y, DECK)),
        span((pad_x[0], -half_y, floor), (pad_x[1], pad_y[0], DECK)),
        span((pad_x[0], pad_y[1], floor), (pad_x[1], half_y, DECK)),
        span((pad_x[1], -half_y, floor), (half_x, half_y, DECK)),
    ]
    black = _keys(keys[0], -half_y + 0.019, floor)
    black += [
        # Feet: two short ones in front, a long bar behind; between them the grille, off the middle.
        span((half_x - 0.030, -half_y + 0.02, 0.0), (half_x - 0.020, -half_y + 0.06, 0.0026)),
        span((half_x - 0.030, half_y - 0.06, 0.0), (half_x - 0.020, half_y - 0.02, 0.0026)),
        span((-half_x + 0.015, -half_y + 0.03, 0.0), (-half_x + 0.027, half_y - 0.03, 0.0026)),
        *(span((-0.06 + 0.011 * k, -0.11, 0.0012), (-0.055 + 0.011 * k, 0.01, 0.0026)) for k in range(6)),
        *(
            span((HINGE[0] - 0.007, y - 0.006, DECK - 0.0005), (HINGE[0] + 0.006, y + 0.006, HINGE[1] + 0.003))
            for y in (-0.122, 0.122)
        ),
        span((-0.082, half_y - 0.014, DECK - 0.0005), (0.006, half_y - 0.005, DECK + 0.0010)),
    ]
    glass = [span((pad_x[0] + 0.001, pad_y[0] + 0.001, floor), (pad_x[1] - 0.001, pad_y[1] - 0.001, DECK - 0.0012))]
    return {"aluminium": join(metal), "black": join(black), "glass": join(glass)}


def _port_layer(half_x: float, half_y: float, low: float, high: float) -> Mesh:
    """Return the middle layer of the base, notched by its ports: four left, three right, a vent behind."""
    depth = 0.007
    outline: list[tuple[float, float]] = [(-half_x, -half_y)]
    for x, width in ((-0.088, 0.010), (-0.068, 0.010), (-0.045, 0.016), (-0.020, 0.010)):
        outline += [
            (x - width / 2, -half_y),
            (x - width / 2, -half_y + depth),
            (x + width / 2, -half_y + depth),
            (x + width / 2, -half_y),
        ]
    outline += [(half_x, -half_y), (half_x, half_y)]
    for x, width in ((0.010, 0.006), (-0.030, 0.014), (-0.080, 0.014)):
        outline += [
            (x + width / 2, half_y),
            (x + width / 2, half_y - depth),
            (x - width / 2, half_y - depth),
            (x - width / 2, half_y),
        ]
    outline += [(-half_x, half_y)]
    for y, width in ((0.075, 0.014), (0.055, 0.014), (0.035, 0.014), (0.015, 0.014)):
        outline += [
            (-half_x, y + width / 2),
            (-half_x + depth, y + width / 2),
            (-half_x + depth, y - width / 2),
            (-half_x, y - width / 2),
        ]
    return prism(outline, high - low).at(0.0, 0.0, (low + high) / 2.0)


def _keys(rear: float, left: float, floor: float) -> list[Mesh]:
    """Return the keys row by row from the rear; widths in units of the pitch, negative for a gap."""
    rows = [
        [1.0] * 15,
        [1.0] * 13 + [2.0],
        [1.5, *([1.0] * 12), 1.5],
        [1.75, *([1.0] * 11), 2.25],
        [2.25, *([1.0] * 10), 2.75],
        [1.0, 1.0, 1.0, 1.25, 5.5, 1.25, 1.0, -1.0, 1.0, -1.0],
    ]
    keys = []
    row_pitch = 0.0168
    for k, row in enumerate(rows):
        pitch = 0.288 / sum(abs(width) for width in row)
        y = left
        for width in row:
            if width > 0.0:
                low = (rear + 0.0015 + k * row_pitch, y + 0.0015, floor)
                high = (rear + (k + 1) * row_pitch - 0.0010, y + width * pitch - 0.0010, floor + 0.0020)
                keys.append(span(low, high))
            y += abs(width) * pitch
    return keys


def _lid() -> dict[str, Mesh]:
    """Return the lid in the frame of its hinge, closed: the screen looks down (-z), the outside up."""
    half_y, reach = WIDTH / 2.0, 0.2145
    shell = [
        span((0.003, -half_y, -0.0010), (reach, half_y, 0.0035), 0.0012),
        span((reach - 0.002, -0.020, -0.0030), (reach + 0.003, 0.020, 0.0025)),
        lathe([(0, 0), (0.016, 0), (0.016, 0.0010), (0, 0.0010)], 24).at(0.125, 0.0, 0.0034),
        box((0.010, 0.060, 0.0008), (0.030, 0.100, 0.0038)),
    ]
    sides, top, bottom, depth = 0.006, 0.010, 0.020, 0.0015
    low, high = -0.0010 - depth, -0.0010
    bezel = [
        span((0.003, -half_y, low), (0.003 + bottom, half_y, high)),
        span((reach - top, -half_y, low), (reach, half_y, high)),
        span((0.003 + bottom, -half_y, low), (reach - top, -half_y + sides, high)),
        span((0.003 + bottom, half_y - sides, low), (reach - top, half_y, high)),
        *(rod((0.0, y - 0.028, 0.0), (0.0, y + 0.028, 0.0), 0.0042, 14) for y in (-0.085, 0.085)),
        *(span((-0.001, y - 0.020, -0.0020), (0.006, y + 0.020, 0.0015)) for y in (-0.085, 0.085)),
    ]
    screen = [span((0.003 + bottom, -half_y + sides, high - 0.0004), (reach - top, half_y - sides, high))]
    return {"aluminium": join(shell), "black": join(bezel), "glass": join(screen)}
