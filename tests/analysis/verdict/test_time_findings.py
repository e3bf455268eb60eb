"""Findings on times at and beside the limits of the requirements."""

import json
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.analysis.records.run_steps import StepTimes
from dpbench.analysis.statistics import UNKNOWN
from dpbench.analysis.verdict.lateness import LateTimings, Uncertainty
from dpbench.analysis.verdict.requirements import Finding, Requirements
from dpbench.analysis.verdict.time_findings import (
    compute_p99_ns,
    compute_speed_margins,
    convert_late_timings_to_findings,
    find_own_times_ns,
    find_slow_loops,
    find_work_in_other_threads,
    judge_replay_times,
)
from dpbench.report.verdict.findings_text import describe_findings

REQUIREMENTS = Requirements(p99_ms=1.0, deadline_ms=8.0)
"""Limits of 1e6 and 8e6 ns."""
FACTOR = 2.0
"""The times are uncertain by a factor of two: products and quotients of it are exact."""
UNCERTAINTY = Uncertainty({}, {}, {}, FACTOR)


def _kinds(findings: list[Finding]) -> list[str]:
    return [finding.kind for finding in findings]


def _found(findings: list[Finding]) -> list[tuple[str, list[str], float]]:
    """Kind, solvers and value of each finding."""
    return [(one.kind, [run.solver for run in one.runs], one.value) for one in findings]


@pytest.mark.parametrize(
    ("steps", "p50_ns", "kind"),
    [
        (200, 2e6 + 1, "slow loop"),
        (200, 2e6, "loop borderline"),
        (200, 1e6, "loop borderline"),
        (200, 5e5, "loop borderline"),
        (200, 5e5 - 1, ""),
        (199, 2e6 + 1, "short slow loop"),
        (199, 1e6 + 1, "short slow loop"),
        (199, 1e6, "loop borderline"),
        (201, 1e6 + 1, "loop borderline"),
        (199, 5e5 - 1, ""),
    ],
)
def test_the_median_of_a_loop_at_limits(records: Any, steps: int, p50_ns: float, kind: str) -> None:
    """From 200 steps on a median beyond twice the limit is late, from half of it borderline."""
    records.loop("daqp", steps=steps, raw_p50_ns=p50_ns)
    view = records.view()
    found = find_slow_loops(view, view.runs, REQUIREMENTS, UNCERTAINTY)
    assert _found(found) == ([(kind, ["daqp"], p50_ns)] if kind else [])


@pytest.mark.parametrize(
    ("steps", "waited_ns", "voluntary", "kind"),
    [
        (200, 0, 0, "slow loop"),
        (200, 999_999, 0, "slow loop"),
        (200, 1_000_000, 0, "loop waits"),
        (200, 2_900_000, 0, "loop waits"),
        (200, None, 0, "slow loop"),
        (200, 2_900_000, 100, "slow loop"),
        (200, 2_900_000, 99, "loop waits"),
        (199, 1_999_999, 0, "short slow loop"),
        (199, 2_000_000, 0, "loop waits"),
    ],
)
def test_waits_for_the_core_prove_no_slow_loop(
    records: Any, steps: int, waited_ns: int | None, voluntary: int, kind: str
) -> None:
    """All timings are 3 ms, late if over 2 ms of them are the solver's own: 1 ms in a short loop.

    The waits of a solver that gives up the core in half of its calls may be for its threads.
    """
    records.loop("daqp", steps=steps, raw_p50_ns=3e6, voluntary_switches=voluntary)
    records._steps[-1]["total_ns"] = 3_000_000
    records._steps[-1]["waited_ns"] = pd.NA if waited_ns is None else waited_ns
    view = records.view()
    (found,) = find_slow_loops(view, view.runs, REQUIREMENTS, UNCERTAINTY)
    assert (found.kind, found.value) == (kind, 3e6)
    if kind == "loop waits":
        assert waited_ns is not None and found.machine == 3e6 - waited_ns
        assert "its median timing of 3.00 ms in the closed loop" in describe_findings([found])
    else:
        assert math.isnan(found.machine)


