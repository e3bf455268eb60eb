"""Tables of solvers, level points and paired comparisons: exact cases."""

import math
from dataclasses import replace
from typing import Any

import pytest

from dpbench.analysis.times.paired_times import (
    PairedComparison,
    compare_paired_times,
    compare_settings_of_solvers,
)
from dpbench.analysis.times.solver_tables import (
    build_level_points,
    tabulate_best_times,
    tabulate_experiment_verdicts,
    tabulate_time_ratios,
    tabulate_verdicts,
)
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.run_matrix import RunMatrix
from dpbench.analysis.verdict.verdict import judge_solvers
from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.suite import load_path_and_suite
from dpbench.report.documents.markdown import make_report_markdown
from dpbench.report.formats import significant
from dpbench.report.report import Report
from dpbench.report.verdict.verdict_text import describe_paired_times
from dpbench.solvers.calibration import COPY_ONLY
from dpbench.solvers.settings import has_distinct_tolerance_presets, list_preset_names
from dpbench.solvers.table import find_solver_record


def _matrix(records: Any) -> RunMatrix:
    view = records.view()
    return RunMatrix.from_records(view, judge_solvers(view, Requirements()), [], 0)


def test_the_ladder_is_that_of_the_verdicts(records: Any) -> None:
    """Milliseconds of p50, p99, largest step and sample."""
    records.loop("daqp")
    records.replay("daqp", median_us=20.0)
    records.loop("scs")
    assert tabulate_best_times(_matrix(records))["share"].tolist() == [0.0]
    records.replay(COPY_ONLY, algo_p50_ns=30e3, route="native", policy="reuse")
    matrix = _matrix(records)
    (row,) = tabulate_best_times(matrix).to_dict("records")
    verdict = matrix.verdicts.verdicts_on_references[0]
    assert row["solver"] == "daqp" and row["share"] == 1.0
    times = [row[name] * 1e6 for name in ("p50_ms", "limiting_p99_ms", "max_ms")]
    expected = [verdict.p50_ns, verdict.p99_ns, verdict.longest_ns]
    assert times == pytest.approx(expected)


def test_the_ladder_has_the_p99_of_the_closed_loop(records: Any) -> None:
    """Scaled by (1 + 20) / (1 + 5) from the iterations of the replay to those of the loop."""
    records.loop("daqp", iterations_p99=20.0)
    records.replay("daqp", steps=1000, iterations_p99=5.0, iterations_max=8.0)
    (row,) = tabulate_best_times(_matrix(records)).to_dict("records")
    assert row["limiting_p99_ms"] == pytest.approx(3.5 * row["replay_p99_ms"])


def test_the_ladder_has_settings_of_ones_own(records: Any) -> None:
    """The best of two call modes of each, below the presets' best where that is faster."""
    records.loop("osqp")
    records.replay("osqp", median_us=50.0, spread=0.0)
    for rho, median_us in ((1, 80.0), (2, 90.0)):
        own = {"settings": f"rho={rho}", "options": f'{{"rho": {rho}}}'}
        for policy in ("fresh", "warm"):
            records.loop("osqp", policy=policy, **own)
            slower = 1.0 if policy == "warm" else 2.0
            records.replay("osqp", median_us=slower * median_us, policy=policy, **own)
    assert tabulate_best_times(_matrix(records))["label"].tolist() == [
        "osqp (qpsolvers fresh)",
        "osqp (qpsolvers warm, rho=1)",
        "osqp (qpsolvers warm, rho=2)",
    ]


def test_a_level_that_was_not_run_somewhere_is_hatched_there(records: Any) -> None:
    records.loop("osqp", "paper", error=0.4)
    records.loop("osqp", "calm", error=0.4)
    records.loop("osqp", "paper", settings="high")
    tiles = tabulate_experiment_verdicts(_matrix(records)).set_index(["settings", "experiment"])[
        "verdict"
    ]
    assert tiles.to_dict() == {
        ("default", "paper"): "fail",
        ("default", "calm"): "fail",
        ("high", "paper"): "pass",
        ("high", "calm"): "not run",
    }


