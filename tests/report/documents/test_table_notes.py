"""Notes below a Markdown table of solvers: replays that differ, options of the user's settings."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from dpbench.analysis.verdict.requirements import Finding, Requirements
from dpbench.analysis.verdict.verdict import Verdict, judge_solvers
from dpbench.bench.record.cell import Configuration
from dpbench.report.documents.markdown import yield_table_remarks


def _run(sequence: str, window_of: int = 0) -> Any:
    return SimpleNamespace(
        mode="replay", sequence=sequence, scenario=sequence, steps_searched_for_hardest=window_of
    )


def _verdict(
    solver: str, timed_on: str, p99_ns: float = 1.0, window: str = "", **given: str
) -> Verdict:
    """A verdict whose hardest step, and p99, is in the replay, or in a window of a scenario."""
    configuration = Configuration(solver, "native", "warm", **given)
    worst = _run(window, 450) if window else _run(timed_on) if timed_on else None
    times: dict[str, Any] = {"p99_ns": p99_ns, "p99_run": worst, "longest_run": worst}
    return Verdict(configuration, "pass", timed_on=timed_on, **times)


def test_rows_of_other_replays_and_own_options_are_named() -> None:
    own = _verdict("osqp", "squall", settings="mine", options='{"rho": 1.6}')
    notes = list(yield_table_remarks([_verdict("daqp", "move"), own, _verdict("piqp", "move")]))
    assert notes == [
        "The p50 is from the replay of `move`, with one exception: for `osqp` (native warm, mine), "
        "it is from the replay of `squall`.",
        "Custom settings: `osqp` mine: rho=1.6.",
    ]


def test_causes_of_crashes_and_hangs_are_named(records: Any) -> None:
    records.replay("d", "move", outcome="crashed", outcome_detail="killed by SIGSEGV", done=0)
    run = records.view().runs[0]
    crash = Finding("crashed", (run,))
    ended = [
        replace(
            _verdict(f"d{i}", "move"), state="fail", causes=(crash, Finding("no answer", (run,)))
        )
        for i in range(4)
    ]
    assert [*yield_table_remarks([_verdict("daqp", "move"), *ended])] == [
        "Runs that crashed or hung: "
        + "; ".join(
            f"`d{i}` (native warm): its process ended in the replay of `move`: killed by SIGSEGV"
            for i in range(3)
        )
        + "; and 1 more."
    ]


def test_the_replays_of_worst_p99_and_hardest_step_are_named() -> None:
    """Those without a p99 are in no note on it."""
    notes = list(
        yield_table_remarks(
            [
                _verdict("daqp", "move", window="turn"),
                _verdict("osqp", "move", window="turn"),
                _verdict("scs", "move"),
                _verdict("piqp", "move", math.nan, window="rough"),
            ]
        )
    )
    scs = "for `scs` (native warm), it is in the replay of `move`"
    piqp = "for `piqp` (native warm), it is in the window of `rough`"
    assert notes == [
        "A window is a replay of a few steps around the hardest step of a scenario; its p99 has no "
        "confidence interval.",
        f"The limiting p99 is in the window of `turn`, with one exception: {scs}.",
        f"The longest step is in the window of `turn`, with 2 exceptions: {scs}; {piqp}.",
    ]


def test_times_of_all_rows_are_of_one_sequence_that_all_have(records: Any) -> None:
    """Each solver has its larger p99 in another replay; together `turn` takes longer."""
    for solver, turn_us, move_us in (("daqp", 90.0, 40.0), ("osqp", 60.0, 70.0)):
        records.loop(solver, "paper")
        records.replay(solver, "turn", median_us=turn_us)
        records.replay(solver, "paper", median_us=move_us)
    view = records.view()
    verdicts = judge_solvers(view, Requirements()).all_verdicts
    assert {verdict.timed_on for verdict in verdicts} == {"turn"}
    assert [verdict.p50_ns / 1e3 for verdict in verdicts] == pytest.approx([90, 60], rel=0.05)
    assert {v.p99_run.sequence for v in verdicts if v.p99_run} == {"turn", "paper"}
    usual, *_ = yield_table_remarks(verdicts)
    assert usual == "The p50 is from the replay of `turn`."


def test_more_than_three_exceptions_are_counted() -> None:
    solvers = ("scs", "piqp", "osqp", "proxqp")
    other = [_verdict(name, "move", window="rough") for name in solvers]
    (*_, hardest) = yield_table_remarks([*(_verdict(f"d{i}", "move") for i in range(5)), *other])
    assert hardest == (
        "The longest step is in the replay of `move` for 5 of the 9 configurations and in the "
        "window of `rough` for 4."
    )


def test_nothing_is_said_of_one_replay_with_presets() -> None:
    assert list(yield_table_remarks([_verdict("daqp", "move"), _verdict("piqp", "")])) == []
    assert list(yield_table_remarks([])) == []
