"""The verdict against hand-made rows."""

import json
import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dpbench.analysis.times.paired_times import (
    compare_configurations,
    compare_paired_times,
    compare_settings_of_solvers,
)
from dpbench.analysis.verdict.requirements import MISSED, Finding, Requirements
from dpbench.analysis.verdict.time_findings import compute_speed_margins
from dpbench.analysis.verdict.verdict import judge_solvers, sort_fastest_first
from dpbench.bench.record.cell import Configuration
from dpbench.report.page.recommendation import Recommendation
from dpbench.report.verdict.findings_text import (
    describe_caching_sign,
    describe_finding,
    describe_findings,
)
from dpbench.report.verdict.verdict_text import (
    describe_answer,
    describe_main_reason,
    describe_paired_times,
    describe_requirements,
    describe_which_solvers_pass,
)

REQUIREMENTS = Requirements()


def _verdict(records: Any, solver: str, settings: str = "default") -> Any:
    own = judge_solvers(records.view(), REQUIREMENTS).of[solver]
    wanted = replace(own[0].configuration, settings=settings)
    return next(verdict for verdict in own if verdict.configuration == wanted)


def _why(verdict: Any) -> str:
    """Return the reasons against a verdict, or those it lacks, in the words of terminal and
    tables."""
    return verdict.refusal or describe_findings(verdict.causes or verdict.findings_that_bar_pass)


def test_exact_and_fast_meets(records: Any) -> None:
    records.loop("daqp")
    records.replay("daqp", median_us=20.0)
    verdict = _verdict(records, "daqp")
    assert verdict.state == "pass"
    assert verdict.steps == 120 + 1000
    assert Recommendation.why(verdict) == ""
    assert not verdict.causes and not verdict.findings_that_bar_pass


CAUSES = [
    (
        {"error": 0.43},
        {},
        "the error of its first move reaches 0.43 times the maximum increment in",
    ),
    ({"error": math.inf}, {}, "it leaves steps without a solution in `paper`"),
    ({"failed": 3}, {}, "3 of 120 steps fail in `paper`"),
    ({}, {"median_us": 4000.0}, "its p99 is"),
    ({}, {"median_us": 4000.0, "steps": 300}, "exceeds the p99 limit"),
    (
        {},
        {"failed": 2},
        "2 of 1\u202f000 steps fail in the replay of `paper`",
    ),
    (
        {},
        {"failed": 2, "lost": (3, 5)},
        "2 of 1\u202f000 steps fail in the replay of `paper`, first at step 3, as the solver ",
    ),
    (
        {},
        {"failed": 4, "lost": (5,)},
        "1 of 1\u202f000 steps fails in the replay of `paper`, at step 5, as the solver reaches ",
    ),
    ({}, {"error": 0.2}, "times the maximum increment in the replay of `paper`"),
]


@pytest.mark.parametrize(("loop", "replay", "clause"), CAUSES)
def test_causes_in_words(
    records: Any, loop: dict[str, Any], replay: dict[str, Any], clause: str
) -> None:
    records.loop("daqp", **loop)
    records.replay("daqp", **replay)
    verdict = _verdict(records, "daqp")
    assert verdict.state in MISSED
    assert clause in _why(verdict)


def test_an_error_of_the_library_is_quoted(records: Any) -> None:
    """Without marks of Markdown, on one line and cut."""
    detail = f"20 × ValueError:\n`2`{'!' * 200}; 3 × Other"
    records.replay("osqp", outcome_detail=detail)
    records.replay("osqp", outcome_detail="stopped after 60 s")
    quoted, plain = (
        describe_finding(Finding("failed", (run,), 8.0, 2, status="ERROR"))
        for run in records.view().runs
    )
    words = f"ValueError: '2'{'!' * 85}"
    assert quoted.endswith(f"as the library reports an error (most frequent message: {words})")
    assert len(words) == 100 and plain.endswith("as the library reports an error")


def test_the_first_failed_step_of_a_window_is_not_named(records: Any) -> None:
    """Its steps are not those of the scenario."""
    source = {"kind": "hardest", "name": "paper hardest 15", "of": 450}
    records.replay("osqp", "paper hardest 15", steps=15, cell=json.dumps({"source": source}))
    finding = Finding("failed", tuple(records.view().runs), 8.0, 2, first=3)
    assert describe_finding(finding).startswith(
        "2 of the 15 steps of the window of `paper` fail, as "
    )


