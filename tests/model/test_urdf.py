"""What is mended on reading with a warning, what is refused, and the normalised URDF."""

from __future__ import annotations

import logging
import math
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from urdf_text import BOX, LIMIT, chain, joint, link, mimic

from pwralign_kin.exceptions import DependencyError, ModelError, UnknownNameError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.model.description import Origin
from pwralign_kin.model.urdf import read_urdf

Read = Callable[..., ArticulatedModel]
WriteUrdf = Callable[..., Path]


def the_warning(model: ArticulatedModel) -> str:
    assert len(model.warnings) == 1, model.warnings
    return model.warnings[0]


# ---- mended


def test_a_sound_urdf_gives_no_warning(read: Read) -> None:
    model = read(chain(LIMIT))
    assert model.warnings == ()
    assert model.name == "bot" and model.root_link == "l0" and model.joint_names == ("j1",)
    assert (model.lower, model.upper) == (-1.0, 1.0) and model.units == {"j1": "rad"}


@pytest.mark.parametrize("head", ["<robot>", '<robot name="">', '<robot name="  ">'])
def test_missing_robot_name_becomes_the_file_name(write_urdf: WriteUrdf, head: str) -> None:
    model = ArticulatedModel.from_urdf(write_urdf(chain(LIMIT), file="cart.v2.urdf", head=head))
    assert model.name == "cart" and "no name" in the_warning(model)


def test_warnings_are_logged(write_urdf: WriteUrdf, caplog: pytest.LogCaptureFixture) -> None:
    path = write_urdf(chain(LIMIT), head="<robot>")
    with caplog.at_level(logging.WARNING, "pwralign_kin"):
        ArticulatedModel.from_urdf(path)
    assert [record.getMessage() for record in caplog.records] == [f"{path}: the robot has no name: taken as 'bot'"]


@pytest.mark.parametrize("content", ["", '<limit effort="1" velocity="1"/>', LIMIT.replace("1", "0")])
def test_revolute_without_limits_turns_a_full_circle(read: Read, content: str) -> None:
    model = read(chain(content))
    assert (model.lower, model.upper) == (-math.pi, math.pi) and model.continuous[0]
    assert "'j1'" in the_warning(model) and "-pi..pi" in the_warning(model)


def test_prismatic_without_limits_gets_the_model_size(read: Read) -> None:
    model = read(chain("", kinds=("prismatic",)))
    assert model.upper[0] == pytest.approx(model.diagonal) and model.lower[0] == -model.upper[0]
    assert "'j1'" in the_warning(model) and "size" in the_warning(model)
    assert model.units == {"j1": "m"}


def test_endless_prismatic_limits_are_cut(read: Read) -> None:
    model = read(chain('<limit lower="-1e9" upper="0.1" effort="1" velocity="1"/>', kinds=("prismatic",)))
    assert model.lower[0] == pytest.approx(-3 * model.diagonal) and model.upper[0] == 0.1
    assert "cut" in the_warning(model)


@pytest.mark.parametrize("endless", ["inf", "1e300"])
def test_endless_limits(read: Read, endless: str) -> None:
    model = read(
        chain(
            f'<limit lower="-{endless}" upper="{endless}" effort="1" velocity="1"/>',
            f'<limit lower="-{endless}" upper="1" effort="1" velocity="1"/>',
        )
    )
    assert (model.lower[0], model.upper[0]) == (-math.pi, math.pi) and model.warnings == ()
    assert (model.lower[1], model.upper[1]) == pytest.approx((1 - 2 * math.pi, 1))


def test_limits_need_neither_effort_nor_velocity(read: Read) -> None:
    model = read(chain('<limit lower="-0.5" upper="0.25"/>', '<limit lower="0" upper="2" effort="1"/>'))
    assert model.lower.tolist() == [-0.5, 0.0] and model.upper.tolist() == [0.25, 2.0]
    assert model.warnings == ()


@pytest.mark.parametrize(
    ("given", "expected"), [('upper="2"', (0, 2)), ('lower="-2"', (-2, 0)), ('upper="-2"', (-2, 0))]
)
def test_one_limit_alone(read: Read, given: str, expected: tuple[float, float]) -> None:
    model = read(chain(f'<limit {given} effort="1" velocity="1"/>'))
    assert (model.lower[0], model.upper[0]) == expected
    assert "of its limits one is given" in model.warnings[0]


