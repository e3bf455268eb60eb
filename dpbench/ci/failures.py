"""Additions of a pytest session to its JSON file: failed benchmarks and imported files."""

import json
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

from dpbench.ci.benchmarks import FAILED, IMPORTED, find_source_files, list_imported_files


class FailedBenchmarks:
    """Plug-in that notes why benchmarks failed: `reasons`, the first line of each by name."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self.reasons: dict[str, str] = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item, call: pytest.CallInfo[None]
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        """Store why a benchmark fails or cannot be set up; return pytest's report unchanged."""
        report = yield
        is_benchmark = "benchmark" in getattr(item, "fixturenames", ())
        if report.failed and is_benchmark and call.excinfo is not None:
            lines = str(call.excinfo.value).splitlines() or [call.excinfo.typename]
            self.reasons.setdefault(item.nodeid, lines[0])
        return report

    @pytest.hookimpl(optionalhook=True)
    def pytest_benchmark_update_json(self, output_json: dict[str, Any]) -> None:
        """Add failed benchmarks and imported files to the given JSON document, in place."""
        output_json |= self._collect_failures_and_files()

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self) -> None:
        """Write the JSON file where nothing was timed: pytest-benchmark then writes none."""
        target = self._config.getoption("benchmark_json", None)
        # No public hook has the benchmarks of a session.
        measured = self._config._benchmarksession.benchmarks  # type: ignore[attr-defined] # a private attribute
        is_noted = self.reasons or self._config.option.collectonly
        if not (target and is_noted) or measured:
            return
        # Older releases of pytest-benchmark have opened the file.
        path = Path(getattr(target, "name", "")) if hasattr(target, "write") else Path(target)
        content = json.dumps({"benchmarks": []} | self._collect_failures_and_files())
        path.write_text(content, encoding="utf-8")

    def _collect_failures_and_files(self) -> dict[str, Any]:
        """Return failed benchmarks and imported files, as stored in the benchmarks' JSON file."""
        files = list_imported_files()
        if self._config.option.collectonly:
            files += find_source_files(self._config.rootpath / "src")
        return {FAILED: self.reasons, IMPORTED: files}
