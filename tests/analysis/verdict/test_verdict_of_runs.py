"""The parts of a verdict: judged steps, reference, gaps, causes and doubts, worked by hand."""

import math
from typing import Any

import pytest

from dpbench.analysis.verdict.requirements import Finding, Requirements
from dpbench.analysis.verdict.verdict import Verdict, judge_solvers

REQUIREMENTS = Requirements()


def _all(records: Any, solver: str = "daqp") -> list[Verdict]:
    return list(judge_solvers(records.view(), REQUIREMENTS).of[solver])


def _only(records: Any) -> Verdict:
    (verdict,) = _all(records)
    return verdict


def _found(findings: tuple[Finding, ...]) -> list[tuple[str, list[str], float, int]]:
    """Kind, scenarios, value (-1 for none) and steps of each finding."""
    return [
        (
            one.kind,
            [run.scenario for run in one.runs],
            -1.0 if one.value != one.value else one.value,
            one.steps,
        )
        for one in findings
    ]


def test_a_configuration_that_was_not_run_has_no_figures(records: Any) -> None:
    records.refused("daqp", "no model.")
    records.refused("daqp", "no wrapper", "replay")
    verdict = _only(records)
    assert (verdict.state, verdict.refusal) == ("not run", "no model")
    counts = verdict.loops, verdict.replays, verdict.windows, verdict.steps, verdict.failed_steps
    assert counts == (0, 0, 0, 0, 0)
    assert math.isnan(verdict.error_move) and verdict.timed_on == ""


def test_a_refusal_without_a_reason(records: Any) -> None:
    records.refused("daqp", "")
    assert _only(records).refusal == "no reason was recorded"


@pytest.mark.parametrize(
    ("columns", "steps"),
    [
        ({}, 100),
        ({"uncertified": 7}, 93),
        ({"undecided_steps": 7}, 93),
        ({"uncertified": 7, "undecided_steps": 3}, 90),
        ({"uncertified": 7, "undecided_steps": 3, "rounds": 0}, 90),
        ({"uncertified": 7, "rounds": 1}, 93),
        ({"uncertified": 30, "rounds": 3}, 90),
        ({"uncertified": 32, "rounds": 3}, 90),
        ({"uncertified": 101}, 0),
        ({"uncertified": 99}, 1),
    ],
)
def test_the_steps_with_a_judged_answer(records: Any, columns: dict[str, Any], steps: int) -> None:
    """Steps without a certified optimum are left out of the 100; a replay has them in rounds."""
    records.loop("daqp", steps=100, **columns)
    assert _only(records).steps == steps


def test_counts_and_errors_over_all_runs(records: Any) -> None:
    records.loop("daqp", steps=100, failed=2, error=1e-4)
    records.loop("daqp", "calm", steps=50, done=40, failed=1, error=1e-3, outcome="timed_out")
    records.replay("daqp", steps=300, failed=4, error=1e-5)
    records.refused("daqp", "no model", sequence="rough", mode="replay")
    verdict = _only(records)
    assert (verdict.loops, verdict.replays, verdict.windows) == (2, 1, 0)
    assert (verdict.steps, verdict.failed_steps, verdict.error_move) == (440, 7, 1e-3)


def test_runs_in_si_units_and_of_the_baseline_law_are_not_judged(records: Any) -> None:
    records.loop("daqp", error=0.5, units="si")
    records.loop("daqp")
    records.loop("unconstrained_clipped", formulation="none")
    records.loop("scs")
    view = records.view()
    assert list(judge_solvers(view, REQUIREMENTS).of) == ["daqp", "scs"]
    assert not _only(records).causes
    assert list(judge_solvers(view, REQUIREMENTS, view.runs[-1:]).of) == ["scs"]


@pytest.mark.parametrize(("first", "second", "error"), [(60, 120, 2), (120, 60, 1), (60, 60, 1)])
def test_the_longest_run_is_judged(records: Any, first: int, second: int, error: float) -> None:
    records.loop("daqp", steps=first, error=1e-4)
    records.loop("daqp", steps=second, error=2e-4)
    verdict = _only(records)
    assert (verdict.loops, verdict.error_move) == (1, error * 1e-4)


def _settings(records: Any) -> list[str]:
    return [verdict.configuration.settings for verdict in _all(records)]


def test_the_reference_has_the_most_usual_settings_that_ran(records: Any) -> None:
    records.refused("daqp", "no model")
    for settings in ("high", "low", "mid"):
        records.loop("daqp", settings=settings)
    assert _settings(records) == ["low", "mid", "high", "default"]


