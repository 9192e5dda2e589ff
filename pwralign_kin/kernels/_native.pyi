"""The compiled kernels as Python calls them; the headers of the source tell how they work.

Lengths are in units of the model's diagonal and angles in rad unless said otherwise; points and directions are (n, 3),
placements (m, 4, 4), configurations `bases` (m, 4, 4) of the root part and `values` (m, k) of the actuated joints.
`parts` (p,) and `mask` (parts,) name parts; where a part, a sample or a point is returned, -1 is none. Arrays must be
contiguous and of the types here. What cannot be raises `ValueError`; no result depends on `threads`.
"""

from collections.abc import Sequence
from typing import overload

import numpy as np
from numpy.typing import NDArray

def thin(points: NDArray[np.float32], radius: float) -> NDArray[np.int32]:
    """Return the points (i,) of a subset of which no two are nearer than `radius`: greedy, in the given order."""

def farthest_points(points: NDArray[np.float32], count: int) -> NDArray[np.int32]:
    """Return `count` points (i,), each the farthest from those before it; the first is the farthest from the mean."""

def closest_sample_grid(
    samples: NDArray[np.float32],
    origin: tuple[float, float, float],
    cell: float,
    dims: tuple[int, int, int],
    band: float,
) -> NDArray[np.uint16]:
    """Return (x * y * z,) the sample (nearly) closest to each cell of a grid, z fastest; 65535 beyond `band` of all.

    Danielsson's vector propagation. `origin` is the lower corner, `dims` the number of cells along each axis.
    """

def voxel_means(
    points: NDArray[np.float32], cell: float
) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32]]:
    """Return the means (c, 3) of the points in each occupied cell, counts (c,), and the cell (n,) of each point."""

def first_of_cells(cell_of_point: NDArray[np.int32], order: NDArray[np.int32], each: int) -> NDArray[np.int32]:
    """Return the first `each` points of each cell in the given `order` (n,), cell by cell."""

def along_curve(points: NDArray[np.float32]) -> NDArray[np.int32]:
    """Return the points (n,) in the order of a space-filling curve: neighbours next to each other."""