@pytest.mark.parametrize(
    ("steps", "infeasible", "clause"),
    [
        (3, 0, "3 of 120 steps fail"),
        (3, 2, "3 of 120 steps, 2 of them with an infeasible QP not reported as such, fail"),
        (3, 3, "3 of 120 steps, all with an infeasible QP not reported as such, fail"),
        (1, 1, "1 of 120 steps, with an infeasible QP not reported as such, fails"),
    ],
)
def test_failed_steps_with_an_infeasible_qp_are_counted(
    steps: int, infeasible: int, clause: str, records: Any
) -> None:
    records.loop("osqp")
    finding = Finding("failed", tuple(records.view().runs), 3.0, steps, infeasible=infeasible)
    assert describe_finding(finding).startswith(f"{clause} in `paper`")


def test_failed_steps_with_an_infeasible_qp_are_read_from_the_steps(records: Any) -> None:
    """At step 5 the solver gives an iterate although its QP is infeasible."""
    records.replay("osqp", failed=2, lost=(3,))
    steps = records._steps[-1]
    infeasible = steps["k"] == 5
    steps.loc[infeasible, "certificate"], steps.loc[infeasible, "unconverged"] = "infeasible", True
    (found,) = records.view().failed_steps_by_run.values()
    assert (found.steps, found.first, found.infeasible) == (2, 3, 1)


@pytest.mark.parametrize("kind", ["p99 late", "window late", "p99 borderline"])
def test_a_p99_is_given_as_measured_and_as_scaled_up(kind: Any, records: Any) -> None:
    """Tables have the scaled one; both are given where they differ in the digits shown."""
    records.replay("osqp")
    (run,) = records.view().runs
    for factor, scaled in ((1.0, ""), (1.0001, ""), (1.25, "5.00 ms")):
        of_loop = replace(run, untimed_iterations=factor)
        text = describe_finding(Finding(kind, (of_loop,), 4e6, limit=3e6, factor=1.1))
        assert "its p99 is 4.00 ms in" in text and "3.00 ms" in text
        words = f", and {scaled} if scaled up to the iterations of the closed loop"
        assert text.endswith(words) if scaled else "scaled" not in text


@pytest.mark.parametrize(
    ("most", "after"),
    [
        (4000, " after at most 4\u202f000 iterations"),
        (2000, " after at most 2\u202f000 iterations (max_iter of the settings)"),
        (math.nan, ""),
    ],
)
def test_an_inaccurate_answer_is_named_with_the_most_iterations(
    most: float, after: str, records: Any
) -> None:
    records.replay("osqp", iterations_max=most, options='{"max_iter": 2000}')
    finding = Finding("failed", tuple(records.view().runs), 8.0, 2, status="INACCURATE")
    ended = f"as the solver returns an iterate that it calls inaccurate{after}"
    assert describe_finding(finding).endswith(ended)


@pytest.mark.parametrize(
    ("solver", "columns", "ending"),
    [
        ("osqp", {}, "a call takes longer than the time limit of the harness"),
        ("osqp", {"options": '{"time_limit": 0.1}'}, "the solver reaches its own time limit"),
        ("mine", {}, "the solver reaches its own time limit"),
        (
            "mine",
            {"outcome_detail": "2 × did not return and was killed"},
            "a call takes longer than the time limit of the harness",
        ),
    ],
)
def test_a_step_ended_from_outside_names_the_limit_of_the_harness(
    solver: str, columns: dict[str, Any], ending: str, records: Any
) -> None:
    records.replay(solver, **columns)
    finding = Finding("failed", tuple(records.view().runs), 2.0, 2, status="TIME_LIMIT")
    assert describe_finding(finding).endswith(f"as {ending}")


def _window(records: Any, scenario: str, **columns: Any) -> None:
    """A replay of the hardest 15 steps of a scenario."""
    source = {"kind": "hardest", "name": f"{scenario} hardest 15", "of": 450}
    cell = json.dumps({"source": source})
    records.replay(
        "daqp", f"{scenario} hardest 15", scenario=scenario, steps=15, cell=cell, **columns
    )


def test_failed_hardest_steps_are_counted_among_them(records: Any) -> None:
    _window(records, "turn")
    records.loop("daqp", "turn")
    records.loop("daqp", "waves")
    window, *loops = sorted(records.view().runs, key=lambda run: run.mode != "replay")
    finding = Finding("failed", (window, *loops), 9.0, 3, status="MAX_ITERATIONS")
    assert describe_finding(finding) == (
        "3 of the 15 steps of the window of `turn` fail, as the solver reaches its iteration "
        "limit (some also in its closed loop and `waves`)"
    )


