"""The public names: what a caller gets wrong raises an error of this package; states and models are plain values."""

from __future__ import annotations

import copy
import dataclasses
import importlib.metadata
import inspect
import json
import pickle
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin import exceptions
from pwralign_kin.exceptions import DependencyError
from pwralign_kin.export import export
from pwralign_kin.simulation import SimulatedScan

REPOSITORY = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def model() -> pk.ArticulatedModel:
    return pk.ArticulatedModel.from_urdf(REPOSITORY / "robots/laptop/laptop.urdf")


@pytest.fixture(scope="module")
def seen(model: pk.ArticulatedModel) -> SimulatedScan:
    return pk.simulate(model, sensor=pk.Sensor(views=2, points=1500), seed=1)


@pytest.fixture(scope="module")
def found(model: pk.ArticulatedModel, seen: SimulatedScan) -> pk.Estimate:
    return pk.estimate(model, seen.scan, initial=seen.state, options=pk.EstimatorOptions(effort="fast"))


def complex_placement() -> Any:
    return np.eye(4) * (1.0 + 1.0j)


Wrong = Callable[[Any, Any, Any], object]


@pytest.mark.filterwarnings("error::numpy.exceptions.ComplexWarning")
@pytest.mark.parametrize(
    "wrong",
    [
        lambda m, s, e: pk.ArticulatedModel.from_urdf(None),
        lambda m, s, e: pk.ArticulatedModel.from_urdf(3),
        lambda m, s, e: pk.ArticulatedModel.from_urdf(m.urdf_path, xacro_args=["name"]),
        lambda m, s, e: pk.Scan.load(None),
        lambda m, s, e: pk.Scan(s.points * 1j),
        lambda m, s, e: pk.Scan(s.points, sensor_origin=[1j, 0, 0]),
        lambda m, s, e: pk.DepthFrame.load(None, (1, 1, 1, 1)),
        lambda m, s, e: pk.DepthFrame(np.ones((4, 4)), (1j, 1, 1, 1)),
        lambda m, s, e: pk.State(complex_placement()),
        lambda m, s, e: pk.State.load(None),
        lambda m, s, e: e.state.save(None),
        lambda m, s, e: pk.BasePrior(T_scan_base=complex_placement()),
        lambda m, s, e: pk.BasePrior(up=(1j, 0, 0)),
        lambda m, s, e: pk.Correspondences.load(None),
        lambda m, s, e: pk.Sensor(points="a"),
        lambda m, s, e: pk.Sensor(noise=None),
        lambda m, s, e: pk.Sensor(distance=(1.0, "far")),
        lambda m, s, e: pk.Sensor(distance=3.0),
        lambda m, s, e: pk.DepthFrame(np.ones((4, 4)), (1, 1, 1, 1), depth_scale="x"),
        lambda m, s, e: pk.Scan.from_depth(np.ones((4, 4)), (1, 1, 1, 1), depth_scale="x"),
        lambda m, s, e: pk.Scan.from_depth([[1.0, 1.0], [1.0]], (1, 1, 1, 1)),
        lambda m, s, e: pk.BasePrior(translation_std="a"),
        lambda m, s, e: pk.simulate(m, sensor={}),
        lambda m, s, e: pk.simulate(m, state={}),
        lambda m, s, e: pk.simulate(None),
        lambda m, s, e: pk.simulate(m, seed="a"),
        lambda m, s, e: pk.estimate(m, s, options={}),
        lambda m, s, e: s.scaled("a"),
        lambda m, s, e: s.scaled(0.0),
        lambda m, s, e: pk.calibrate(m, [s], [None]),
        lambda m, s, e: pk.calibrate(m, [s], ["a"]),
        lambda m, s, e: pk.calibrate(m, [s], None),
        lambda m, s, e: pk.calibrate(m, [None], [{}]),
        lambda m, s, e: pk.calibrate(m, [s], [{}], options={}),
        lambda m, s, e: pk.Tracker(m, options={}),
        lambda m, s, e: pk.TrackerOptions(points="a"),
        lambda m, s, e: pk.TrackerOptions(estimator={}),
        lambda m, s, e: pk.TrackerOptions(time_limit="a"),
        lambda m, s, e: export(e, m, s, None),
        lambda m, s, e: export(None, m, s, "out"),
        lambda m, s, e: export(e, None, s, "out"),
    ],
)
def test_wrong_types_raise_errors_of_this_package(
    wrong: Wrong, model: pk.ArticulatedModel, seen: SimulatedScan, found: pk.Estimate
) -> None:
    with pytest.raises(pk.PwralignError):
        wrong(model, seen.scan, found)