def local_planes(
    points: NDArray[np.float32], radius: float, threads: int
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
    """Return of the neighbours within `radius` of each point the plane's unit normal (n, 3), of either sign, their mean
    (n, 3), variances (n, 3) in ascending order, and count (n,)."""

def apparent_normals(
    points: NDArray[np.float32], normals: NDArray[np.float32], radius: float, threads: int
) -> NDArray[np.float32]:
    """Return the normals (n, 3) of an oriented surface as scans tell them, whose local planes mix all that faces the
    sensor within `radius`."""

def nearest_neighbours(
    points: NDArray[np.float32], queries: NDArray[np.float32], count: int, threads: int
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return distances and indices (q, count) of the points nearest to each query, nearest first: all, if fewer."""

def neighbourhood_variances(
    points: NDArray[np.float32], queries: NDArray[np.float32], sizes: Sequence[int], threads: int
) -> NDArray[np.float64]:
    """Return (sizes, 3, q) the variances, ascending, of the nearest `sizes` (ascending) points of each query
    about their mean."""

def openness(
    points: NDArray[np.float32], normals: NDArray[np.float32], cell: float, threads: int
) -> NDArray[np.float32]:
    """Return (n,) how open the side is that each normal points to, by rays through the cloud's cells; negative where it
    points inwards."""

def components(points: NDArray[np.float32], radius: float) -> NDArray[np.int32]:
    """Return (n,) the number of the cluster of each point; points nearer than `radius` are of one."""

def retracted(placement: NDArray[np.float64], twist: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the placement (4, 4) moved by a twist (6,), its turn first, about its own origin; turns end at pi."""

def first_occurrences(rows: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return (m,) the first of all equal ones among rows (n, 3), finite, in their order."""

def steps_around(
    points: NDArray[np.float32], normals: NDArray[np.float32], step: float, directions: int
) -> NDArray[np.float32]:
    """Return (n * directions, 3) where steps end that lead from each point evenly around its tangential plane, those of
    one point together."""

def dominant_plane(
    points: NDArray[np.float32], normals: NDArray[np.float32], tolerance: float, trials: int, seed: int
) -> tuple[float, float, float, float, int]:
    """Return unit normal (x, y, z), offset and number of points of the plane that holds most oriented points.

    By minimal samples of one point; all 0 without points.
    """

def closest_on_meshes(
    meshes: Sequence[TriangleMesh],
    placements: NDArray[np.float64],
    points: NDArray[np.float32],
    reach: float,
    threads: int,
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return the place (n, 3) closest to each point on the placed meshes, and the mesh (n,) that it is on.

    Points without one within `reach` stay where they are.
    """

class TriangleMesh:
    """Triangles ready for closest-point queries: `vertices` (v, 3), finite, and `faces` (f, 3)."""

    def __init__(self, vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> None: ...

class Articulated:
    """A kinematic tree of parts with surfaces; parts[0] is the root, parents come before their children.

    A joint's value is `multiplier` * actuated value + `offset`; `placement` and `axis` are those of the joint in its
    parent. `restricted` returns a copy with other limits (k,), `travel` (parts,) the range of parts that slide,
    `limits` the least and greatest actuated values (k,), `forward` the placements (m, parts, 4, 4) of configurations.
    """

    def __init__(
        self,
        parent: NDArray[np.int32],
        actuated: NDArray[np.int32],
        placement: NDArray[np.float64],
        axis: NDArray[np.float64],
        prismatic: NDArray[np.uint8],
        multiplier: NDArray[np.float64],
        offset: NDArray[np.float64],
        lower: NDArray[np.float64],
        upper: NDArray[np.float64],
        wraps: NDArray[np.uint8],
    ) -> None: ...
    def set_surface(
        self,
        part: int,
        samples: NDArray[np.float32],
        normals: NDArray[np.float32],
        weights: NDArray[np.float32],
        dense: NDArray[np.float32],
        dense_normals: NDArray[np.float32],
        apparent_normals: NDArray[np.float32],
        grid: NDArray[np.uint16],
        origin: tuple[float, float, float],
        cell: float,
        slack: float,
        centre: tuple[float, float, float],
        radius: float,
        size: float,
        area: float,
        weight: float,
    ) -> None: ...
    def restricted(self, lower: NDArray[np.float64], upper: NDArray[np.float64]) -> Articulated: ...
    @property
    def parent(self) -> NDArray[np.int32]: ...
    @property
    def actuated(self) -> NDArray[np.int32]: ...
    @property
    def travel(self) -> NDArray[np.float64]: ...
    @property
    def limits(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
    def closed(
        self,
        chain: Sequence[int],
        above: NDArray[np.float64],
        below: NDArray[np.float64],
        open_turn: float,
        open_slide: float,
        beyond: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """Return the values (a, b, joints) that the joints holding the parts of a `chain`, one or two from above, take
        between placements above (a, 4, 4) and below (b, 4, 4), and whether (a, b) they close within the limits."""

    def forward(self, bases: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]: ...

class ScanField:
    """A grid about the points of a scan that tells the nearest one of each cell, and what is free or hidden.

    The meaning of the arrays stands at `estimation.sensing.observation.Observation`. `nearest` returns the scan point
    (n,) nearest to the cell of each position, -1 where that is not within `reach`,
    `with_unreturned` the same field with another trust in silent pixels.
    """

    def __init__(
        self,
        points: NDArray[np.float32],
        normals: NDArray[np.float32],
        weights: NDArray[np.float32],
        areas: NDArray[np.float32],
        regions: NDArray[np.int32],
        cell: float,
        truncation: float,
        sensor_origin: Sequence[float],
        depth_points: NDArray[np.float32],
        borders: NDArray[np.float32],
        pixel: float,
        tolerance: float,
        shadow: float,
        unreturned: float,
        threads: int,
    ) -> None: ...
    def with_unreturned(self, unreturned: float) -> ScanField: ...
    def nearest(self, points: NDArray[np.float32], reach: float = ...) -> NDArray[np.int32]: ...

class SearchOptions:
    """What `estimation.comparison.search_options.SearchOptions` is for one scan."""

    def __init__(self) -> None: ...
    @property
    def support_distance(self) -> float: ...
    @support_distance.setter
    def support_distance(self, arg: float, /) -> None: ...
    @property
    def coverage_distance(self) -> float: ...
    @coverage_distance.setter
    def coverage_distance(self, arg: float, /) -> None: ...
    @property
    def support_weight(self) -> float: ...
    @support_weight.setter
    def support_weight(self, arg: float, /) -> None: ...
    @property
    def coverage_scale(self) -> float: ...
    @coverage_scale.setter
    def coverage_scale(self, arg: float, /) -> None: ...
    @property
    def near_penalty(self) -> float: ...
    @near_penalty.setter
    def near_penalty(self, arg: float, /) -> None: ...
    @property
    def mismatch_penalty(self) -> float: ...
    @mismatch_penalty.setter
    def mismatch_penalty(self, arg: float, /) -> None: ...
    @property
    def normal_penalty(self) -> float: ...
    @normal_penalty.setter
    def normal_penalty(self, arg: float, /) -> None: ...
    @property
    def solid(self) -> bool: ...
    @solid.setter
    def solid(self, arg: bool, /) -> None: ...
    @property
    def two_way(self) -> bool: ...
    @two_way.setter
    def two_way(self, arg: bool, /) -> None: ...
    @property
    def angle_step(self) -> float: ...
    @angle_step.setter
    def angle_step(self, arg: float, /) -> None: ...
    @property
    def beam(self) -> int: ...
    @beam.setter
    def beam(self, arg: int, /) -> None: ...
    @property
    def modes(self) -> int: ...
    @modes.setter
    def modes(self, arg: int, /) -> None: ...
    @property
    def branch_beam(self) -> int: ...
    @branch_beam.setter
    def branch_beam(self, arg: int, /) -> None: ...
    @property
    def threads(self) -> int: ...
    @threads.setter
    def threads(self, arg: int, /) -> None: ...

class Search:
    """Configurations of a model proposed for a scan, and compared with it.

    Hypotheses are returned as parts (m,), placements (m, 4, 4) and scores (m,), configurations as bases, values and
    scores (m,), assignments as distances (n,), at most `cap`, parts (n,) and their samples (n,). Tasks are arrays of
    one length that name a row of the configurations in `configuration`.
    """

    def __init__(
        self, model: Articulated, field: ScanField, options: SearchOptions, neutral: NDArray[np.float64]
    ) -> None: ...
    def set_prior(
        self,
        position: NDArray[np.float64],
        position_deviation: float,
        turn: NDArray[np.float64],
        turn_deviation: float,
        up: NDArray[np.float64],
        up_deviation: float,
        region: NDArray[np.float64],
        region_deviation: float,
        values: NDArray[np.float64],
        inverse_deviations: NDArray[np.float64],
    ) -> None: ...
    def look_first(self, marked: NDArray[np.uint8]) -> None: ...
    def base_prior(self, base: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
    def part_hypotheses(
        self,
        parts: NDArray[np.int32],
        points: Sequence[NDArray[np.int32]],
        anchors: int,
        seed: int,
        keep: int,
        point_weights: NDArray[np.float32],
    ) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float32]]: ...
    def correspondence_hypotheses(
        self,
        part: int,
        source: NDArray[np.float32],
        source_normals: NDArray[np.float32],
        target: NDArray[np.float32],
        target_normals: NDArray[np.float32],
        weights: NDArray[np.float32],
        seed: int,
        keep: int,
    ) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float32]]: ...
    def refine_parts(
        self, parts: NDArray[np.int32], placements: NDArray[np.float64], iterations: int
    ) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float32]]: ...
    def distinct_parts(
        self, parts: NDArray[np.int32], placements: NDArray[np.float64], keep: int, radius: float
    ) -> NDArray[np.int32]: ...
    def distinct_configurations(
        self, bases: NDArray[np.float64], values: NDArray[np.float64], keep: int, apart: float
    ) -> NDArray[np.int32]: ...
    def grow(
        self, parts: NDArray[np.int32], placements: NDArray[np.float64], keep: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float32]]: ...
    def regrow(
        self,
        bases: NDArray[np.float64],
        values: NDArray[np.float64],
        configuration: NDArray[np.int32],
        start: NDArray[np.int32],
        next: NDArray[np.int32],
        weights: NDArray[np.float32],
        keep: int,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float32]]: ...
    def reach(
        self,
        bases: NDArray[np.float64],
        values: NDArray[np.float64],
        configuration: NDArray[np.int32],
        anchor: NDArray[np.int32],
        part: NDArray[np.int32],
        placements: NDArray[np.float64],
        seed: int,
        starts: int,
        keep: int,
        tolerance: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float32]]: ...
    def sweep(
        self,
        bases: NDArray[np.float64],
        values: NDArray[np.float64],
        configuration: NDArray[np.int32],
        joint: NDArray[np.int32],
        base_moves: NDArray[np.uint8],
        with_joint: NDArray[np.int32],
        keep: int,
        behind: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float32]]: ...
    def score(
        self, bases: NDArray[np.float64], values: NDArray[np.float64], points: int, coverage_distances: Sequence[float]
    ) -> list[tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]]: ...
    def refine(
        self,
        bases: NDArray[np.float64],
        values: NDArray[np.float64],
        points: int,
        iterations: int,
        sigma_first: float,
        sigma_last: float,
        support_weight: float,
        part_weights: NDArray[np.float32],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float32]]: ...
    def assign(
        self, points: NDArray[np.float32], placements: NDArray[np.float64], mask: NDArray[np.uint8], cap: float
    ) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32]]: ...
    def owners(
        self, placements: NDArray[np.float64], mask: NDArray[np.uint8], cap: float
    ) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32]]: ...
    def facing(
        self,
        normals: NDArray[np.float32],
        placements: NDArray[np.float64],
        part: NDArray[np.int32],
        sample: NDArray[np.int32],
    ) -> NDArray[np.float32]: ...
    def distances(
        self,
        points: NDArray[np.float32],
        placements: NDArray[np.float64],
        mask: NDArray[np.uint8],
        cap: float,
        loosely: bool,
    ) -> NDArray[np.float32]: ...
    def in_sight(
        self, placements: NDArray[np.float64], distance: float, cosine: float
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]: ...
    def normal_equations(
        self,
        placements: NDArray[np.float64],
        points: NDArray[np.float32],
        normals: NDArray[np.float32],
        sigma: float,
        cap: float,
        support_weight: float,
        part_weights: NDArray[np.float32],
        along_rays: bool,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]: ...

