"""The search on functions with a known best point, and the ranges of options that it searches."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from dpbench.analysis.verdict.requirements import Finding
from dpbench.errors import InputError
from dpbench.solvers.contract import Options
from dpbench.solvers.settings import resolve_settings_to_options
from dpbench.solvers.table import (
    TABLE,
    find_solver_availability,
    find_solver_record,
    get_native_adapter,
    get_qpsolvers_adapter,
)
from dpbench.tuning.search import BATCH, OptionRange, Score, SearchSpace, SettingsSearch, make_space

SPACE = SearchSpace((OptionRange("a", 1e-3, 1e3), OptionRange("b", 0.0, 1.0)))


def _time(options: Options) -> float:
    """1 at a = 10 and b = 0.7, and more elsewhere."""
    a, b = float(str(options["a"])), float(str(options["b"]))
    return 1.0 + math.log10(a / 10.0) ** 2 + (b - 0.7) ** 2


def _evaluate(settings: Sequence[Options]) -> list[Score]:
    """Inaccurate above a = 100, the more the larger."""
    scores = []
    for options in settings:
        excess = max(0.0, math.log10(float(str(options["a"])) / 100.0))
        scores.append(Score(int(excess > 0.0), excess, _time(options) if not excess else math.nan))
    return scores


def test_the_batches_near_the_best_improve_it() -> None:
    search = SettingsSearch(SPACE, _evaluate, seed=1)
    search.run(8 * BATCH)
    spread = search.trials[: 4 * BATCH]
    assert search.best.score.is_right
    assert search.best not in spread
    assert search.best.score.ratio < 1.02
    assert len({trial.name for trial in search.trials}) == len(search.trials) <= 8 * BATCH


def test_the_same_seed_tries_the_same_settings() -> None:
    """So that a search that was interrupted finds its finished runs again."""
    trials = []
    for seed in (3, 3, 4):
        search = SettingsSearch(SPACE, _evaluate, seed)
        search.run(2 * BATCH)
        trials.append([trial.name for trial in search.trials])
    assert trials[0] == trials[1] != trials[2]


@pytest.mark.parametrize("trials", [1, 2, 3, 8, 11, 20])
def test_as_many_settings_are_tried_as_asked(trials: int) -> None:
    """In batches of at most 8; from two trials on some are near the best."""
    batches: list[int] = []

    def evaluate(settings: Sequence[Options]) -> list[Score]:
        batches.append(len(settings))
        return _evaluate(settings)

    SettingsSearch(SPACE, evaluate, seed=1).run(trials)
    assert sum(batches) == trials and max(batches) <= BATCH
    assert len(batches) >= min(2, trials)


def _late(time_ms: float) -> Finding:
    return Finding("p99 late", value=1e6 * time_ms, limit=3e6)


def test_accuracy_comes_before_time() -> None:
    """Inaccurate settings rank by their distance from the requirement; a run without a time comes
    after those with one, and late ones after those in time, by number and time."""
    first_to_last = [
        Score(0, 0.0, 0.5),
        Score(0, 0.0, 2.0),
        Score(0, 0.0, math.nan),
        Score(0, 0.0, 0.3, (_late(4.0),)),
        Score(0, 0.0, 0.1, (_late(9.0),)),
        Score(0, 0.0, 0.1, (_late(4.0), _late(4.0))),
        Score(1, 0.1, math.nan),
        Score(1, 3.0, math.nan),
        Score(2, 0.1, math.nan),
    ]
    last_to_first = first_to_last[::-1]
    assert sorted(last_to_first, key=lambda score: score.key) == first_to_last


def test_the_search_tries_the_start_first() -> None:
    """As it is given, also between the points of the ranges, and goes on near it."""
    start = {"a": 10.001, "b": 0.7}
    search = SettingsSearch(SPACE, _evaluate, seed=1)
    search.run(2 * BATCH, [start])
    assert search.trials[0].options == start
    assert search.best.score.ratio < 1.0001
    near = [trial.point for trial in search.trials[-BATCH:]]
    assert all(abs(point - search.trials[0].point).max() <= 0.25 for point in near)


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
    with pytest.raises(InputError, match=r"--range: rho: found .*allowed: two increasing numbers"):
        make_space("osqp", [text])


def test_a_solver_without_stated_ranges_needs_some() -> None:
    with pytest.raises(InputError, match=r"no predefined range; .*--range .*such as \w+, \w+"):
        make_space("cvxopt")
    with pytest.raises(InputError, match="no options to tune; allowed: a solver with predefined "):
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
    if not find_solver_availability(solver).ok:
        pytest.skip(f"{solver} is not installed")
    native = "native" in find_solver_record(solver).routes
    adapter = get_native_adapter(solver) if native else get_qpsolvers_adapter(solver)
    for share in (0.0, 1.0):
        options = space.options_at(np.full(len(space.ranges), share))
        assert all(math.isfinite(value) for value in options.values())
        assert resolve_settings_to_options(options, adapter).items() >= options.items()


def test_a_wider_range_keeps_the_other_stated_ones() -> None:
    stated, wider = make_space("osqp"), make_space("osqp", widened=["rho=[1e-3,1e4]"])
    assert [own.name for own in wider.ranges] == [own.name for own in stated.ranges]
    changed = set(wider.ranges) - set(stated.ranges)
    assert changed == {OptionRange("rho", 1e-3, 1e4)}
    (alpha,) = set(make_space("osqp", widened=["alpha=[0.1,1.9]"]).ranges) - set(stated.ranges)
    assert alpha.describe_edge(1.9) == "" != alpha.describe_edge(0.1)
    assert make_space("quadprog", widened=["x=[1,2]"]).ranges == (OptionRange("x", 1, 2),)
    with pytest.raises(InputError, match=r"--widen: rho: found \[2, 1\]"):
        make_space("osqp", widened=["rho=[2,1]"])


def test_own_options_that_are_not_searched_are_fixed() -> None:
    own = {"rho": 1, "adaptive_rho": False}
    space = make_space("osqp", ["rho=[0.1,10.0]", "max_iter=[10,20]"], own=own)
    assert space.options_at(np.array([1.0, 0.0])) == {
        "adaptive_rho": False,
        "rho": 10.0,
        "max_iter": 10,
    }
    assert type(space.convert_to_range_types(own)["rho"]) is float
    assert space.point_of(own).tolist() == [0.5, 0.5]


@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("ends", [(1e-4, 1e2), (1.0, 2.0), (-5.0, 5.0)])
def test_the_share_of_a_value_gives_the_value(ends: tuple[float, float], share: float) -> None:
    own = OptionRange("x", *ends)
    assert own.share_of(own.value_at(share)) == pytest.approx(share, abs=2e-3)
    assert own.share_of(ends[0] - 1e-5) == 0.0 and own.share_of(2 * ends[1]) == 1.0


@pytest.mark.parametrize(
    ("own", "value", "wider"),
    [
        (OptionRange("rho", 1e-3, 1e2), 99.0, "[0.001, 10000.0]"),
        (OptionRange("rho", 1e-3, 1e2), 1e-3, "[1e-05, 100.0]"),
        (OptionRange("rho", 1e-3, 1e2), 1.0, ""),
        (OptionRange("a", 1.0, 2.0), 2.0, "[1.0, 3.0]"),
        (OptionRange("a", 1.0, 2.0), 1.0, "[0.0, 2.0]"),
        (OptionRange("a", 1.0, 2.0, "both"), 2.0, ""),
        (OptionRange("a", 1.0, 2.0, "high"), 2.0, ""),
        (OptionRange("a", 1.0, 1.9, "high"), 1.0, "[0.1, 1.9]"),
        (OptionRange("a", 1.0, 1.9, "low"), 1.0, ""),
        (OptionRange("k", 1, 50), 50, "[1, 5000]"),
        (OptionRange("k", 1, 50), 1, ""),
        (OptionRange("k", 20, 50), 20, "[1, 50]"),
    ],
)
def test_a_value_at_the_edge_names_a_wider_range(
    own: OptionRange, value: float, wider: str
) -> None:
    remark = f"{own.name} = {value:g}: widen it with --widen '{own.name}={wider}'"
    expected = remark if wider else ""
    assert own.describe_edge(value) == expected
