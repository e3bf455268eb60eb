"""The comparison of a whole pytest session with a stored JSON file, `--dpbench-compare`."""

from collections.abc import Mapping
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from dpbench.ci.benchmarks import BenchmarkRun, load_run
from dpbench.ci.comparison import compare_runs, describe_end
from dpbench.errors import InputError


class SessionComparison:
    """Plug-in that compares a session's benchmarks with a stored run and fails on a regression."""

    def __init__(self, config: pytest.Config, failed: Mapping[str, str]) -> None:
        self._path = Path(config.getoption("dpbench_compare"))
        self._margin: float = config.getoption("dpbench_margin")
        if not 0.0 < self._margin < 10.0:
            raise pytest.UsageError(f"--dpbench-margin: found {self._margin}; allowed: 0 to 10")
        try:
            self._baseline = load_run(self._path)
        except InputError as error:
            raise pytest.UsageError(f"--dpbench-compare: {error}") from error
        self._config, self._failed, self._text = config, failed, StringIO()

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Compare a session's benchmarks with the stored run; set exit code 1 if one is worse."""
        # No public hook has the benchmarks of a session that writes no JSON file.
        measured = self._config._benchmarksession.benchmarks  # type: ignore[attr-defined] # a private attribute
        entries = (one.as_dict() for one in measured if one and not one.has_error)
        now = BenchmarkRun.from_json_entries(entries, self._failed)
        allow_gone: bool = self._config.getoption("dpbench_allow_gone")
        found = compare_runs([(self._baseline, now)], margin=self._margin, allow_gone=allow_gone)
        found.print(Console(file=self._text, width=120), [describe_end(found, str(self._path))])
        if found.worse and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print the comparison with the stored run below pytest's table of benchmarks."""
        terminalreporter.section("dpbench comparison")
        terminalreporter.write_line(self._text.getvalue().rstrip())
