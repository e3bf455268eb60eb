"""Consequence analysis: answers counted by hand, times of a batch, and what the topic says."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.capability import (
    HELD,
    LOST,
    UNKNOWN,
    Answers,
    CapabilityResult,
    build_consequence_analyses,
)
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.ship_results import find_ship_results
from dpbench.analysis.verdict.verdict import judge_solvers
from dpbench.bench.record.result_folder import Results
from dpbench.bench.record.schema import convert_to_step_columns
from dpbench.report.ship import capability_text
from dpbench.report.ship.capability_text import (
    count_answering,
    describe_consequence_solver,
    describe_losses_held,
    describe_unanswered_qps,
)
from dpbench.report.ship.open_losses import find_open_losses
from dpbench.report.topics.capability import build_consequence_topic
from dpbench.report.topics.thrusters import build_conclusion_topic
from tests.result_folder import StepsInMemory

TRUE = {"true": True, "true_1e4": True, "true_1e6": True}
REFUSED = TRUE | {"status": "PRIMAL_INFEASIBLE", "claimed": False}
SILENT = {"status": "MAX_ITERATIONS", "claimed": False}
DENIED = {"status": "PRIMAL_INFEASIBLE", "claimed": False}
CERTIFICATES = {"board A": ["linear"] * 4, "board B": ["gap", "gap", "infeasible", "infeasible"]}
"""Claims at four samples; the loss of board B can be held at two."""


def view(
    records: Any,
    said: dict[str, dict[str, list[list[dict[str, Any]]]]],
    files: dict[str, Any] | None = None,
    **columns: Any,
) -> Records:
    """Replays of four samples by solver and group: of each round the answers, 1 µs times k + 1."""
    files = files or records.scenario("thrusters_loss").files
    rows = []
    for solver, by_group in said.items():
        for group, rounds in by_group.items():
            source = {
                "kind": "consequence",
                "name": f"thrusters_loss[2:6], {group} lost",
                "group": group,
            }
            records.replay(
                solver,
                source["name"],
                steps=4,
                scenario="thrusters_loss",
                cell=json.dumps({"scenario": files, "source": source}),
                steps_done=max(map(len, rounds)),
                **columns,
            )
            run_id = records.results().runs["run_id"].iloc[-1]
            rows += [
                {
                    "run_id": run_id,
                    "repeat": r,
                    "counts": r > 0,
                    "k": k,
                    "t_s": 0.3 * k,
                    "total_ns": 1000 * (k + 1) * r,
                    "status": "SOLVED",
                    "claimed": True,
                    "true": False,
                    "certificate": CERTIFICATES[group][k],
                    **answer,
                }
                for r, answers in enumerate(rounds, 1)
                for k, answer in enumerate(answers)
            ]
    return Records(
        Results(
            records.results().runs,
            StepsInMemory(convert_to_step_columns(pd.DataFrame(rows))),
            {},
            {},
        )
    )


@pytest.fixture
def storm(records: Any) -> Records:
    """A solver that is right, one that misses alarms, and one that stops within board B."""
    good, held = [TRUE, TRUE, REFUSED, REFUSED], [TRUE] * 4
    # In its second round it misses an alarm, has one for nothing, is inexact and silent.
    bad = [DENIED, {}, {}, SILENT]
    return view(
        records,
        {
            "quadprog": {"board A": [held, held], "board B": [good, good]},
            "osqp": {"board A": [held, held], "board B": [good, bad]},
            "daqp": {"board A": [held, held], "board B": [good[:3]]},
        },
    )


def test_each_qp_counts_once_by_its_worst_round(storm: Records) -> None:
    (analysis,) = build_consequence_analyses(storm)
    assert (analysis.name, analysis.groups) == ("thrusters_loss[2:6]", ("board A", "board B"))
    found = {a.solver: a for a in analysis.answers}
    assert list(found) == ["quadprog", "daqp", "osqp"]
    counts = {
        solver: (a.asked, a.feasible, a.infeasible, a.held, a.refused, a.missed, a.untrue)
        for solver, a in found.items()
    }
    assert counts == {
        "quadprog": (8, 6, 2, 6, 2, 0, 0),
        "daqp": (8, 6, 1, 6, 1, 0, 0),
        "osqp": (8, 6, 2, 4, 0, 1, 3),
    }
    assert [a.has_only_right_answers for a in analysis.answers] == [True, False, False]


def test_a_batch_takes_what_its_groups_take_together(storm: Records) -> None:
    """At the fourth sample 4 µs a group, of 0.3 s; four samples have no p99, a gap no time."""
    (analysis,) = build_consequence_analyses(storm)
    found = {a.solver: a for a in analysis.answers}
    assert found["quadprog"].largest == pytest.approx(8e-6 / 0.3)
    assert pd.isna(found["quadprog"].p99) and pd.isna(found["daqp"].largest)


def test_spans_join_what_is_proven_alike(storm: Records) -> None:
    """Board A throughout, board B until 0.6 s."""
    (analysis,) = build_consequence_analyses(storm)
    spans = [tuple(row) for row in analysis.spans.round(9).itertuples(index=False)]
    wanted = [
        ("board A", 0.0, 1.2, HELD, 0),
        ("board B", 0.0, 0.6, HELD, 0),
        ("board B", 0.6, 1.2, LOST, 0),
    ]
    assert spans == wanted


@pytest.mark.parametrize(
    ("certificates", "said"),
    [
        (["linear"] * 4, "throughout"),
        (["infeasible"] * 4, "at no time"),
        (["linear", "infeasible", "infeasible", "infeasible"], "at no time"),
        (
            ["linear", "linear", "infeasible", "infeasible"],
            "until 1 s, after which the remaining thrusters cannot produce the required force",
        ),
        (["infeasible", "gap", "linear", "gap"], "from 0 s on"),
        (["linear", "infeasible", "linear", "infeasible"], "in 50 % of the time"),
        (["linear", "undecided", "linear", "linear"], "in 75 % of the time"),
    ],
)
def test_the_topic_says_when_a_loss_can_be_held(
    records: Any, monkeypatch: pytest.MonkeyPatch, certificates: list[str], said: str
) -> None:
    monkeypatch.setitem(CERTIFICATES, "board A", certificates)
    answers = [REFUSED if kind == "infeasible" else TRUE for kind in certificates]
    topic = build_consequence_topic(view(records, {"quadprog": {"board A": [answers]}}))
    margin = "(required force: filtered over 60 s, times a dynamic margin of "
    assert f"the loss of board A can be held {said} {margin}" in topic.lines[0]


def test_the_topic_names_who_misses_alarms(storm: Records) -> None:
    topic = build_consequence_topic(storm)
    assert (
        "1 of 3 configurations answers all QPs correctly; the fastest, quadprog" in topic.lines[0]
    )
    said = "missed alarms: osqp (1); no answer to some QPs: daqp (1) and osqp (1)."
    assert topic.lines[0].endswith(said)
    assert [figure.name for figure in topic.figures] == [
        "consequence-thrusters_loss-2-6",
        "consequence-time-thrusters_loss-2-6",
    ]
    (table,) = topic.tables
    assert table.rows[-1] == ("osqp", "–", "0.0027 %", "4 of 6", "0 of 2", "1", "2", "1", "0 of 1")


def test_the_conclusion_calls_the_losses_that_could_be_held_static(records: Any) -> None:
    """At the last of the four samples, 1.2 s after the start, board B cannot be lost."""
    records.loop("quadprog", "thrusters_loss", steps=500)
    last = [TRUE, TRUE, REFUSED, REFUSED]
    found = view(records, {"quadprog": {"board A": [[TRUE] * 4], "board B": [last]}})
    topic = build_conclusion_topic(found, judge_solvers(found, Requirements()))
    assert topic is not None
    assert (
        "In the static consequence analysis, at 1 s of thrusters_loss 1 of 2 losses could be held. "
        "quadprog finds this at every sample in at most "
    ) in topic.lines[-1]


@pytest.mark.parametrize(
    ("right", "count", "said"),
    [
        (0, 1, "0 of 1 solver answers"),
        (1, 1, "1 of 1 solver answers"),
        (0, 3, "0 of 3 solvers answer"),
        (1, 3, "1 of 3 solvers answers"),
    ],
)
def test_the_verb_of_a_count_of_solvers_is_singular_for_one(
    right: int, count: int, said: str
) -> None:
    assert count_answering(right, count, "solver") == said


def test_it_says_that_no_alarm_was_due(records: Any) -> None:
    """No solver misses an alarm if every QP is feasible."""
    topic = build_consequence_topic(view(records, {"quadprog": {"board A": [[TRUE] * 4]}}))
    assert topic.lines[0].endswith(
        "no alarm was due, as every QP that a solver reached is feasible."
    )
    assert "misses" not in topic.lines[0]


@pytest.mark.parametrize(
    ("left_s", "others_left_s", "at"),
    [(1.1, 99.0, "1.10"), (np.nan, 1.0, "1.00"), (np.nan, 80.0, ""), (np.nan, np.nan, "")],
)
def test_it_says_that_the_ship_of_the_loop_was_not_held(
    records: Any, left_s: float, others_left_s: float, at: str
) -> None:
    """By the end of the analysed steps, at 1.2 s; by the analysis or by another run."""
    records.loop("daqp", "thrusters_loss", steps=500, exact_left_s=others_left_s)
    of_board = {"quadprog": {"board A": [[TRUE] * 4]}}
    (analysis,) = build_consequence_analyses(view(records, of_board, exact_left_s=left_s))
    said = describe_losses_held(analysis)
    assert ("CAUTION: this analysis is of a ship that was not held" in said) == bool(at)
    if at:
        assert f"it leaves its station at {at} s." in said


STATIC = (
    "The analysis is static: it balances only the filtered mean force of the analysed steps, so "
    "the simulated ship may hold its station or leave it."
)


def _describe(records: Any, said: dict[str, Any], **columns: Any) -> str:
    (analysis,) = build_consequence_analyses(view(records, {"daqp": said}, **columns))
    return describe_losses_held(analysis)


def _cell_with_losses(records: Any, *losses: tuple[float, list[str]]) -> dict[str, Any]:
    """The documents of `thrusters_loss` with these losses of thrusters at these times."""
    files = records.scenario("thrusters_loss").files
    faults = [{"at_s": at_s, "lost": lost, "loss": "trip"} for at_s, lost in losses]
    return files | {"scenario": files["scenario"] | {"faults": faults}}


def test_it_names_simulated_losses_after_which_the_ship_leaves_its_station(records: Any) -> None:
    """Board A at 90 s; the analysed steps end at 1.2 s."""
    records.loop("quadprog", "thrusters_loss", steps=500, exact_left_s=100.0)
    found = view(records, {"quadprog": {"board A": [[TRUE] * 4]}})
    (analysis,) = build_consequence_analyses(found)
    caution = (
        "CAUTION: in closed loop the ship leaves its station after the loss of board A "
        "(`thrusters_loss`)."
    )
    assert describe_losses_held(analysis).endswith(f"{STATIC} {caution}")
    topic = build_conclusion_topic(found, judge_solvers(found, Requirements()))
    assert topic is not None and f"could be held. {caution}" in topic.lines[-1]


def test_it_says_that_it_is_static_where_the_ship_is_held(records: Any) -> None:
    records.loop("quadprog", "thrusters_loss", steps=500)
    assert _describe(records, {"board A": [[TRUE] * 4]}).endswith(STATIC)


def test_a_departure_after_two_losses_is_not_one_after_a_single_loss(records: Any) -> None:
    """Board A is lost at 50 s and board B at 90 s; the ship leaves its station after the second."""
    cell = _cell_with_losses(records, (90.0, ["board B"]), (50.0, ["board A"]))
    columns = {"steps": 500, "cell": json.dumps({"scenario": cell})}
    records.loop("daqp", "thrusters_loss", exact_left_s=95.0, **columns)
    assert _describe(records, {"board A": [[TRUE] * 4]}).endswith(STATIC)
    records.loop("daqp", "thrusters", exact_left_s=55.0, **columns)
    said = _describe(records, {"board A": [[TRUE] * 4]})
    assert said.endswith("leaves its station after the loss of board A (`thrusters`).")


def test_it_names_the_scenario_if_the_intact_ship_leaves_its_station_later(records: Any) -> None:
    records.loop("daqp", "thrusters_loss", steps=500, exact_left_s=50.0)
    said = _describe(records, {"board A": [[TRUE] * 4]})
    assert said.endswith("leaves its station without a loss (`thrusters_loss`).")


def test_it_names_a_mean_load_beyond_the_thrust(
    records: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dpbench.analysis.verdict.ship_results.find_overload", lambda _: 1.54)
    records.loop("daqp", "thrusters_loss", steps=100)
    assert _describe(records, {"board A": [[TRUE] * 4]}).endswith(
        f"{STATIC} CAUTION: the mean load needs 154 % of the thrust, so the ship does not hold its "
        "station, even without a loss."
    )


def test_a_loss_on_top_of_a_simulated_one_is_a_further_loss(records: Any) -> None:
    """Board A is lost at 0.6 s; board B could be lost before, and not after."""
    cell = _cell_with_losses(records, (0.6, ["board A"]))
    said = {"board A": [[TRUE] * 4], "board B": [[TRUE, TRUE, REFUSED, REFUSED]]}
    found = view(records, {"daqp": said}, files=cell)
    (analysis,) = build_consequence_analyses(found)
    assert [*analysis.spans.round(9).itertuples(index=False, name=None)] == [
        ("board A", 0.0, 0.6, HELD, 0),
        ("board B", 0.0, 0.6, HELD, 0),
        ("board B", 0.6, 1.2, LOST, 1),
    ]
    assert describe_losses_held(analysis).startswith(
        "In thrusters_loss[2:6] (steps 2 to 5, wind 13.8 m/s from 40°) before 0.6 s the loss of "
        "board A or of board B can be held throughout; after the loss of board A at 0.6 s, the "
        "further loss of board B can be held at no time (required force"
    )
    ships = find_ship_results(found)
    assert find_open_losses(found, ships, [], [analysis]).not_held == ()
    (figure, *_) = build_consequence_topic(found).figures
    assert '"board B after board A"' in json.dumps(figure.chart.to_dict())


def test_two_losses_at_once_are_no_single_loss(records: Any) -> None:
    """Boards A and B at 90 s, as two faults: the ship leaves its station after both."""
    cell = _cell_with_losses(records, (90.0, ["board A"]), (90.0, ["board B"]))
    columns = {"steps": 500, "cell": json.dumps({"scenario": cell})}
    records.loop("daqp", "thrusters_loss", exact_left_s=95.0, **columns)
    found = view(records, {"daqp": {"board A": [[TRUE] * 4]}})
    assert describe_losses_held(build_consequence_analyses(found)[0]).endswith(STATIC)
    analyses = build_consequence_analyses(found)
    losses = find_open_losses(found, find_ship_results(found), [], analyses)
    assert losses.not_simulated.startswith("Loss of board A: not simulated")


def test_a_loop_without_the_analysed_groups_has_no_further_losses(records: Any) -> None:
    cell = _cell_with_losses(records, (0.0, ["board A"]))
    found = view(records, {"daqp": {"board A": [[TRUE] * 4]}}, files=cell)
    assert (
        "the loop has lost all analysed groups before the"
        in build_consequence_topic(found).lines[0]
    )


def test_it_says_nothing_of_what_steers_the_ship(records: Any, storm: Records) -> None:
    assert not storm.runs and len(storm.consequence) == 6
    records.replay("daqp")
    assert [run.sequence for run in records.view().runs] == ["paper"]
    assert {run.lost_thruster_group for run in records.view().runs} == {""}
    assert UNKNOWN not in set(build_consequence_analyses(storm)[0].spans["state"])


def test_a_solver_that_misses_alarms_or_leaves_qps_unanswered_is_named(storm: Records) -> None:
    assert (
        describe_unanswered_qps(storm, "quadprog") == describe_unanswered_qps(storm, "piqp") == ""
    )
    left = "`daqp` leaves 1 of 8 QPs of the consequence analysis unanswered"
    assert describe_unanswered_qps(storm, "daqp") == left
    assert describe_unanswered_qps(storm, "osqp") == (
        "`osqp` misses 1 alarm of the consequence analysis and leaves 1 of 8 QPs of the "
        "consequence analysis unanswered where a loss cannot be held"
    )


def test_a_missed_alarm_alone_is_named(records: Any) -> None:
    """Reported as solved at both samples at which the loss cannot be held."""
    missed = view(records, {"daqp": {"board B": [[TRUE, TRUE, {}, {}]]}})
    said = "`daqp` misses 2 alarms of the consequence analysis"
    assert describe_unanswered_qps(missed, "daqp") == said


def test_a_solver_that_is_silent_where_a_loss_cannot_be_held_is_named(records: Any) -> None:
    silent = view(records, {"daqp": {"board B": [[TRUE, TRUE, SILENT, SILENT]]}})
    assert describe_unanswered_qps(silent, "daqp") == (
        "`daqp` leaves 2 of 4 QPs of the consequence analysis unanswered where a loss cannot be "
        "held"
    )


ALL_RIGHT = Answers("quadprog", "finished", 432, 216, 216, 216, 216, 0, 1.0, 2.0)


def test_another_solver_for_the_consequence_analysis_is_named_beside_that_of_the_mpc(
    storm: Records,
) -> None:
    """The fastest one that is right on all QPs; nothing where it is the same."""
    assert describe_consequence_solver(storm, "quadprog") == ""
    wanted = "MPC: osqp; consequence analysis: quadprog."
    assert describe_consequence_solver(storm, "osqp") == wanted


@pytest.mark.parametrize(("kind", "answer"), [("infeasible", REFUSED), ("linear", TRUE)])
def test_qps_that_are_all_alike_recommend_no_solver_for_the_analysis(
    records: Any, monkeypatch: pytest.MonkeyPatch, kind: str, answer: dict[str, Any]
) -> None:
    """A solver that always answers the same would be right on them, and not at the edge."""
    monkeypatch.setitem(CERTIFICATES, "board A", [kind] * 4)
    alike = view(records, {"daqp": {"board A": [[answer] * 4]}})
    word = "feasible" if kind == "linear" else kind
    who = "; correct on all of them: daqp" if kind == "linear" else ""
    wanted = f"MPC: daqp; consequence analysis: none named, as all its QPs are {word}{who}."
    assert describe_consequence_solver(alike, "daqp") == wanted
    at_edge = replace(ALL_RIGHT, solver="daqp")
    plot = CapabilityResult("osv", 8, pd.DataFrame(), (at_edge, replace(ALL_RIGHT, solver="osqp")))
    monkeypatch.setattr(capability_text, "build_capability_results", lambda *_: [plot])
    for solver in ("daqp", "osqp"):
        assert describe_consequence_solver(alike, solver) == (
            f"MPC: {solver}; consequence analysis: daqp (all QPs of the analysis are {word}, but "
            "not all at the edge of the capability plot)."
        )


def test_a_solver_that_leaves_qps_at_the_edge_unanswered_is_not_named(
    storm: Records, monkeypatch: pytest.MonkeyPatch
) -> None:
    """quadprog, right on the analysis, leaves 32 of 432 without an answer."""
    silent = replace(ALL_RIGHT, refused=184)
    plot = CapabilityResult("osv", 8, pd.DataFrame(), (silent,))
    monkeypatch.setattr(capability_text, "build_capability_results", lambda *_: [plot])
    none = "no solver that was run answers all its QPs and those at the edge of the capability plot"
    for solver in ("quadprog", "osqp"):
        wanted = f"MPC: {solver}; consequence analysis: {none} correctly."
        assert describe_consequence_solver(storm, solver) == wanted


def test_without_a_consequence_analysis_no_solver_for_it_is_named(records: Any) -> None:
    records.loop("daqp")
    assert describe_consequence_solver(records.view(), "daqp") == ""


def test_where_no_solver_is_right_on_all_qps_of_the_analysis_that_is_said(records: Any) -> None:
    silent = view(records, {"daqp": {"board B": [[TRUE, TRUE, SILENT, SILENT]]}})
    none = "no solver that was run answers all its QPs correctly"
    assert (
        describe_consequence_solver(silent, "daqp") == f"MPC: daqp; consequence analysis: {none}."
    )
