"""What the report says of machine, harness, repeatability and memory, on made-up records."""

import re
from typing import Any

import pytest

from dpbench.analysis.machine import disturbance_of, timed_runs
from dpbench.analysis.records import Records
from dpbench.bench.record.result_folder import Results
from dpbench.report.blocks import Paragraph, Tabular
from dpbench.report.render import render_markdown
from dpbench.report.section_harness import harness_lines, machine_blocks, repeat_section
from dpbench.report.table import Table
from dpbench.report.tables_harness import cost_table, determinism_table, memory_table
from dpbench.report.write import build_page
from dpbench.solvers.calibration import CALIBRATION, WAITS_NS

QUIET = {
    "replay_s": 2.0,
    "involuntary_switches": 4,
    "steal_s": 0.0,
    "rerun_rounds": 1,
    "bit_identical_share": 1.0,
    "answer_spread_max": 0.0,
    "peak_rss_bytes": 5e6,
    "os_threads": 1,
    "pool_threads": 1,
    "N_p": 30,
    "N_c": 5,
}


def _with_calibration(records: Any, off_us: float = 0.4, **columns: Any) -> None:
    for name in CALIBRATION:
        median_us = WAITS_NS.get(name, 0) / 1e3 + off_us
        records.replay(
            name, median_us=median_us, route="native", policy="reuse", **(QUIET | columns)
        )


def _cells(table: Table | None, column: str) -> list[str]:
    assert table is not None
    at = table.heads.index(column)
    return [row[at].text for row in table.rows]


@pytest.mark.slow
def test_own_configurations_are_seen_in_no_other_part_of_the_view(records: Any) -> None:
    """They are no solvers, no runs and no rows of anything but the table of their own."""
    records.replay("daqp", **QUIET)
    _with_calibration(records)
    view = records.view()
    assert [run.solver for run in view.all_runs] == ["daqp"] == view.solvers
    assert [run.solver for run in view.runs] == ["daqp"]
    assert _cells(cost_table(view), "configuration") == list(CALIBRATION)


@pytest.mark.slow
def test_own_configurations_change_nothing_else_in_the_report(records: Any) -> None:
    """With and without them, every section but those on times and runs reads the same."""
    for solver, median in (("daqp", 18.0), ("quadprog", 25.0)):
        records.replay(solver, median_us=median, **QUIET)
        records.loop(solver)
    before = build_page(records.results())
    _with_calibration(records)
    after = build_page(records.results())
    assert [s.key for s in after.sections] == [s.key for s in before.sections]
    for old, new in zip(before.sections, after.sections, strict=True):
        if old.key not in ("runs", "timing", "repeat"):
            said = [[b for b in s.blocks if isinstance(b, Paragraph | Tabular)] for s in (old, new)]
            assert said[0] == said[1], old.key
    text = render_markdown(after)
    outside = re.sub(r"### What the harness itself costs.*?(?=\n### )", "", text, flags=re.DOTALL)
    assert "busy_wait_20us" in text and "busy_wait_20us" not in outside


@pytest.mark.slow
@pytest.mark.parametrize(
    ("off_us", "missed"),
    [
        (0.9, []),
        (1.5, ["no_op", "busy_wait_20us", "busy_wait_50us"]),
        (3.0, ["no_op", "busy_wait_20us", "busy_wait_50us", "busy_wait_200us"]),
        (11.0, ["no_op", *WAITS_NS]),
    ],
)
def test_the_bar_is_a_microsecond_or_a_hundredth(
    records: Any, off_us: float, missed: list[str]
) -> None:
    """20, 50 and 200 µs and nothing at all: within 1, 1, 2 and 1 µs; 1000 µs within 10."""
    _with_calibration(records, off_us)
    table = cost_table(records.view())
    held = dict(zip(_cells(table, "configuration"), _cells(table, "within the bar"), strict=True))
    assert [configuration for configuration, word in held.items() if word == "no"] == missed
    assert held["copy_only"] == "–"


def test_a_quiet_machine_and_a_disturbed_one(records: Any) -> None:
    """Sums over all configurations; a run under two names of its settings counts once."""
    same = QUIET | {"raw_max_ns": 7e4}
    records.replay("quadprog", **same)
    records.replay("quadprog", **(same | {"settings": "high"}))
    view = records.view()
    found = disturbance_of(timed_runs(view))
    assert (found.rounds, found.seconds, found.involuntary, found.rerun) == (3, 2.0, 4, 1)
    assert harness_lines(view) == ["machine: quiet"]
    records.replay("daqp", **(QUIET | {"involuntary_switches": 96, "steal_s": 0.2}))
    (line,) = harness_lines(records.view())
    assert "25 involuntary context switches a second" in line and "5.0 % of the time" in line


