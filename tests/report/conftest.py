"""A report that several tests look at, written once a session: drawing starts slowly."""

import json
from pathlib import Path
from typing import Any

import pytest

from dpbench.bench.record.result_folder import Results, load_results
from dpbench.bench.record.schema import SCHEMA_VERSION
from dpbench.report.report import Report
from dpbench.report.write import write_report_with_summary
from tests.conftest import MadeRecords

HEIGHTS, OFFSETS, SEAS = (1.0, 2.0, 3.5), (0.0, 3.0), 4
LOOSE = "1e-1"
"""The settings of osqp that lose a ship in the highest of those seas, in all but the first."""


class Written:
    """A result folder with its report, what it is made of, and what the terminal heard."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.page, self.lines = write_report_with_summary(folder, figures=("pdf",))
        self.markdown = (folder / "report.md").read_text(encoding="utf-8")
        self.html = self.page.read_text(encoding="utf-8")
        self.results: Results = load_results(folder)
        self.report = Report.from_results(self.results)


@pytest.fixture(scope="session")
def written(campaign: Path) -> Written:
    """The report of a campaign like the standard one."""
    return Written(campaign)


def run_row(run_id: str, mode: str, solver: str, steps: int, **columns: Any) -> dict[str, Any]:
    """Return a row of runs.parquet, of a finished run."""
    scenario = columns.get("scenario", "paper")
    return {
        **{"run_id": run_id, "mode": mode, "scenario": scenario, "solver": solver},
        **{"sequence": scenario if mode == "replay" else "", "solver_version": "1.0"},
        **{"route": "native", "policy": "fresh", "settings": "default"},
        **{"formulation": "condensed_box", "units": "scaled", "outcome": "finished"},
        **{"schema": SCHEMA_VERSION, "cell": json.dumps({"scenario": {"name": scenario}})},
        **{"steps_planned": steps, "steps_done": steps},
        **columns,
    }


def of_seas(records: MadeRecords) -> MadeRecords:
    """A study over wave height and offset, three configurations in four seas at each point."""
    for point, (hs, east) in enumerate((hs, east) for hs in HEIGHTS for east in OFFSETS):
        for replicate in range(1, SEAS + 1):
            sea_m = 0.1 * hs + 0.01 * replicate
            for solver, settings, more in (
                ("daqp", "default", 0.0),
                ("osqp", "default", 2e-3 * replicate),
                ("osqp", LOOSE, 0.02 * hs + 1e-3 * replicate),
            ):
                lost = settings == LOOSE and hs == max(HEIGHTS) and replicate > 1
                records.sea(
                    solver,
                    point,
                    replicate,
                    {"waves.hs_m": hs, "start.east_m": east},
                    settings=settings,
                    r_95_m=sea_m + more,
                    tail_m=1.5 if lost else 2.0 * (sea_m + more),
                    closed_loop_cost=100.0 * (1.0 + more),
                    exact_cost=100.0,
                )
    return records
