"""Claims of solvers on a batch: right, wrong or none, and their order."""

import json
import operator
import re
from dataclasses import replace
from typing import Any

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.capability import (
    Answers,
    CapabilityResult,
    build_capability_results,
    count_answers_by_run,
)
from dpbench.bench.capability.frontier import CapabilityPlot, compute_capability
from dpbench.bench.record.result_folder import Results
from dpbench.bench.record.schema import convert_to_run_columns, convert_to_step_columns
from dpbench.report.documents import statement
from dpbench.report.ship import capability_text
from dpbench.report.ship.capability_text import describe_capability, describe_worst_loss
from dpbench.report.topics.capability import build_capability_topic
from tests.result_folder import StepsInMemory

TRUE = {"true": True, "true_1e4": True, "true_1e6": True}
REFUSED = {"status": "PRIMAL_INFEASIBLE", "claimed": False}
EMPTY = {"certificate": "infeasible"}
SILENT = {"status": "UNKNOWN", "claimed": False}
NOBODY = convert_to_run_columns(pd.DataFrame({"run_id": pd.Series([], dtype="str")}))


def results_of(records: Any, said: dict[str, list[dict[str, Any]]]) -> Results:
    """Replays of four QPs by solver, each answer a step of 1, 2, 3 and 4 µs."""
    usual: dict[str, Any] = {"status": "SOLVED", "claimed": True, "certificate": "linear"}
    usual |= {"counts": True, "primal": 0.0, "error_plan": 0.0}
    usual |= {"true": False, "true_1e4": False, "true_1e6": False}
    rows = []
    for solver, answers in said.items():
        records.replay(solver, steps=4, rounds=1, steps_planned=4, steps_done=len(answers))
        run_id = records.results().runs["run_id"].iloc[-1]
        rows += [
            {"run_id": run_id, "k": k, "total_ns": 1000 * (k + 1)} | usual | answer
            for k, answer in enumerate(answers)
        ]
    return Results(
        records.results().runs, StepsInMemory(convert_to_step_columns(pd.DataFrame(rows))), {}, {}
    )


def asked(results: Results) -> list[Answers]:
    """The answers of all runs."""
    records = Records(results)
    return count_answers_by_run(records, records.runs)


def test_claims_are_held_against_certificates(records: Any) -> None:
    held, refused = TRUE, TRUE | REFUSED | EMPTY
    results = results_of(
        records,
        {
            "osqp": [held, REFUSED, refused, EMPTY],
            "daqp": [held, held, SILENT | EMPTY, SILENT | EMPTY],
            "quadprog": [held, held, refused, refused],
        },
    )
    answers = asked(results)
    assert [a.solver for a in answers] == ["quadprog", "daqp", "osqp"]
    counts = {a.solver: (a.balanced, a.refused, a.wrong, a.right_count) for a in answers}
    assert counts == {"quadprog": (2, 2, 0, 4), "daqp": (2, 0, 0, 2), "osqp": (1, 1, 2, 2)}
    assert {(a.asked, a.feasible, a.infeasible) for a in answers} == {(4, 2, 2)}
    assert (answers[0].p50_ns, answers[0].max_ns) == (2500.0, 4000.0)


def test_who_was_stopped_is_judged_on_what_it_was_given(records: Any) -> None:
    (answer,) = asked(results_of(records, {"osqp": [TRUE]}))
    assert (answer.asked, answer.feasible, answer.infeasible, answer.balanced) == (4, 1, 0, 1)


def edge_runs(records: Any) -> Records:
    """Two solvers at the edge of one ship; one claims of the third QP what is not true."""
    name = "osv capability, 8 sides"
    source = {"kind": "capability", "name": name, "vessel_name": "osv", "sides": 8}
    cell = {"sequence": name, "cell": json.dumps({"scenario": {}, "source": source})}
    results = results_of(
        records,
        {
            "quadprog": [TRUE, TRUE, TRUE | REFUSED | EMPTY, TRUE | REFUSED | EMPTY],
            "osqp": [TRUE, TRUE, EMPTY, SILENT | EMPTY],
        },
    )
    return Records(replace(results, runs=results.runs.assign(**cell)))


def plot_table() -> pd.DataFrame:
    """Two directions of two QPs."""
    return pd.DataFrame(
        {
            "sequence": "osv capability, 8 sides",
            "k": range(4),
            "vessel": "osv",
            "sides": 8,
            "case": "intact",
            "lost": "",
            "from_deg": [0.0, 0.0, 90.0, 90.0],
            "edge_mps": [20.0, 20.0, 12.0, 12.0],
            "number": [8, 8, 6, 6],
        }
    )


def test_an_untrue_claim_is_found_on_the_plot(records: Any) -> None:
    """From 90°, by one solver; the other is right everywhere."""
    (plot,) = build_capability_results(edge_runs(records), plot_table())
    assert plot.edges["untrue"].tolist() == [0, 1]
    assert plot.edges["wind_mps"].tolist() == [20.0, 12.0]
    assert {a.solver: (a.right_count, a.wrong, a.unanswered_count) for a in plot.answers} == {
        "quadprog": (4, 0, 0),
        "osqp": (2, 1, 1),
    }