def test_times_above_one_limit_are_one_clause(records: Any) -> None:
    for scenario in ("turn", "rough"):
        _window(records, scenario)
    records.replay("daqp", "paper")
    records.replay("daqp", "rough[900:1400]")
    of_sequence = {run.sequence: run for run in records.view().runs}

    def late(kind: Any, sequence: str, ns: float) -> Finding:
        return Finding(kind, (of_sequence[sequence],), ns, limit=3e6)

    found = [
        late("p95 late", "paper", 6.06e6),
        late("p95 late", "rough[900:1400]", 6.95e6),
        late("window late", "turn hardest 15", 5.24e6),
        late("window late", "rough hardest 15", 6.83e6),
    ]
    assert describe_findings(found) == (
        "its p95 is above the p99 limit of 3.00 ms in the replays of `paper` (6.06 ms) and steps "
        "900 to 1399 of `rough` (6.95 ms); its p99 is above the limit of 3.00 ms in the windows "
        "of `turn` (5.24 ms) and `rough` (6.83 ms)"
    )
    assert describe_findings([late("p99 late", "paper", 4e6), *found[3:]]) == (
        "its p99 is above the limit of 3.00 ms in the replay of `paper` (4.00 ms) and the window "
        "of `rough` (6.83 ms)"
    )


@pytest.mark.parametrize(
    ("solver", "after"), [("sip", " (known of `sip`: it answers infeasible QPs so)"), ("piqp", "")]
)
def test_what_is_known_of_a_failure_stands_where_it_is_met(
    solver: str, after: str, records: Any
) -> None:
    records.replay(solver)
    finding = Finding("failed", tuple(records.view().runs), 8.0, 2, status="NUMERICAL_ERROR")
    assert describe_finding(finding).endswith(f"as the solver reports a numerical error{after}")


@pytest.mark.parametrize(
    ("error", "violation", "words"),
    [
        (math.nan, 1e-6, "reported as solved, violates a limit by 1.0e-06"),  # of an infeasible QP
        (0.5, 0.02, "reported as solved, violates a limit by 0.020"),
        (0.5, 1e-6, "reported as solved, not verified"),
        (math.nan, 0.0, "reported as solved, not verified"),
    ],
)
def test_a_claim_beyond_the_limits_is_stated_by_its_violation(
    error: float, violation: float, words: str, records: Any
) -> None:
    records.replay("daqp")
    view = records.view()
    ((_, steps, _),) = view.yield_merged_and_raw_steps(view.runs)
    step = steps.select_steps(np.array([0]))
    flags = {"claimed": np.array([True]), "true": np.array([False])}
    numbers = {"error": np.array([error]), "violation": np.array([violation])}
    assert describe_answer(replace(step, **flags, **numbers), 0) == words
    assert describe_answer(replace(step, **numbers, true=np.array([True])), 0).endswith(
        ", verified"
    )


@pytest.mark.parametrize(
    ("loop", "replay", "state"),
    [
        ({}, {}, "pass"),
        ({}, {"median_us": 4000.0}, "late"),
        ({"outcome": "hung", "done": 0}, {}, "late"),
        ({"error": 0.4}, {"median_us": 4000.0}, "fail"),
        ({"outcome": "crashed", "done": 0}, {}, "fail"),
        ({"failed": 3}, {}, "fail"),
        ({"outcome": "timed_out", "done": 40}, {}, "inconclusive"),
    ],
)
def test_late_or_wrong(
    records: Any, loop: dict[str, Any], replay: dict[str, Any], state: str
) -> None:
    records.loop("daqp", **loop)
    records.replay("daqp", **replay)
    verdict = _verdict(records, "daqp")
    assert verdict.state == state
    assert (verdict.state in MISSED) == (state in ("late", "fail"))


@pytest.mark.parametrize("mode", ["closed_loop", "replay"])
@pytest.mark.parametrize(
    ("failed", "error", "state"), [(1, math.inf, "fail"), (0, 1e-9, "inconclusive")]
)
def test_a_run_stopped_by_its_limit_fails_by_a_step_that_hung(
    records: Any, mode: str, failed: int, error: float, state: str
) -> None:
    """A replay may be stopped in its warm-up; slow calls that return are no hang."""
    stopped = {"outcome": "timed_out", "done": 0, "failed": failed, "error": error}
    records.loop("daqp", **(stopped if mode == "closed_loop" else {}))
    records.replay("daqp", **(stopped if mode == "replay" else {}))
    assert _verdict(records, "daqp").state == state