def test_names_and_version() -> None:
    assert pk.__version__ == importlib.metadata.version("pwralign-kin")
    assert dir(pk) == sorted(pk.__all__)
    assert all(getattr(pk, name) is not None for name in pk.__all__)


def test_the_documentation_names_all_that_is_public() -> None:
    text = (REPOSITORY / "docs/python.md").read_text(encoding="utf-8")
    words = set(re.findall(r"\w+", " ".join(re.findall(r"`[^`]+`", text))))
    errors = {name for name, kind in vars(exceptions).items() if isinstance(kind, type) and "Error" in name}
    assert len(errors) > 10
    assert not {*pk.__all__, *errors} - {"__version__"} - words


@pytest.mark.parametrize("function", [pk.estimate, pk.calibrate, pk.simulate, export])
def test_the_documentation_tells_the_arguments(function: Callable[..., object]) -> None:
    text = (REPOSITORY / "docs/python.md").read_text(encoding="utf-8")
    called = re.search(rf"`(?:[\w.]+\.)?{function.__name__}\(([^`]*)\)`", text)
    assert called is not None
    told = [argument.partition("=")[0] for argument in called[1].replace("()", "").split(", ")]
    assert told == list(inspect.signature(function).parameters)


def test_python_started_in_the_source_folder_is_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def shadowed(module: str) -> None:
        raise ModuleNotFoundError("No module named 'pwralign_kin.kernels._native'", name="pwralign_kin.kernels._native")

    monkeypatch.setattr(pk, "import_module", shadowed)
    with pytest.raises(DependencyError, match=f"not built in {REPOSITORY}.* in another folder"):
        pk.__getattr__("Scan")


def test_states_are_equal_by_value() -> None:
    state = pk.State(np.eye(4), {"a": 0.1, "b": 0.0}, "base")
    same = pk.State(np.eye(4), {"b": -0.0, "a": 0.1}, "base")
    assert state == same and hash(state) == hash(same) and len({state, same}) == 1
    moved = np.eye(4)
    moved[0, 3] = 1e-9
    others = (pk.State(moved, state.joints, "base"), pk.State(np.eye(4), {"a": 0.1}, "base"), pk.State(np.eye(4)))
    assert all(state != other for other in (*others, None, 3))


def test_a_line_tells_a_state_and_a_result(seen: SimulatedScan, found: pk.Estimate) -> None:
    assert (
        repr(pk.State()) == "State(root link: xyz 0.0000 0.0000 0.0000 m, xyzw 0.0000 0.0000 0.0000 1.0000; no joints)"
    )
    lid = f"lid_hinge {found.state.joints['lid_hinge']:.4f})"
    assert repr(found.state).startswith("State(base: xyz ") and repr(found.state).endswith(lid)
    assert repr(found).startswith(f"Estimate(confidence {found.confidence:.2f}; ")
    assert repr(found).endswith(f"{found.state!r})") and len(repr(found)) < 300


