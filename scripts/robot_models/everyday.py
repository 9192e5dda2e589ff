"""A room door, a cabinet and a laptop: the hinged and sliding things of a household. Lengths in m, z up."""

from __future__ import annotations

import math

from robot_models.shapes import Mesh, box, cylinder, join, lathe, prism, rod, span, tube
from robot_models.urdf import Joint, Link, Robot

# --- Door ---------------------------------------------------------------------------------------------------------

LEAF_WIDTH, LEAF_HEIGHT, LEAF_THICKNESS = 0.826, 2.040, 0.044
LEAF_BOTTOM, LEAF_GAP = 0.006, 0.003
LINING_DEPTH, LINING = 0.132, 0.032
HINGE_OFFSET = 0.006
BACKSET, HANDLE_HEIGHT = 0.060, 1.000


def door() -> Robot:
    """Return a door: the root frame is on the floor in the middle of the opening, +x on the side it opens to."""
    face = LINING_DEPTH / 2.0
    axis = (face + HINGE_OFFSET, -LEAF_WIDTH / 2.0 - LEAF_GAP / 2.0)
    to_leaf = (-axis[0], -axis[1], 0.0)
    spindle = (face - LEAF_THICKNESS / 2.0, LEAF_WIDTH / 2.0 - BACKSET, HANDLE_HEIGHT)
    links = [
        Link("frame", _door_frame(face, axis)),
        Link("leaf", {name: mesh.at(*to_leaf) for name, mesh in _leaf(face, spindle).items()}),
        Link("handle", {"steel": _levers()}),
    ]
    joints = [
        Joint(
            "leaf_hinge", "revolute", "frame", "leaf", (*axis, 0.0), axis=(0.0, 0.0, -1.0),
            limits=(0.0, math.radians(110.0)), effort=50.0,
        ),
        Joint(
            "handle_turn", "revolute", "leaf", "handle", [s + t for s, t in zip(spindle, to_leaf, strict=True)],
            axis=(1.0, 0.0, 0.0), limits=(0.0, math.radians(40.0)),
        ),
    ]  # fmt: skip
    materials = {"paint": (0.93, 0.92, 0.88, 1.0), "oak": (0.72, 0.55, 0.36, 1.0), "steel": (0.62, 0.64, 0.66, 1.0)}
    comment = "A panelled room door in its frame, opening towards +x. Built by scripts/build_robots.py"
    return Robot("door", comment, materials, links, joints)


def _portal(inner: float, outer: float, top: float, outer_top: float, x: tuple[float, float]) -> Mesh:
    """Return three sides of a door frame: half widths, heights and extent in x."""
    outline = [
        (-outer, 0.0), (-inner, 0.0), (-inner, top), (inner, top), (inner, 0.0), (outer, 0.0), (outer, outer_top),
        (-outer, outer_top),
    ]  # fmt: skip
    return prism(outline, x[1] - x[0], along="x").at((x[0] + x[1]) / 2.0, 0.0, 0.0)


def _door_frame(face: float, axis: tuple[float, float]) -> dict[str, Mesh]:
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
        span((face - 0.040, inner - 0.002, HANDLE_HEIGHT - 0.08), (face - 0.012, inner + 0.001, HANDLE_HEIGHT + 0.04)),
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
    for (_, z0), (z1, _) in zip(rails[:-1], rails[1:], strict=True):
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
    front = tube([(half + 0.004, 0, 0), (half + 0.050, 0, 0), (half + 0.050, -0.115, 0), (half + 0.012, -0.128, 0)], 0.0095, 12)
    back = [
        rod((-half - 0.004, 0, 0), (-half - 0.056, 0, 0), 0.010, 12),
        box((0.012, 0.135, 0.022), (-half - 0.050, -0.060, 0.0), 0.004),
    ]
    return join([front, *back])


# --- Cabinet ------------------------------------------------------------------------------------------------------

CABINET_WIDTH, CABINET_DEPTH, CABINET_HEIGHT, CABINET_LEGS = 1.00, 0.40, 0.80, 0.12
PANEL = 0.018
DIVIDER = 0.127
DRAWERS = {"upper_drawer": (0.600, 0.778), "lower_drawer": (0.364, 0.597)}
DRAWER_STROKE = 0.30