def test_settings_that_ran_in_another_call_mode_show_their_verdict_there(records: Any) -> None:
    """The best configuration has options of its own; the others were run, and failed."""
    tuned = {"settings": "tuned", "options": '{"rho": 0.005}', "route": "native", "policy": "warm"}
    mine = {"settings": "mine", "options": '{"rho": 1.6}', "error": 0.5}
    records.loop("osqp", **tuned)
    records.loop("osqp", route="native", policy="warm", error=0.4)
    records.loop("osqp", route="native", policy="reuse", **mine)
    records.loop("osqp", route="qpsolvers", policy="fresh", **(mine | {"failed": 3}))
    records.loop("osqp", "calm", route="qpsolvers", policy="fresh", **mine)
    for settings in ("tuned", "default", "mine"):
        columns = {"tuned": tuned, "mine": mine}.get(settings, {"error": 0.4})
        call = {"route": "native", "policy": "reuse" if settings == "mine" else "warm"}
        records.replay("osqp", **(columns | call | {"settings": settings}))
    table = tabulate_experiment_verdicts(_matrix(records)).set_index(["settings", "experiment"])
    assert table["verdict"].to_dict() == {
        ("default", "paper"): "fail",
        ("default", "calm"): "not run",
        ("default", "paper (replay)"): "fail",
        ("mine", "paper"): "fail",
        ("mine", "calm"): "fail",
        ("mine", "paper (replay)"): "fail",
        ("tuned", "paper"): "pass",
        ("tuned", "calm"): "not run",
        ("tuned", "paper (replay)"): "pass",
    }
    modes = table["call_mode"].to_dict()
    assert modes[("default", "paper")] == "native warm"
    assert modes[("mine", "calm")] == "qpsolvers fresh"


def test_custom_settings_have_the_verdict_in_their_best_call_mode(records: Any) -> None:
    """Cold start fails with them, though it is the call mode of the solver's best preset."""
    own = {"settings": "mine", "options": '{"rho": 1.6}', "route": "native"}
    records.loop("osqp", route="native", policy="fresh")
    records.replay("osqp", route="native", policy="fresh", median_us=10.0)
    for policy, error in (("fresh", 0.5), ("warm", 1e-9)):
        records.loop("osqp", policy=policy, error=error, **own)
        records.replay("osqp", policy=policy, error=error, **own)
    table = tabulate_experiment_verdicts(_matrix(records)).set_index(["settings", "experiment"])
    assert table.loc["mine", "call_mode"].tolist() == ["native warm"] * 2
    assert table.loc["mine", "verdict"].tolist() == ["pass"] * 2


def test_settings_of_ones_own_are_judged_apart_and_have_their_options_beside(records: Any) -> None:
    """A preset has none."""
    records.loop("osqp", error=0.4)
    records.loop("osqp", settings="mine", options='{"eps_abs": 1e-05, "rho": 2}')
    table = tabulate_verdicts(_matrix(records)).set_index("settings")
    assert table["options"].to_dict() == {"default": "", "mine": "eps_abs=1e-5,rho=2"}
    assert table["verdict"].to_dict() == {"default": "fail", "mine": "inconclusive"}


EXACT = {"spread": 0.0, "rounds": 1}
"""Every algorithmic time is the median itself."""


def _compared(records: Any) -> list[PairedComparison]:
    view = records.view()
    first, second = judge_solvers(view, Requirements()).verdicts_on_references
    return compare_paired_times(view, first, second)