def test_the_notation_is_that_of_the_plot_and_none_of_a_plot_with_gaps(records: Any) -> None:
    """8 intact but from 90°, 5 without board A but from 20°."""
    rows = [
        (case, from_deg, 3 if from_deg == least else number)
        for case, number, least in (("intact", 8, 90), ("board A", 5, 20))
        for from_deg in range(0, 360, 10)
    ]
    table = pd.DataFrame(rows, columns=["case", "from_deg", "number"])
    table = table.assign(k=range(72), sequence="plot", vessel="osv", sides=8, lost="", edge_mps=9.0)
    (plot,) = build_capability_results(records.view(), table)
    assert plot.capability_numbers_text == "DP capability-L1(8, 3, 3, 3)"
    (gaps,) = build_capability_results(records.view(), table[table["from_deg"] > 0])
    assert gaps.capability_numbers_text == ""


def test_a_loss_after_which_nothing_is_held_is_so_from_every_direction(records: Any) -> None:
    rows = [
        (case, from_deg, mps)
        for case, mps in (("intact", 9.0), ("board A", 0.0), ("board B", 5.0))
        for from_deg in (0.0, 90.0)
    ]
    table = pd.DataFrame(rows, columns=["case", "from_deg", "edge_mps"])
    table = table.assign(k=range(6), sequence="plot", vessel="osv", sides=8, lost="", number=1)
    (plot,) = build_capability_results(records.view(), table)
    said = "9.0 m/s of wind from every direction; after the loss of board A no wind ("
    assert said in " ".join(describe_capability(records.view(), plot))


def test_the_worst_loss_is_named_with_the_least_wind_held_after_it(records: Any) -> None:
    """Board A, by one direction of it alone; "" where no loss is in the plot."""
    rows = [("intact", 2.0, 0.0), ("board A", 9.0, 0.0), ("board A", 3.0, 90.0)]
    rows += [("board B", 5.0, from_deg) for from_deg in (0.0, 90.0)]
    edges = pd.DataFrame(rows, columns=["case", "wind_mps", "from_deg"])
    said = "After the worst loss, of board A, osv holds 3.0 m/s of wind in its weakest direction, "
    plot, view = CapabilityResult("osv", 8, edges, ()), records.view()
    assert describe_worst_loss(view, plot) == f"{said}from 90° (level 1)."
    assert describe_worst_loss(view, CapabilityResult("osv", 8, edges[:1], ())) == ""


def test_of_equal_winds_the_starboard_direction_is_named(records: Any) -> None:
    """As by `dpbench init`; the search of an edge leaves differences below 1 mm/s."""
    rows = [("intact", 9.0, 0.0), ("board A", 3.00004, 70.0), ("board A", 3.00001, 290.0)]
    edges = pd.DataFrame(rows, columns=["case", "wind_mps", "from_deg"])
    said = describe_worst_loss(records.view(), CapabilityResult("osv", 8, edges, ()))
    assert "3.0 m/s of wind in its weakest direction, from 70°" in said


def test_a_plot_says_that_it_has_more_directions_than_controllers_plan_with(records: Any) -> None:
    """`ratownik` with an azimuth barred for 60°, 240° in all, of which 180° are planned with."""
    records.loop("daqp", "thrusters")
    view = records.view()
    plain = view.build_scenario("thrusters")
    every = plain.vessel.thrusters
    wide = replace(every.thrusters[0], sector_rad=(-2.0, 2.0))
    barred = replace(every, thrusters=(wide, *every.thrusters[1:]))
    rows = [("intact", 20.0, 0.0, 7), ("board A", 9.0, 0.0, 4)]
    edges = pd.DataFrame(rows, columns=["case", "wind_mps", "from_deg", "number"])
    plot = CapabilityResult(plain.vessel.id, 8, edges, ())
    said = "in all directions outside their barred zones"
    assert said not in " ".join(describe_capability(view, plot)) + describe_worst_loss(view, plot)
    view._scenarios["thrusters"] = replace(plain, vessel=replace(plain.vessel, thrusters=barred))
    assert said in " ".join(describe_capability(view, plot))
    assert said in describe_worst_loss(view, plot)
    # The half turns of one azimuth hold no more than all of its directions.
    planned = capability_text._compute_planned_numbers(view, plain.vessel.id)
    free = compute_capability(CapabilityPlot(view._scenarios["thrusters"].vessel)).notation
    numbers = [[int(one) for one in re.findall(r"\d+", text)[1:]] for text in (planned, free)]
    assert len(numbers[0]) == 4 and all(map(operator.le, *numbers))


def test_the_topic_says_what_is_held_and_who_knows(records: Any) -> None:
    runs = edge_runs(records)
    topic = build_capability_topic(runs, plot_table())
    assert topic.lines == (
        "Intact, osv holds 12.0 m/s of wind in its weakest direction, from 90° (DNV-ST-0111, level "
        "1; azimuths as polygons of 8 sides). 1 of 2 solvers answers all 4 QPs at the edge of the "
        "plot correctly: quadprog. "
        "False claims: osqp (1). No answer (given up or out of time): osqp (1).",
    )
    assert len(topic.figures) == 2
    (line,) = statement._describe_held(runs, build_capability_results(runs, plot_table()), [])
    assert line.endswith(
        "1 of 2 solvers answers all 4 QPs at the edge of the plot correctly: quadprog."
    )
    without_plot = build_capability_topic(runs, None)
    assert without_plot.lines[0].startswith("1 of 2 solvers") and len(without_plot.figures) == 1
    without_runs = build_capability_topic(
        Records(replace(records.results(), runs=NOBODY)), plot_table()
    )
    assert without_runs.lines[0].endswith("sides).") and len(without_runs.figures) == 1


def test_runs_at_an_edge_are_no_part_of_a_verdict(records: Any) -> None:
    runs = edge_runs(records)
    assert runs.runs == [] and len(runs.at_edge) == 2
    assert build_capability_topic(Records(replace(records.results(), runs=NOBODY)), None) is None