def cabinet() -> Robot:
    """Return a sideboard: root on the floor under its middle, front towards +x, +y to the right of who faces it."""
    front = CABINET_DEPTH / 2.0
    half = CABINET_WIDTH / 2.0
    links = [Link("carcass", _carcass(front, half))]
    joints: list[Joint] = []
    doors = {"left_door": (-half + 0.001, 0.311, 1.0), "right_door": (DIVIDER - 0.001, 0.311, -1.0)}
    for name, (hinge_y, width, sign) in doors.items():
        links.append(Link(name, _cabinet_door(width, sign)))
        joints.append(
            Joint(
                f"{name}_hinge", "revolute", "carcass", name, (front + PANEL, hinge_y, CABINET_LEGS + 0.004),
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
    comment = "A sideboard with two doors, two drawers and an open niche, front towards +x. Built by scripts/build_robots.py"
    return Robot("cabinet", comment, materials, links, joints)


def _carcass(front: float, half: float) -> dict[str, Mesh]:
    low, high = CABINET_LEGS, CABINET_HEIGHT
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
    legs = []
    for x in (-front + 0.05, front - 0.04):
        for y in (-half + 0.06, half - 0.06):
            legs.append(lathe([(0, 0), (0.011, 0), (0.019, CABINET_LEGS), (0, CABINET_LEGS)], 14).at(x, y, 0.0))
    stretcher = rod((-front + 0.05, -half + 0.06, 0.06), (-front + 0.05, half - 0.06, 0.06), 0.008)
    return {"walnut": join([*panels, *legs, stretcher]), "white": join(back)}


def _cabinet_door(width: float, sign: float) -> dict[str, Mesh]:
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


# --- Laptop -------------------------------------------------------------------------------------------------------

LAPTOP_WIDTH, LAPTOP_DEPTH, LAPTOP_DECK = 0.326, 0.222, 0.0170
LAPTOP_AXIS = (-0.1035, 0.0215)
KEY_PITCH = 0.0190


def laptop() -> Robot:
    """Return a 14-inch laptop: root under the middle of the base, +x towards the user, +y to the user's right."""
    x, z = LAPTOP_AXIS
    links = [Link("base", _laptop_base()), Link("lid", _laptop_lid())]
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
    comment = "A 14-inch laptop, +x towards the user; the lid is closed at 0. Built by scripts/build_robots.py"
    return Robot("laptop", comment, materials, links, joints)


def _laptop_base() -> dict[str, Mesh]:
    half_x, half_y = LAPTOP_DEPTH / 2.0, LAPTOP_WIDTH / 2.0
    floor = 0.0140
    keys = (-0.086, 0.016)
    pad_x, pad_y = (0.026, 0.100), (-0.066, 0.046)
    metal = [
        span((-half_x, -half_y, 0.0025), (half_x, half_y, 0.0055), 0.0012),
        _port_layer(half_x, half_y, 0.0055, floor),
        # The top deck stands around the wells of the keyboard and of the touchpad, which sits left of the middle.
        span((-half_x, -half_y, floor), (keys[0], half_y, LAPTOP_DECK)),
        span((keys[0], -half_y, floor), (keys[1], -half_y + 0.019, LAPTOP_DECK)),
        span((keys[0], half_y - 0.019, floor), (keys[1], half_y, LAPTOP_DECK)),
        span((keys[1], -half_y, floor), (pad_x[0], half_y, LAPTOP_DECK)),
        span((pad_x[0], -half_y, floor), (pad_x[1], pad_y[0], LAPTOP_DECK)),
        span((pad_x[0], pad_y[1], floor), (pad_x[1], half_y, LAPTOP_DECK)),
        span((pad_x[1], -half_y, floor), (half_x, half_y, LAPTOP_DECK)),
    ]
    black = _keys(keys[0], -half_y + 0.019, floor)
    black += [
        # Feet: two short ones in front, one long bar behind; between them the grille of the fan, off the middle.
        span((half_x - 0.030, -half_y + 0.02, 0.0), (half_x - 0.020, -half_y + 0.06, 0.0026)),
        span((half_x - 0.030, half_y - 0.06, 0.0), (half_x - 0.020, half_y - 0.02, 0.0026)),
        span((-half_x + 0.015, -half_y + 0.03, 0.0), (-half_x + 0.027, half_y - 0.03, 0.0026)),
        *(span((-0.06 + 0.011 * k, -0.11, 0.0012), (-0.055 + 0.011 * k, 0.01, 0.0026)) for k in range(6)),
        *(span((LAPTOP_AXIS[0] - 0.007, y - 0.006, LAPTOP_DECK - 0.0005), (LAPTOP_AXIS[0] + 0.006, y + 0.006, LAPTOP_AXIS[1] + 0.003))
          for y in (-0.122, 0.122)),
        span((-0.082, half_y - 0.014, LAPTOP_DECK - 0.0005), (0.006, half_y - 0.005, LAPTOP_DECK + 0.0010)),
    ]  # fmt: skip
    glass = [span((pad_x[0] + 0.001, pad_y[0] + 0.001, floor), (pad_x[1] - 0.001, pad_y[1] - 0.001, LAPTOP_DECK - 0.0012))]
    return {"aluminium": join(metal), "black": join(black), "glass": join(glass)}


def _port_layer(half_x: float, half_y: float, low: float, high: float) -> Mesh:
    """Return the middle layer of the base, its edge notched by the ports: four left, three right, the vent behind."""
    depth = 0.007
    outline: list[tuple[float, float]] = [(-half_x, -half_y)]
    for x, width in ((-0.088, 0.010), (-0.068, 0.010), (-0.045, 0.016), (-0.020, 0.010)):
        outline += [(x - width / 2, -half_y), (x - width / 2, -half_y + depth), (x + width / 2, -half_y + depth), (x + width / 2, -half_y)]
    outline += [(half_x, -half_y), (half_x, half_y)]
    for x, width in ((0.010, 0.006), (-0.030, 0.014), (-0.080, 0.014)):
        outline += [(x + width / 2, half_y), (x + width / 2, half_y - depth), (x - width / 2, half_y - depth), (x - width / 2, half_y)]
    outline += [(-half_x, half_y)]
    for y, width in ((0.075, 0.014), (0.055, 0.014), (0.035, 0.014), (0.015, 0.014)):
        outline += [(-half_x, y + width / 2), (-half_x + depth, y + width / 2), (-half_x + depth, y - width / 2), (-half_x, y - width / 2)]
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


def _laptop_lid() -> dict[str, Mesh]:
    """Return the lid in the frame of its hinge, closed: the screen looks down (-z), the outside up."""
    half_y, reach = LAPTOP_WIDTH / 2.0, 0.2145
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
