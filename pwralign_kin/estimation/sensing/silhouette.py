"""The outline of a model against the outline of a scan seen from one place.

A depth camera errs along its rays, smoothly over some centimetres, by far more than it errs across them: outlines are
right where surfaces are not. Samples on the model's outline get a residual across their viewing ray, the signed
distance to the scan's outline, which joins the normal equations of their parts like a point-to-plane residual.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from pwralign_kin.arrays import Bools, Indices, Singles
from pwralign_kin.estimation.sensing.observation import Observation
from pwralign_kin.se3 import Array, axes_across

MARGIN = 30
"""Pixels around the scan's image."""
MOST_PIXELS = 2.5e5
"""Of the image that the outline is drawn in: the pixels of a larger one are larger."""
CUT = 3
"""Pixels from the border of the picture within which an outline may be its own."""
RIM = 1.5
"""Samples this near to the edge of the model's image (pixels) are on its outline."""
RIM_HELD = 0.5
"""Pixels that samples move by before those on the outline are chosen anew."""
LEAST_SLOPE = 0.3
"""The scan's outline has a direction where its signed distance rises by this much a unit; not on medial axes."""
OUTLINE_GAIN = 2.0
"""Weight of the outline besides that of the variances: errors of the surface are smooth, fewer of them independent."""
ON_MODEL = 0.05
"""Scan points farther than this from the model (model diagonals) are of other things; ..."""
BEHIND = 0.05
"""... those nearer than this behind the model's points hide or touch it, and no outline is seen there."""


@dataclass(frozen=True)
class OutlineResiduals:
    """Samples on the model's outline and where they should be, in search units."""

    parts: Indices
    """(r,) part of each sample."""
    points: Array
    """(r, 3) where they are."""
    directions: Array
    """(r, 3) unit vectors across the viewing rays, out of the scan's image."""
    residuals: Array
    """(r,) how far beyond the scan's outline they are."""
    pixel: float
    """What the outline is exact to."""

    def normal_equations(self, systematic: float, most: float, parts: int, centre: Array) -> tuple[Array, Array]:
        """Return information (parts, 6, 6) and gradients (parts, 6) in twist space about `centre`.

        Against a surface whose residuals have the `systematic` standard deviation they weigh by the variances,
        at most `most`.
        """
        information, gradients = np.zeros((parts, 6, 6)), np.zeros((parts, 6))
        if len(self.residuals) == 0:
            return information, gradients
        # Half a pixel is what the outline of points is exact to; 1.48 median deviations are one standard deviation.
        sigma = max(1.48 * float(np.median(np.abs(self.residuals))), 0.5 * self.pixel)
        kernel = sigma**2 / (sigma**2 + self.residuals**2)
        weight = min(most, OUTLINE_GAIN * (systematic / sigma) ** 2)
        w = weight * kernel**2 / len(self.residuals)
        twist = np.concatenate([np.cross(self.points - centre, self.directions), self.directions], axis=1)
        for part in np.unique(self.parts):
            mine = self.parts == part
            information[part] = np.einsum("n,ni,nj->ij", w[mine], twist[mine], twist[mine])
            gradients[part] = -(w[mine] * self.residuals[mine]) @ twist[mine]
        return information, gradients


