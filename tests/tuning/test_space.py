"""The ranges of options, stated and given."""

import math
from typing import Any

import numpy as np
import pytest

from dpbench.errors import InputError
from dpbench.solvers.settings import resolve_options
from dpbench.solvers.table import (
    TABLE,
    check_availability,
    find_record,
    native_adapter,
    qpsolvers_adapter,
)
from dpbench.tuning.space import OptionRange, make_space


@pytest.mark.parametrize(
    ("ends", "middle"),
    [((1e-4, 1e2), 0.1), ((1.0, 2.0), 1.5), ((1, 50), 7), ((1, 4), 2), ((0, 100), 50)],
)
def test_wide_ranges_are_logarithmic_and_whole_numbers_stay_whole(
    ends: tuple[float, float], middle: float
) -> None:
    own = OptionRange("x", *ends)
    assert own.value_at(0.0) == ends[0] and own.value_at(1.0) == ends[1]
    value = own.value_at(0.5)
    assert value == middle and type(value) is type(ends[0])


def test_a_value_has_three_digits() -> None:
    """It is read by people, and is the same in every file."""
    assert OptionRange("x", 1e-3, 1e2).value_at(0.3) == float(f"{10 ** (-3 + 5 * 0.3):.3g}")


def test_ranges_of_ones_own_take_the_place_of_the_stated_ones() -> None:
    space = make_space("osqp", ["rho=[0.1,10]", "max_iter=[10,20]"])
    assert [own.name for own in space.ranges] == ["rho", "max_iter"]
    assert space.options_at(np.array([0.5, 1.0])) == {"rho": 1.0, "max_iter": 20}


@pytest.mark.parametrize("text", ["rho=1", "rho=[1]", "rho=[2,1]", "rho=[1,inf]", 'rho=["a","b"]'])
def test_what_is_no_range_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"--range: rho: found .*allowed: two numbers that grow"):
        make_space("osqp", [text])


def test_a_solver_without_stated_ranges_needs_some() -> None:
    with pytest.raises(InputError, match=r"quadprog, which has no stated range; .*--range"):
        make_space("quadprog")


def _solvers_with_ranges() -> list[Any]:
    found = []
    for name in TABLE:
        try:
            found.append((name, make_space(name)))
        except InputError:
            continue
    return found


@pytest.mark.parametrize(("solver", "space"), _solvers_with_ranges(), ids=lambda x: str(x)[:20])
def test_every_stated_range_is_of_an_option_of_the_solver(solver: str, space: Any) -> None:
    """A library accepts both ends; a renamed option would be found here."""
    if not check_availability(solver).ok:
        pytest.skip(f"{solver} is not installed")
    native = "native" in find_record(solver).routes
    adapter = native_adapter(solver) if native else qpsolvers_adapter(solver)
    for share in (0.0, 1.0):
        options = space.options_at(np.full(len(space.ranges), share))
        assert all(math.isfinite(value) for value in options.values())
        assert resolve_options(options, adapter).items() >= options.items()
