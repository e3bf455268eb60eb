"""Ranking and recommendation of verdicts made by hand."""

import json
import math
from typing import Any

import pytest

from dpbench.analysis.verdict.requirements import Finding, Requirements
from dpbench.analysis.verdict.verdict import (
    Verdict,
    Verdicts,
    choose_best_settings,
    choose_solver,
    explain_deployment_blocker,
    find_fastest_configuration,
    find_solver_family,
    find_solver_record_or_none,
    list_best_verdict_of_each_solver,
    list_best_verdict_of_own_settings,
    list_main_verdicts,
    rank_configurations,
    rank_solvers,
    sort_best_first,
    sort_fastest_first,
)
from dpbench.bench.record.cell import Configuration

PYTHON_CODE = "qtqp"
"""A solver that exists only as code of this project."""


def _verdict(
    solver: str,
    p99_ns: float = math.nan,
    *,
    settings: str = "default",
    route: Any = "qpsolvers",
    policy: Any = "fresh",
    state: Any = "pass",
    options: str = "",
    **figures: Any,
) -> Verdict:
    """A verdict on a configuration that was timed in one loop and one replay."""
    rounds = p99_ns, p99_ns
    usual = {"timed_on": "paper", "loops": 1, "replays": 1, "rounds_ns": rounds}
    configuration = Configuration(solver, route, policy, settings, options=options)
    return Verdict(configuration, state, p99_ns=p99_ns, **(usual | figures))


def _verdicts(*verdicts: Verdict) -> Verdicts:
    of: dict[str, list[Verdict]] = {}
    for verdict in verdicts:
        of.setdefault(verdict.configuration.solver, []).append(verdict)
    return Verdicts(Requirements(), of)


def _names(verdicts: list[Verdict]) -> list[str]:
    return [verdict.configuration.label for verdict in verdicts]


def test_verdicts_are_sorted_by_p99_then_p50_then_largest_step_then_name() -> None:
    verdicts = [
        _verdict("e"),
        _verdict("d"),
        _verdict("c", longest_ns=9.0),
        _verdict("f", longest_ns=8.0),
        _verdict("b", 20.0, longest_ns=1.0),
        _verdict("a", 20.0, longest_ns=1.0),
        _verdict("g", 10.0, longest_ns=99.0),
        _verdict("h", p50_ns=5.0, longest_ns=99.0),
    ]
    found = [verdict.configuration.solver for verdict in sort_fastest_first(verdicts)]
    assert found == ["g", "a", "b", "h", "f", "c", "d", "e"]


def test_settings_without_a_time_are_equally_good() -> None:
    """No step of theirs was timed, or not all; settings with a time are better."""
    late = {"state": "late", "options": "{}", "timed_on": ""}
    untimed = [_verdict("osqp", settings=name, **late) for name in ("a", "b")]
    assert choose_best_settings(_verdicts(*untimed), untimed).verdict is untimed[0]
    points = [*untimed, _verdict("osqp", p50_ns=5.0, settings="c", state="late", options="{}")]
    assert choose_best_settings(_verdicts(*points), points).verdict is points[2]


def test_only_the_most_widely_timed_are_ranked() -> None:
    verdicts = _verdicts(
        _verdict("daqp", 30.0, replays=3),
        _verdict("piqp", 20.0, replays=3),
        _verdict("few", 10.0, replays=2),
        _verdict("many", 10.0, replays=4, doubts=(Finding("lost"),)),
        _verdict("wrong", 10.0, replays=3, causes=(Finding("failed"),)),
        _verdict("absent", 10.0, replays=3, gaps=(Finding("absent"),)),
        _verdict("untimed", 10.0, replays=3, timed_on=""),
    )
    assert [v.configuration.solver for v in rank_configurations(verdicts)] == ["piqp", "daqp"]
    assert rank_configurations(_verdicts()) == []


@pytest.mark.parametrize(
    ("route", "policy", "p99_ns", "settings"),
    [
        ("qpsolvers", "fresh", 103.0, "default"),
        ("qpsolvers", "fresh", 103.5, "high"),
        ("native", "fresh", 101.0, "high"),
        ("qpsolvers", "reuse", 101.0, "high"),
        ("qpsolvers", "warm", 101.0, "high"),
    ],
)
def test_usual_settings_within_3_percent(
    route: str, policy: str, p99_ns: float, settings: str
) -> None:
    """The default of the same route and policy is chosen up to 1.03 times the time."""
    best = _verdict("daqp", 100.0, settings="high")
    usual = _verdict("daqp", p99_ns, route=route, policy=policy)
    found = find_fastest_configuration(_verdicts(usual, best), "daqp")
    assert found is not None and found.configuration.settings == settings