DOUBTS = [
    ({"outcome": "timed_out", "done": 40}, "`paper` was stopped at its time limit after 40 of 120"),
    (
        {"outcome": "lost", "outcome_detail": "no room for its log", "done": 0},
        "the harness lost `paper`: no room for its log",
    ),
    ({"uncertified": 2}, "2 steps of `paper` have no certified optimum"),
    ({"thread_s": 1.3, "solve_s": 1.0}, "work 1.3 times as long as all timed calls"),
]


@pytest.mark.parametrize(("loop", "clause"), DOUBTS)
def test_the_unmeasured_leaves_it_open(records: Any, loop: dict[str, Any], clause: str) -> None:
    records.loop("daqp", **loop)
    records.replay("daqp")
    verdict = _verdict(records, "daqp")
    assert verdict.state == "inconclusive"
    assert clause in _why(verdict)


@pytest.mark.parametrize(
    ("columns", "counted"),
    [
        ({"uncertified": 5, "rounds": 5}, "1 step of"),
        ({"uncertified": 12, "rounds": 3}, "4 steps of"),
        ({"uncertified": 1, "rounds": 3}, "1 step of"),
    ],
)
def test_steps_without_a_certified_optimum_are_counted_once(
    records: Any, columns: dict[str, int], counted: str
) -> None:
    """The column counts them in every round of a replay."""
    records.loop("daqp")
    records.replay("daqp", **columns)
    assert f"{counted} the replay of `paper`" in _why(_verdict(records, "daqp"))


@pytest.mark.parametrize(
    ("outcome", "clause"),
    [
        ("crashed", "its process ended in `paper`: killed by SIGSEGV"),
        ("hung", "it did not return in `paper`: killed by SIGSEGV"),
    ],
)
@pytest.mark.parametrize("mode", ["closed_loop", "replay"])
def test_crashes_and_hangs_have_a_cause(records: Any, outcome: str, clause: str, mode: str) -> None:
    ended = {"outcome": outcome, "outcome_detail": "killed by SIGSEGV", "done": 0}
    records.loop("daqp", **(ended if mode == "closed_loop" else {}))
    records.replay("daqp", **(ended if mode == "replay" else {}))
    verdict = _verdict(records, "daqp")
    assert verdict.state in MISSED
    experiment = "`paper`" if mode == "closed_loop" else "the replay of `paper`"
    assert clause.replace("`paper`", experiment) in _why(verdict)


def test_crashes_in_several_experiments_are_one_clause(records: Any) -> None:
    for scenario in ("paper", "calm", "rough"):
        records.loop("daqp", scenario, outcome="crashed", outcome_detail="exit code 3", done=0)
    records.replay("daqp")
    assert describe_findings(_verdict(records, "daqp").causes) == (
        "its process ended in `paper`: exit code 3 (also in `calm` and `rough`)"
    )


def test_on_a_disturbed_machine_its_state_comes_before_all_reasons(records: Any) -> None:
    """The first reason alone would blame the solver for slow first visits of disturbed rounds."""
    counts = {"disturbed_rounds": 3.0, "counting_disturbed": 1.0, "rounds": 3}
    records.loop("daqp")
    records.replay("daqp", concurrency=2.0, first_visit_ratio=40.0, **counts)
    records.loop("piqp")
    records.replay("piqp", concurrency=2.0, first_visit_ratio=40.0)
    disturbed, calm = (_verdict(records, solver) for solver in ("daqp", "piqp"))
    reasons = describe_findings(calm.findings_that_bar_pass)
    assert "when first solved" in reasons and "timed in parallel with other work" in reasons
    machine = "other load disturbed 3 of 5 rounds of the replay of `paper`; "
    assert _why(disturbed) == machine + reasons
    assert describe_main_reason(disturbed) == machine + reasons
    assert describe_main_reason(calm) == describe_finding(calm.doubts[0])


def test_too_few_steps_for_a_p99(records: Any) -> None:
    for solver, median in (("fast", 20.0), ("near", 1500.0)):
        records.loop(solver)
        records.replay(solver, steps=300, median_us=median, spread=0.38)
    assert _verdict(records, "fast").state == "pass"
    near = _verdict(records, "near")
    assert near.state == "inconclusive"
    assert _why(near).startswith("300 steps of the replay of `paper` do not support a p99, and ")
    assert _why(near).endswith(", above the limit of 3.00 ms")
    assert "for the core" not in _why(near)
    records._steps[-1]["waited_ns"] = (records._steps[-1]["total_ns"] * 0.5).astype(int)
    assert re.search(
        r"takes (\S+) ms \(including a wait of \S+ ms for the core\), ",
        _why(_verdict(records, "near")),
    )