def _switching(records: Any, solver: str, a_second: float, step_s: float, own: float) -> None:
    """Three rounds of 100 steps: switches by the machine, and so many of the configuration's own a
    step."""
    seconds = 300 * step_s
    columns = {"replay_s": seconds, "involuntary_switches": round(a_second * seconds + own * 300)}
    records.replay(solver, steps=100, rounds=3, **(QUIET | columns))


@pytest.mark.slow
def test_switches_a_configuration_makes_itself_are_not_the_machines(records: Any) -> None:
    """A thread in each solve puts a configuration off its core every step; its neighbours are let
    alone."""
    for solver, step_s in (("daqp", 1e-3), ("osqp", 5e-3), ("qtqp", 2e-2)):
        _switching(records, solver, 2.0, step_s, 0.0)
    _switching(records, "threads", 2.0, 2e-3, 1.0)
    view = records.view()
    assert harness_lines(view) == ["machine: quiet"]
    page = render_markdown(build_page(records.results()))
    assert "not counted above | threads (qpsolvers fresh): 1.0 a step |" in page


def test_a_busy_machine_hits_every_configuration_and_is_told(records: Any) -> None:
    """At 100 switches a second a step of 20 ms has two, and they are still the machine's."""
    for solver, step_s in (("daqp", 1e-3), ("osqp", 5e-3), ("qtqp", 2e-2)):
        _switching(records, solver, 100.0, step_s, 0.0)
    (line,) = harness_lines(records.view())
    assert "100 involuntary context switches a second" in line


def test_disturbed_rounds_are_part_of_all_rounds(records: Any) -> None:
    """Three rounds count and one is disturbed: one of four."""
    records.replay("daqp", **(QUIET | {"disturbed_rounds": 1}))
    assert "1 of 4 rounds disturbed" in harness_lines(records.view())[0]


@pytest.mark.slow
def test_configurations_that_differ_are_listed_and_the_others_counted(records: Any) -> None:
    """One line when all repeat themselves, a row for each that does not."""
    records.replay("daqp", **QUIET)
    section = repeat_section(records.view())
    assert section is not None and determinism_table(timed_runs(records.view())) is None
    other = {"bit_identical_share": 0.5, "answer_spread_max": 1e-4, "iterations_spread": 25}
    records.replay("osqp", **(QUIET | other | {"iterations_identical_share": 0.9}))
    view = records.view()
    assert _cells(determinism_table(timed_runs(view)), "solver") == ["osqp"]
    section = repeat_section(view)
    assert section is not None
    (text,) = [block.text for block in section.blocks if isinstance(block, Paragraph)]
    assert "1 configuration of 2 gives" in text and "1 does not" in text


@pytest.mark.slow
def test_memory_is_the_largest_of_a_solver_and_horizon(records: Any) -> None:
    """Two policies are one row, two horizons are two; of the own configurations no_op stands
    first."""
    records.replay("daqp", policy="reuse", **QUIET)
    records.replay("daqp", policy="warm", **(QUIET | {"peak_rss_bytes": 7e6}))
    records.replay("daqp", policy="warm", **(QUIET | {"peak_rss_bytes": 9e6, "N_p": 60}))
    _with_calibration(records, peak_rss_bytes=2e6)
    table = memory_table(timed_runs(records.view()))
    assert _cells(table, "solver") == ["no_op", "daqp", "daqp"]
    assert _cells(table, "horizons") == ["30/5", "60/5", "30/5"]
    assert _cells(table, "peak [MB]") == ["2.00", "9.00", "7.00"]


def test_a_report_on_nothing_but_the_harness(records: Any) -> None:
    """The suite `calibration` alone: no verdict on solvers, and no sentence that misses them."""
    _with_calibration(records)
    text = render_markdown(build_page(records.results()))
    assert "The machine was quiet" in text and "What the harness itself costs" in text
    assert "Missing:" not in text and "Verdict" not in text


def test_records_without_counters_say_nothing(records: Any) -> None:
    """A folder of closed loops has no section on what was never looked at."""
    records.loop("daqp")
    found: Results = records.results()
    assert machine_blocks(Records(found)) == [] and repeat_section(Records(found)) is None
    assert harness_lines(Records(found)) == []


@pytest.mark.slow
def test_replays_of_disturbed_rounds_alone_say_so(records: Any) -> None:
    """Three rounds count though all are disturbed: three of three, and the page says they count."""
    records.replay("daqp", **(QUIET | {"disturbed_rounds": 3, "counting_disturbed": 3}))
    assert "3 of 3 rounds disturbed" in harness_lines(records.view())[0]
    assert "in 1 replay every round was, so all of them count" in render_markdown(
        build_page(records.results())
    )