def test_inverted_limits_are_swapped(read: Read) -> None:
    model = read(chain('<limit lower="0.5" upper="-0.25" effort="1" velocity="1"/>'))
    assert (model.lower[0], model.upper[0]) == (-0.25, 0.5) and "swapped" in the_warning(model)


def test_axis_is_normalised(read: Read) -> None:
    model = read(chain(LIMIT + '<axis xyz="0 3 4"/>'))
    assert model.parts[1].joint is not None
    assert model.parts[1].joint.axis == pytest.approx([0, 0.6, 0.8]) and "axis" in the_warning(model)


def test_axis_defaults_to_x(read: Read) -> None:
    model = read(chain(LIMIT))
    assert model.parts[1].joint is not None and model.parts[1].joint.axis.tolist() == [1, 0, 0]


def test_whatever_mimics_nothing_that_moves_is_a_joint_of_its_own(read: Read) -> None:
    absent = read(chain(LIMIT + mimic("j2", 2.0), LIMIT + mimic("elbow")))
    assert absent.joint_names == ("j2",) and "'j2' of 'elbow', which is not there" in the_warning(absent)
    fixed = read(chain("", LIMIT + mimic("j1"), kinds=("fixed", "revolute")))
    assert fixed.joint_names == ("j2",) and "'j2' of 'j1', which is fixed" in the_warning(fixed)


def test_undeclared_prefixes_are_forgiven(read: Read) -> None:
    assert read(chain(LIMIT) + "<controller:plugin name='x'/>").joint_names == ("j1",)


@pytest.mark.parametrize(
    "head",
    [
        '<?xml version="0.0" ?>',
        '\n<!-- made by hand -->\n<?xml version="1.0"?>',
        "\n<?xml version='2.0' encoding='utf-8'?>",
    ],
)
def test_malformed_declarations_are_mended(write_urdf: Callable[..., Path], head: str) -> None:
    model = ArticulatedModel.from_urdf(write_urdf(chain(LIMIT), head=f'{head}<robot name="bot">'))
    assert model.joint_names == ("j1",) and "XML declaration" in the_warning(model)


@pytest.mark.parametrize("head", ["<?xml version='1.0'?>", "\ufeff<?xml version=\"1.0\" encoding='UTF-8'?>", ""])
def test_sound_declarations_are_left_alone(write_urdf: Callable[..., Path], head: str) -> None:
    assert ArticulatedModel.from_urdf(write_urdf(chain(LIMIT), head=f'{head}<robot name="bot">')).warnings == ()


def test_neutral_is_zero_clamped(read: Read) -> None:
    model = read(chain('<limit lower="0.5" upper="1" effort="1" velocity="1"/>', LIMIT))
    assert model.neutral() == {"j1": 0.5, "j2": 0.0}


# ---- wide limits


@pytest.mark.parametrize(
    ("lower", "upper", "expected"),
    [
        (-6.3, 6.3, (-math.pi, math.pi)),
        (-math.pi, math.pi, (-math.pi, math.pi)),
        (-3.1416, 3.1416, (-math.pi, math.pi)),
        (-7.0, 1.0, (1 - 2 * math.pi, 1.0)),
        (2.0, 9.0, (2.0, 2 + 2 * math.pi)),
    ],
)
def test_more_than_a_turn_becomes_one_turn(
    read: Read, lower: float, upper: float, expected: tuple[float, float]
) -> None:
    model = read(chain(f'<limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/>'))
    assert (model.lower[0], model.upper[0]) == pytest.approx(expected, abs=1e-12) and model.continuous[0]
    assert model.parts[1].joint is not None and model.parts[1].joint.continuous


def test_less_than_a_turn_stays(read: Read) -> None:
    model = read(chain('<limit lower="-4" upper="2" effort="1" velocity="1"/>'))
    assert (model.lower[0], model.upper[0]) == (-4, 2) and not model.continuous[0]


# ---- mimic


def test_mimic_of_a_mimic_is_resolved(read: Read) -> None:
    model = read(
        chain(
            LIMIT,
            LIMIT.replace("1", "9") + mimic("j1", 2, 0.1),
            mimic("j2", -3, 0.2),
            kinds=("revolute",) * 3,
        )
    )
    assert model.joint_names == ("j1",)
    relations = [
        (part.joint.actuated, part.joint.multiplier, part.joint.offset) for part in model.parts[1:] if part.joint
    ]
    assert relations == [(0, 1, 0), (0, 2, 0.1), (0, -6, pytest.approx(-0.1))]


