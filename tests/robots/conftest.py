"""Sample models read once per test file."""

from __future__ import annotations

import pytest
from sample_robot import NAMES, Sample


@pytest.fixture(scope="module")
def cubebot() -> Sample:
    return Sample("cubebot")


@pytest.fixture(scope="module")
def lander() -> Sample:
    return Sample("viking_lander")


@pytest.fixture(params=NAMES, scope="module")
def sample(request: pytest.FixtureRequest) -> Sample:
    return Sample(request.param)