def test_the_requirements_are_read_from_the_suite(records: Any) -> None:
    records.loop("osqp", error=0.05)
    records.replay("osqp")
    looser = Requirements.from_suite({"requirements": {"error_move": 0.1, "unknown": 1}})
    assert judge_solvers(records.view(), looser).verdicts_on_references[0].state == "pass"
    assert _verdict(records, "osqp").state == "fail"
    assert "of at most 0.1 times the maximum increment" in describe_requirements(looser)


def test_a_loop_of_200_timings_that_is_slow_in_the_median_is_late(records: Any) -> None:
    records.loop("daqp", steps=200, raw_p50_ns=5.74e6)
    records.loop("daqp", "rough", steps=200, raw_p50_ns=4.1e6)
    records.replay("daqp", median_us=20.0)
    verdict = _verdict(records, "daqp")
    assert verdict.state == "late"
    assert _why(verdict) == (
        "its median timing in the closed loop `paper` is 5.74 ms, above the limit of 3.00 ms (also "
        "in `rough`)"
    )
    records.loop("osqp", steps=200, raw_p50_ns=5.74e6, slowdown=100.0)
    records.loop("osqp", "rough")
    records.replay("osqp", "rough")
    assert _verdict(records, "osqp").state == "pass"


@pytest.mark.parametrize(
    ("median_us", "state"),
    [(2500.0, "pass"), (2900.0, "borderline"), (3300.0, "borderline"), (3600.0, "late")],
)
def test_a_p99_within_the_spread_of_rounds(records: Any, median_us: float, state: str) -> None:
    """The spread of rounds is 1.155: every time from 2.60 to 3.46 ms is borderline."""
    records.loop("daqp")
    records.replay("daqp", median_us=median_us, spread=0.0)
    verdict = _verdict(records, "daqp")
    assert verdict.state == state
    near = r"spread of the rounds: (.*) ms to (.*) ms; limit: 3.00 ms\)"
    found = re.search(near, _why(verdict))
    assert (found is not None) == (state == "borderline")
    if found is not None:
        low, high = map(float, found.groups())
        assert low <= 3.0 <= high
        assert math.sqrt(low * high) == pytest.approx(1e-3 * median_us, rel=5e-3)
        assert high / low == pytest.approx(1.155**2, rel=0.02)


def test_few_timings_of_a_loop_name_limit_and_uncertainty(records: Any) -> None:
    """3.3 ms, uncertain by the spread of rounds of 1.155, which the limit of 3 ms is within."""
    records.loop("daqp", steps=100, raw_p50_ns=3.3e6)
    records.replay("daqp", median_us=20.0)
    verdict = _verdict(records, "daqp")
    assert verdict.state == "inconclusive"
    assert _why(verdict) == (
        "its median timing in the closed loop `paper` is 3.30 ms, from too few timings to judge it "
        "by the limit of 3.00 ms: it is uncertain from 2.85 ms to 3.82 ms"
    )


def test_a_hardest_step_beyond_the_deadline_is_late(records: Any) -> None:
    """One step of a thousand takes 400 ms in every round: the p99 does not see it."""
    records.loop("daqp")
    records.replay("daqp", median_us=20.0, spread=0.0, slow={500: 20_000.0})
    verdict = _verdict(records, "daqp")
    assert verdict.state == "late"
    assert _why(verdict) == (
        "its largest step time is 400 ms in the replay of `paper`, above the deadline of 300 ms"
    )


def test_qps_without_a_sample_time_are_judged_by_accuracy_alone(records: Any) -> None:
    """They have no plant; with a deadline, a pass needs a closed loop."""
    cell = json.dumps({"source": {"kind": "recorded", "path": "mine.npz"}})
    for solver, error in (("daqp", 1e-9), ("osqp", 0.4)):
        records.replay(solver, error=error, cell=cell, scenario="")
    unlimited = Requirements.from_suite({"requirements": {"deadline_ms": 0.0}})
    (good,), (bad,) = judge_solvers(records.view(), unlimited).of.values()
    assert (good.state, good.findings_that_bar_pass, bad.state) == ("pass", (), "fail")
    (good,), _ = judge_solvers(records.view(), REQUIREMENTS).of.values()
    assert (good.state, [f.kind for f in good.findings_that_bar_pass]) == (
        "inconclusive",
        ["no closed loop"],
    )
    records.replay("daqp", "rough")
    (good, *_), _ = judge_solvers(records.view(), unlimited).of.values()
    assert good.state == "inconclusive"