def test_a_line_tells_a_model_and_a_frame(model: pk.ArticulatedModel, seen: SimulatedScan, found: pk.Estimate) -> None:
    assert repr(model) == "ArticulatedModel(laptop: 2 parts, 0.397 m; lid_hinge 0..2.36 rad)"
    depth = pk.DepthFrame(np.ones((3, 4), np.uint16), (100.0, 100.0, 2.0, 1.5), depth_scale=0.001)
    assert repr(depth) == "DepthFrame(depth image: 4 x 3 uint16 pixels, focal length 100)"
    tracked = pk.Tracker(model, initial=found.state).update(seen.scan, 0.5)
    assert repr(tracked).startswith("TrackedFrame(0.5 s: confidence") and repr(tracked).endswith(f"{tracked.state!r})")


@pytest.mark.parametrize(
    ("wrong", "named"), [(lambda s: [s, None], "NoneType among them"), (lambda s: s.points, "got ndarray")]
)
def test_what_is_no_scan_is_named(
    wrong: Callable[[pk.Scan], Any], named: str, model: pk.ArticulatedModel, seen: SimulatedScan
) -> None:
    with pytest.raises(pk.PwralignError, match=named):
        pk.estimate(model, wrong(seen.scan))


def test_an_answer_far_from_all_points_has_no_distance_from_them(found: pk.Estimate) -> None:
    assert "inlier RMSE -" in str(dataclasses.replace(found, inlier_rmse=np.nan))


def test_results_are_equal_by_identity(model: pk.ArticulatedModel, seen: SimulatedScan, found: pk.Estimate) -> None:
    again = copy.copy(found)
    assert found == found and found != again and len({found, again}) == 2
    assert again.state == found.state
    assert seen == seen and seen != copy.copy(seen)


def test_options_never_change_and_have_a_hash() -> None:
    prior = {"lid_hinge": 0.5}
    options, same = (pk.EstimatorOptions(prior=prior, prior_std=prior) for _ in "ab")
    assert options == same and hash(options) == hash(same) and json.dumps(options.prior) == '{"lid_hinge": 0.5}'
    held: Any = options.prior
    with pytest.raises(TypeError, match="never change"):
        held["lid_hinge"] = np.nan
    prior["lid_hinge"] = np.nan
    assert pickle.loads(pickle.dumps(options)) == options and options.prior["lid_hinge"] == 0.5


def test_joint_values_of_a_state_never_change(found: pk.Estimate) -> None:
    joints: Any = found.state.joints
    before = dict(joints)
    for change in (
        lambda: joints.__setitem__("lid_hinge", 0.0),
        lambda: joints.update(lid_hinge=0.0),
        lambda: joints.pop("lid_hinge"),
        lambda: joints.__ior__({"lid_hinge": 0.0}),
        lambda: joints.setdefault("other", 0.0),
        joints.clear,
        joints.popitem,
    ):
        with pytest.raises(TypeError, match="never change"):
            change()
    assert joints == before and {**joints} == before and json.loads(json.dumps(joints)) == before


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))])
def test_copies_of_results_and_models(
    copied: Callable[[Any], Any], model: pk.ArticulatedModel, seen: SimulatedScan, found: pk.Estimate
) -> None:
    state = copied(found).state
    assert state == found.state and not state.T_scan_base.flags.writeable
    with pytest.raises(TypeError):
        state.joints["lid_hinge"] = 0.0
    other = copied(model)
    assert other.content_key == model.content_key
    scan = copied(seen.scan)
    unchanging = (scan.points, scan.source_index, copied(found).covariance, found.covariance, found.scan_labels)
    for array in (*unchanging, other.lower, other.continuous, model.continuous, found.parts["lid"].T_scan_part):
        assert not array.flags.writeable
    for mapping in (model.units, other.units, found.units, found.std, copied(found).parts, scan.dropped):
        with pytest.raises(TypeError, match="never change"):
            mapping["lid_hinge"] = 0.0  # type: ignore[index]
    with pytest.raises(AttributeError, match="a scan never changes"):
        scan.points = np.zeros((3, 3))
    options = pk.EstimatorOptions(effort="fast")
    assert pk.estimate(other, seen.scan, initial=seen.state, options=options).state == found.state