def test_only_loops_of_the_measured_computer_are_slow(records: Any) -> None:
    records.replay("daqp", raw_p50_ns=9e6)
    records.loop("daqp", slowdown=0.5, steps=200, raw_p50_ns=9e6)
    records.loop("piqp", slowdown=0.0, steps=200, raw_p50_ns=3e6)
    records.loop("scs", steps=200, raw_p50_ns=4e6)
    records.loop("osqp", steps=60, raw_p50_ns=2e6)
    view = records.view()
    found = find_slow_loops(view, view.all_runs, REQUIREMENTS, UNCERTAINTY)
    assert _found(found) == [
        ("slow loop", ["scs", "piqp"], 4e6),
        ("short slow loop", ["osqp"], 2e6),
    ]


def test_threads_that_work_longer_than_the_timed_calls_are_hidden_work(records: Any) -> None:
    """A processor time of 1.1 of the timed calls is allowed; windows are left out."""
    records.replay("equal", thread_s=1.1, solve_s=1.0)
    records.replay("twice", thread_s=2.0, solve_s=1.0)
    records.replay("thrice", thread_s=1.5, solve_s=0.5)
    records.replay("idle", thread_s=0.25, solve_s=1.0)
    source = {"kind": "hardest", "name": "paper hardest 30", "of": 450}
    cell = json.dumps({"source": source})
    records.replay("window", steps=30, thread_s=9.0, solve_s=1.0, cell=cell)
    found = find_work_in_other_threads(records.view().runs)
    assert _found(found) == [("hidden work", ["thrice", "twice"], 3.0)]


def test_clocks_that_differ_are_no_hidden_work(records: Any) -> None:
    """A call that only waited for the core has no time of its own to divide by."""
    records.replay("clocks", thread_s=25e-6, solve_s=0.0)
    records.replay("thread", thread_s=4e-3, solve_s=0.0)
    assert _found(find_work_in_other_threads(records.view().runs)) == [
        ("hidden work", ["thread"], 4.0)
    ]


def _late(run: Any, kind: Any, late: int, p: float) -> LateTimings:
    return LateTimings(kind, run, late, 100, 0.25, p)


def test_late_timings_are_reported_by_kind_with_the_worst_run_first() -> None:
    runs: list[Any] = [SimpleNamespace(run_id=name, solver=name) for name in "abcd"]
    a, b, c, d = runs
    late = {
        "a": [_late(a, "late timings", 10, 0.0005), _late(a, "late at random", 8, 0.04)],
        "b": [_late(b, "late timings", 30, 0.0005), _late(b, "past the deadline", 1, 0.02)],
        "c": [_late(c, "late timings", 20, 0.001), _late(c, "late at random", 2, 0.0005)],
        "d": [_late(d, "late timings", 40, 0.002), _late(d, "past the deadline", 2, 0.0001)],
        "e": [_late(d, "late timings", 90, 0.0001)],
    }
    found = convert_late_timings_to_findings(runs, late)
    assert _found(found) == [
        ("late timings", ["b", "c", "a"], 0.3),
        ("late at random", ["a", "c"], 0.08),
        ("perhaps past the deadline", ["b"], 0.01),
        ("perhaps late timings", ["d"], 0.4),
        ("past the deadline", ["d"], 0.02),
    ]
    assert {(finding.steps, finding.machine) for finding in found} == {(100, 0.25)}
    assert convert_late_timings_to_findings(runs, {}) == []


def _judged(records: Any) -> tuple[list[Finding], dict[str, Any]]:
    view = records.view()
    return judge_replay_times(view, view.runs, REQUIREMENTS, UNCERTAINTY)


def _even_replay(records: Any, ns: float, steps: int, **columns: Any) -> None:
    """A replay whose steps all take `ns`."""
    records.replay("daqp", steps=steps, median_us=ns / 1e3, spread=0.0, **columns)