def test_followers_narrow_the_leader(read: Read) -> None:
    model = read(chain(LIMIT, LIMIT.replace('"1"', '"0.5"', 1) + mimic("j1", 2, 0.1)))
    assert (model.lower[0], model.upper[0]) == pytest.approx((-0.55, 0.2))
    for value in (model.lower, model.upper):
        assert -1 - 1e-12 <= 2 * value[0] + 0.1 <= 0.5 + 1e-12


def test_a_negative_multiplier_turns_the_range_round(read: Read) -> None:
    model = read(chain(LIMIT, '<limit lower="0" upper="0.5" effort="1" velocity="1"/>' + mimic("j1", -1)))
    assert (model.lower[0], model.upper[0]) == (-0.5, 0.0)


def test_limits_that_meet_at_zero_are_no_reversed_range(read: Read) -> None:
    half = '<limit lower="0" upper="0.5" effort="1" velocity="1"/>'
    model = read(chain(half, half + mimic("j1", -1)))
    assert model.lower == model.upper == [0.0]
    np.random.default_rng(0).uniform(model.lower, model.upper)  # raises for 0.0 to -0.0


def test_followers_that_leave_no_range_are_ignored(read: Read) -> None:
    model = read(chain(LIMIT, '<limit lower="3" upper="4" effort="1" velocity="1"/>' + mimic("j1")))
    assert (model.lower[0], model.upper[0]) == (-1, 1) and "'j2'" in the_warning(model)


@pytest.mark.parametrize(("multiplier", "wraps"), [(1, True), (-2, True), (0.5, False)])
def test_a_leader_wraps_only_if_its_followers_do(read: Read, multiplier: float, wraps: bool) -> None:
    model = read(chain("", mimic("j1", multiplier), kinds=("continuous", "continuous")))
    assert model.continuous[0] == wraps and (model.lower[0], model.upper[0]) == (-math.pi, math.pi)


def test_a_slide_that_follows_a_turn_keeps_it_from_wrapping(read: Read) -> None:
    model = read(chain("", mimic("j1", 0.01), kinds=("continuous", "prismatic")))
    assert not model.continuous[0] and model.units == {"j1": "rad"}
    assert model.warnings == ()


# ---- planar and floating


def placement(xyz: tuple[float, float, float], rpy: tuple[float, float, float]) -> np.ndarray:
    return Origin(xyz, rpy).matrix


def test_floating_joint(read: Read) -> None:
    model = read(chain('<origin xyz="1 2 3" rpy="0.1 0.2 0.3"/>', kinds=("floating",)))
    assert model.joint_names == tuple(f"j1.{suffix}" for suffix in ("x", "y", "z", "roll", "pitch", "yaw"))
    assert list(model.units.values()) == ["m"] * 3 + ["rad"] * 3
    assert model.upper[:3] == pytest.approx(3 * model.diagonal) and model.warnings == ()
    pose = {"j1.x": 0.1, "j1.y": -0.2, "j1.z": 0.3, "j1.roll": 0.4, "j1.pitch": -0.5, "j1.yaw": 0.6}
    expected = placement((1, 2, 3), (0.1, 0.2, 0.3)) @ placement((0.1, -0.2, 0.3), (0.4, -0.5, 0.6))
    assert model.link_placements(model.values(pose))["l1"] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("axis", "x", "y"),
    [
        ("0 0 1", (1, 0, 0), (0, 1, 0)),
        ("1 0 0", (0, 1, 0), (0, 0, 1)),
        ("0 1 0", (0, 0, 1), (1, 0, 0)),
        ("1 1 1", None, None),
    ],
)
def test_planar_joint(read: Read, axis: str, x: tuple[float, ...] | None, y: tuple[float, ...] | None) -> None:
    model = read(chain(f'<axis xyz="{axis}"/>', kinds=("planar",)))
    assert model.joint_names == ("j1.x", "j1.y", "j1.yaw")
    normal = np.array(axis.split(), float) / np.linalg.norm(np.array(axis.split(), float))

    def moved(**values: float) -> np.ndarray:
        return model.link_placements(model.values({f"j1.{name}": value for name, value in values.items()}))["l1"]

    along_x, along_y = moved(x=1)[:3, 3], moved(y=1)[:3, 3]
    assert np.cross(along_x, along_y) == pytest.approx(normal)
    assert x is None or (along_x == pytest.approx(x) and along_y == pytest.approx(y))
    turned = moved(x=0.5, y=-0.25, yaw=0.7)
    assert turned[:3, 3] == pytest.approx(0.5 * along_x - 0.25 * along_y)
    assert turned[:3, :3] @ normal == pytest.approx(normal)
    assert np.trace(turned[:3, :3]) == pytest.approx(1 + 2 * math.cos(0.7))
    assert np.cross(along_x, turned[:3, :3] @ along_x) @ normal == pytest.approx(math.sin(0.7))