class SurfaceMixture:
    """The posed surface as a mixture of normal distributions, one for each patch of side `spacing`.

    `evidence` returns the logarithm of the likelihood, its gradient (n + 1,) and what stands for its negative Hessian
    (n + 1, n + 1) by the n parameters of the `jacobians` (parts, 6, n) and the logarithm of `sigma`, the information
    (parts, 6, 6) of each part's twist, and the number of strays.
    """

    def __init__(self, model: Articulated, spacing: float) -> None: ...
    def look(self, placements: NDArray[np.float64], directions: NDArray[np.float32], unseen: float) -> None: ...
    def evidence(
        self,
        points: NDArray[np.float32],
        placements: NDArray[np.float64],
        jacobians: NDArray[np.float64],
        sigma: float,
        strays: float,
        volume: float,
        threads: int,
    ) -> tuple[float, NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float]: ...

def explained_within(noise: float) -> float:
    """Return the distance within which points of this noise (standard deviation) are explained."""

class TrackingJudgement:
    """How a configuration fits a frame: see `tracking.fit.FrameFit`; `supported` is its `support`."""

    @property
    def noise(self) -> float: ...
    @property
    def tolerance(self) -> float: ...
    @property
    def coverage(self) -> float: ...
    @property
    def agreement(self) -> float: ...
    @property
    def visible(self) -> float: ...
    @property
    def supported(self) -> float: ...
    @property
    def cost(self) -> float: ...