@pytest.mark.parametrize(
    ("steps", "ns", "kinds"),
    [
        (1000, 499_999, []),
        (1000, 500_000, ["p99 borderline"]),
        (1000, 2_000_000, ["p99 borderline"]),
        (1000, 2_000_001, ["p99 late"]),
        (1000, 3_999_999, ["p99 late"]),
        (1000, 4_000_000, ["deadline borderline", "p99 late"]),
        (1000, 16_000_000, ["deadline borderline", "p99 late"]),
        (1000, 16_000_001, ["deadline late", "p99 late"]),
        (999, 499_999, []),
        (999, 500_000, ["p95 borderline"]),
        (999, 1_000_000, ["p95 borderline"]),
        (999, 1_000_001, ["p95 uncertain"]),
        (999, 2_000_000, ["p95 uncertain"]),
        (999, 2_000_001, ["p95 late"]),
        (199, 1_000_000, []),
        (199, 1_000_001, ["p50 uncertain"]),
        (20, 2_000_000, ["p50 uncertain"]),
        (20, 2_000_001, ["p50 late"]),
        (19, 2_000_001, ["no p99"]),
    ],
)
def test_the_times_of_a_replay_at_limits(
    records: Any, steps: int, ns: int, kinds: list[str]
) -> None:
    """All steps take the same time, so that p95, p99 and maximum are equal.

    A p99 requires 1000 steps, a p95 requires 200, a p50 requires 20.
    """
    _even_replay(records, ns, steps)
    findings, _ = _judged(records)
    assert _found(findings) == [(kind, ["daqp"], float(ns)) for kind in kinds]
    assert [f.steps for f in findings if f.kind == "no p99"] == [steps] * kinds.count("no p99")


def test_a_p50_within_the_uncertainty_of_rounds_is_named(records: Any) -> None:
    _even_replay(records, 1_500_000, 60)
    assert describe_findings(_judged(records)[0]) == (
        "its p50 of 1.50 ms in the replay of `paper` exceeds the p99 limit of 1.00 ms, but by "
        "less than the rounds differ (750 µs to 3.00 ms)"
    )


@pytest.mark.parametrize(
    ("slow_ns", "waited_ns", "text"),
    [
        ((5e6, 4e6), (4e6, 0.0), "takes 5.00 ms (including a wait of 4.00 ms for the core), above"),
        ((5e6, 4e6), (0.0, 2e6), "takes 5.00 ms, above"),
        (
            (2e7, 1e7),
            (1.9e7, 0.0),
            "its largest step time of 20.0 ms in the replay of `paper` is 1.00",
        ),
    ],
)
def test_the_wait_of_the_longest_step_is_its_own(
    records: Any, slow_ns: tuple[float, float], waited_ns: tuple[float, float], text: str
) -> None:
    """Two of 60 steps are slow; the larger own part is that of the other one."""
    slow = {k: ns / 300_000 for k, ns in enumerate(slow_ns)}
    _even_replay(records, 300_000, 60, slow=slow, rounds=1)
    frame = records._steps[-1]
    frame["waited_ns"] = frame["k"].map(dict(enumerate(waited_ns))).fillna(0.0).astype(int)
    assert text in describe_findings(_judged(records)[0])


@pytest.mark.parametrize(("done", "timed_on"), [(60, "paper"), (59, "calm"), (1, "calm")])
def test_a_part_of_a_replay_has_no_p50(records: Any, done: int, timed_on: str) -> None:
    """Its longest step remains; a complete replay is timed on instead."""
    _even_replay(records, 5_000_000, 60, done=done, stopped=True)
    _, alone = _judged(records)
    assert alone["longest_ns"] == 5e6
    assert alone.get("p50_ns") == (5e6 if done == 60 else None)
    _even_replay(records, 30_000, 60, sequence="calm")
    _, figures = _judged(records)
    assert figures["timed_on"] == timed_on and figures["longest_ns"] == 5e6
    assert list(figures["of_sequences"]) == ["paper", "calm"][done < 60 :]


