"""Random problems: what counts as what, and that nothing else counts them."""

import json
from dataclasses import asdict
from typing import Any

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.random_claims import RandomClaims
from dpbench.bench.record.result_folder import Results
from dpbench.bench.record.schema import convert_to_step_columns
from dpbench.qp.random_sequence import RandomRecipe
from dpbench.report.topics.random import build_random_topic
from tests.result_folder import StepsInMemory

INF, NAN = float("inf"), float("nan")
RECIPE = RandomRecipe("plain", 4, 6, 1)


def cell(recipe: RandomRecipe = RECIPE) -> dict[str, str]:
    """The columns that make a row one of a random sequence."""
    source = {"kind": "random", "name": recipe.sequence_name, "recipe": asdict(recipe)}
    return {"scenario": "", "cell": json.dumps({"source": source})}


def records_of(records: Any, *steps: dict[str, Any], **columns: Any) -> Records:
    """A view of one random configuration with these steps."""
    usual: dict[str, Any] = {"status": "SOLVED", "claimed": True, "certificate": "linear"}
    usual |= {"counts": True, "primal": 0.0}
    usual |= {"true": False, "true_1e4": False, "true_1e6": False, "error_plan": 0.0}
    count = {"steps": 1, "rounds": 1, "steps_planned": len(steps), "steps_done": len(steps)}
    records.replay("osqp", **(count | cell() | columns))
    results = records.results()
    run_id = results.runs["run_id"].iloc[-1]
    rows = [{"run_id": run_id, "k": k} | usual | step for k, step in enumerate(steps)]
    return Records(
        Results(results.runs, StepsInMemory(convert_to_step_columns(pd.DataFrame(rows))), {}, {})
    )


def test_each_step_counts_as_what_it_is(records: Any) -> None:
    true = {"true": True, "true_1e4": True, "true_1e6": True}
    view = records_of(
        records,
        true,
        true | {"true_1e6": False, "error_plan": 1e-4},
        {"error_plan": 0.5},
        {"error_plan": INF},
        {"error_plan": 1e-3, "primal": 1.0},
        {"error_plan": 1e-3, "dual": 1.0},
        {"error_plan": NAN, "certificate": "infeasible"},
        true | {"status": "MAX_ITERATIONS", "claimed": False},
        {"status": "NUMERICAL_ERROR", "claimed": False, "error_plan": INF},
        true | {"status": "PRIMAL_INFEASIBLE", "claimed": False, "certificate": "infeasible"},
        {"status": "DUAL_INFEASIBLE", "claimed": False, "error_plan": INF},
        {"certificate": "none", "error_plan": NAN},
        {"certificate": "undecided", "error_plan": NAN},
        true | {"status": "PRIMAL_INFEASIBLE", "claimed": False, "certificate": "undecided"},
        {"counts": False},
        steps_planned=20,
        steps_done=14,
    )
    tally = RandomClaims(view).sum_tallies_by_columns("solver")[("osqp",)]
    assert (tally.steps, tally.missed, tally.false_claims) == (11, 6, 5)
    assert (tally.right_claims, tally.not_claimed, tally.nothing) == (2, 1, 1)
    assert (tally.right_refusals, tally.wrong_refusals) == (1, 1)
    assert tally.wrong_count == 6


def test_settings_without_effect_are_counted_once(records: Any) -> None:
    lie: dict[str, Any] = {"claimed": True, "true": False, "error_plan": 0.5}
    for policy, times in (("fresh", (7.0, 7.0)), ("warm", (7.0, 8.0))):
        for settings, raw_max_ns in zip(("default", "high"), times, strict=True):
            columns = {"settings": settings, "policy": policy, "raw_max_ns": raw_max_ns}
            records.replay("osqp", steps=1, rounds=1, **columns, **cell())
    results = records.results()
    rows = [{"run_id": run_id, "k": 0, "counts": True} | lie for run_id in results.runs["run_id"]]
    claims = RandomClaims(
        Records(
            Results(
                results.runs, StepsInMemory(convert_to_step_columns(pd.DataFrame(rows))), {}, {}
            )
        )
    )
    found = {
        configuration: tally.false_claims
        for configuration, tally in claims.sum_tallies_by_columns("policy", "settings").items()
    }
    assert found == {("fresh", "default, high"): 1, ("warm", "default"): 1, ("warm", "high"): 1}


def test_random_problems_change_nothing_that_is_said_about_the_ship(records: Any) -> None:
    records.loop("daqp", route="native")
    records.replay("daqp", route="native", steps=60)
    before, lines = records.view(), records.ending()
    records.replay("daqp", error=1.0, steps=24, route="qpsolvers", **cell())
    after = records.view()
    assert [run.run_id for run in after.runs] == [run.run_id for run in before.runs]
    assert [run.default_route for run in after.runs] == [True, True]
    more = records.ending()
    assert "false claims on" in more.pop("random")
    assert more == lines


def test_the_topic_puts_who_lies_first(records: Any) -> None:
    true = {"true": True, "true_1e4": True, "true_1e6": True}
    lie = {"true": False, "error_plan": 0.5}
    steps = {"daqp": [true, true], "scs": [lie, true], "osqp": [lie, lie]}
    ids, rows = {}, []
    for solver in steps:
        ids[solver] = f"run{len(records._runs):04d}"
        records.replay(solver, steps=2, rounds=1, **cell())
    usual = {"status": "SOLVED", "claimed": True, "certificate": "linear", "counts": True}
    for solver, own in steps.items():
        for k, step in enumerate(own):
            rows.append({"run_id": ids[solver], "k": k, "primal": 0.0} | usual | step)
    found = records.results()
    view = Records(
        Results(found.runs, StepsInMemory(convert_to_step_columns(pd.DataFrame(rows))), {}, {})
    )
    topic = build_random_topic(view)
    assert [row[:4] for row in topic.tables[0].rows] == [
        ("osqp", "2", "0", "2"),
        ("scs", "2", "1", "1"),
        ("daqp", "2", "2", "0"),
    ]
    said = "3 false claims on 6 certified steps: 2 by osqp, 1 by scs; none by daqp."
    assert topic.lines[0] == said


def test_what_never_ran_is_counted_as_never_reached(records: Any) -> None:
    records.replay("daqp", outcome="crashed", steps_done=0, steps_planned=24, **cell())
    records.replay("ecos", outcome="refused", steps_done=0, **cell())
    topic = build_random_topic(records.view())
    (row,) = topic.tables[0].rows
    assert (row[0], row[1], row[-1]) == ("daqp", "0", "24")