def test_a_stopped_run_makes_a_reference(records: Any) -> None:
    records.loop("daqp", settings="high")
    records.loop("daqp", outcome="timed_out", done=40)
    assert _settings(records) == ["default", "high"]


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ([{"policy": "warm"}, {"policy": "reuse"}, {}], ["fresh", "reuse", "warm"]),
        ([{"route": "native"}, {"policy": "warm"}], ["qpsolvers", "native"]),
    ],
)
def test_the_reference_has_the_default_route_and_the_first_policy(
    records: Any, columns: list[dict[str, Any]], expected: list[str]
) -> None:
    for one in columns:
        records.loop("daqp", **one)
    own = [verdict.configuration for verdict in _all(records)]
    assert [c.policy if len(columns) == 3 else c.route for c in own] == expected


def test_the_reference_has_loops_and_replays(records: Any) -> None:
    records.loop("daqp")
    records.loop("daqp", "calm")
    records.loop("daqp", route="native", policy="warm")
    records.replay("daqp", route="native", policy="warm")
    assert [v.configuration.policy for v in _all(records)] == ["warm", "fresh"]


def test_gaps_of_a_configuration(records: Any) -> None:
    for scenario in ("paper", "calm", "rough", "turn", "move"):
        outcome = {"outcome": "timed_out", "done": 90} if scenario == "turn" else {}
        records.loop("daqp", scenario, **outcome)
    records.refused("daqp", "no model", scenario="wrap")
    records.loop("daqp", "rough", settings="high", steps=119, done=119)
    records.loop("daqp", "move", settings="high", steps=121)
    records.loop("daqp", "calm", settings="high", outcome="refused", done=0)
    reference, high = _all(records)
    assert reference.gaps == ()
    assert _found(high.gaps) == [
        ("absent", ["paper", "turn"], -1.0, 0),
        ("refused", ["calm"], -1.0, 0),
        ("short", ["rough"], -1.0, 120),
    ]
    assert high.state == "inconclusive" and not high.is_rankable


def test_wrong_answers_and_failed_steps_are_causes(records: Any) -> None:
    records.loop("daqp", error=0.02)
    records.loop("daqp", "calm", error=0.03, failed=1)
    records.loop("daqp", "rough", error=math.inf, failed=3)
    records.loop("daqp", "turn", outcome="hung", done=0)
    records.loop("daqp", "wrap", outcome="crashed", done=0)
    records.loop("daqp", "move", outcome="hung", done=0)
    verdict = _only(records)
    above = verdict.causes[1].steps
    assert 0 < above <= 120
    assert _found(verdict.causes) == [
        ("no answer", ["rough"], -1.0, 0),
        ("inaccurate", ["calm", "paper"], 0.03, above),
        ("failed", ["rough", "calm"], 3.0, 0),
        ("crashed", ["wrap"], -1.0, 0),
        ("hung", ["turn", "move"], -1.0, 0),
    ]
    assert (verdict.state, verdict.doubts) == ("fail", ())


def test_unfinished_runs_are_doubts(records: Any) -> None:
    records.loop("daqp", outcome="crashed", done=0)
    records.loop("daqp", "calm", outcome="timed_out", done=40)
    records.loop("daqp", "rough", outcome="timed_out", done=120)
    records.loop("daqp", "turn", outcome="lost", done=0)
    records.loop("daqp", "wrap", outcome="invalid", done=60)
    records.loop("daqp", "move", uncertified=2)
    records.loop("daqp", "squall", outcome="invalid", done=60)
    records.replay("daqp", stopped=True)
    records.replay("daqp", "calm", steps=400, stopped=True, done=399)
    assert _found(_only(records).doubts) == [
        ("stopped", ["calm"], 40.0, 120),
        ("stopped", ["rough"], 120.0, 120),
        ("lost", ["turn"], -1.0, 0),
        ("ended", ["wrap"], -1.0, 0),
        ("uncertified", ["move"], 2.0, 0),
        ("ended", ["squall"], -1.0, 0),
        ("stopped", ["calm"], 399.0, 400),
    ]


def test_loops_of_a_study_are_named_beside_a_missing_loop(records: Any) -> None:
    records.replay("daqp", median_us=20.0)
    records.sea("daqp", 0, 0, {"sea": 1.0})
    (timed,) = _all(records)
    assert [finding.kind for finding in timed.findings_that_bar_pass] == [
        "no loop but studied ones"
    ]


def test_kinds_of_runs_that_are_missing(records: Any) -> None:
    records.replay("daqp", median_us=20.0)
    records.loop("scs")
    (timed,), (steered,) = _all(records), _all(records, "scs")
    assert [finding.kind for finding in timed.findings_that_bar_pass] == ["no closed loop"]
    assert [finding.kind for finding in steered.findings_that_bar_pass] == ["no replay"]
    assert (timed.state, timed.is_rankable) == ("inconclusive", True)
    assert (steered.state, steered.is_rankable) == ("inconclusive", False)