@pytest.mark.parametrize(
    ("fastest", "other"),
    [
        ({"route": "native"}, {"route": "qpsolvers"}),
        ({"route": "qpsolvers"}, {"route": "native"}),
        ({"policy": "reuse"}, {"policy": "fresh"}),
        ({"policy": "fresh"}, {"policy": "reuse"}),
    ],
)
def test_another_route_or_policy_is_no_twin(fastest: dict[str, str], other: dict[str, str]) -> None:
    best = _verdict("daqp", 100.0, settings="high", **fastest)
    usual = _verdict("daqp", 101.0, **other)
    assert rank_solvers(_verdicts(usual, best)) == [best]


@pytest.mark.parametrize(
    ("p99_ns", "rounds_ns", "settings"),
    [
        (119.0, (10.0, 12.0), "default"),
        (121.0, (10.0, 12.0), "high"),
        (119.0, (10.0, 11.0), "high"),
        (130.0, (10.0, 40.0), "high"),
    ],
)
def test_times_are_alike_within_the_spread_of_both_rounds(
    p99_ns: float, rounds_ns: tuple[float, float], settings: str
) -> None:
    """The rounds of the best spread by 1.2; equal medians of rounds hide no slower p99."""
    best = _verdict("daqp", 100.0, settings="high", rounds_ns=(10.0, 12.0))
    usual = _verdict("daqp", p99_ns, rounds_ns=rounds_ns)
    found = find_fastest_configuration(_verdicts(usual, best), "daqp")
    assert found is not None and found.configuration.settings == settings


def test_disturbed_rounds_hide_no_setting_that_is_twice_as_fast() -> None:
    """Both spread by 2.5, on a busy machine: 90 us is not named where 38 us passes."""
    slow = _verdict("osqp", 90e3, settings="rho=0.1", rounds_ns=(40e3, 100e3))
    fast = _verdict("osqp", 38e3, settings="rho=10", rounds_ns=(36e3, 90e3))
    assert find_fastest_configuration(_verdicts(slow, fast), "osqp") is fast


def test_without_a_p99_medians_are_compared() -> None:
    """Medians of 100 and 102 are alike, whichever has the longer step."""
    best = _verdict("daqp", settings="high", p50_ns=100.0, longest_ns=200.0)
    usual = _verdict("daqp", p50_ns=102.0, longest_ns=300.0)
    assert find_fastest_configuration(_verdicts(usual, best), "daqp") is usual
    slow = _verdict("daqp", p50_ns=240.0, longest_ns=190.0)
    assert find_fastest_configuration(_verdicts(slow, best), "daqp") is best
    assert find_fastest_configuration(_verdicts(usual, best), "piqp") is None


def test_the_recommendation_is_the_fastest_that_can_be_deployed() -> None:
    fast, second, third = (
        _verdict(PYTHON_CODE, 10.0),
        _verdict("daqp", 20.0),
        _verdict("piqp", 30.0),
    )
    found = choose_solver(_verdicts(third, second, fast))
    assert (found.chosen, found.runner_up, found.faster) == (second, third, fast)
    assert found.because == explain_deployment_blocker(PYTHON_CODE) != ""
    alone = choose_solver(_verdicts(second, third))
    assert (alone.chosen, alone.runner_up, alone.faster) == (second, third, None)
    assert alone.because == ""


def test_nothing_is_recommended_where_nobody_can_be_deployed() -> None:
    fast = _verdict(PYTHON_CODE, 10.0)
    found = choose_solver(_verdicts(fast))
    assert (found.chosen, found.runner_up, found.faster) == (None, None, fast)
    empty = choose_solver(_verdicts())
    assert (empty.chosen, empty.runner_up, empty.faster, empty.because) == (None, None, None, "")


@pytest.mark.parametrize(
    ("states", "chosen"),
    [
        (("pass", "borderline", "inconclusive"), 0),
        (("borderline", "pass", "inconclusive"), 1),
        (("inconclusive", "borderline", "pass"), 2),
        (("inconclusive", "borderline", "inconclusive"), 1),
        (("inconclusive", "inconclusive", "inconclusive"), 0),
    ],
)
def test_a_better_verdict_precedes_a_time(states: tuple[str, str, str], chosen: int) -> None:
    solvers = ("daqp", "piqp", "osqp")
    verdicts = [
        _verdict(solver, 10.0 * (i + 1), state=state)
        for i, (solver, state) in enumerate(zip(solvers, states, strict=True))
    ]
    found = choose_solver(_verdicts(*verdicts))
    assert found.chosen is verdicts[chosen]
    assert found.faster is None
    assert (found.runner_up is None) == (states.count("inconclusive") < 3)