def test_without_a_deadline_no_time_is_judged(records: Any) -> None:
    """Steps of a minute pass, and have no speed margin; a wrong answer fails all the same."""
    for solver, error in (("daqp", 1e-9), ("osqp", 0.4)):
        records.loop(solver, error=error, raw_p50_ns=6e10)
        records.replay(solver, error=error, median_us=6e7)
    view = records.view()
    unlimited = Requirements.from_suite({"requirements": {"p99_ms": 3.0, "deadline_ms": 0.0}})
    verdicts = judge_solvers(view, unlimited)
    assert {v.configuration.solver: v.state for v in verdicts.verdicts_on_references} == {
        "daqp": "pass",
        "osqp": "fail",
    }
    assert describe_which_solvers_pass(verdicts).startswith(
        "1 of 2 solvers passes (lateness not judged): `d"
    )
    assert describe_requirements(unlimited).endswith(
        "no limit on step time, as no deadline is known."
    )
    assert not compute_speed_margins(view, unlimited)
    assert {v.state for v in judge_solvers(view, REQUIREMENTS).verdicts_on_references} == {
        "late",
        "fail",
    }


def test_borderline_is_counted_as_such(records: Any) -> None:
    for solver, median_us in (("daqp", 20.0), ("osqp", 2900.0)):
        records.loop(solver)
        records.replay(solver, median_us=median_us, spread=0.0)
    verdicts = judge_solvers(records.view(), REQUIREMENTS)
    assert describe_which_solvers_pass(verdicts).startswith(
        "1 of 2 solvers passes: `daqp`. `osqp` is borderline: its p99 is 2.90 ms in the replay of "
        "`paper` (uncertainty from the spread of the rounds: 2.5"
    )


def test_high_settings_rescue(records: Any) -> None:
    records.loop("osqp", error=0.4)
    records.loop("osqp", settings="high")
    records.replay("osqp", error=0.4)
    records.replay("osqp", settings="high")
    verdicts = judge_solvers(records.view(), REQUIREMENTS)
    assert [v.state for v in verdicts.all_verdicts] == ["fail", "pass"]
    assert describe_which_solvers_pass(verdicts) == (
        "1 of 1 solver passes in at least one configuration: `osqp`. `osqp` (qpsolvers fresh, "
        "high) passes, but its default configuration, `osqp` (qpsolvers fresh), fails: the error "
        "of its first move reaches 0.40 times the maximum increment in `paper`, above the limit in "
        "120 of 120 steps, first at step 0."
    )


def test_the_first_settings_of_a_grid_are_no_default(records: Any) -> None:
    for eps, error in ((1e-6, 0.4), (1e-4, 1e-9)):
        own = {"settings": f"eps_abs={eps}", "options": json.dumps({"eps_abs": eps})}
        records.loop("osqp", error=error, **own)
        records.replay("osqp", error=error, **own)
    text = describe_which_solvers_pass(judge_solvers(records.view(), REQUIREMENTS))
    assert (
        "eps_abs=0.0001) passes, but its first configuration, `osqp` (qpsolvers fresh, "
        "eps_abs=1e-06), fails: the error"
    ) in text
    assert "default" not in text


def _high(records: Any, **columns: Any) -> Any:
    """A solver that fails in `calm` by default; its verdict with settings high."""
    for scenario in ("paper", "calm"):
        records.loop("osqp", scenario, error=0.4)
    records.replay("osqp", error=0.4)
    records.loop("osqp", settings="high")
    records.replay("osqp", settings="high")
    if columns:
        records.loop("osqp", "calm", settings="high", **columns)
    return _verdict(records, "osqp", "high")


@pytest.mark.parametrize(
    ("columns", "clause"),
    [
        ({}, "not run in `calm`"),
        ({"steps": 60}, "only 60 of 120 steps were run in `calm`"),
        (
            {"outcome": "refused", "outcome_detail": "no model", "done": 0},
            "not run in `calm` (no model)",
        ),
        ({"steps": 120}, ""),
    ],
)
def test_a_level_passes_where_it_was_run(
    records: Any, columns: dict[str, Any], clause: str
) -> None:
    verdict = _high(records, **columns)
    assert verdict.state == ("inconclusive" if clause else "pass")
    assert clause in _why(verdict)
    if clause:
        assert (
            describe_which_solvers_pass(judge_solvers(records.view(), REQUIREMENTS))
            == f"0 of 1 solver passes. `osqp` (high; with default: fail) is inconclusive: {clause}."
        )


