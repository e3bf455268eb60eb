"""The section on random problems: what counts as what, and that nothing else counts them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from dpbench.analysis.random_claims import RandomClaims
from dpbench.analysis.records import Records
from dpbench.bench.record.result_folder import Results, load_results
from dpbench.bench.record.schema import as_steps
from dpbench.qp.random.recipe import RandomRecipe
from dpbench.report.blocks import Tabular
from dpbench.report.table import Table
from dpbench.report.tables_random import configurations_of
from dpbench.report.write import build_page, verdict_lines, write_report

INF, NAN = float("inf"), float("nan")
RECIPE = RandomRecipe("plain", 4, 6, 1)


def cell(recipe: RandomRecipe = RECIPE) -> dict[str, str]:
    """The columns that make a row one of a random sequence."""
    source = {"kind": "random", "name": recipe.name, "recipe": recipe.to_dict()}
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
    return Records(Results(results.runs, as_steps(pd.DataFrame(rows)), {}, {}))


def test_each_step_counts_as_what_it_is(records: Any) -> None:
    """Every combination of claim, truth and certificate has one column, told apart by rows."""
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
    tally = RandomClaims(view).by("solver")[("osqp",)]
    assert (tally.steps, tally.unknown, tally.missed) == (11, 3, 6)
    assert tally.lies == (5, 5, 6)
    assert (tally.off, tally.outside, tally.dual, tally.empty) == (2, 1, 1, 1)
    assert (tally.told, tally.silent, tally.nothing) == (2, 1, 1)
    assert (tally.empty_right, tally.empty_wrong) == (1, 1)
    assert tally.worst == INF and tally.wrong == 6


@pytest.mark.slow
def test_settings_without_effect_are_counted_once(records: Any) -> None:
    """One run shown under two names is one configuration with one count, and two runs are two."""
    lie: dict[str, Any] = {"claimed": True, "true": False, "error_plan": 0.5}
    for policy, times in (("fresh", (7.0, 7.0)), ("warm", (7.0, 8.0))):
        for settings, raw_max_ns in zip(("default", "high"), times, strict=True):
            columns = {"settings": settings, "policy": policy, "raw_max_ns": raw_max_ns}
            records.replay("osqp", steps=1, rounds=1, **columns, **cell())
    results = records.results()
    rows = [{"run_id": run_id, "k": 0, "counts": True} | lie for run_id in results.runs["run_id"]]
    claims = RandomClaims(Records(Results(results.runs, as_steps(pd.DataFrame(rows)), {}, {})))
    found = {
        (configuration[2], configuration[3]): tally.lies[0]
        for configuration, tally in configurations_of(claims)
    }
    assert found == {("fresh", "default, high"): 1, ("warm", "default"): 1, ("warm", "high"): 1}


def _tables(results: Results) -> dict[str, Table]:
    """All tables but those that say what was run and what there is."""
    page = build_page(results)
    own = ("random", "runs", "solvers")
    return {
        block.table.title: block.table
        for section in page.sections
        if section.key not in own
        for block in section.blocks
        if isinstance(block, Tabular)
    }


@pytest.mark.slow
def test_random_problems_change_nothing_that_is_said_about_the_ship(
    records: Any, tmp_path: Path
) -> None:
    """Verdict, accuracy and times are the same with a random configuration that lies on another
    route."""
    records.loop("daqp", route="native")
    records.replay("daqp", route="native", steps=60)
    records.write(tmp_path)
    before, lines = _tables(records.results()), verdict_lines(load_results(tmp_path))
    records.replay("daqp", error=1.0, steps=24, route="qpsolvers", **cell())
    write_report(records.write(tmp_path))
    assert _tables(records.results()) == before
    assert verdict_lines(load_results(tmp_path))[: len(lines)] == lines
    assert "24 random QPs in 1 sequence" in verdict_lines(load_results(tmp_path))[len(lines)]
    keys = [section.key for section in build_page(records.results()).sections]
    assert keys.index("random") == keys.index("units") + 1


def test_a_random_configuration_that_never_ran_still_makes_a_report(
    records: Any, tmp_path: Path
) -> None:
    """Refused and crashed cells alone leave a page that says so."""
    records.replay("daqp", outcome="crashed", steps_done=0, steps_planned=24, **cell())
    records.replay("ecos", outcome="refused", steps_done=0, **cell())
    write_report(records.write(tmp_path))
    text = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert "0 random QPs in 1 sequence, put to 1 configuration" in text
    assert "crashed" in text
