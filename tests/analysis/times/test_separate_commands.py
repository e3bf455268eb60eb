"""Replays of two commands make no ratio: both times are given in its place, everywhere."""

import math
from dataclasses import replace
from typing import Any

import pytest

from dpbench.analysis.compare.pairs import pair_runs_of_folders
from dpbench.analysis.compare.times import compute_log_time_ratios, find_reference_indices
from dpbench.analysis.records.machine import select_timed_replays, sum_disturbances_by_campaign
from dpbench.analysis.records.run_record import SEPARATE
from dpbench.analysis.times.contrasts import compare_routes, count_wins_of_formulations
from dpbench.analysis.times.paired_times import (
    PairedComparison,
    compare_paired_times,
    find_faster_inconclusive,
)
from dpbench.analysis.times.solver_tables import compute_ratios_of_pairs, tabulate_time_ratios
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.run_matrix import RunMatrix
from dpbench.analysis.verdict.verdict import judge_solvers
from dpbench.bench.record.cell import CapabilitySource
from dpbench.report.commands_text import (
    describe_commands,
    describe_machine_states,
    describe_turns,
    describe_versions,
)
from dpbench.report.compare.further_tables import make_settings_table
from dpbench.report.documents.markdown import make_report_markdown
from dpbench.report.report import Report
from dpbench.report.topics.replays import build_race_topic

EARLY = {"turns": "a1", "campaign_utc": "2026-11-28T08:00:00.000+00:00"}
LATE = {"turns": "b2", "campaign_utc": "2026-11-28T09:30:00.000+00:00"}
EARLY["judged_utc"], LATE["judged_utc"] = "2026-11-28T08:05:00Z", "2026-11-28T09:42:10Z"
EXACT = {"spread": 0.0, "rounds": 1}
UNDECIDED = "Not decided (machine disturbed):"
STOLEN = {"replay_s": 1.0, "steal_s": 0.1}
QUIET = {"replay_s": 2.0, "involuntary_switches": 4, "steal_s": 0.0}


def _compared(records: Any) -> list[PairedComparison]:
    view = records.view()
    first, second = judge_solvers(view, Requirements()).verdicts_on_references
    return compare_paired_times(view, first, second)


def _two_commands(records: Any) -> None:
    for solver, median_us, command in (("daqp", 20.0, EARLY), ("piqp", 50.0, LATE)):
        records.loop(solver, **command | {"turns": ""})
        records.replay(solver, median_us=median_us, **EXACT, **command)


def test_two_commands_give_both_times_and_no_ratio(records: Any) -> None:
    _two_commands(records)
    (found,) = _compared(records)
    assert (found.finding_text, found.separate) == (SEPARATE, SEPARATE)
    assert (found.first_ns, found.second_ns) == (pytest.approx(20e3), pytest.approx(50e3))
    assert math.isnan(found.ratio.value) and not found.is_unstable
    view = records.view()
    matrix = RunMatrix.from_records(view, judge_solvers(view, Requirements()), [], 0)
    (row,) = tabulate_time_ratios(matrix).to_dict("records")
    assert (row["first_us"], row["second_us"]) == (pytest.approx(20.0), pytest.approx(50.0))
    assert row["finding"] == SEPARATE and math.isnan(row["ratio"])
    pairs = compute_ratios_of_pairs(matrix)
    assert len(pairs.widths) == 1 and math.isnan(pairs.widths[0]) and math.isnan(pairs.logs[0])
    (turns,) = (of_replay for of_replay in pairs.turns.values() if of_replay)
    assert len({*turns.values()}) == 2


def test_every_place_names_separate_commands_in_place_of_a_ratio(records: Any) -> None:
    _two_commands(records)
    text = f"50.0 µs per step against 20.0 µs (geometric means over the same steps), {SEPARATE}"
    said, report = records.ending(), Report.from_results(records.results())
    assert text in said["next"] and said["commands"].startswith(f"The solvers were {SEPARATE} on")
    written = make_report_markdown(report)
    assert text in written and "times as long" not in written
    race = build_race_topic(records.view(), Requirements())
    assert race is not None
    assert race.tables[0].rows[0][-1] == SEPARATE and f"Not decided ({SEPARATE}): " in race.lines[0]