def test_summary_counts_everybody_once(records: Any) -> None:
    records.loop("daqp")
    records.replay("daqp")
    records.loop("osqp", error=0.4)
    records.replay("osqp")
    records.loop("scs", outcome="timed_out", done=10)
    records.refused("qpax", "not installed")
    said = describe_which_solvers_pass(judge_solvers(records.view(), REQUIREMENTS))
    assert said == (
        "1 of 3 solvers passes: `daqp`. `osqp` fails: the error of its first move reaches 0.40 "
        "times the maximum increment in `paper`, above the limit in 120 of 120 steps, first at "
        "step 0. "
        "`scs` is inconclusive: `paper` was stopped at its time limit after 10 of 120 steps. "
        "`qpax` was not run: not installed."
    )


def test_summary_names_three_of_each_verdict(records: Any) -> None:
    """The fastest that pass; of those that fail each has its reason."""
    for i, solver in enumerate(("a", "b", "c", "d", "e")):
        records.loop(solver)
        records.replay(solver, median_us=10.0 + i, spread=0.0)
        records.loop(f"bad_{solver}", error=0.4)
        records.replay(f"bad_{solver}", median_us=10.0 + i, spread=0.0)
    said = describe_which_solvers_pass(judge_solvers(records.view(), REQUIREMENTS))
    assert said.startswith(
        "5 of 10 solvers pass: `a`, `b`, `c` and 2 more. `bad_a` fails: the error of "
    )
    assert said.count(" fails: ") == 3 and said.endswith(". 2 more fail.")


def test_summary_names_crashes_and_hangs_first_and_beside_wrong_answers(records: Any) -> None:
    for i, solver in enumerate(("a", "b", "c", "d")):
        records.loop(solver, error=0.4)
        records.replay(solver, median_us=10.0 + i, spread=0.0)
    hung = {"outcome": "hung", "outcome_detail": "did not return and was killed", "done": 0}
    records.loop("d", "turn", **hung)
    said = describe_which_solvers_pass(judge_solvers(records.view(), REQUIREMENTS))
    assert said.startswith("0 of 4 solvers pass. `d` fails: the error of its first move reaches ")
    assert "; it did not return in `turn`: did not return and was killed. `a` fails: " in said


def test_summary_names_the_call_mode_of_a_solver_that_has_several(records: Any) -> None:
    for policy, error in (("fresh", 0.4), ("warm", 1e-9)):
        for settings in ("default", "high"):
            wrong = error if settings == "default" else 0.5
            records.loop("osqp", policy=policy, settings=settings, error=wrong)
            records.replay("osqp", policy=policy, settings=settings, median_us=9000.0)
    records.loop("daqp", error=0.4)
    records.replay("daqp")
    said = describe_which_solvers_pass(judge_solvers(records.view(), REQUIREMENTS))
    assert said.startswith(
        "0 of 2 solvers pass. `osqp` (qpsolvers warm, default; with high: fail) is late: its p99 is"
    )
    assert "`daqp` fails: " in said


def _duel(records: Any, median_us: float) -> Any:
    for solver, median in (("first", 20.0), ("second", median_us)):
        records.loop(solver)
        records.replay(solver, median_us=median, spread=0.1)
    view = records.view()
    ranked = sort_fastest_first(judge_solvers(view, REQUIREMENTS).verdicts_on_references)
    (found,) = compare_paired_times(view, ranked[0], ranked[1])
    return found


def test_a_clear_lead_is_called_so(records: Any) -> None:
    """Two solvers a factor of two apart are told apart, with ratio and interval.

    The geometric mean of 1000 paired ratios of spread 0.14 is within 2 % of 2 (4 sigma).
    """
    found = _duel(records, 40.0)
    assert found.ratio.value == pytest.approx(2.0, rel=0.02)
    assert not found.is_tied and found.finding_text == "slower"
    said = (
        r"[\d.]+ times as long over the same steps in the replay of `[a-z, ]+` "
        r"\(95 % interval, for these measurements only: [\d.]+ to [\d.]+\)"
    )
    assert re.fullmatch(said, describe_paired_times([found]))