class Silhouette:
    """The image of a scan's points as its sensor saw them.

    It never changes, but for the samples that it remembers to be on the model's outline: they are the same for all
    configurations near the last one that was chosen for (`RIM_HELD`).
    """

    def __init__(self, observation: Observation, points: Singles, on_model: Bools) -> None:
        """Take all points (n, 3) of the scan in search units, and which of them are the model's."""
        from scipy import ndimage
        from scipy.spatial import cKDTree

        assert observation.sensor_origin is not None
        self.origin = observation.sensor_origin.astype(float)
        self.axes = _image_axes(points[on_model].mean(axis=0) - self.origin)
        image, depth = self._projected(points.astype(float))
        in_front = depth > 0
        own, others = image[on_model & in_front], image[~on_model & in_front]
        # The third neighbour: pixels of one spacing then leave few holes in a random sample of a depth image.
        self.pixel = float(np.median(cKDTree(own).query(own, k=4)[0][:, 3]))
        low, high = own.min(axis=0), own.max(axis=0)
        self.pixel = max(self.pixel, float(np.sqrt(np.prod(high - low) / MOST_PIXELS)))
        self.corner = low - MARGIN * self.pixel
        self.shape = tuple(np.ceil((high - low) / self.pixel).astype(int) + 2 * MARGIN)
        seen = self._raster(own)
        seen = ndimage.binary_opening(ndimage.binary_closing(seen, iterations=2), iterations=2)
        beyond = self._beyond(observation.borders) if len(observation.borders) else np.zeros(self.shape, bool)
        inside = ndimage.distance_transform_edt(seen | beyond)
        outside, nearest = ndimage.distance_transform_edt(~seen, return_indices=True)
        signed = (outside - inside) * self.pixel
        self.signed = signed
        self.slope = np.stack(np.gradient(ndimage.gaussian_filter(signed, 1.0), self.pixel))
        self.hidden = ndimage.binary_dilation(beyond, iterations=CUT) if beyond.any() else beyond
        if len(others):
            nearest_own = cKDTree(own).query(others)[1]
            before = depth[~on_model & in_front] < depth[on_model & in_front][nearest_own] + BEHIND
            self.hidden |= ndimage.binary_dilation(self._raster(others[before]), iterations=3)
        self.nearest = nearest
        self._rim: tuple[Array, Indices] | None = None

    def residuals(self, parts: Indices, points: Array, spacing: float, reach: float) -> OutlineResiduals:
        """Return the residuals of those of the model's samples (n, 3), of `parts` (n,), that are on its outline.

        `spacing` is how far apart samples are.

        Those farther than `reach` from the scan's outline have no counterpart there.
        """
        from scipy import ndimage

        image, depth = self._projected(points)
        rim = self._rim_of(image, depth, spacing)
        parts, points, depth = parts[rim], points[rim], depth[rim]
        place = (image[rim] - self.corner) / self.pixel
        # Between pixels: residuals that jump from one to the next would never let the steps come to an end.
        read = partial(ndimage.map_coordinates, coordinates=place.T - 0.5, order=1, mode="nearest")
        slope = np.stack([read(rise) for rise in self.slope], axis=1)
        steepness = np.linalg.norm(slope, axis=1)
        residual = read(self.signed) * depth
        row, column = np.clip(np.floor(place).astype(int), 0, np.array(self.shape) - 1).T
        hidden = self.hidden[self.nearest[0][row, column], self.nearest[1][row, column]]
        kept = (steepness > LEAST_SLOPE) & (np.abs(residual) < reach) & ~hidden
        parts, points, residual = parts[kept], points[kept], residual[kept]
        direction = (slope[kept] / steepness[kept, None]) @ self.axes[:2]
        ray = points - self.origin
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        direction -= np.einsum("ij,ij->i", direction, ray)[:, None] * ray
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        pixel = self.pixel * float(np.median(depth)) if len(depth) else self.pixel
        return OutlineResiduals(parts, points, direction, residual, pixel)

    def _rim_of(self, image: Array, depth: Array, spacing: float) -> Indices:
        """Return which samples at `image` (n, 2) and `depth` (n,) are on the model's outline.

        They are the same until a sample has moved by `RIM_HELD`: chosen anew at every step, they would keep the steps
        from coming to an end too.
        """
        if self._rim is not None and np.abs(image - self._rim[0]).max() < RIM_HELD * self.pixel:
            return self._rim[1]
        cell = np.floor((image - self.corner) / self.pixel).astype(int)
        within = np.flatnonzero(((cell >= 0) & (cell < self.shape)).all(axis=1) & (depth > 0))
        rim = within
        if len(within):
            gap = max(2.0, spacing / float(np.median(depth[within])) / self.pixel)
            rim = within[self._on_rim(cell[within], gap)]
        self._rim = image, rim
        return rim

    def _on_rim(self, cell: Indices, gap: float) -> Bools:
        """Return which samples are at the edge of the image that all of them make, their gaps (pixels) closed."""
        image = np.zeros(self.shape, bool)
        image[cell[:, 0], cell[:, 1]] = True
        covered = dilated(image, gap)
        return np.asarray(dilated(~covered, gap + RIM)[cell[:, 0], cell[:, 1]])

    def _projected(self, points: Array) -> tuple[Array, Array]:
        """Return image coordinates (n, 2), tangents of angles, and depths (n,)."""
        local = (points - self.origin) @ self.axes.T
        with np.errstate(divide="ignore", invalid="ignore"):
            return local[:, :2] / local[:, 2:], local[:, 2]

    def _beyond(self, borders: Singles) -> Bools:
        """Return which pixels are out of the picture, by the outward normals (b, 3) of the planes that end it."""
        cells = np.moveaxis(np.indices(self.shape), 0, -1) + 0.5
        rays = np.concatenate([self.corner + cells * self.pixel, np.ones((*self.shape, 1))], axis=-1)
        return np.asarray((rays @ (borders @ self.axes.T).T > 0.0).any(axis=-1))

    def _raster(self, image: Array) -> Bools:
        cell = np.floor((image - self.corner) / self.pixel).astype(int)
        cell = cell[((cell >= 0) & (cell < self.shape)).all(axis=1)]
        out = np.zeros(self.shape, bool)
        out[cell[:, 0], cell[:, 1]] = True
        return out


def dilated(mask: Bools, radius: float) -> Bools:
    """Return which pixels are no farther than `radius` from a pixel of a mask (rows, columns).

    A row after the other of a disc: a tenth of the time of a distance transform, which tells the same.
    """
    reach, count = int(radius), len(mask)
    widths = [int(np.sqrt(radius**2 - row**2)) for row in range(reach + 1)]
    wide, out = mask.copy(), np.zeros_like(mask)
    for width in range(reach + 1):
        if 0 < width < mask.shape[1]:
            wide[:, width:] |= mask[:, :-width]
            wide[:, :-width] |= mask[:, width:]
        for row in np.flatnonzero(np.equal(widths, width)):
            out[row:] |= wide[: max(count - row, 0)]
            out[: max(count - row, 0)] |= wide[row:]
    return out


def _image_axes(towards: Array) -> Array:
    """Return the axes (3, 3) of an image whose third axis looks `towards` something."""
    z = towards / np.linalg.norm(towards)
    return np.stack([*axes_across(z), z])