def test_qps_of_different_sizes_are_not_pooled(records: Any) -> None:
    """Twice as long at 15 variables and half as long at 120 is not a tie."""
    for sequence, n, medians in (("calm", 120, (80.0, 40.0)), ("paper", 15, (12.0, 24.0))):
        for solver, median_us in zip(("base", "other"), medians, strict=True):
            records.replay(solver, sequence, n=n, median_us=median_us, **EXACT)
    small, large = _compared(records)
    assert (small.variables, small.ratio.value) == (15, pytest.approx(2.0))
    assert (large.variables, large.ratio.value) == (120, pytest.approx(0.5))
    said = describe_paired_times([small, large])
    assert said.startswith("2.00 times as long at 15 variables over the same steps")
    assert "; on average 0.500 times as long at 120 variables" in said
    records.loop("base")
    records.loop("other")
    table = tabulate_time_ratios(_matrix(records))
    assert table[["variables", "steps"]].to_numpy().tolist() == [[15, 1000], [120, 1000]]
    assert table["sequences"].tolist() == ["paper", "calm"]
    said = describe_paired_times([small, replace(small, variables=30), large])
    assert said.endswith("; 1 more size in the table `paired_ratios`")


def test_the_pooled_sequences_of_a_ratio_are_in_its_row(records: Any) -> None:
    for solver, median_us in (("base", 10.0), ("other", 20.0)):
        for sequence in ("paper", "calm"):
            records.replay(solver, sequence, median_us=median_us, **EXACT)
        records.loop(solver)
    assert tabulate_time_ratios(_matrix(records))["sequences"].tolist() == ["paper;calm"]


def test_sequences_weigh_the_same_in_a_ratio(records: Any) -> None:
    """Twice as long on 1000 steps and 8 times on 500 is 4 times."""
    for solver, factors in (("base", (1.0, 1.0, 1.0)), ("other", (2.0, 8.0, 99.0))):
        for (sequence, steps), factor in zip(
            (("paper", 1000), ("calm", 500), ("rough", 100)), factors, strict=True
        ):
            records.replay(solver, sequence, steps=steps, median_us=10.0 * factor, **EXACT)
    (found,) = _compared(records)
    assert (found.ratio.value, found.steps) == (pytest.approx(4.0), 1500)
    assert (found.ratio.low, found.ratio.high, found.is_unstable) == (0.0, math.inf, False)


def test_a_ratio_that_turns_with_the_sequence_names_both_leaders(records: Any) -> None:
    for solver, medians in (("base", (20.0, 20.0)), ("other", (10.0, 80.0))):
        for sequence, median_us in zip(("paper", "calm"), medians, strict=True):
            records.replay(solver, sequence, steps=400, median_us=median_us, **EXACT)
    (found,) = _compared(records)
    assert found.leaders["median on `paper`"] == "other (qpsolvers fresh)"
    assert found.leaders["median on `calm`"] == "base (qpsolvers fresh)"
    assert found.is_unstable


def test_settings_of_a_solver_are_compared_with_its_first_in_one_call_mode(records: Any) -> None:
    """Half the time of default in its mode; warm, where nothing else ran, has no ratio."""
    records.loop("osqp")
    records.replay("osqp", median_us=40.0, spread=0.1)
    own = {"settings": "mine", "options": '{"rho": 1.6}'}
    records.replay("osqp", median_us=20.0, spread=0.1, **own)
    records.replay("osqp", median_us=60.0, settings="high", spread=0.1)
    records.replay("osqp", median_us=5.0, policy="warm", spread=0.1, **own)
    found = {one.second: one for one in compare_settings_of_solvers(records.view())}
    assert {one.first for one in found.values()} == {"osqp (qpsolvers fresh)"}
    mine, high = found["osqp (qpsolvers fresh, mine)"], found["osqp (qpsolvers fresh, high)"]
    assert len(found) == 2 and mine.ratio.value == pytest.approx(0.5, rel=0.02)
    assert (mine.finding_text, high.finding_text) == ("faster", "slower")
    report = Report.from_results(records.results())
    pair = "osqp (qpsolvers fresh, mine) against osqp (qpsolvers fresh)"
    text = f"{pair}: {significant(mine.ratio.value)} times as long over"
    assert text in dict(report.summary_rows())["settings"] and "high" not in text
    assert text in make_report_markdown(report)
    (topic,) = (one for one in report.topics if one.id == "settings")
    ratios = [row[3].split(" ")[0] for row in topic.tables[0].rows]
    assert ratios == [significant(one.ratio.value) for one in (high, mine)]
    assert {mine.second, high.second} <= {*report.tables["paired_ratios"]["second"]}