@pytest.mark.parametrize(
    ("ns", "kinds"),
    [
        (333_333, []),
        (333_334, ["p99 borderline"]),
        (2_666_666, ["p99 borderline"]),
        (2_666_667, ["deadline borderline", "p99 borderline"]),
    ],
)
def test_a_third_of_a_limit_is_not_rounded(records: Any, ns: int, kinds: list[str]) -> None:
    """Limits of 1 ms and 8 ms, of times that are uncertain by a factor of three."""
    _even_replay(records, ns, 1000)
    view = records.view()
    uncertainty = Uncertainty({}, {}, {}, 3.0)
    assert _kinds(judge_replay_times(view, view.runs, REQUIREMENTS, uncertainty)[0]) == kinds


@pytest.mark.parametrize(
    ("slow", "rounds", "switches", "expected"),
    [
        (30, 1, None, [("few timings", 1)]),
        (30, 2, None, [("few timings", 2)]),
        (30, 3, None, [("p99 late", 0)]),
        (500, 1, None, [("few timings", 1)]),
        (501, 1, None, [("p99 late", 0)]),
        (0, 1, None, []),
        (30, 1, 0, [("p99 late", 0)]),
        (30, 1, 19, [("p99 late", 0)]),
        (30, 1, 20, [("few timings", 1)]),
        (30, 2, 39, [("p99 late", 0)]),
        (30, 2, 40, [("few timings", 2)]),
        (30, 2, 9000, [("few timings", 2)]),
        (30, 3, 9000, [("p99 late", 0)]),
    ],
)
@pytest.mark.parametrize("stopped", [False, True])
def test_few_timings_prove_no_late_p99(
    records: Any,
    slow: int,
    rounds: int,
    switches: int | None,
    expected: list[tuple[str, int]],
    stopped: bool,
) -> None:
    """Some of 1000 steps of 0.3 ms take 3 ms: once or twice timed, by the machine perhaps.

    Half of the steps beyond the limit of 1 ms by more than twice are the solver's own. So are 30
    steps where context switches can have hit fewer than 20 of them in each round: 11 are left. A
    round that was stopped has no count of its switches.
    """
    times = dict.fromkeys(range(slow), 10.0)
    columns = {"involuntary_switches": switches}
    _even_replay(records, 300_000, 1000, slow=times, rounds=rounds, stopped=stopped, **columns)
    findings, figures = _judged(records)
    if stopped and switches is not None and rounds < 3:
        expected = [("few timings", rounds)]
    assert [(found.kind, found.steps) for found in findings] == expected
    assert figures["p99_ns"] == (3e6 if slow else 3e5)


@pytest.mark.parametrize(
    ("outcome", "switches", "expected"),
    [
        ("finished", math.nan, [3.0] * 4),
        ("finished", 8, [3.0] * 4),
        ("finished", 7, [1.0, 3.0, 3.0, 3.0]),
        ("finished", 1, [1.0, 2.0, 4.0, 9.0]),
        ("crashed", 1, [3.0] * 4),
        ("timed_out", 1, [3.0] * 4),
    ],
)
def test_own_times_of_two_timings_by_hand(
    outcome: str, switches: float, expected: list[float]
) -> None:
    """Four steps with a median of 3; each two switches may have hit one of the slowest.

    Only of a finished run all switches are counted.
    """
    run: Any = SimpleNamespace(outcome=outcome, involuntary_switches=switches, voluntary_switches=0)
    k, algo_ns = np.arange(4), np.array([4.0, 1.0, 9.0, 2.0])
    times = StepTimes(k, algo_ns, None, np.full(4, 2), 9.0, np.array([3.0, 3.0]), np.zeros(4))
    assert find_own_times_ns(run, times).tolist() == expected


