"""Evidence that speaks for an answer in every way."""

from __future__ import annotations

from pwralign_kin.estimation.evidence.evidence import Evidence

GOOD = Evidence(
    nearby=0.0,
    lacking=0.0,
    uneven=1.1,
    margin=0.05,
    distinct=8.0,
    told=8.0,
    ahead=0.3,
    noise=0.002,
    borne_out=0.6,
    in_sight=0.85,
    shown=1.0,
    agreed=0.95,
    explained=1.0,
    strange=0.0,
    astray=0.0,
    refuted=0.0,
    continued=0.0,
    points_per_part=300.0,
    size=1.0,
    size_gain=0.0,
    mirrored=0.0,
)