def test_a_solver_that_is_not_known_here() -> None:
    assert find_solver_record_or_none("nobody") is None
    assert find_solver_family("nobody") == "not stated"
    assert explain_deployment_blocker("nobody") == "not in the table of this installation"
    assert (
        find_solver_record_or_none("daqp") is not None
        and find_solver_family("daqp") == "active set"
    )
    assert {explain_deployment_blocker(name) for name in ("daqp", "osqp", "clarabel")} == {""}
    assert explain_deployment_blocker("qtqp") == "written in Python"
    assert explain_deployment_blocker(PYTHON_CODE).startswith("written in Python")


LATE, WRONG = (Finding("p99 late"),), (Finding("failed"),)


def test_the_verdict_that_shows_each_solver() -> None:
    """It has the best state; of those the fastest qualifying one, or the fastest."""
    shown = {
        "a": _verdict("a", 30.0, settings="high"),
        "b": _verdict("b", 10.0, settings="low", state="late", causes=LATE),
        "c": _verdict("c", 20.0, settings="low", state="late", causes=LATE),
        "d": _verdict("d", 70.0, state="fail", causes=WRONG),
        "e": _verdict("e", 90.0, state="inconclusive", replays=0, timed_on=""),
        "f": _verdict("f", 60.0, state="borderline"),
    }
    found = list_best_verdict_of_each_solver(
        _verdicts(
            _verdict("d", 10.0, state="pass", loops=0, doubts=(Finding("lost"),)),
            shown["d"],
            _verdict("e", 95.0, settings="low", state="fail", causes=WRONG, loops=0),
            shown["e"],
            shown["b"],
            _verdict("b", 50.0, state="late", causes=LATE),
            _verdict("c", 10.0, state="fail", causes=WRONG),
            _verdict("c", 25.0, settings="high", state="late", causes=LATE),
            shown["c"],
            shown["f"],
            _verdict("a", 40.0),
            shown["a"],
        )
    )
    assert found == [shown[name] for name in "afebcd"]


def test_the_best_of_failing_configurations_is_the_most_accurate() -> None:
    """By failed steps, then error, then time; one that did not finish its runs is last."""
    failing = {"state": "fail", "causes": WRONG}
    ordered = [
        _verdict("a", 40.0, settings="1", failed_steps=0, error_move=0.16, **failing),
        _verdict("a", 30.0, settings="2", failed_steps=0, error_move=0.2, **failing),
        _verdict("a", 35.0, settings="3", failed_steps=0, error_move=0.2, **failing),
        _verdict("a", 10.0, settings="4", failed_steps=55, error_move=0.1, **failing),
        _verdict("a", 5.0, settings="5", state="fail", causes=(Finding("crashed"),)),
    ]
    assert sort_best_first(reversed(ordered)) == ordered
    assert list_best_verdict_of_each_solver(_verdicts(*reversed(ordered))) == ordered[:1]


@pytest.mark.parametrize(
    ("faster", "slower", "shown"),
    [
        ((1, 1, 3), (1, 3, 1), "faster"),
        ((1, 3, 1), (2, 1, 1), "faster"),
        ((1, 2, 2), (2, 3, 1), "slower"),
        ((2, 1, 1), (1, 2, 2), "slower"),
        ((2, 2, 1), (1, 3, 2), "slower"),
        ((0, 5, 3), (1, 1, 0), "slower"),
    ],
)
def test_own_settings_are_shown_by_the_call_mode_that_was_judged_most(
    faster: tuple[int, int, int], slower: tuple[int, int, int], shown: str
) -> None:
    """In how many loops, replays and windows: a call mode of no loop or fewer runs hides none."""
    verdicts = []
    for policy, p99_ns, judged in (("warm", 10.0, faster), ("fresh", 20.0, slower)):
        counts = dict(zip(("loops", "replays", "windows"), judged, strict=True))
        verdicts.append(_verdict("daqp", p99_ns, policy=policy, options="{}", **counts))
    (found,) = list_best_verdict_of_own_settings(_verdicts(*verdicts))
    assert found is verdicts[["faster", "slower"].index(shown)]


def test_the_best_twelve_own_settings_are_listed_beside_each_solver() -> None:
    """Points of a grid leave room for single settings, even slower ones."""
    preset = _verdict("daqp", 30.0)
    grid = [
        _verdict("daqp", 40.0 + i, options=json.dumps({"rho": i}), replays=2, state="late")
        for i in range(13)
    ]
    assert list_main_verdicts(_verdicts(preset, *reversed(grid))) == [preset, *grid[:12]]
    single = _verdict("daqp", 99.0, options='{"alpha": 1}', replays=2, state="late")
    listed = [preset, *grid[:11], single]
    assert list_main_verdicts(_verdicts(preset, *reversed(grid), single)) == listed