def _waiting_replay(records: Any, ns: int, waits: list[float], **columns: Any) -> None:
    """1000 steps of 0.3 ms of which 30 take `ns`, of it so much waiting for the core by round."""
    times = dict.fromkeys(range(30), ns / 300_000)
    _even_replay(records, 300_000, 1000, slow=times, rounds=len(waits), **columns)
    frame = records._steps[-1]
    waited_ns = np.array([0.0, *waits])[frame["repeat"].astype(int)]
    frame["waited_ns"] = np.where(frame["k"] < 30, waited_ns, 0)


@pytest.mark.parametrize(
    ("waits", "expected"),
    [
        ([0, 0], ("p99 late", 9e6)),
        ([6_999_999, 7_500_000], ("p99 late", 9e6)),
        ([7_000_000, 0], ("p99 waits", 9e6)),
        ([8_700_000, 0], ("p99 waits", 9e6)),
        ([8_700_000] * 5, ("p99 waits", 9e6)),
        ([6_999_999] * 5, ("p99 late", 9e6)),
    ],
)
@pytest.mark.parametrize("stopped", [False, True])
def test_waits_for_the_core_prove_no_late_p99(
    records: Any, waits: list[float], expected: tuple[str, float], stopped: bool
) -> None:
    """A p99 of 9 ms is late if over 2 ms of it are the solver's own, however often it was timed.

    Without its wait of 8.7 ms each step takes its 0.3 ms. Context switches are not asked for.
    """
    _waiting_replay(records, 9_000_000, waits, stopped=stopped, involuntary_switches=9000)
    findings, figures = _judged(records)
    deadline = "deadline borderline", 9e6
    assert [(one.kind, one.value) for one in findings] == [deadline, expected]
    assert figures["p99_ns"] == 9e6
    own_ns = 9e6 - waits[0]
    machine = findings[-1].machine
    assert machine == own_ns if expected[0] == "p99 waits" else math.isnan(machine)


@pytest.mark.parametrize(
    ("waited_ns", "switches", "kind"),
    [(8_700_000, None, "p95 waits"), (0, None, "few p95 timings")],
)
def test_too_few_steps_for_a_p99_are_judged_by_a_p95_of_that_name(
    records: Any, waited_ns: int, switches: int | None, kind: str
) -> None:
    """30 of 500 steps take 9 ms: they are beyond the p95, and none is a p99."""
    columns = {"involuntary_switches": switches}
    _even_replay(records, 300_000, 500, slow=dict.fromkeys(range(30), 30.0), rounds=2, **columns)
    if waited_ns:
        records._steps[-1]["waited_ns"] = np.where(records._steps[-1]["k"] < 30, waited_ns, 0)
    findings, figures = _judged(records)
    (found,) = (one for one in findings if "deadline" not in one.kind)
    assert (found.kind, found.value) == (kind, 9e6)
    assert math.isnan(figures["p99_ns"])
    text = describe_findings([found])
    assert "its p95 of 9.00 ms" in text and "p99" not in text


@pytest.mark.parametrize(
    ("waited_ns", "switches", "voluntary", "kinds"),
    [
        (4_000_000, 0, 0, ["deadline waits", "p99 late"]),
        (3_999_999, 0, 0, ["deadline late", "p99 late"]),
        (19_700_000, 0, 0, ["deadline waits", "p99 waits"]),
        (19_700_000, 9000, 1000, ["few deadline timings", "few timings"]),
        (19_700_000, 9000, 999, ["deadline waits", "p99 waits"]),
        (19_700_000, 0, 1000, ["deadline late", "p99 late"]),
    ],
)
def test_a_wait_for_the_core_proves_no_missed_deadline(
    records: Any, waited_ns: float, switches: int, voluntary: int, kinds: list[str]
) -> None:
    """Two rounds, 30 steps of 20 ms; the deadline of 8 ms is surely missed beyond 16 ms.

    The waits of a solver that gives up the core in half of its 2000 calls may be for its threads.
    """
    counts = {"involuntary_switches": switches, "voluntary_switches": voluntary}
    _waiting_replay(records, 20_000_000, [waited_ns] * 2, **counts)
    findings, _ = _judged(records)
    assert _found(findings) == [(kind, ["daqp"], 2e7) for kind in kinds]