def test_a_tie_is_called_a_tie(records: Any) -> None:
    found = _duel(records, 20.0)
    assert found.is_tied and found.finding_text == "tied"
    assert "no significant difference" in describe_paired_times([found])


def test_a_tie_counts_the_steps_that_are_slower(records: Any) -> None:
    """The second takes 1.01 times as long, 20 times in the first 200 steps and half as long in one.

    The logs of the five parts have one outlier, so that their interval includes 1.
    """
    slow = dict.fromkeys(range(200), 20.0) | {900: 0.5}
    for solver, median_us, slow_steps in (("first", 20.0, {}), ("second", 20.2, slow)):
        records.loop(solver)
        records.replay(solver, median_us=median_us, spread=0.0, slow=slow_steps)
    (found,) = compare_configurations(
        records.view(), *(Configuration(s, "qpsolvers", "fresh") for s in ("first", "second"))
    )
    assert found.finding_text == "tied" and found.ratio.value > 1.8
    said = "no significant difference, slower in 999 of 1\u202f000 steps"
    assert describe_paired_times([found]).endswith(said)


def test_load_is_the_likely_cause_of_a_slow_loop_of_a_solver_without_a_cache() -> None:
    said = describe_caching_sign("daqp", ("loop tail", 30.0))
    assert said == (
        "the p90 of the closed loop's steps is 30 times that of the replay: the likely cause is "
        "other load on the machine; repeat the run on an idle machine"
    )
    assert "likely cause" not in describe_caching_sign("daqp", ("slow first visits", 0.06))
    assert "cached answers" in describe_caching_sign("my_function", ("loop tail", 30.0))


def test_two_names_of_one_run_are_called_so(records: Any) -> None:
    """Settings without effect have the same times on all 1000 steps: enough for an interval."""
    for level in ("default", "high"):
        records.loop("quadprog", settings=level)
        records.replay("quadprog", settings=level, median_us=20.0, spread=0.0)
    (found,) = compare_settings_of_solvers(records.view())
    assert found.steps == 1000 and found.finding_text == "one run"
    assert describe_paired_times([found]).startswith("the same run under another name")


@pytest.mark.parametrize("median_us", [20.2, 45_200.0])
def test_few_steps_state_the_ratio_and_no_more(records: Any, median_us: float) -> None:
    """2260 times as long over 40 steps is the ratio, without an interval."""
    for solver, median in (("first", 20.0), ("second", median_us)):
        records.loop(solver, steps=40)
        records.replay(solver, steps=40, median_us=median, spread=0.0)
    view = records.view()
    (found,) = compare_paired_times(
        view, *sort_fastest_first(judge_solvers(view, REQUIREMENTS).verdicts_on_references)
    )
    assert found.finding_text == "too few steps"
    said = describe_paired_times([found])
    assert said.startswith("1.01 times" if median_us < 21.0 else "2\u202f260 times")
    assert said.endswith(
        "(geometric mean of 40 steps, no interval: fewer than 500 in each sequence)"
    )


def test_an_order_that_turns_with_the_yardstick_is_called_unstable(records: Any) -> None:
    """A better p99 with a worse median is no clear lead."""
    records.loop("steady")
    records.replay("steady", median_us=40.0, spread=0.01)
    records.loop("nervous")
    records.replay("nervous", median_us=20.0, spread=0.6)
    view = records.view()
    ranked = sort_fastest_first(judge_solvers(view, REQUIREMENTS).verdicts_on_references)
    assert [v.configuration.solver for v in ranked] == ["steady", "nervous"]
    (found,) = compare_paired_times(view, *ranked)
    said = "with the larger limiting p99: which is faster depends on the measure"
    assert describe_paired_times([found]).startswith("on average 0.5")
    assert found.finding_text == "unstable" and said in describe_paired_times([found])


def test_terminal_lines_carry_no_markup(records: Any) -> None:
    records.loop("daqp")
    records.replay("daqp")
    text = "\n".join(records.ending().values())
    assert "daqp" in text
    assert not {"*", "`"} & set(text)


def test_a_headline_that_cannot_be_told_apart_carries_caution(records: Any) -> None:
    for solver in ("daqp", "osqp"):
        records.replay(solver, median_us=10.0, spread=0.1, route="native", policy="warm")
        records.replay(solver, median_us=50.0)
    second = records.ending()["next"]
    assert "no significant difference" in second
    assert "(native warm)" in second