@pytest.mark.parametrize(
    ("median_us", "state", "lead", "end"),
    [
        (19.0, {}, "Step time of `osqp` over that of `daqp`: 1.05", ")"),
        (
            19.0,
            STOLEN,
            "Not decided (machine disturbed): `paper` (",
            ", machine disturbed",
        ),
        (10.0, STOLEN, "Step time of `osqp` over that of `daqp`: 1.99", ")"),
    ],
)
def test_two_solvers_on_a_disturbed_machine_are_ranked_beyond_its_spread_alone(
    records: Any, median_us: float, state: dict[str, float], lead: str, end: str
) -> None:
    """The slower rounds take 1.155 times as long as the fastest, see `test_solver_tables`."""
    records.replay("osqp", median_us=20.0, spread=0.1, **state)
    records.replay("daqp", median_us=median_us, spread=0.1)
    race = build_race_topic(records.view(), Requirements())
    assert race is not None and race.lines[0].startswith(lead)
    assert race.tables[0].rows[0][-1].endswith(end)


def test_a_race_names_the_inaccurate_solver_before_the_ratio(records: Any) -> None:
    records.replay("osqp", median_us=20.0, error=0.25)
    records.replay("daqp", median_us=10.0)
    race = build_race_topic(records.view(), Requirements())
    assert race is not None
    assert race.lines[0].startswith(
        "Not accurate on every step: `osqp` in `paper` (largest error of the first move 0.25). "
        "Step time of `osqp` over that of `daqp`: "
    )


def test_settings_within_a_disturbed_folder_have_the_finding_beside_the_interval(
    records: Any,
) -> None:
    records.replay("osqp", median_us=20.0, spread=0.1, **STOLEN)
    records.replay("osqp", median_us=19.0, settings="high", spread=0.1)
    view = records.view()
    table = make_settings_table(view, view)
    assert table is not None
    assert all(cell.endswith(", machine disturbed") for cell in table.rows[0][4::2])


def test_replays_by_turns_alone_count_where_some_are(records: Any) -> None:
    """Twice as long if interleaved; the 40 times of the other sequence is another command's."""
    for solver, medians, calm in (("base", (20.0, 1.0), EARLY), ("other", (40.0, 40.0), LATE)):
        records.replay(solver, "paper", median_us=medians[0], **EXACT, **EARLY)
        records.replay(solver, "calm", median_us=medians[1], **EXACT, **calm)
    (found,) = _compared(records)
    assert (found.ratio.value, found.steps, found.separate) == (pytest.approx(2.0), 1000, "")
    assert [*found.leaders] == ["median on `paper`", "limiting p99"]


def test_a_run_without_a_key_is_of_another_command_than_one_with(records: Any) -> None:
    """Two without are of an old folder: a ratio, and a caution on it."""
    for solver in ("base", "other"):
        records.replay(solver, **EXACT, turns="", campaign_utc="")
    assert _compared(records)[0].separate == ""
    assert describe_turns(records.view()).startswith("Which replays were interleaved is not")
    records.replay("third", **EXACT, **EARLY)
    assert "timed in separate commands on paper" in describe_turns(records.view())


def test_qps_that_are_not_timed_by_turns_need_no_record_of_it(records: Any) -> None:
    """Neither those at the edge of a capability plot nor refused ones are of an earlier release."""
    for solver in ("base", "other"):
        records.replay(solver, **EXACT, **EARLY)
        records.replay(solver, "calm", **EXACT, **EARLY | {"turns": ""})
        records.replay(solver, "rough", done=0, outcome="refused", turns="", campaign_utc="")
    view, edge = records.view(), CapabilitySource("calm")
    view.all_runs = [
        replace(run, source=edge) if run.sequence == "calm" else run for run in view.all_runs
    ]
    assert len(view.all_runs) == 6 and describe_turns(view) == ""


def test_replays_of_one_command_after_a_crash_are_not_called_separate(records: Any) -> None:
    records.replay("base", **EXACT, **EARLY)
    records.replay("other", **EXACT, **EARLY | {"turns": "c3"})
    assert _compared(records)[0].separate == "not interleaved"