def test_an_unknown_wait_leaves_all_unknown(records: Any) -> None:
    """One timing without a recorded wait: those of the others prove nothing."""
    _waiting_replay(records, 9_000_000, [8_700_000] * 3)
    records._steps[-1].loc[1500, "waited_ns"] = pd.NA
    assert _kinds(_judged(records)[0]) == ["deadline borderline", "p99 late"]


@pytest.mark.parametrize(("slow", "kinds"), [(20, []), (21, ["p95 borderline"])])
def test_a_p95_is_judged_where_no_step_is_over(records: Any, slow: int, kinds: list[str]) -> None:
    """The p95 of 400 steps is at index 0.95 * 399 = 379.05.

    With 20 steps of 0.8 ms it is 0.4 + 0.05 * 0.4 = 0.42 ms, with 21 it is 0.8 ms.
    """
    _even_replay(records, 400_000, 400, slow=dict.fromkeys(range(slow), 2.0))
    findings, _ = _judged(records)
    assert _found(findings) == [(kind, ["daqp"], 800_000.0) for kind in kinds]


def _window(records: Any, of: int, ns: float, steps: int = 30, **columns: Any) -> None:
    source = {"kind": "hardest", "name": "turn hardest 30", "of": of}
    _even_replay(
        records, ns, steps, sequence="turn hardest", cell=json.dumps({"source": source}), **columns
    )


@pytest.mark.parametrize(
    ("of_loop", "bound_ns", "kinds"),
    [(4.0, 4e5, []), (3.0, 4e5, []), (11.5, 1e6, []), (11.6, 1.008e6, ["slow steps untimed"])],
)
@pytest.mark.parametrize("policy", ["fresh", "warm"])
def test_a_window_that_leaves_out_slow_steps_does_not_pass(
    records: Any, of_loop: float, bound_ns: float, kinds: list[str], policy: str
) -> None:
    """Its steps take 400 µs and 4 iterations, 80 µs each with the step's own; the limit is 1 ms.

    A closed loop of another call mode says nothing.
    """
    records.loop("daqp", "turn", iterations_p99=99.0, route="native", policy="warm")
    records.loop("daqp", "turn", iterations_p99=of_loop, policy=policy)
    _window(records, 450, 400_000, scenario="turn", iterations_p99=4.0, policy=policy)
    findings, figures = _judged(records)
    found = [one for one in findings if one.kind != "short slow loop"]
    assert _kinds(found) == kinds
    assert figures["p99_ns"] == pytest.approx(bound_ns)
    if kinds:
        text = describe_findings(found)
        assert "its p99 is 400 µs in the window of `turn`, and 1.01 ms if scaled up" in text
    margins = compute_speed_margins(records.view(), REQUIREMENTS)
    (margin,) = margins.values()
    assert margin.p99_limit == pytest.approx(1e6 / bound_ns)


def test_a_replay_of_a_part_is_bounded_by_the_iterations_of_the_whole_loop(records: Any) -> None:
    """Its p99 of 400 µs has 4 iterations, the loop 9: 800 µs, a margin of 1.25 instead of 2.5."""
    records.loop("daqp", "turn", iterations_p99=9.0)
    _even_replay(
        records, 400_000, 1000, sequence="turn[0:1000]", scenario="turn", iterations_p99=4.0
    )
    findings, figures = _judged(records)
    assert not [one for one in findings if one.kind != "short slow loop"]
    assert figures["p99_ns"] == pytest.approx(8e5) and figures["p99_interval"] is UNKNOWN
    (margin,) = compute_speed_margins(records.view(), REQUIREMENTS).values()
    assert margin.limiting_p99_ns == pytest.approx(8e5)
    assert margin.p99_limit == pytest.approx(1.25)


