"""Scores of different answers that can be held against each other."""

from __future__ import annotations

from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.ranking import ahead_of_mirrored
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison


def test_an_answer_farther_off_its_points_is_no_likelier_for_the_noise_that_it_makes(
    comparison: ScanComparison, right: Candidates
) -> None:
    """By the noise that each leaves, a worse fit to the mirror image of a scan was about as likely."""
    off = Candidates(right.bases.copy(), right.values, right.scores)
    off.bases[:, :3, 3] += 0.005
    assert comparison.residual(off) > comparison.residual(right)
    ahead = ahead_of_mirrored((comparison, right), (comparison, off))
    assert ahead > 0.3
    assert ahead == -ahead_of_mirrored((comparison, off), (comparison, right))
