"""An estimate as files that robots, viewers and inspectors read."""

from __future__ import annotations

import logging
from functools import partial
from pathlib import Path

from pwralign_kin.estimation.result import Estimate
from pwralign_kin.exceptions import ExportError
from pwralign_kin.export import deviation, glb, joints, mesh, overlay, report, srdf, states, urdf
from pwralign_kin.export.axes import UP_AXES, up_vector
from pwralign_kin.export.signed_distances import signed_distances
from pwralign_kin.files import atomic_folder, check_path, files_in
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.render import posed_mesh
from pwralign_kin.scan import Scan

__all__ = ["FILES", "UP_AXES", "export"]

FILES = (
    "aligned.urdf", "deviation.csv", "deviation.ply", "estimate.json", "initial_positions.yaml", "joint_state.yaml",
    "model.glb", "model.ply", "model.srdf", "overlay.png", "report.html", "state.json",
)  # fmt: skip
"""Names of what is written."""

logger = logging.getLogger(__name__)


def export(
    estimate: Estimate,
    model: ArticulatedModel,
    scan: Scan,
    folder: Path | str,
    *,
    up: str = "z",
    bundle: bool = False,
) -> list[Path]:
    """Write an estimate into `folder`, all files or none, and return their paths.

    - `state.json`: base placement and joint values; `estimate.json`: the same with all figures of the
      estimate;
    - `joint_state.yaml` (ROS sensor_msgs/JointState), `initial_positions.yaml` (MoveIt), `model.srdf` (group
      state);
    - `aligned.urdf`: the URDF with the link `world` as the scan frame and the base placed in it, planar and
      floating joints too, which the ROS files leave out;
    - `model.glb`, `model.ply`: the posed model as a tree of links, and as one mesh in the scan frame;
    - `deviation.ply`, `deviation.csv`: signed distance of every scan point to the model, and a table per
      part;
    - `overlay.png`: model and scan in one picture; `report.html`: the picture, the joints and the distances on one
      page.

    `scan` is the one that the estimate was made from; `up` (x, y, z, -x, -y or -z) names its upward axis, for
    the GLB and the pictures. With `bundle`, meshes and textures are copied into `folder`, where `aligned.urdf`
    finds them wherever the folder goes; else it names them where they are. Other files in `folder` stay.

    Raises `ExportError` when files cannot be written or the estimate is not one of this scan,
    `UnknownNameError` for an unknown `up` or a state that does not fit the model.
    """
    check_path(folder, partial(ExportError, "result"))
    for value, kind in ((estimate, Estimate), (model, ArticulatedModel), (scan, Scan)):
        if not isinstance(value, kind):
            raise ExportError(folder, f"expected {kind.__name__}, got {type(value).__name__}")
    folder = Path(folder)
    upward = up_vector(up)
    if len(estimate.scan_labels) != scan.n_input:
        raise ExportError(
            folder,
            f"the estimate speaks of {len(estimate.scan_labels)} scan points, this scan has {scan.n_input}",
        )
    labels = estimate.scan_labels[scan.source_index]
    state = estimate.state
    posed = posed_mesh(model, state)
    values = joints.joint_values(model, state)
    if values.multiple:
        logger.info(
            "%s: planar and floating joints (%s) have no place in joint_state.yaml and initial_positions.yaml; "
            "in aligned.urdf their values are in their origins",
            model.urdf_path, ", ".join(values.multiple),
        )  # fmt: skip
    distances = signed_distances(posed, scan.points)
    with atomic_folder(folder) as new:
        state.save(new / "state.json")
        states.write_estimate(new / "estimate.json", estimate)
        states.write_joint_state(new / "joint_state.yaml", values)
        states.write_initial_positions(new / "initial_positions.yaml", values)
        srdf.write_srdf(new / "model.srdf", model, values)
        urdf.write_aligned_urdf(new / "aligned.urdf", model, state, folder, bundle=bundle)
        glb.write_glb(new / "model.glb", model, state, up)
        mesh.write_model_ply(new / "model.ply", model, state)
        deviation.write_deviation_ply(new / "deviation.ply", scan.points, distances, labels, posed)
        figures = deviation.part_figures(distances, labels, len(posed.parts))
        deviation.write_deviation_table(new / "deviation.csv", figures, posed.parts)
        overlay.write_overlay(new / "overlay.png", model, estimate, posed, scan, upward)
        report.write_report(new / "report.html", model, estimate, scan, figures, new / "overlay.png")
        names = files_in(new)
    return [folder / name for name in names]
