"""A capability plot in a suite: planned, judged, and its plot beside the runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.capability import capability_plots
from dpbench.bench.campaign import run_campaign
from dpbench.bench.capability.table import load_capability
from dpbench.bench.plan.plan import plan
from dpbench.bench.plan.suite import CapabilityTable, SuiteFile
from dpbench.bench.record.cell import CapabilitySource
from dpbench.bench.record.result_folder import load_results
from dpbench.errors import InputError
from dpbench.report.write import write_report

SUITE = """
title = "The edge of a ship"
baseline_law = false
cell_limit_s = 60.0

[[capability]]
vessel = "osv"
sides = 8
routes = ["default", "native"]
"""


def suite_of(**keys: object) -> SuiteFile:
    """A suite with one plot."""
    return SuiteFile(title="", capability=[CapabilityTable.model_validate(keys)])


def test_a_solver_has_a_cell_of_four_qps_a_direction_and_case() -> None:
    """Once, in its own way, in one round; the harness's own configurations have no part."""
    suite = suite_of(vessel="osv").model_copy(update={"calibration": True})
    (planned,) = plan(suite, solvers=["quadprog"])
    cell = planned.cell
    assert (cell.steps, cell.rounds, cell.scenario) == (4 * 36 * 3, 1, {})
    assert cell.sequence == "osv capability, 16 sides"
    assert isinstance(cell.source, CapabilitySource) and cell.source.vessel_name == "osv"


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"vessel": "supply_mss"}, "thrusters"),
        ({"vessel": "nowhere"}, "'nowhere'"),
    ],
)
def test_a_vessel_that_has_no_plot_is_refused(keys: dict[str, object], said: str) -> None:
    """Before anything runs."""
    with pytest.raises(InputError, match=said):
        plan(suite_of(**keys), solvers=["quadprog"])


@pytest.mark.slow
def test_a_run_leaves_the_plot_and_answers_that_the_referee_judged(tmp_path: Path) -> None:
    """A row a QP in `capability.parquet`; the plot is kept where nothing is left to run, and the
    page draws it."""
    (tmp_path / "edge.toml").write_text(SUITE, encoding="utf-8")
    out = run_campaign(tmp_path / "edge.toml", tmp_path / "out", solvers=["quadprog"])
    table_of_run = load_capability(out)
    assert table_of_run is not None
    (plot,) = capability_plots(Records(load_results(out)), table_of_run)
    (answers,) = plot.answers
    assert answers.all_right
    held = int(table_of_run["held"].sum())
    assert (answers.balanced, answers.refused) == (held, len(table_of_run) - held)
    assert len(plot.edges) == 36 * 3 and not plot.edges["untrue"].any()
    (out / "capability.parquet").unlink()
    run_campaign(tmp_path / "edge.toml", out, solvers=["quadprog"])
    assert load_capability(out) is not None
    page = write_report(out).read_text(encoding="utf-8")
    assert 'id="answer"' in page and "1 of 1 solver answers all 432 QPs" in page
    assert (out / "figures" / "capability-osv.svg").is_file()