def test_planar_without_axis_says_which_plane(read: Read) -> None:
    assert "orthogonal to x" in the_warning(read(chain("", kinds=("planar",))))


def test_a_free_base_is_told_unobservable(read: Read) -> None:
    model = read(
        link("world", "") + link("a") + link("b") + joint("free", "world", "a", "floating", "") + joint("j", "a", "b")
    )
    assert model.unobservable == tuple(f"free.{suffix}" for suffix in ("x", "y", "z", "roll", "pitch", "yaw"))


# ---- refused


def faults(path: Path, **options: object) -> tuple[str, ...]:
    with pytest.raises(ModelError) as caught:
        ArticulatedModel.from_urdf(path, **options)  # type: ignore[arg-type]
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    return caught.value.faults


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (chain(LIMIT + '<axis xyz="0 0 0"/>'), ("j1", "axis is zero")),
        (chain(LIMIT + '<axis xyz="0 zero 0"/>'), ("j1", "xyz='0 zero 0'")),
        (chain(LIMIT + '<origin xyz="1 2"/>'), ("j1", "3 finite numbers")),
        (chain(LIMIT + '<origin rpy="nan 0 0"/>'), ("j1", "3 finite numbers")),
        (chain(LIMIT + '<origin xyz="$(optenv PLACE 0 0 1)"/>'), ("j1", "xacro", "suffix")),
        (chain(LIMIT + '<origin xyz="1e300 0 0"/>'), ("j1", "3 finite numbers")),
        (chain('<limit lower="low" upper="1" effort="1" velocity="1"/>'), ("j1", "lower='low'")),
        (chain("", kinds=("hinge",)), ("j1", "'hinge'", "revolute")),
        (chain(LIMIT + mimic("j2"), LIMIT + mimic("j1")), ("circle", "j1 -> j2 -> j1")),
        (chain(LIMIT + mimic("j1")), ("circle", "j1 -> j1")),
        (chain(mimic("j1"), kinds=("planar",)), ("j1", "planar", "mimic")),
        (link("a") + link("a"), ("link 'a'", "2 times")),
        (chain(LIMIT) + link("c") + joint("j1", "l1", "c"), ("joint 'j1'", "2 times")),
        (link("a") + link("b"), ("several roots", "'a'", "'b'")),
        (link("a") + link("b") + joint("j", "a", "b") + joint("k", "b", "a"), ("cycle", "'a', 'b'")),
        (
            link("r") + link("a") + link("b") + joint("j", "a", "b") + joint("k", "b", "a"),
            ("cycle", "'a', 'b'"),
        ),
        (
            link("a") + link("b") + link("c") + joint("j", "a", "c") + joint("k", "b", "c"),
            ("'c'", "'j', 'k'"),
        ),
        (link("a") + joint("j", "a", "hand"), ("joint 'j'", "'hand'", "does not exist")),
        (
            link("a") + link("b") + '<joint name="j" type="fixed"><child link="b"/></joint>',
            ("joint 'j'", "no parent"),
        ),
        (link("a") + "<link/>" + joint("j", "a", ""), ("link has no name",)),
        (link("a") + link("b") + joint("", "a", "b"), ("joint has no name",)),
        ("", ("no links",)),
        (link("a", ""), ("no geometry",)),
        (link("a", "<visual><geometry><cone/></geometry></visual>"), ("'a'", "<cone>", "capsule")),
        (link("a", "<visual><geometry><sphere/></geometry></visual>"), ("'a'", "lacks radius")),
        (link("a", '<visual><geometry><sphere radius="-1"/></geometry></visual>'), ("'a'", "negative")),
        (link("a", "<visual><geometry><mesh/></geometry></visual>"), ("'a'", "filename")),
        (link("a", BOX.replace("<visual>", '<visual><origin quat_xyzw="0 0 0 0"/>')), ("'a'", "quat_xyzw")),
    ],
)
def test_faults(write_urdf: WriteUrdf, body: str, words: tuple[str, ...]) -> None:
    text = "; ".join(faults(write_urdf(body)))
    assert all(word in text for word in words), text


