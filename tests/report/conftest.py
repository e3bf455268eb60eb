"""A report that several tests look at, written once a session: drawing starts slowly."""

from __future__ import annotations

from pathlib import Path

import pytest

from dpbench.bench.record.result_folder import Results, load_results
from dpbench.report.report import Report
from dpbench.report.write import report_and_ending


class Written:
    """A result folder with its report, what it is made of, and what the terminal heard."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.page, self.lines = report_and_ending(folder, figures=("pdf",))
        self.markdown = (folder / "report.md").read_text(encoding="utf-8")
        self.html = self.page.read_text(encoding="utf-8")
        self.results: Results = load_results(folder)
        self.report = Report.of(self.results)


@pytest.fixture(scope="session")
def written(campaign: Path) -> Written:
    """The report of a campaign like the standard one."""
    return Written(campaign)