@pytest.mark.parametrize(("most", "bound_ns"), [(8.0, 8e5), (9.0, 6e5), (30.0, 6e5)])
def test_a_step_with_the_iterations_of_the_loop_bounds_the_p99(
    records: Any, most: float, bound_ns: float
) -> None:
    """The longest step takes 600 µs; one of at most 8 iterations is none of the loop's 9."""
    records.loop("daqp", "turn", iterations_p99=9.0)
    columns = {"iterations_p99": 4.0, "iterations_max": most, "slow": {7: 1.5}}
    times = {"algo_p99_ns": 4e5, "algo_max_ns": 6e5}
    _even_replay(
        records, 400_000, 1000, sequence="turn[0:1000]", scenario="turn", **columns, **times
    )
    assert _judged(records)[1]["p99_ns"] == pytest.approx(bound_ns)


def test_a_scaled_p99_is_at_most_the_scaled_longest_step(records: Any) -> None:
    """The loop has 9 iterations and the replay 8: 600 µs times (1 + 9) / (1 + 8), not 800 µs."""
    records.loop("daqp", "turn", iterations_p99=9.0, iterations_max=9.0)
    columns = {"iterations_p99": 4.0, "iterations_max": 8.0, "slow": {7: 1.5}}
    times = {"algo_p99_ns": 4e5, "algo_max_ns": 6e5}
    _even_replay(
        records, 400_000, 1000, sequence="turn[0:1000]", scenario="turn", **columns, **times
    )
    assert _judged(records)[1]["p99_ns"] == pytest.approx(6e5 * 10 / 9)
    (margin,) = compute_speed_margins(records.view(), REQUIREMENTS).values()
    assert margin.limiting_p99_ns <= margin.longest_ns


@pytest.mark.parametrize(
    ("most", "longest_ns", "kinds"),
    [(19.0, 1.6e6, []), (99.0, 8e6, []), (100.0, 8.08e6, ["longest step untimed"])],
)
def test_the_longest_step_is_scaled_to_the_most_iterations_of_the_loop(
    records: Any, most: float, longest_ns: float, kinds: list[str]
) -> None:
    """Its longest step takes 400 µs with 4 iterations; the deadline is 8 ms."""
    records.loop("daqp", "turn", iterations_p99=4.0, iterations_max=most)
    counts = {"iterations_p99": 4.0, "iterations_max": 4.0}
    _even_replay(records, 400_000, 1000, sequence="turn[0:1000]", scenario="turn", **counts)
    (margin,) = compute_speed_margins(records.view(), REQUIREMENTS).values()
    assert margin.hardest.time_ns == 4e5 and margin.p99_limit == pytest.approx(2.5)
    assert margin.longest_ns == pytest.approx(longest_ns)
    assert margin.deadline == pytest.approx(8e6 / longest_ns)
    found = [one for one in _judged(records)[0] if one.kind != "short slow loop"]
    assert _kinds(found) == kinds
    if kinds:
        assert "of `turn`, and 8.08 ms if scaled up to the iterations" in describe_findings(found)


def test_a_loop_without_iterations_leaves_a_window_as_it_was_timed(records: Any) -> None:
    records.loop("daqp", "turn")
    _window(records, 450, 400_000, scenario="turn", iterations_p99=4.0)
    assert _judged(records)[1]["p99_ns"] == 4e5


@pytest.mark.parametrize(
    ("ns", "kinds"), [(2_000_001, ["window late"]), (2_000_000, ["p99 borderline"]), (400_000, [])]
)
def test_a_slow_window_has_its_own_cause(records: Any, ns: int, kinds: list[str]) -> None:
    """A window always has a p99: that of its stretch."""
    _window(records, 450, ns)
    findings, figures = _judged(records)
    assert _kinds(findings) == kinds
    assert (figures["p99_ns"], figures["timed_on"]) == (ns, "turn hardest")


@pytest.mark.parametrize(
    ("of", "expected"),
    [(99, 50.0), (100, 40.0), (199, 40.0), (200, 30.0), (400, 10.0), (500, 10.0), (9000, 10.0)],
)
def test_the_p99_of_a_stretch_by_hand(of: int, expected: float) -> None:
    """One step in 100 may be slower than the p99, two in 200; a window ends at its fastest."""
    run: Any = SimpleNamespace(steps_searched_for_hardest=of)
    assert compute_p99_ns(run, np.array([20.0, 50.0, 10.0, 40.0, 30.0])) == expected


