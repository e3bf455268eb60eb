"""The comparison of a whole pytest session with a stored JSON file, `--dpbench-compare`."""

from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from dpbench.ci.comparison import index_benchmarks, load_benchmarks, print_comparison
from dpbench.errors import InputError


class SessionComparison:
    """Plug-in that compares a session's benchmarks with a stored run and fails on a regression."""

    def __init__(self, config: pytest.Config) -> None:
        self._path = Path(config.getoption("dpbench_compare"))
        self._margin: float = config.getoption("dpbench_margin")
        if not config.pluginmanager.hasplugin("benchmark"):
            raise pytest.UsageError("--dpbench-compare: pip install 'dpbench[ci]'")
        if not 0.0 < self._margin < 10.0:
            raise pytest.UsageError(f"--dpbench-margin: found {self._margin}; allowed: 0 to 10")
        try:
            self._baseline = load_benchmarks(self._path)
        except InputError as error:
            raise pytest.UsageError(f"--dpbench-compare: {error}") from error
        self._config, self._text = config, StringIO()

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Compare what the session measured; a regression is exit code 1."""
        # No public hook has the benchmarks of a session that writes no JSON file.
        measured = self._config._benchmarksession.benchmarks  # type: ignore[attr-defined] # a private attribute
        entries = (one.as_dict(include_data=False) for one in measured if one and not one.has_error)
        now = index_benchmarks(entries)
        console = Console(file=self._text, width=120)
        if now.keys() & self._baseline.keys():
            worse = print_comparison(self._baseline, now, console, margin=self._margin)
            result = "a regression" if worse else "no regression"
        else:
            worse, result = True, "nothing measured that is in the file, no comparison"
        console.print(f"{result} against {self._path}", markup=False, soft_wrap=True)
        if worse and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print the comparison with the stored run below pytest's table of benchmarks."""
        terminalreporter.section("dpbench comparison")
        terminalreporter.write_line(self._text.getvalue().rstrip())
