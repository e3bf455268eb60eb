"""Additions of a pytest session to its JSON file: failed benchmarks, files, selected tests."""

import json
import os
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

import pytest

from dpbench.ci.benchmarks import (
    COLLECTED,
    FAILED,
    IMPORTED,
    PATHS,
    SELECTION,
    Selection,
    describe_disturbed_baseline,
    describe_quiet_baseline,
    find_source_files,
    list_imported_files,
    read_complaints,
    read_exact_measures,
)
from dpbench.errors import InputError


class FailedBenchmarks:
    """Plug-in that notes why benchmarks failed: `reasons`, the first line of each by name.

    last_line : outcome and exit code, printed below pytest's last line; "" for none.
    """

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._deselected: set[str] = set()
        self._collected = 0
        self._warning = self._note = ""
        self.last_line = ""
        self.reasons: dict[str, str] = {}

    def pytest_deselected(self, items: Sequence[pytest.Item]) -> None:
        """Note what -k, -m and other options leave out."""
        self._deselected.update(item.nodeid for item in items)

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        """Count the benchmarks of a session."""
        self._collected = sum(map(_is_benchmark, session.items))

    @property
    def selection(self) -> Selection:
        """Tests that the session was given; an argument that is no path may name a package."""
        given, root = [], self._config.rootpath
        for argument in self._config.args:
            place, colons, test = argument.partition("::")
            path = (self._config.invocation_params.dir / place).resolve()
            is_path = path.exists()
            given.append(f"{os.path.relpath(path, root) if is_path else '.'}{colons}{test}")
        return Selection(tuple(given), frozenset(self._deselected))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item, call: pytest.CallInfo[None]
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        """Store why a benchmark fails or cannot be set up; return pytest's report.

        A benchmark with an exact measure that is no number fails.
        """
        report = yield
        if report.passed and call.when != "setup" and item.nodeid not in self.reasons:
            benchmark = getattr(item, "funcargs", {}).get("benchmark")
            try:
                read_exact_measures(item.nodeid, getattr(benchmark, "extra_info", {}))
            except InputError as error:
                report.outcome, report.longrepr = "failed", str(error)
                self.reasons[item.nodeid] = str(error).removeprefix(f"{item.nodeid}: ")
        if report.failed and _is_benchmark(item) and call.excinfo is not None:
            lines = str(call.excinfo.value).splitlines() or [call.excinfo.typename]
            self.reasons.setdefault(item.nodeid, lines[0])
            if benchmark := getattr(item, "funcargs", {}).get("benchmark"):
                benchmark.skipped = True  # no warning of an unused fixture; the test still fails
        return report

    @pytest.hookimpl(optionalhook=True)
    def pytest_benchmark_update_json(self, output_json: dict[str, Any]) -> None:
        """Add what this plug-in notes to the given JSON document, in place."""
        output_json |= self._make_notes()
        stored = [entry.get("extra_info", {}) for entry in output_json["benchmarks"]]
        disturbed = sum(bool(read_complaints(extra)) for extra in stored)
        self._warning = describe_disturbed_baseline(disturbed, len(stored))
        self._note = describe_quiet_baseline(stored)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print whether stored times are of use as a baseline."""
        if self._warning or self._note:
            line = f"stored times: {self._warning or self._note}"
            terminalreporter.write_line(line, yellow=bool(self._warning))

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Set the exit code of a disturbed baseline; write a JSON file where nothing was timed.

        pytest-benchmark then writes none.
        """
        is_stored_only = not self._config.getoption("dpbench_compare")
        if self._warning and is_stored_only and session.exitstatus == pytest.ExitCode.OK:
            code = session.exitstatus = self._config.getoption("dpbench_disturbed_exit")
            self.last_line = f"dpbench: disturbed baseline stored (exit code {code})"
        target = self._config.getoption("benchmark_json", None)
        # No public hook has the benchmarks of a session.
        measured = self._config._benchmarksession.benchmarks  # type: ignore[attr-defined] # a private attribute
        is_noted = self.reasons or self._config.option.collectonly
        if not (target and is_noted) or measured:
            return
        # Older releases of pytest-benchmark have opened the file.
        path = Path(getattr(target, "name", "")) if hasattr(target, "write") else Path(target)
        content = json.dumps({"benchmarks": []} | self._make_notes())
        path.write_text(content, encoding="utf-8")

    def pytest_unconfigure(self, config: pytest.Config) -> None:
        """Print the outcome and the exit code below pytest's last line."""
        reporter = config.pluginmanager.getplugin("terminalreporter")
        if reporter is not None and self.last_line:
            reporter.write_line(self.last_line)

    def _make_notes(self) -> dict[str, Any]:
        """Return failed benchmarks, imported files and selected tests for the JSON file."""
        files = list_imported_files()
        if self._config.option.collectonly:
            files += find_source_files(self._config.rootpath / "src")
        notes = {FAILED: self.reasons, IMPORTED: files, COLLECTED: self._collected}
        return notes | {SELECTION: self.selection.json_entry, PATHS: self._find_given_paths()}

    def _find_given_paths(self) -> list[str]:
        """Return the paths of the command line, as they were given, whether they exist or not."""
        given = self._config.invocation_params.args
        is_of_packages = self._config.option.pyargs
        return [one for one in self._config.args if one in given and not is_of_packages]


def _is_benchmark(item: pytest.Item) -> bool:
    """Return True if a test uses pytest-benchmark, as every test with `dpbench_replay` does."""
    return "benchmark" in getattr(item, "fixturenames", ())
