"""Topics on replays: formulations side by side, and the quality of measurements."""

from pathlib import Path
from typing import Any

import pytest

from dpbench import load_results, run_campaign
from dpbench.analysis.times.contrasts import compare_routes
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.verdict import Verdict, judge_solvers
from dpbench.cli.main import main
from dpbench.report.formats import Table
from dpbench.report.report import Report
from dpbench.report.topics.replays import build_formulations_topic, build_levels_topic
from dpbench.report.topics.trust import build_trust_topic

REQUIREMENTS = Requirements()


def _figures(verdict: Verdict) -> tuple[object, ...]:
    return verdict.configuration, verdict.state, verdict.p99_ns, verdict.steps, verdict.causes


def _rows(table: Table) -> dict[str, dict[str, str]]:
    return {row[0]: dict(zip(table.heads[1:], row[1:], strict=True)) for row in table.rows}


def test_the_forms_stand_side_by_side(records: Any) -> None:
    """Medians of 1000 steps without spread; a form with wrong answers says so, one that was not
    run is a dash, and one that was refused a word."""
    exact = {"spread": 0.0}
    records.replay("osqp", median_us=80.0, **exact)
    records.replay("osqp", median_us=40.0, formulation="sparse", **exact)
    records.replay("osqp", median_us=20.0, formulation="condensed_stacked", error=0.5, **exact)
    records.replay("daqp", median_us=10.0, **exact)
    records.refused("daqp", "P is only semidefinite", "replay", formulation="sparse")
    topic = build_formulations_topic(records.view(), REQUIREMENTS)
    (table,) = topic.tables
    assert _rows(table) == {
        "osqp (qpsolvers fresh)": {
            "condensed_box": "80.0 µs",
            "sparse": "40.0 µs",
            "condensed_stacked": "20.0 µs (inaccurate)",
        },
        "daqp (qpsolvers fresh)": {
            "condensed_box": "10.0 µs",
            "sparse": "refused",
            "condensed_stacked": "–",
        },
    }


def test_route_settings_and_units_are_told_apart(records: Any) -> None:
    for units in ("scaled", "si"):
        for route, median in (("qpsolvers", 50.0), ("native", 40.0)):
            configuration = {"route": route, "units": units, "spread": 0.0}
            records.replay("piqp", median_us=median, **configuration)
            records.replay("piqp", median_us=90.0, formulation="sparse", **configuration)
    topic = build_formulations_topic(records.view(), REQUIREMENTS)
    scaled, si = topic.tables
    assert [cells["condensed_box"] for cells in _rows(scaled).values()] == ["50.0 µs", "40.0 µs"]
    assert len(si.rows) == 2 and si.title == "paper (SI units)"


def test_without_a_second_form_there_is_nothing_to_say(records: Any) -> None:
    records.replay("daqp")
    records.replay("daqp", sequence="rough", formulation="sparse")
    view = records.view()
    assert build_formulations_topic(view, REQUIREMENTS) is None
    # The only formulation of a sequence is its common one.
    assert [run.formulation for run in view.select_replays("rough")] == ["sparse"]


def test_rankings_and_verdicts_keep_to_the_common_formulation(records: Any) -> None:
    records.replay("osqp", median_us=80.0, route="native", policy="reuse")
    records.replay("osqp", median_us=90.0, route="native", policy="fresh")
    records.loop("osqp", route="native")
    before = records.view()
    expected = (
        [_figures(v) for v in judge_solvers(before, REQUIREMENTS).all_verdicts],
        compare_routes(before, "paper"),
        [run.run_id for run in before.select_replays("paper")],
    )
    configuration = {"route": "native", "formulation": "sparse", "error": 0.7}
    records.replay("osqp", median_us=5.0, policy="reuse", **configuration)
    records.replay("osqp", median_us=5.0, policy="fresh", **configuration)
    records.loop("osqp", failed=9, **configuration)
    after = records.view()
    found = (
        [_figures(v) for v in judge_solvers(after, REQUIREMENTS).all_verdicts],
        compare_routes(after, "paper"),
        [run.run_id for run in after.select_replays("paper")],
    )
    assert found == expected
    assert len(after.all_runs) == len(before.all_runs) + 3


@pytest.mark.slow
def test_a_replay_without_a_feasible_step_is_answered_by_who_reports_that(tmp_path: Path) -> None:
    """The 102nd QP of the sequence, at 121 s, has no feasible point (quadprog: inconsistent)."""
    path = tmp_path / "never.npz"
    assert main(["export", "thruster_loss_hard-30-5", "--at", "101", "--out", str(path)]) == 0
    levels = ["default", "mid"]
    folder = run_campaign(
        sequence=path, out=tmp_path / "never", solvers=["quadprog"], settings=levels
    )
    ending = dict(Report.from_results(load_results(folder)).summary_rows())
    assert ending["answer"] == (
        "No step has a feasible point. Reported correctly on every step with default settings: "
        "quadprog."
    )
    assert "Nothing is recommended, because no step has a feasible point." in ending["solver"]


def test_repeated_rounds_of_a_quiet_machine_are_counted(records: Any) -> None:
    records.replay("daqp", replay_s=9.0, rerun_rounds=2, involuntary_switches=0, steal_s=0.0)
    topic = build_trust_topic(records.view())
    (quiet,) = (
        line for line in topic.lines if line.startswith("Over all replays, the machine was quiet: ")
    )
    assert (
        "Over all replays, the machine was quiet: 2 of 3 rounds were repeated because "
        "other load disturbed them, and "
        "none remained disturbed (0 %, limit 5 %)." in quiet
    )


def test_a_wait_is_said_by_its_largest_replay(records: Any) -> None:
    for sequence, median_us in (("calm", 50.1), ("paper", 52.0), ("rough", 50.2)):
        records.replay("busy_wait_50us", sequence, median_us=median_us, replay_s=1.0)
    topic = build_trust_topic(records.view())
    (waits,) = (
        line for line in topic.lines if line.startswith("1 of 1 wait of known length had an error")
    )
    assert "50 µs measured as 52.00 µs. Absolute times" in waits
    assert "may be wrong by 4.0 % near 50 µs" in waits
    assert "busy_wait_50us 52.0 µs" in records.ending()["timing"]


def test_accurate_first_moves_without_verified_solutions_are_named(records: Any) -> None:
    """49 of 600 solutions have a residual above its limit, with first moves below theirs."""
    for settings in ("default", "high"):
        records.replay("daqp", steps=600, settings=settings)
    records.replay("osqp", steps=600, error=5e-3, claimed_not_true=3 * 49)
    topic = build_levels_topic(records.view(), REQUIREMENTS)
    assert topic.lines[0] == (
        "First moves accurate on every step with default settings: daqp and osqp. "
        "Solutions not verified: osqp at default in 49 of 600 steps."
    )


def test_solvers_without_a_run_at_default_are_not_named_as_failing_there(records: Any) -> None:
    records.replay("daqp", settings="high")
    records.replay("osqp", settings="high", error=0.5)
    records.replay("osqp", settings="polished")
    topic = build_levels_topic(records.view(), REQUIREMENTS)
    assert topic.lines[0] == (
        "Accurate on every step with their own settings (default not run): daqp at high, "
        "osqp at polished."
    )
    records.replay("scs", error=0.5)
    records.replay("scs", settings="high")
    topic = build_levels_topic(records.view(), REQUIREMENTS)
    assert topic.lines[0] == (
        "Accurate on every step with default settings: no solver; with other settings only: scs "
        "at high; with their own settings (default not run): daqp at high, osqp at polished."
    )