def test_settings_that_fail_or_are_called_otherwise_are_named(records: Any) -> None:
    """Wrong settings in a warm call beside a right solver in a fresh one."""
    records.loop("daqp")
    records.replay("daqp", median_us=10.0, **EXACT)
    own = {"settings": "mine", "options": '{"rho": 1.6}', "policy": "warm"}
    records.loop("osqp", **own)
    records.replay("osqp", median_us=20.0, error=0.5, spread=0.1, **own)
    records.replay("osqp", median_us=30.0, policy="warm", **EXACT)
    said = dict(Report.from_results(records.results()).summary_rows())["settings"]
    mine = "osqp (qpsolvers warm, mine)"
    assert f"{mine} against daqp (qpsolvers fresh), in another call mode: " in said
    assert f"{mine} against osqp (qpsolvers warm): " in said
    assert said.count(f". {mine} fails.") == 2


def test_a_larger_tail_of_the_faster_settings_is_named(records: Any) -> None:
    """Most steps take half as long and 20 of them 50 times: which is faster depends."""
    records.replay("osqp", median_us=40.0, spread=0.1)
    slow = dict.fromkeys(range(20), 50.0)
    records.replay("osqp", median_us=20.0, settings="low", slow=slow, spread=0.1)
    (found,) = compare_settings_of_solvers(records.view())
    assert found.finding_text == "unstable"
    assert "with the larger p99 on `paper`" in describe_paired_times([found])


def test_only_common_steps_are_compared(records: Any) -> None:
    records.replay(
        "base", steps=300, median_us=10.0, slow=dict.fromkeys(range(250, 300), 50.0), **EXACT
    )
    records.replay("other", steps=300, done=250, median_us=20.0, **EXACT)
    (found,) = _compared(records)
    assert (found.steps, found.ratio.value) == (250, pytest.approx(2.0))


def test_without_a_common_step_nothing_is_compared(records: Any) -> None:
    records.replay("base", "paper", steps=40)
    records.replay("other", "calm", steps=40)
    assert _compared(records) == []


BOTH = ("paper", "rough[900:1400]")
USUAL = dict.fromkeys(("osqp", "whole", "half", "part"), ("qpsolvers", "fresh"))


def test_a_point_is_the_worst_of_its_sequences(records: Any) -> None:
    """Worst p50 and p99, largest error, of two sequences long enough for a p99."""
    records.replay("osqp", BOTH[0], median_us=10.0, spread=0.0, error=1e-5)
    records.replay("osqp", BOTH[1], median_us=30.0, spread=0.0, error=1e-3, failed=2)
    (point,) = build_level_points(records.view(), BOTH, USUAL)["osqp"]
    assert (point.p50_ns, point.p99_ns, point.error_move) == (30e3, 30e3, 1e-3)
    assert point.failed == 2


def test_both_times_of_a_point_are_of_the_same_steps(records: Any) -> None:
    """A sequence too short for a p99 gives no p50 either, or that would exceed the p99."""
    records.replay("osqp", BOTH[0], median_us=10.0, spread=0.0, error=1e-5)
    records.replay("osqp", BOTH[1], steps=500, median_us=30.0, spread=0.0, error=1e-3)
    (point,) = build_level_points(records.view(), BOTH, USUAL)["osqp"]
    assert (point.p50_ns, point.p99_ns, point.error_move) == (10e3, 10e3, 1e-3)
    (short,) = build_level_points(records.view(), BOTH[1:], USUAL)["osqp"]
    assert short.p50_ns == 30e3 and math.isnan(short.p99_ns)


def test_the_points_have_their_levels_in_order_and_leaves_out_other_ways(records: Any) -> None:
    for settings in ("high", "default", "low", "mid"):
        records.replay("osqp", settings=settings)
    records.replay("osqp", settings="mid", policy="warm", median_us=1.0)
    (points,) = build_level_points(records.view(), BOTH[:1], USUAL).values()
    assert [point.configuration.settings for point in points] == ["default", "low", "mid", "high"]
    assert {point.configuration.policy for point in points} == {"fresh"}