def test_all_faults_at_once(write_urdf: WriteUrdf) -> None:
    body = chain("<axis xyz='0 0 0'/>", mimic("j2"), kinds=("hinge", "revolute")) + link("stray")
    found = faults(write_urdf(body))
    assert len(found) == 3
    for words in ("unknown type 'hinge'", "circle", "several roots"):
        assert any(words in fault for fault in found), found


def test_missing_file(tmp_path: Path) -> None:
    assert faults(tmp_path / "none.urdf") == ("no such file",)
    assert faults(tmp_path) == ("not a file",)


@pytest.mark.parametrize(
    "text", ["", "   ", "robot", "<robot", "<robot><link></robot>", '<robot name="a"/>\0', "\x89PNG\r\n"]
)
def test_not_xml(tmp_path: Path, text: str) -> None:
    path = tmp_path / "bad.urdf"
    path.write_text(text)
    assert faults(path)[0].startswith("not a URDF, for it is not XML: ")
    assert "<string>" not in faults(path)[0]


def test_not_a_urdf(tmp_path: Path) -> None:
    path = tmp_path / "bot.sdf"
    path.write_text("<sdf version='1.6'/>")
    assert "<sdf>" in faults(path)[0]


@pytest.mark.parametrize(
    "doctype",
    [
        '<!DOCTYPE robot [<!ENTITY secret SYSTEM "file:///etc/passwd">]>',
        '<!DOCTYPE robot SYSTEM "http://localhost/x.dtd">',
    ],
)
def test_entities_and_dtds_are_refused(write_urdf: WriteUrdf, doctype: str) -> None:
    found = faults(
        write_urdf(link("a", BOX + "&secret;" if "ENTITY" in doctype else BOX), head=f'{doctype}<robot name="x">')
    )
    assert "document type" in found[0]


@pytest.mark.parametrize("options", [{"geometry": "inertial"}, {"mesh_units": "mm"}])
def test_unknown_options(write_urdf: WriteUrdf, options: dict[str, str]) -> None:
    assert next(iter(options.values())) in faults(write_urdf(link("a")), **options)[0]


# ---- origins, xacro, normalised


@pytest.mark.parametrize("pitch", [0.3, math.pi / 2, -math.pi / 2])
def test_quaternion_origins(read: Read, pitch: float) -> None:
    from scipy.spatial.transform import Rotation

    expected = placement((0, 0, 0), (0.4, pitch, -0.8))
    x, y, z, w = 2 * Rotation.from_matrix(expected[:3, :3]).as_quat()
    model = read(chain(LIMIT + f'<origin quat_xyzw="{x} {y} {z} {w}"/>'))
    assert model.part_placements(np.zeros(1))[1] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("name", ["bot.urdf.xacro", "bot.urdf"])
def test_xacro(write_urdf: WriteUrdf, name: str) -> None:
    pytest.importorskip("xacrodoc", reason="the xacro extra is not installed")
    body = '<xacro:property name="reach" value="${1 + 0.5}"/>' + chain(
        '<limit lower="0" upper="${reach}" effort="1" velocity="1"/>'
    )
    path = write_urdf(body, name, '<robot name="bot" xmlns:xacro="http://www.ros.org/wiki/xacro">')
    model = ArticulatedModel.from_urdf(path)
    assert model.upper[0] == 1.5 and model.name == "bot"
    path.write_text(path.read_text().replace("1 + 0.5", "1 + nothing"))
    assert "xacro fails" in faults(path)[0]


def test_xacro_under_another_prefix(write_urdf: WriteUrdf) -> None:
    path = write_urdf('<x:macro name="m"/>' + chain(LIMIT), "bot.urdf", XACRO.replace("xmlns:xacro", "xmlns:x"))
    assert "another prefix" in faults(path)[0]


def test_a_xacro_of_macros_alone(write_urdf: WriteUrdf) -> None:
    pytest.importorskip("xacrodoc", reason="the xacro extra is not installed")
    body = f'<xacro:macro name="arm" params="prefix">{chain(LIMIT)}</xacro:macro>'
    path = write_urdf(body, "bot.xacro", '<robot name="bot" xmlns:xacro="http://www.ros.org/wiki/xacro">')
    assert "only defines macros" in faults(path)[0]


