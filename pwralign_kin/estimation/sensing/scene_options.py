"""How a model is found among other things."""

from __future__ import annotations

from dataclasses import dataclass

from pwralign_kin.checked_options import Cell, CheckedOptions, Count, Natural, NotNegative, Positive, Share, Threshold


@dataclass(frozen=True)
class SceneOptions(CheckedOptions):
    """How the model is found among other things. Lengths in model diagonals."""

    reaches: Threshold = 1.3
    """A scan wider than this many times the model's largest extent (strays aside) is a scene."""
    reaches_unseen: Threshold = 3.0
    """The same for scans without a sensor origin, which tell less of what is in the way of what."""
    plane_unlike: Threshold = 0.22
    """A scan with a sensor origin is a scene too if it holds a plane that spreads this far (standard deviation along
    its shorter axis): the largest square in a box of diagonal 1 has 0.2."""
    normal_radius: Cell = 0.045
    """Neighbourhood of the normals that planes are found by."""
    planes: Natural = 12
    """Planes that are looked for, at most, ..."""
    plane_trials: Count = 200
    """... each by so many points with their normals, ..."""
    plane_sample: Count = 3000
    """... among so many, drawn by the surface that they stand for."""
    plane_tolerance: Positive = 0.012
    plane_noises: NotNegative = 2.5
    plane_most: NotNegative = 0.06
    """A point lies on a plane within the tolerance, or so many times the noise at its range, at most this far."""
    plane_cell: Cell = 0.04
    """Pieces of a plane farther apart than this are looked at one by one."""
    plane_wider: NotNegative = 1.5
    """A piece of a plane is background if it spreads so many times wider than any part of the model, ..."""
    plane_least: NotNegative = 0.09
    """... this far (standard deviation along its shorter axis) ..."""
    plane_area: NotNegative = 0.3
    """... and has more than this share of the largest part's area."""
    patch_wider: NotNegative = 1.25
    """A piece of a plane that an answer leaves unexplained is background if it is so many times larger and spreads so
    many times wider than any flat face of the model, ..."""
    patch_least: NotNegative = 0.05
    """... or than one that spreads this far."""
    range_bin: Cell = 0.25
    """Points are as dense and as noisy as is usual at their range from the sensor, within this; without a sensor, in
    cells twice as wide."""
    spacing: Positive = 0.026
    """Median distance to the sixth neighbour up to which a range is searched, if all these hold enough, ..."""
    spacing_room: Positive = 1.25
    """... even if this is so many times smaller; ..."""
    spacing_more: Positive = 1.5
    """... else so many times that up to which they do: the model may be a little farther, ..."""
    spacing_most: Positive = 0.09
    """... but no more than this."""
    enough: NotNegative = 1.5
    """How many times the visible area of the model is enough."""
    link: Positive = 0.03
    link_spacings: NotNegative = 1.1
    """Points nearer than this, or so many of their usual distances to the sixth neighbour, belong to one region: fewer
    than 0.87 would leave even points of one surface apart."""
    region_area: NotNegative = 0.015
    region_points: Count = 25
    """Regions with less than this share of the visible area of the model, or fewer points, are fragments."""
    margin: NotNegative = 0.35
    """Fragments and surroundings this near to a region are kept."""
    plane_weight: Share = 0.35
    """How much a point of a background plane speaks for the model, ..."""
    other_weight: Share = 0.5
    """... and one of what else is not searched."""
    most_noise: NotNegative = 0.012
    """Noise beyond this is taken for other things about what is searched."""
    unreturned: Share = 0.5
    """How far space counts as seen to be free where no ray of a sensor came back: dark, shiny and slanted surface sends
    none back, and out of the image there are none."""
