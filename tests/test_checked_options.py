"""Every number of every section of options is checked, and anything else than its type says is refused by name."""

from __future__ import annotations

import importlib
import json
import math
import pkgutil
from collections.abc import Iterator
from dataclasses import fields, replace
from fractions import Fraction
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.checked_options import SEED_LIMIT, CheckedOptions
from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.refinement.joint_least_squares import LeastSquaresOptions
from pwralign_kin.exceptions import OptionError, UnknownNameError

for module in pkgutil.walk_packages(pk.__path__, "pwralign_kin."):
    if ".cli" not in module.name:
        importlib.import_module(module.name)

SECTIONS = sorted(CheckedOptions.__subclasses__(), key=lambda section: section.__name__)


ELSEWHERE = {"near", "up", "base_up", "prior", "prior_std"}
"""Points, directions and values by joint: checked as they are elsewhere."""


def _numbers() -> Iterator[Any]:
    """Section, field, and the type of its number, for each of all sections."""
    for section in SECTIONS:
        for name, hint in get_type_hints(section, include_extras=True).items():
            members = get_args(hint) if get_origin(hint) is not Annotated else (hint,)
            hints = [member for member in members if get_origin(member) is Annotated]
            if hints:
                yield pytest.param(section, name, hint, hints[0], id=f"{section.__name__}.{name}")


def test_options_are_found() -> None:
    names = {section.__name__ for section in SECTIONS}
    assert {"EstimatorOptions", "SearchOptions", "VoteOptions", "TrackerOptions", "Sensor", "Room"} <= names
    nested = {own.default_factory for section in SECTIONS for own in fields(section) if own.name != "T_scan_camera"}
    assert all(not isinstance(kind, type) or kind in (*SECTIONS, dict) for kind in nested)


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.__name__)
def test_every_number_says_its_range(section: type) -> None:
    hints = get_type_hints(section, include_extras=True)
    plain = {name: {hint} if get_origin(hint) is Annotated else {hint, *get_args(hint)} for name, hint in hints.items()}
    assert not [name for name, kinds in plain.items() if {int, float} & kinds and name not in ELSEWHERE]


@pytest.mark.parametrize(("section", "name", "hint", "number"), list(_numbers()))
def test_every_number_is_checked(section: Any, name: str, hint: Any, number: Any) -> None:
    kind, valid = get_args(number)
    wrap = (lambda value: (value, value)) if get_origin(hint) is tuple else (lambda value: value)
    for value in (0, -1, 1, 10**7, 1.5, math.nan, math.inf, "8", True, [1], 1j, np.ones(2), None):
        if value is None and type(None) in get_args(hint):
            continue
        plain = isinstance(value, int if kind is int else int | float) and not isinstance(value, bool)
        if plain and valid.least <= value <= valid.most and not (valid.beyond_least and value == valid.least):
            assert getattr(section(**{name: wrap(value)}), name) == wrap(value)
        else:
            with pytest.raises(OptionError, match=rf"^{section.__name__}\.{name}(\[0\])? must be ") as caught:
                section(**{name: wrap(value)})
            error = caught.value
            assert error.valid and error.name.startswith(f"{section.__name__}.{name}")


def test_no_number_is_too_large_to_be_refused() -> None:
    for options in ({"most_turn": 10**400}, {"noisy": 10**400}, {"iterations": 10**400}):
        with pytest.raises(OptionError, match=next(iter(options))):
            LeastSquaresOptions(**options)  # type: ignore[arg-type]
    assert LeastSquaresOptions(noisy=math.inf).noisy == math.inf


def test_numbers_of_numpy_become_plain_ones() -> None:
    options = pk.EstimatorOptions(
        seed=np.random.default_rng(0).integers(100),
        threads=np.uint8(1),
        search=SearchOptions(refine_points=np.int64(500), support_weight=np.float32(0.5), solid=np.True_),
        prior={"a": np.float32(0.5)},
    )
    assert type(options.seed) is int and type(options.search.support_weight) is float
    assert options.search.solid is True
    json.dumps([options.seed, options.threads, vars(options.search), dict(options.prior)])
    assert SearchOptions(support_weight=Fraction(1, 2)).support_weight == 0.5  # type: ignore[arg-type]


def test_seeds_have_one_limit() -> None:
    assert pk.EstimatorOptions(seed=SEED_LIMIT - 1).seed == 2**32 - 1
    with pytest.raises(OptionError, match=r"EstimatorOptions\.seed must be a whole number from 0 to 4294967295"):
        pk.EstimatorOptions(seed=SEED_LIMIT)


@pytest.mark.parametrize("wrong", ["fast", None, 3, (3,), ("a", None)])
def test_names_are_names(wrong: Any) -> None:
    for name in ("sources", "locked"):
        with pytest.raises(OptionError, match=f"EstimatorOptions.{name} must be several names"):
            pk.EstimatorOptions(**{name: wrong})


def test_an_effort_is_one_of_three() -> None:
    for wrong in ("fsat", None, 3):
        with pytest.raises(UnknownNameError, match="effort"):
            pk.EstimatorOptions(effort=wrong)


def test_sections_are_of_their_own_kind() -> None:
    with pytest.raises(OptionError, match=r"EstimatorOptions.search must be SearchOptions\(...\), not VoteOptions"):
        replace(pk.EstimatorOptions(), search=pk.EstimatorOptions().repair.votes)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match=r"SearchOptions\.solid must be True or False, not 'no'"):
        SearchOptions(solid="no")  # type: ignore[arg-type]