class Tracking:
    """One model followed from frame to frame: of each at most `points` are used, one a cell of size `cell`.

    A frame begins with `expect`, whose `centre` (3,), `sensor` (3,), empty if unknown, and `unit`, the diagonal, are in
    m, and is looked at once. `fit` returns base, values, iterations and rms distance; `information` (6 + k, 6 + k) and
    `levers` (k,) are of the last fit, `explained`, `strays`, `visible` and `shown` (parts,) of what was judged last.
    """

    def __init__(self, model: Articulated, points: int, cell: float) -> None: ...
    def expect(
        self,
        base: NDArray[np.float64],
        values: NDArray[np.float64],
        centre: NDArray[np.float64],
        unit: float,
        sensor: NDArray[np.float64],
        margin: float,
    ) -> None: ...
    @overload
    def look_at_points(self, points: NDArray[np.float32]) -> None: ...
    @overload
    def look_at_points(self, points: NDArray[np.float64]) -> None: ...
    @overload
    def look_at_depth(
        self, depth: NDArray[np.float32], intrinsics: NDArray[np.float64], scale: float, camera: NDArray[np.float64]
    ) -> None: ...
    @overload
    def look_at_depth(
        self, depth: NDArray[np.uint16], intrinsics: NDArray[np.float64], scale: float, camera: NDArray[np.float64]
    ) -> None: ...
    @property
    def points(self) -> int: ...
    def fit(
        self,
        base: NDArray[np.float64],
        values: NDArray[np.float64],
        predicted: NDArray[np.float64],
        predicted_values: NDArray[np.float64],
        expected: NDArray[np.float64],
        held: NDArray[np.uint8],
        sigma_first: float,
        sigma_last: float,
        noise: float,
        iterations: int,
        seconds: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], int, float]: ...
    @property
    def information(self) -> NDArray[np.float64]: ...
    def judge(self, base: NDArray[np.float64], values: NDArray[np.float64], tolerance: float) -> TrackingJudgement: ...
    @property
    def levers(self) -> NDArray[np.float64]: ...
    @property
    def explained(self) -> NDArray[np.float32]: ...
    @property
    def strays(self) -> NDArray[np.float32]: ...
    @property
    def visible(self) -> NDArray[np.float32]: ...
    @property
    def shown(self) -> NDArray[np.float32]: ...
    def weigh(
        self,
        base: NDArray[np.float64],
        values: NDArray[np.float64],
        varied: NDArray[np.uint8],
        tolerance: float,
    ) -> NDArray[np.float32]: ...
    def sweep(
        self, base: NDArray[np.float64], values: NDArray[np.float64], variable: int, range: float, sigma: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]: ...
