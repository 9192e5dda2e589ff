"""The posed model as one coloured mesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import write_ply
from pwralign_kin.se3 import transform
from pwralign_kin.state import State


def write_model_ply(path: Path, model: ArticulatedModel, state: State) -> None:
    """Write the model in `state` as a binary PLY mesh in the scan frame, m, with its colours per vertex."""
    T_scan_base = model.root_placement(state)
    placements = model.link_placements(model.values(state.joints))
    vertices, faces, colours = [], [], []
    count = 0
    for visual in (visual for part in model.parts for visual in part.visuals):
        vertices.append(transform(T_scan_base @ placements[visual.link] @ visual.T_link_visual, visual.vertices))
        faces.append(visual.faces + count)
        colours.append(np.broadcast_to(np.rint(255.0 * visual.rgba[:3]).astype(np.uint8), visual.vertices.shape))
        count += len(visual.vertices)
    rgb = np.concatenate(colours).T
    write_ply(
        path,
        np.concatenate(vertices),
        dict(zip(("red", "green", "blue"), rgb, strict=True)),
        np.concatenate(faces),
    )