def test_xacro_without_the_extra(write_urdf: WriteUrdf, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xacrodoc", None)
    with pytest.raises(DependencyError, match=r"pwralign-kin\[xacro\]"):
        ArticulatedModel.from_urdf(write_urdf(chain(LIMIT), "bot.xacro"))
    expanded = write_urdf("<!-- was\n<xacro:arm/> -->" + chain(LIMIT), "bot.urdf", XACRO.replace("$(arg name)", "bot"))
    assert ArticulatedModel.from_urdf(expanded).joint_names == ("j1",)


def test_the_normalised_urdf_reads_the_same(read: Read, write_urdf: WriteUrdf) -> None:
    contents = ("", "", '<axis xyz="0 2 0"/>', mimic("j3", 0.5, 0.1), '<limit lower="1" upper="-1"/>')
    model = read(chain(*contents, kinds=("planar", "floating", "prismatic", "revolute", "revolute")))
    path = write_urdf("", "again.urdf")
    path.write_text(model.normalised_urdf)
    again = ArticulatedModel.from_urdf(path)
    assert again.warnings == () and again.joint_names == model.joint_names
    assert np.array_equal(again.lower, model.lower) and np.array_equal(again.upper, model.upper)
    assert again.normalised_urdf == model.normalised_urdf and again.content_key == model.content_key


def test_xacro_finds_packages(write_urdf: WriteUrdf, tmp_path: Path) -> None:
    pytest.importorskip("xacrodoc", reason="the xacro extra is not installed")
    xacro = '<robot name="bot" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    for package in ("src/arm", "other/hand"):
        write_urdf("", f"{package}/package.xml", f"<robot><name>{Path(package).name}</name>")
    write_urdf(link("palm"), "other/hand/hand.xacro", xacro)
    include = '<xacro:include filename="$(find hand)/hand.xacro"/>'
    path = write_urdf(include, "src/arm/urdf/bot.xacro", xacro)
    assert "hand" in faults(path)[0]
    assert ArticulatedModel.from_urdf(path, package_dirs=[tmp_path / "other"]).root_link == "palm"
    assert ArticulatedModel.from_urdf(path, package_dirs=[tmp_path / "other/hand"]).root_link == "palm"
    (tmp_path / "other/hand").rename(tmp_path / "src/hand")
    assert ArticulatedModel.from_urdf(path).root_link == "palm"
    (tmp_path / "src/hand/package.xml").unlink()
    assert ArticulatedModel.from_urdf(path).root_link == "palm"
    own = write_urdf(include.replace("hand)", "arm)/urdf"), "src/arm/bot.xacro", xacro)
    (tmp_path / "src/hand/hand.xacro").rename(tmp_path / "src/arm/urdf/hand.xacro")
    (tmp_path / "src/arm/package.xml").unlink()
    assert ArticulatedModel.from_urdf(own).root_link == "palm"


def test_xacro_includes_relative_names(write_urdf: WriteUrdf) -> None:
    """Beside the file that includes them, wherever the program runs, and after an include that failed."""
    pytest.importorskip("xacrodoc", reason="the xacro extra is not installed")
    xacro = '<robot name="bot" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    path = write_urdf('<xacro:include filename="parts/arm.xacro"/>', "bot.xacro", xacro)
    write_urdf('<xacro:include filename="hand.xacro"/>', "parts/arm.xacro", xacro)
    assert "hand.xacro" in faults(path)[0]
    write_urdf(link("palm"), "parts/hand.xacro", xacro)
    assert ArticulatedModel.from_urdf(path).root_link == "palm"


XACRO = '<robot name="$(arg name)" xmlns:xacro="http://www.ros.org/wiki/xacro">'
ARGUMENTS = '<xacro:arg name="name"/><xacro:arg name="wide" default="false"/><xacro:arg name="tool"/>'


def test_xacro_arguments(write_urdf: WriteUrdf) -> None:
    pytest.importorskip("xacrodoc", reason="the xacro extra is not installed")
    body = ARGUMENTS + link("$(arg tool)")
    path = write_urdf(body, "bot.urdf.xacro", XACRO)
    model = ArticulatedModel.from_urdf(path, xacro_args={"name": "ur", "tool": "hand"})
    other = ArticulatedModel.from_urdf(path, xacro_args={"name": "ur", "tool": "hook"})
    assert (model.name, model.root_link, other.root_link) == ("ur", "hand", "hook")
    assert model.content_key != other.content_key
    with pytest.raises(UnknownNameError, match="did you mean 'tool'"):
        ArticulatedModel.from_urdf(path, xacro_args={"name": "ur", "tool": "hand", "tol": 1})


def test_xacro_arguments_take_truth_values(write_urdf: WriteUrdf) -> None:
    pytest.importorskip("xacrodoc", reason="the xacro extra is not installed")
    one = '<xacro:{} value="$(arg wide)">{}</xacro:{}>'
    body = one.format("if", link("wide"), "if") + one.format("unless", link("narrow"), "unless")
    path = write_urdf(ARGUMENTS + body, "bot.xacro", XACRO)
    for wide, root in ((True, "wide"), (False, "narrow")):
        assert ArticulatedModel.from_urdf(path, xacro_args={"name": "a", "tool": "", "wide": wide}).root_link == root


def test_missing_xacro_arguments_are_named_with_the_remedy(write_urdf: WriteUrdf) -> None:
    pytest.importorskip("xacrodoc", reason="the xacro extra is not installed")
    path = write_urdf(ARGUMENTS + link("base"), "bot.xacro", XACRO.replace("$(arg name)", "bot"))
    (fault,) = faults(path)
    assert "'name', 'tool'" in fault and "--xacro-arg name=VALUE --xacro-arg tool=VALUE" in fault
    undeclared = write_urdf(link("$(arg other)"), "other.xacro", XACRO.replace("$(arg name)", "bot"))
    assert "--xacro-arg other=VALUE" in faults(undeclared)[0]
    plain = write_urdf(link("base"))
    with pytest.raises(ModelError, match="xacro"):
        ArticulatedModel.from_urdf(plain, xacro_args={"name": "a"})


def test_packages_that_xacro_misses_are_named_with_the_remedy(write_urdf: WriteUrdf) -> None:
    pytest.importorskip("xacrodoc", reason="the xacro extra is not installed")
    include = '<xacro:include filename="$(find arm_description)/arm.xacro"/>'
    (fault,) = faults(write_urdf(include, "bot.xacro", XACRO.replace("$(arg name)", "bot")))
    assert "'arm_description'" in fault and "--package-dir" in fault and "class" not in fault


def test_xacro_finds_packages_of_a_workspace(write_urdf: WriteUrdf, tmp_path: Path) -> None:
    pytest.importorskip("xacrodoc", reason="the xacro extra is not installed")
    write_urdf("", "ws/src/vendor/Hand-ROS2/package.xml", "<robot><name>hand</name>")
    head = XACRO.replace("$(arg name)", "bot")
    write_urdf(link("palm"), "ws/src/vendor/Hand-ROS2/hand.xacro", head)
    path = write_urdf('<xacro:include filename="$(find hand)/hand.xacro"/>', "elsewhere/urdf/bot.xacro", head)
    assert ArticulatedModel.from_urdf(path, package_dirs=[tmp_path / "ws"]).root_link == "palm"
    write_urdf("", "ws2/src/hand/hand/package.xml", "<robot><name>hand</name>")
    write_urdf(link("wrist"), "ws2/src/hand/hand/hand.xacro", head)
    assert ArticulatedModel.from_urdf(path, package_dirs=[tmp_path / "ws2/src"]).root_link == "wrist"


def test_every_example_robot_reads(wheel_folder: Path) -> None:
    """Of all URDFs of the wheel only an empty one and one that mimics unknown joints are refused."""
    paths = sorted(wheel_folder.rglob("*.urdf"))
    assert len(paths) > 50
    refused = {}
    for path in paths:
        try:
            read_urdf(path)
        except ModelError as error:
            refused[path.name] = error.faults[0]
    assert set(refused) <= {"alex_psyonic_hands.urdf", "ur3.urdf"}, refused


def test_the_text_of_a_urdf_is_no_path() -> None:
    with pytest.raises(ModelError, match="expected the path of a file") as caught:
        ArticulatedModel.from_urdf("<?xml version='1.0'?>\n<robot name='arm'><link name='base'/></robot>")
    assert "robot name" not in str(caught.value)
