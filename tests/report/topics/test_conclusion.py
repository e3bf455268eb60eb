"""The conclusion for an operator whose controller commands thrusters: no more than the runs
support."""

import json
from pathlib import Path
from typing import Any

import pytest

from dpbench.report.report import Report
from dpbench.report.topics.thrusters import build_conclusion_topic
from dpbench.report.write import write_report

WARM = {"route": "native", "policy": "warm"}


def campaign(records: Any, solvers: dict[str, tuple[float, float]], *, forces: bool = True) -> Any:
    """Loops and replays by solver, with the median [µs] with thrusters and the largest error."""
    for solver, (median_us, error) in solvers.items():
        for name in ("thrusters", "thrusters_loss"):
            records.loop(solver, name, steps=500, error=error, tail_m=0.275, **WARM)
        records.replay(solver, "thrusters", error=error, median_us=median_us, **WARM)
        if forces:
            records.loop(solver, "three_forces", **WARM)
            records.replay(solver, "three_forces", median_us=9.0, **WARM)
    return records


def output(records: Any) -> tuple[str, ...]:
    """The lines of the topic; none where there is none."""
    report = Report.from_results(records.results())
    topic = build_conclusion_topic(report.data.records, report.data.verdicts)
    assert topic is None or report.topics[0].id == "conclusion"
    return () if topic is None else topic.lines


def test_solvers_that_do_for_three_forces_only_are_named_with_their_fault(records: Any) -> None:
    solvers = {"daqp": (40.0, 1e-9), "piqp": (4000.0, 1e-9), "osqp": (60.0, 0.3)}
    first, second = output(campaign(records, solvers))
    assert first.startswith(
        "For commanded thrusters use daqp (native warm, default): its longest step, step "
    )
    assert first.endswith(
        "3 solvers pass with three forces (three_forces); 2 of them fail with "
        "thrusters: piqp, too late; osqp, wrong."
    )
    assert second == (
        "After the loss of board A (thrusters_loss), the ship with this solver stays within 0.28 m."
    )


def test_a_solver_that_ran_alone_is_not_chosen(records: Any) -> None:
    """Two call modes of one solver are no comparison with another."""
    solvers = {"daqp": (40.0, 1e-9)}
    first, _ = output(campaign(records, solvers, forces=False))
    assert first.startswith(
        "With commanded thrusters daqp (native warm) passes; only daqp was run: its longest step"
    )
    for name in ("thrusters", "thrusters_loss"):
        records.loop("daqp", name, steps=500)
    sentence = Report.from_results(records.results()).recommendation.sentence
    assert sentence.startswith(
        "Only `daqp` was run, in 2 configurations: no other solver is compared. Use `daqp`"
    )


def test_no_solver_is_to_be_used_for_a_ship_that_is_not_held(records: Any, tmp_path: Path) -> None:
    campaign(records, {"daqp": (40.0, 1e-9), "piqp": (4000.0, 1e-9)}, forces=False)
    records.loop("daqp", "paper", exact_left_s=40.0, exact_offset_max_m=9.0, **WARM)
    first, *_ = output(records)
    assert first.startswith(
        "As a solver of these QPs alone, daqp (native warm, default) passes with commanded "
        "thrusters: its longest step, step "
    )
    report = Report.from_results(records.results())
    assert report.recommendation.ship.warning and dict(report.summary_rows())["answer"] == first
    page = write_report(records.write(tmp_path / "out")).read_text(encoding="utf-8")
    assert '<p class="lead">As a solver of these QPs alone, daqp' in page and "use daqp" not in page


def test_without_runs_of_three_forces_nothing_is_said_of_them(records: Any) -> None:
    solvers = {"daqp": (40.0, 1e-9), "piqp": (4000.0, 1e-9)}
    first, _ = output(campaign(records, solvers, forces=False))
    assert "three forces" not in first
    assert first.endswith(" % of the sample time.") and "piqp" not in first


def test_a_ship_that_drifts_off_after_a_loss_is_said_to(records: Any) -> None:
    """Switchboard A is lost at 90 s; 500 samples of 0.3 s end 60 s later."""
    for name in ("thrusters", "thrusters_loss"):
        records.loop("daqp", name, steps=500, tail_m=28.4, station_radius_m=5.0, **WARM)
    records.replay("daqp", "thrusters", **WARM)
    _, second = output(records)
    assert second == (
        "After the loss of board A (thrusters_loss), the ship with this solver drifts away: its "
        "offset, at the start of each step, reaches 28.4 m within 60 s of the loss."
    )


def test_the_used_share_of_the_thrust_that_is_left_is_stated(records: Any) -> None:
    """The largest of the window and its mean, as recorded of the reference loop."""
    use = {"window_s": [90.0, 180.0], "thrust": [0.302, 0.476], "thrusters": {"bow": [1, 1, 1, 0]}}
    for name in ("thrusters", "thrusters_loss"):
        stored = json.dumps(use) if name == "thrusters_loss" else ""
        records.loop("daqp", name, steps=600, tail_m=0.25, exact_thruster_use=stored, **WARM)
    records.replay("daqp", "thrusters", **WARM)
    _, second = output(records)
    assert second == (
        "After the loss of board A (thrusters_loss), the ship with this solver stays within "
        "0.25 m. It uses 48 % of the remaining thrust at most, 30 % on average."
    )


def test_where_nobody_qualifies_nobody_is_named(records: Any) -> None:
    (first,) = output(campaign(records, {"osqp": (60.0, 0.3)}))
    assert first.startswith(
        "No solver can be recommended for a controller that commands thrusters."
    )
    assert first.endswith("with three forces (three_forces); it fails with thrusters: osqp, wrong.")


def test_a_loss_beyond_what_was_run_is_not_spoken_of(records: Any) -> None:
    """The scenario loses a switchboard at 90 s, and the loop ends before."""
    for name in ("thrusters", "thrusters_loss"):
        records.loop("daqp", name, steps=200, **WARM)
    records.replay("daqp", "thrusters", **WARM)
    (only,) = output(records)
    assert "loss" not in only


@pytest.mark.parametrize("scenarios", [("paper",), ("paper", "rough", "thrusters")])
def test_a_suite_about_other_things_says_nothing(records: Any, scenarios: tuple[str, ...]) -> None:
    for name in scenarios:
        records.loop("daqp", name, **WARM)
    records.replay("daqp", scenarios[-1], **WARM)
    assert output(records) == ()


def test_times_for_thrusters_are_those_of_thruster_qps(records: Any) -> None:
    """Though the QPs of three forces take longer here."""
    for name in ("thrusters", "thrusters_loss"):
        records.loop("daqp", name, steps=500, tail_m=0.275, **WARM)
    records.replay("daqp", "thrusters", median_us=40.0, **WARM)
    records.loop("daqp", "three_forces", **WARM)
    records.replay("daqp", "three_forces", median_us=90.0, **WARM)
    first, *_ = output(records)
    assert " of the replay of thrusters, takes " in first
    recommendation = Report.from_results(records.results()).recommendation
    assert "in the replay of `thrusters`." in recommendation.sentence
    assert " With commanded thrusters, its limiting p99 is " in recommendation.sentence
    margin = dict(recommendation.notes)["margin"]
    assert margin.startswith("With commanded thrusters, the ship's computer may be up to ")
    assert " over all replays); " in margin and "The longest step is step " in margin
    assert "three_forces" not in margin
