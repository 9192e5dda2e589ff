"""What is known beforehand narrows the search and stays in the answer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin import se3
from pwralign_kin.simulation import SimulatedScan

BOX = """<robot name="box">
  <link name="box"><visual><geometry><box size="0.4 0.3 0.2"/></geometry></visual></link>
  <link name="lid"><visual><origin xyz="0.2 0 0"/><geometry><box size="0.4 0.3 0.2"/></geometry></visual></link>
  <joint name="slide" type="prismatic">
    <parent link="box"/><child link="lid"/><origin xyz="0.2 0 0"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.05" effort="1" velocity="1"/>
  </joint>
</robot>"""
"""Two equal boxes: half a turn about any axis changes hardly anything."""


@pytest.fixture(scope="module")
def boxes(tmp_path_factory: pytest.TempPathFactory) -> pk.ArticulatedModel:
    path = tmp_path_factory.mktemp("box") / "box.urdf"
    path.write_text(BOX)
    return pk.ArticulatedModel.from_urdf(path)


@pytest.fixture(scope="module")
def boxes_scan(boxes: pk.ArticulatedModel) -> SimulatedScan:
    return pk.simulate(boxes, seed=4)


def _turned(T: np.ndarray, axis: int) -> np.ndarray:
    """The base after half a turn of both boxes about an axis through their middle."""
    half = np.eye(4)
    half[:3, :3] = se3.rotation_about(np.eye(3)[axis], np.pi)
    middle = np.array([0.2, 0.0, 0.0])
    half[:3, 3] = middle - half[:3, :3] @ middle
    return T @ half


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(
    "known",
    [
        lambda T: pk.BasePrior(up=tuple(T[:3, 2]), region=(tuple(T[:3, 3] - 0.1), tuple(T[:3, 3] + 0.1))),
        lambda T: pk.BasePrior(T_scan_base=T, translation_std=0.05, rotation_std=0.2),
        lambda T: pk.BasePrior(T_scan_base=T),
    ],
    ids=["up and region", "about", "exact"],
)
def test_picks_the_answer_that_agrees(
    boxes: pk.ArticulatedModel, boxes_scan: SimulatedScan, known: Callable[[np.ndarray], pk.BasePrior], axis: int
) -> None:
    wanted = _turned(boxes_scan.state.T_scan_base, axis)
    found = pk.estimate(boxes, boxes_scan.scan, options=pk.EstimatorOptions(base=known(wanted)))
    error = se3.inverse(wanted) @ found.state.T_scan_base
    assert se3.rotation_angle(error[:3, :3]) < np.radians(3.0)
    assert np.linalg.norm(error[:3, 3]) < 0.06  # the slide may move either box


def test_an_exact_base_is_kept(arm: pk.ArticulatedModel, single_scan: SimulatedScan) -> None:
    T = single_scan.state.T_scan_base
    options = pk.EstimatorOptions(base=pk.BasePrior(T_scan_base=T))
    found = pk.estimate(arm, single_scan.scan, options=options)
    np.testing.assert_allclose(found.state.T_scan_base, T, atol=1e-9)
    for name in set(found.state.joints) - set(found.undetermined):
        assert found.state.joints[name] == pytest.approx(single_scan.state.joints[name], abs=np.radians(2.0))
    assert np.abs(found.covariance[:6, :6]).max() < 1e-6


def test_a_joint_prior_bounds_the_search_and_tells_what_the_scan_does_not(
    arm: pk.ArticulatedModel, full_scan: SimulatedScan
) -> None:
    wrong = full_scan.state.joints["elbow"] - 1.0
    wrong = wrong if wrong > -2 else wrong + 2.0
    options = pk.EstimatorOptions(prior={"elbow": wrong}, prior_std={"elbow": 0.05})
    found = pk.estimate(arm, full_scan.scan, options=options)
    assert abs(found.state.joints["elbow"] - wrong) <= 4 * 0.05 + 1e-9


@pytest.mark.parametrize(
    ("make", "fault"),
    [
        (lambda: pk.BasePrior(up=(0, 0, 0)), "length"),
        (lambda: pk.BasePrior(up=(0, 1)), "finite numbers"),
        (lambda: pk.BasePrior(region=((1, 0, 0), (0, 1, 1))), "corner"),
        (lambda: pk.BasePrior(T_scan_base=np.ones((4, 4))), "not a rigid placement"),
        (lambda: pk.BasePrior(T_scan_base=np.eye(4), rotation_std=-1), "rotation_std must be a finite number from 0"),
    ],
)
def test_nonsense_is_refused(make: Callable[[], pk.BasePrior], fault: str) -> None:
    with pytest.raises(pk.PwralignError, match=fault):
        make()


def test_names_and_deviations_are_checked(arm: pk.ArticulatedModel, full_scan: SimulatedScan) -> None:
    def run(options: pk.EstimatorOptions) -> None:
        pk.estimate(arm, full_scan.scan, options=options)

    with pytest.raises(pk.PwralignError, match="did you mean 'elbow'"):
        run(pk.EstimatorOptions(locked=("elbo",)))
    with pytest.raises(pk.PwralignError, match="did you mean 'elbow'"):
        run(pk.EstimatorOptions(prior={"elbo": 0.0}, prior_std={"elbo": 0.1}))
    with pytest.raises(pk.PwralignError, match="prior_std of joint 'elbow' must be a finite number above 0"):
        run(pk.EstimatorOptions(prior={"elbow": 0.0}, prior_std={"elbow": 0.0}))
    with pytest.raises(pk.PwralignError, match="no joint moves"):
        run(pk.EstimatorOptions(base=pk.BasePrior(T_scan_base=np.eye(4), base_link="lower")))
    with pytest.raises(pk.PwralignError, match="no link named"):
        run(pk.EstimatorOptions(base=pk.BasePrior(T_scan_base=np.eye(4), base_link="nowhere")))
