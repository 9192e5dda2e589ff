"""What the search sees of a scan: prepared points, and what is free and hidden around them.

Lengths are in units of the model's diagonal, about the centre of the scan, in which all scales of the search are
stated. `Observation.to_scan` and `to_search` convert placements.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.arrays import Ints, Singles
from pwralign_kin.checked_options import Cell, CheckedOptions, Count, NotNegative, Positive, Share
from pwralign_kin.estimation.sensing.points import area_of_point
from pwralign_kin.se3 import Array

NO_BORDERS: Singles = np.zeros((0, 3), np.float32)
LEAST_POINTS = 20
"""Occupied cells of the downsampling below which a scan cannot be of the model."""
ONE_SIDE, ALL_SIDES = 0.42, 0.85
"""Share of a model's visible surface that one view, and views from all around, usually show."""


@dataclass(frozen=True)
class ObservationOptions(CheckedOptions):
    """How a scan is prepared. Lengths in model diagonals."""

    most_raw: Count = 60000
    """Points that are kept undownsampled, for the outline and to tell the noise by."""
    given_per_cell: Count = 2
    """Points of each cell of the downsampling that are kept as given, for the joint least squares."""
    voxel: Cell = 0.01
    """Cell of the downsampling."""
    normal_radius: Positive = 0.012
    """Neighbourhood of a normal without noise; `normal_noises` times the noise is added, ..."""
    normal_noises: NotNegative = 4.0
    neighbour_spacings: NotNegative = 1.6
    """... and it is widened to this many point spacings where the scan is sparse."""
    grazing: Share = 0.05
    """Cosine between ray and normal below which a sensor does not measure the surface that is there."""
    stray_distance: NotNegative = 0.06
    """A point whose sixth neighbour is farther than this, and than `stray_spacings` spacings, is a stray."""
    stray_spacings: NotNegative = 4.0
    remove_planes: bool = True
    """Whether a plane wider than the model (a table, a floor) is removed; scans with a sensor origin keep theirs."""
    plane_tolerance: Positive = 0.015
    """How far from such a plane its points lie, at most."""
    plane_share: Share = 0.15
    """Least share of the scan that such a plane holds."""
    plane_spread: NotNegative = 0.3
    """Least standard deviation of its points along both of its directions: no face of the model is that wide."""
    field_cell: Cell = 0.0125
    """Cell of the field of distances to what was seen, and of what is free and hidden, ..."""
    field_truncation: Cell = 0.06
    """... which tells distances up to this."""
    shadow: NotNegative = 0.45
    """How far behind a seen surface space counts as occluded."""
    depth_pixel: Cell = 0.011
    """Pixel of the depth image that tells free from hidden space, at the mean range of the points, ..."""
    depth_tolerance: Positive = 0.02
    """... in which what is farther than this behind the nearest point is hidden."""


@dataclass(frozen=True)
class Observation:
    """A prepared scan."""

    points: Singles
    """(m, 3) downsampled points."""
    normals: Singles
    """(m, 3) unit normals, towards the sensor or the open side."""
    raw: Singles
    """(n, 3) all points, without wide planes; at most `ObservationOptions.most_raw`."""
    given: Singles
    """(r, 3) points as given, `ObservationOptions.given_per_cell` a cell: noisy, but not displaced by any smoothing."""
    given_normals: Singles
    """(r, 3) normals of the nearest prepared points."""
    weights: Singles
    """(m,) how much each point speaks for a part that lies on it: 1, and less for known surroundings."""
    areas: Singles
    """(m,) surface that each point stands for, relative to the others'."""
    regions: Ints
    """(m,) the region of a scene that each point belongs to, -1 for known surroundings; otherwise all 0."""
    scene: bool
    """Whether the scan is mostly of other things than the model."""
    spacing: float
    """Median distance of a point to its sixth neighbour."""
    noise: float
    """Standard deviation of the given points from their local planes."""
    depth_pixel: float
    """Pixel of the depth image, at the mean range of what was seen."""
    sensor_origin: Singles | None
    """(3,) where the whole scan was seen from one place, else None."""
    field: kernels.ScanField
    """Distances to what was seen, and what is free and hidden."""
    centre: Array
    """(3,) in the scan frame, m."""
    diagonal: float
    """The unit of length, m."""
    borders: Singles = dataclasses.field(default_factory=lambda: NO_BORDERS)
    """(b, 3) outward unit normals of planes through the sensor beyond which it looked at nothing."""
    cut_out: bool = False
    """Whether it is what lies near one answer to a scene: other things may be among it."""

    @property
    def single_view(self) -> bool:
        """Whether free and occluded space are known."""
        return self.sensor_origin is not None

    @property
    def area_per_point(self) -> float:
        """Surface area that one point stands for."""
        return area_of_point(self.spacing)

    def to_search(self, T: Array) -> Array:
        """Convert placements (..., 4, 4) of the scan frame (m) to the search's centred, scaled frame."""
        out = np.array(T, dtype=np.float64)
        out[..., :3, 3] = (out[..., :3, 3] - self.centre) / self.diagonal
        return out

    def to_scan(self, T: Array) -> Array:
        """Convert placements (..., 4, 4) of the search's frame to the scan frame (m)."""
        out = np.array(T, dtype=np.float64)
        out[..., :3, 3] = out[..., :3, 3] * self.diagonal + self.centre
        return out

    def scaled(self, points: Array) -> Singles:
        """Convert points (n, 3) of the scan frame (m) to the search's frame."""
        return np.ascontiguousarray((points - self.centre) / self.diagonal, np.float32)