def test_a_replay_of_all_steps_has_the_usual_p99() -> None:
    """Without a window the percentile is that of the steps, and needs 1000 of them."""
    run: Any = SimpleNamespace(steps_searched_for_hardest=0)
    assert compute_p99_ns(run, np.arange(1001.0)) == 990.0
    assert math.isnan(compute_p99_ns(run, np.arange(999.0)))


def test_replays_without_times_are_doubts_and_hide_no_other(records: Any) -> None:
    records.replay("daqp", concurrency=2.0, first_visit_ratio=40.0)
    records.replay("daqp", "rough[0:300]", steps=300, done=0)
    records.replay("daqp", "rough[300:600]", steps=300, done=0, outcome="timed_out")
    records.replay("daqp", "rough[600:900]", steps=300, median_us=20.0, loop_ratio=40.0)
    findings, figures = _judged(records)
    assert [(f.kind, f.runs[0].sequence) for f in findings] == [
        ("remembered", "paper"),
        ("not alone", "paper"),
        ("no step", "rough[0:300]"),
        ("remembered", "rough[600:900]"),
    ]
    assert figures["timed_on"] == "rough[600:900]"


@pytest.mark.parametrize("outcome", ["timed_out", "crashed"])
def test_replays_that_leave_no_times_leave_no_figures(records: Any, outcome: str) -> None:
    records.replay("daqp", done=0, outcome=outcome)
    assert _judged(records) == ([], {})


def test_the_figures_are_of_the_replay_with_the_limiting_p99(records: Any) -> None:
    """A shorter replay has no p99 and a window counts for the p99 alone.

    The largest step is that of the shorter replay, the limiting p99 that of the window.
    """
    _even_replay(records, 10_000, 1000, sequence="paper", rounds=1, raw_p99_ns=1.0)
    counts = {"iterations_p50": 3.0, "iterations_max": 9.0}
    _even_replay(records, 20_000, 1000, sequence="calm", rounds=2, raw_p99_ns=2.0, **counts)
    _even_replay(records, 90_000, 300, sequence="rough", rounds=1, raw_p99_ns=3.0)
    _window(records, 450, 50_000, rounds=1, raw_p99_ns=4.0)
    steps = records._steps[1]
    chosen = steps["counts"] & (steps["repeat"] == 2)
    steps.loc[chosen, "total_ns"] = 25_000
    findings, figures = _judged(records)
    assert findings == []
    assert figures.pop("p99_run").sequence == "turn hardest"
    assert figures.pop("longest_run").sequence == "rough"
    assert figures.pop("p99_interval") is UNKNOWN
    assert list(figures.pop("of_sequences")) == ["paper", "calm", "rough"]
    assert figures == {
        "p50_ns": 20e3,
        "iterations": (3.0, 9.0),
        "disturbed_spread": 1.0,
        "p99_ns": 50e3,
        "p99_wait_ns": 0.0,
        "timed_on": "calm",
        "rounds_ns": (20e3, 25e3),
        "replay_p99_ns": 20e3,
        "raw_p99_ns": 2.0,
        "longest_ns": 90e3,
        "raw_max_ns": 90e3,
    }


def test_without_a_p99_the_figures_are_of_the_largest_median(records: Any) -> None:
    """The short replay of the larger p50 is named, without a p99."""
    for name, ns in (("paper", 10_000), ("calm", 30_000), ("rough", 20_000)):
        _even_replay(records, ns, 300, sequence=name, slow={0: 50.0 if name == "rough" else 1.0})
    _, figures = _judged(records)
    assert (figures["timed_on"], figures["p50_ns"]) == ("calm", 30e3)
    assert math.isnan(figures["p99_ns"]) and figures["longest_ns"] == 1e6
