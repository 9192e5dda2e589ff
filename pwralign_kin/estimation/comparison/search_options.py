"""How much a search tries, and how its configurations are compared with the scan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from pwralign_kin.checked_options import CheckedOptions, Count, Natural, NotNegative, Positive, Range, Share

BAND = 0.06
"""Distances beyond this (model diagonals) are all the same to the kernels."""


@dataclass(frozen=True)
class SearchOptions(CheckedOptions):
    """How many hypotheses are made and kept, and how they are grown and scored. Lengths in model diagonals."""

    root_parts: Count = 7
    """The largest parts that hypotheses start from."""
    hypotheses_per_part: Count = 12
    """Hypotheses that are kept of each."""
    scene_hypotheses_per_part: Count = 28
    """The same in each region of a scene, where other things look like parts."""
    roots: Count = 60
    """Part hypotheses that are grown into whole configurations, ..."""
    roots_close_up: Share = 0.5
    """... and the share of these that is in what is cut out of a scene, which holds little but the model."""
    many_parts: Natural = 16
    """Models with more parts than this get `more_*` in addition."""
    halvings: Annotated[int, Range(0, 20)] = 3
    """How often a scan that has no convincing answer is halved into pieces with hypotheses of their own, ..."""
    anchors_per_piece: Count = 50
    """... so many points of each piece to start from, ..."""
    roots_per_piece: Count = 40
    """... and so many of its hypotheses grown."""
    more_root_parts: Natural = 4
    """Parts that hypotheses start from, ..."""
    more_hypotheses: Natural = 3
    """... hypotheses that are kept of each, ..."""
    more_roots: Natural = 30
    """... hypotheses that are grown, ..."""
    more_refined: Natural = 12
    """... and configurations that are refined."""
    angle_step: Annotated[float, Range(float(np.radians(0.1)), np.pi)] = float(np.radians(6))
    """Step of the sweep of a revolute joint, rad."""
    beam: Count = 8
    """States kept along a chain."""
    modes: Count = 5
    """Values kept of each joint."""
    branch_beam: Count = 2
    """States kept at a branching."""
    wide_beam: Count = 96
    """The same from a known base, and for the limbs that the answer to a scene lacks."""
    wide_modes: Count = 16
    """Values kept of each joint there, ..."""
    wide_branch_beam: Count = 3
    """... and states kept at a branching."""
    refined: Count = 24
    """Grown configurations that are refined together."""
    refine_points: Count = 900
    """Scan points that configurations are refined with, ..."""
    fine_points: Count = 1500
    """... and the last of them, to the end."""
    lacking: NotNegative = 0.6
    """A part that explains less than this, against the average of all parts, may be wrong."""
    scene_points: Count = 4
    """How many times as many points of a scene are used, ..."""
    near_points: Count = 2
    """... and of what is near to one candidate."""
    sift_points: Count = 800
    """Scan points that decide which of many candidates are worth refining."""
    support_weight: NotNegative = 0.6
    """Weight of model support (model to scan) against scan coverage (scan to model)."""
    scene_support_weight: NotNegative = 1.5
    """The same where the scan is of a whole scene: a false answer hides where little speaks for or against it."""
    tolerant_unreturned: Share = 0.1
    """How free space is where no ray came back, once a single view has no convincing answer: it may have holes."""
    scene_normal_penalty: NotNegative = 1.8
    """Share of a point's gain lost when its normal is at right angles to the model's: more than all, in a scene and in
    what is cut out of one, or limbs would explain the things that touch the model."""
    scene_near_penalty: NotNegative = 0.3
    """Gain lost by a point near the model that it does not explain."""
    scene_mismatch_penalty: NotNegative = 0.5
    """Share of the price of free space for surface of the model on scan that is oriented otherwise, in a scene."""
    two_way: bool = True
    """Whether model support counts at all."""
    solid: bool = False
    """Whether parts that no joint connects may not be inside each other. Meshes of real machines often are."""
    support_distance: Positive = 0.035
    """A sample of the model nearer to the scan than this, or than 1.3 of its spacings, is supported."""
    coverage_distance: Positive = 0.03
    """A scan point nearer than this to the model is covered."""
    least_sigma: Positive = 0.005
    """Smallest robust scale of the refinement."""
    contradicted: Share = 0.1
    """Share of its surface that a single view may contradict of a right answer: 0.02 to 0.05 at true poses, 0.07 where
    a real sensor bends surfaces."""
    near: NotNegative = BAND - 1e-4
    """Points of a scene nearer than this should be of the model; the last distance that the kernels tell."""
    distinct: NotNegative = 0.03
    """Mean displacement of the surface below which two configurations are the same solution, ..."""
    alike: NotNegative = 0.004
    """... and below which they are not worth refining both."""