def test_all_points_of_a_solver_are_of_the_way_that_is_asked_for(records: Any) -> None:
    for policy, us in (("fresh", 20.0), ("warm", 5.0), ("reuse", 8.0)):
        records.replay("osqp", route="native", policy=policy, median_us=us, spread=0.0)
    for policy, us in (("fresh", 30.0), ("warm", 60.0)):
        way = {"route": "native", "policy": policy, "settings": "high"}
        records.replay("osqp", **way, median_us=us, spread=0.0)
    records.replay("osqp", median_us=1.0)
    records.replay("daqp", route="native", policy="warm")
    levels = build_level_points(records.view(), BOTH[:1], {"osqp": ("native", "warm")})
    found = {
        solver: [(p.configuration.settings, p.p50_ns) for p in points]
        for solver, points in levels.items()
    }
    assert found == {"osqp": [("default", 5e3), ("high", 60e3)]}


def test_a_solver_on_one_sequence_of_two_has_no_point(records: Any) -> None:
    records.replay("whole", BOTH[0])
    records.replay("whole", BOTH[1])
    records.replay("half", BOTH[0])
    records.replay("part", BOTH[0])
    records.replay("part", BOTH[1], steps=60, done=1, stopped=True)
    assert list(build_level_points(records.view(), BOTH, USUAL)) == ["whole"]


@pytest.mark.parametrize("sequence", ["paper", "rough"])
def test_the_levels_suite_runs_every_level_of_every_solver(sequence: str) -> None:
    """Each solver whose settings matter is replayed at each of its four levels, long enough for
    a p99; the others run once and stand under all names."""
    _, suite = load_path_and_suite("levels")
    levels = ("default", "low", "mid", "high")
    found: dict[str, set[str]] = {}
    for planned in plan_suite(suite):
        cell = planned.cell
        if cell.sequence.partition("[")[0] == sequence:
            assert cell.steps >= 1000
            assert cell.route == find_solver_record(cell.solver).default_route
            names = (cell.settings, *planned.alias_settings)
            found.setdefault(cell.solver, set()).update(names)
    assert {"daqp", "osqp", "piqp", "quadprog"} <= set(found)
    for solver, names in found.items():
        assert names == set(levels) & set(list_preset_names(solver))
    assert any(not has_distinct_tolerance_presets(solver) for solver in found)


STOLEN = {"replay_s": 1.0, "steal_s": 0.1}
"""The host of the virtual machine took 10 % of the time."""


@pytest.mark.parametrize(
    ("median_us", "state", "finding"),
    [
        (19.0, {}, "faster"),
        (19.0, STOLEN, "machine disturbed"),
        (21.0, STOLEN, "machine disturbed"),
        (15.0, STOLEN, "faster"),
        (27.0, STOLEN, "slower"),
        (20.0, STOLEN, "tied"),
        (10.0, STOLEN | {"rounds": 1}, "machine disturbed"),
    ],
)
def test_rounds_of_a_disturbed_machine_bound_what_is_a_finding(
    records: Any, median_us: float, state: dict[str, float], finding: str
) -> None:
    """The slower rounds take 1.155 times as long as the fastest, by the median of 1.01 to 1.3."""
    records.replay("osqp", median_us=20.0, spread=0.1, **state)
    records.replay("osqp", median_us=median_us, settings="high", spread=0.1)
    (found,) = compare_settings_of_solvers(records.view())
    assert found.finding_text == finding
    if finding == "machine disturbed":
        assert ": no ranking, as the machine was disturbed and " in describe_paired_times([found])


def test_the_state_of_a_command_holds_for_each_of_its_replays(records: Any) -> None:
    records.replay("osqp", median_us=20.0, spread=0.1)
    records.replay("osqp", median_us=19.0, settings="high", spread=0.1)
    records.replay("daqp", **STOLEN)
    (found,) = compare_settings_of_solvers(records.view())
    assert found.finding_text == "machine disturbed"
