"""Rigid alignment by small_gicp (Koide, JOSS 2024) from a start: the practical floor of the time.

Set up as in its example for Python
(https://github.com/koide3/small_gicp/blob/master/src/example/basic_registration.py): clouds downsampled and prepared,
then GICP. The example's lengths, of a street, are scaled to the model: four downsampling cells are the farthest pair.
"""

from __future__ import annotations

import numpy as np

from pwralign_kin.dependencies import peer
from pwralign_kin.se3 import Array

FARTHEST = 4.0
"""Farthest pair, downsampling cells."""


def rigid_gicp(source: Array, target: Array, voxel: float, threads: int = 1) -> Array:
    """Return T_target_source (4, 4) of points (n, 3) and (m, 3), m, that lie about right already.

    `voxel` is the cell of the downsampling, m. Raises `DependencyError` where small_gicp is missing.
    """
    library = peer("small_gicp")
    targets, tree = library.preprocess_points(target, downsampling_resolution=voxel, num_threads=threads)
    sources, _ = library.preprocess_points(source, downsampling_resolution=voxel, num_threads=threads)
    found = library.align(
        targets, sources, tree, max_correspondence_distance=FARTHEST * voxel, num_threads=threads,
        # Its tolerances are for metres of street: 1 mm where the downsampling cell is 25 cm.
        translation_epsilon=voxel / 250.0,
    )  # fmt: skip
    return np.array(found.T_target_source)