def test_nothing_of_another_command_is_called_faster(records: Any) -> None:
    for solver, median_us, command in (("daqp", 50.0, EARLY), ("piqp", 20.0, LATE)):
        records.replay(solver, median_us=median_us, **EXACT, **command)
    records.loop("daqp")
    view = records.view()
    verdicts = judge_solvers(view, Requirements())
    chosen = verdicts.of["daqp"][0]
    assert find_faster_inconclusive(view, verdicts, chosen) == []


def test_routes_and_formulations_of_two_commands_are_not_compared(records: Any) -> None:
    records.replay("daqp", median_us=40.0, **EXACT, **EARLY)
    for form, command in (("condensed_box", LATE), ("sparse", EARLY)):
        records.replay("daqp", median_us=20.0, route="native", formulation=form, **EXACT, **command)
    (gain,) = compare_routes(records.view(), "paper")
    assert gain.separate == SEPARATE and math.isnan(gain.gain.value)
    assert (gain.above_ns, gain.median_ns) == (pytest.approx(40e3), pytest.approx(20e3))
    assert count_wins_of_formulations(records.view(), Requirements()).total() == 0


def test_settings_of_two_commands_have_both_times_in_a_comparison(records: Any) -> None:
    records.replay("osqp", median_us=40.0, **EXACT, **EARLY)
    records.replay("osqp", median_us=20.0, settings="high", **EXACT, **LATE)
    table = make_settings_table(records.view(), records.view())
    assert table is not None
    assert table.rows[0][3:5] == ("20.0 µs, 40.0 µs", SEPARATE)


def test_the_factor_of_the_machine_is_that_of_one_command(records: Any) -> None:
    """A group for each pair of commands, one of either folder."""
    for solver, command in (("daqp", EARLY), ("piqp", EARLY), ("osqp", LATE)):
        records.replay(solver, **EXACT, **command)
    view = records.view()
    pairs = pair_runs_of_folders(view, view, names=("a", "b")).pairs
    timings = compute_log_time_ratios(view, view, pairs)
    names = [timing.group for timing in timings]
    assert names == ["paper, command 1 of 2", "paper, command 1 of 2", "paper, command 2 of 2"]
    assert find_reference_indices(timings, "daqp").tolist() == [0, 0, -1]


def test_the_state_of_each_command_is_given_worst_first(records: Any) -> None:
    """Summed up, 4 disturbed rounds of 104 would be quiet."""
    records.replay("daqp", steps=9, rounds=100, **EARLY, **QUIET)
    records.replay("piqp", steps=9, rounds=4, **LATE, **QUIET, disturbed_rounds=4)
    runs = select_timed_replays(records.view())
    assert [*sum_disturbances_by_campaign(runs)] == [LATE["campaign_utc"], EARLY["campaign_utc"]]
    assert describe_machine_states(runs) == (
        "affected by other load: 4 of 8 rounds disturbed after a repeat (command of 2026-11-28 "
        "09:30:00 UTC); quiet (command of 2026-11-28 08:00:00 UTC)"
    )
    assert describe_machine_states(runs[:1]) == "quiet"
    assert describe_machine_states([runs[0], runs[0]]) == "quiet"


def test_the_span_of_a_folder_is_from_the_first_start_to_the_last_end(records: Any) -> None:
    assert describe_commands([], "2026-11-28T07:00:00+00:00") == "started 2026-11-28 07:00:00 UTC"
    _two_commands(records)
    span = "run from 2026-11-28 08:00:00 UTC to 2026-11-28 09:42:10 UTC in 2 commands"
    assert describe_commands(records.view().all_runs, "2026-11-28T09:30:00+00:00") == span
    records.replay("osqp", turns="", campaign_utc="", judged_utc="")
    runs = records.view().all_runs
    assert describe_commands(runs, "") == f"{span}; when other runs were made is not recorded"


def test_a_solver_without_a_version_is_named_alone(records: Any) -> None:
    records.loop("daqp", steps=4)
    records.loop("own", steps=4, solver_version="")
    assert describe_versions(records.view(), {}).startswith("Versions: daqp 1.0, own; suite ")
