"""Compare results of pytest-benchmark with stored results of the same machine.

    python -m dpbench.ci.gate bench.json BASELINE [--renew] [--retries 3] [--margin SHARE]
        [--allow-gone] [--disturbed-exit CODE] [--allow MEASURE:SOLVER[=PERCENT]]

BASELINE is a JSON file, or a folder that keeps one for each machine. What looks worse or was
disturbed is measured again: noise only ever makes a minimum larger. The baseline is not, and so
nothing whose baseline was disturbed: `dpbench.ci.revisions` measures both alternately. Exit 0: no
regression shown, or no baseline yet, which is stored; 1: a regression, or a failed or missing
benchmark; 2: bad input, or no benchmark in common; CODE (0): times not judged, no regression shown,
or a baseline stored that is disturbed or lacks a reference kernel.
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from dpbench.bench.record.machine import describe_machine
from dpbench.ci import ALLOW, GATE_EXIT, MARGIN, MARGIN_SHARE
from dpbench.ci.benchmarks import (
    Benchmark,
    BenchmarkRun,
    describe_disjoint_runs,
    describe_disturbed_baseline,
    describe_unusable_times,
    load_run,
)
from dpbench.ci.comparison import (
    DISTURBED,
    NO_KERNEL,
    NOT_JUDGED,
    SLOWER,
    WORSE,
    Allowed,
    compare_runs,
    describe_end,
    find_exact_changes,
)
from dpbench.ci.failures import FailedBenchmarks
from dpbench.errors import InputError, SituationError
from dpbench.report.formats import plural

HELP_EPILOG = """\
exit codes:
  0     no regression shown, or the baseline was stored
  1     a regression: longer times, more iterations, larger errors, or a failed
        or missing benchmark
  2     bad input, or no benchmark in common
  CODE  (--disturbed-exit) times not judged and no regression shown, or this
        command stored a baseline that is disturbed or has no times of the
        reference kernel

disturbed:
  A benchmark is disturbed if other programs, the host of a virtual machine or
  throttling slow the machine while it runs.

reference kernel:
  A fixed computation, timed before and after each benchmark. Its time shows
  the speed of the machine.

examples:
  python -m dpbench.ci.gate now.json base.json
  python -m dpbench.ci.gate now.json baselines/ --retries 5 --disturbed-exit 75
"""


class SessionComparison:
    """Plug-in that compares a session's benchmarks with a stored run and fails on a regression."""

    def __init__(self, config: pytest.Config, notes: FailedBenchmarks) -> None:
        self._path = Path(config.getoption("dpbench_compare"))
        try:
            self._baseline = load_run(self._path)
        except InputError as error:
            raise pytest.UsageError(f"--dpbench-compare: {error}") from error
        self._config, self._notes, self._text = config, notes, StringIO()

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Compare a session's benchmarks with the stored run; set the exit code of the verdict.

        2 where benchmarks were measured, none failed, and none of them is in the stored run.
        """
        # No public hook has the benchmarks of a session that writes no JSON file.
        measured = self._config._benchmarksession.benchmarks  # type: ignore[attr-defined] # a private attribute
        entries = (one.as_dict() for one in measured if one and not one.has_error)
        now = BenchmarkRun.from_json_entries(entries, self._notes.reasons)
        now = replace(now, selection=self._notes.selection)
        found = compare_runs(
            [(self._baseline, now)],
            margin=self._config.getoption("dpbench_margin"),
            allow_gone=self._config.getoption("dpbench_allow_gone"),
            allow=self._config.getoption("dpbench_allow"),
            option="--dpbench-allow",
        )
        passed = session.exitstatus == pytest.ExitCode.OK
        selected = self._config.getoption("dpbench_disturbed_exit") if passed else 0
        option = "--dpbench-disturbed-exit"
        fault = "" if now.failed else describe_disjoint_runs(self._baseline, now, self._path)
        if fault:
            lines = [found.describe_scope(str(self._path), "this session"), fault]
        else:
            lines = describe_end(found, str(self._path), "this session", selected, option)
        console = Console(file=self._text, width=120)
        if line := describe_unusable_times(self._baseline, self._path):
            console.print(line, markup=False, highlight=False, soft_wrap=True)
        found.print(console, lines)
        if passed:
            session.exitstatus = 2 if fault else found.exit_code(selected)
        why = "" if passed or (found.worse and not fault) else ": pytest did not pass"
        code = int(session.exitstatus)
        self._notes.last_line = f"dpbench: {fault or found.outcome} (exit code {code}{why})"

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print the comparison with the stored run below pytest's table of benchmarks."""
        terminalreporter.section("dpbench comparison")
        terminalreporter.write_line(self._text.getvalue().rstrip())


def measure_suspects_again(
    was: BenchmarkRun,
    now: BenchmarkRun,
    retries: int,
    console: Console,
    allow: Allowed = (),
    margin: float = MARGIN,
) -> BenchmarkRun:
    """Repeat benchmarks that look worse or disturbed; return the run with the better times.

    No repeat gives a verdict on a time whose baseline was disturbed.
    """
    for _ in range(retries):
        rows = compare_runs([(was, now)], allow=allow, margin=margin).rows
        doubtful = [
            row.name
            for row in rows
            if row.verdict in (SLOWER, WORSE)
            or (row.verdict == DISTURBED and not was.benchmarks[row.name].complaints)
        ]
        if not doubtful:
            break
        count = plural(len(doubtful), "benchmark")
        console.print(f"repeating {count}, without the baseline", soft_wrap=True)
        again = _run_benchmarks(doubtful)
        kept = {
            name: _merge_repeated_measurements(
                was.benchmarks[name], now.benchmarks[name], again[name]
            )
            for name in doubtful
            if name in again
        }
        now = replace(now, benchmarks=now.benchmarks | kept)
    return now


def _run_benchmarks(names: Sequence[str]) -> dict[str, Benchmark]:
    """Run benchmarks in the present folder; return them by name, none where one fails."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "again.json"
        command = [sys.executable, "-m", "pytest", "-q", *names, f"--benchmark-json={path}"]
        done = subprocess.run(command, capture_output=True, check=False)
        return load_run(path).benchmarks if done.returncode == 0 else {}


def _merge_repeated_measurements(was: Benchmark, *measured: Benchmark) -> Benchmark:
    """Return the fastest of the least disturbed measurements, with the least exact measures."""
    exact = min(measured, key=lambda one: len(find_exact_changes(was, one))).exact
    fastest = min(
        measured, key=lambda one: (bool(one.complaints), one.minimum_s / (one.reference_ns or 1.0))
    )
    return replace(fastest, exact=exact)


def _build_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="dpbench.ci.gate",
        description=__doc__.splitlines()[0],
        usage="python -m %(prog)s [OPTIONS] FILE BASELINE",
        epilog=HELP_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "json", type=Path, metavar="FILE", help="JSON file written by pytest --benchmark-json"
    )
    baseline = "JSON file of an earlier run, or a folder with one for each machine"
    parser.add_argument("baseline", type=Path, metavar="BASELINE", help=baseline)
    renew = "store this run as the baseline; compare nothing"
    parser.add_argument("--renew", action="store_true", help=renew)
    retries = (
        "repeat each benchmark that looks worse or was disturbed, at most N times (default: 3)"
    )
    parser.add_argument("--retries", type=int, default=3, metavar="N", help=retries)
    gone = "pass even if a benchmark of the baseline is missing"
    parser.add_argument("--margin", **MARGIN_SHARE)
    parser.add_argument("--allow-gone", action="store_true", help=gone)
    parser.add_argument("--disturbed-exit", **GATE_EXIT)
    parser.add_argument("--allow", **ALLOW)
    return parser


def main(argv: list[str] | None = None) -> int:
    """Compare benchmarks with a baseline, or store it if missing; return the exit code."""
    arguments = _build_parser().parse_args(argv)
    console = Console() if sys.stdout.isatty() else Console(width=200)
    baseline: Path = arguments.baseline
    if baseline.suffix != ".json":
        baseline = baseline / f"{describe_machine()['id']}.json"
    allowed: dict[str, Any] = {"allow": arguments.allow, "margin": arguments.margin}
    try:
        now = load_run(arguments.json)
        if arguments.renew or not baseline.exists():
            return _store_baseline(now, arguments, baseline, console)
        was = load_run(baseline)
        if fault := describe_disjoint_runs(was, now, baseline):
            remedy = f"--renew replaces {baseline} with {arguments.json}"
            raise SituationError(str(arguments.json), f"found {fault}; {remedy}")
        if line := describe_unusable_times(was, baseline):
            console.print(f"{line} (--renew)", soft_wrap=True)
        now = measure_suspects_again(was, now, arguments.retries, console, **allowed)
    except InputError as error:
        print(f"gate: {error}", file=sys.stderr)
        return 2
    found = compare_runs([(was, now)], allow_gone=arguments.allow_gone, **allowed)
    selected: int = arguments.disturbed_exit
    lines = describe_end(found, str(baseline), str(arguments.json), selected)
    found.print(console, [*lines, found.describe_exit(selected)])
    return found.exit_code(selected)


def _describe_baseline_without_kernel(run: BenchmarkRun) -> str:
    """Return a warning for a run whose times have no verdict even against itself; "" for none."""
    unjudged = [row for row in compare_runs([(run, run)]).rows if row.not_judged == NO_KERNEL]
    if not unjudged:
        return ""
    count = f"{len(unjudged)} of {plural(len(run.benchmarks), 'benchmark')}"
    return (
        f"{NOT_JUDGED[NO_KERNEL]} in {count}: as a baseline, their times will not be compared; add "
        "the fixture dpbench_reference_kernel to the tests and measure again"
    )


def _store_baseline(
    run: BenchmarkRun, arguments: argparse.Namespace, baseline: Path, console: Console
) -> int:
    """Store the given file, of a run, as the baseline; return the exit code."""
    baseline.parent.mkdir(parents=True, exist_ok=True)
    baseline.write_bytes(arguments.json.read_bytes())
    why = "renewed" if arguments.renew else "no baseline of this machine yet"
    console.print(f"{why}: stored {baseline}, nothing compared", soft_wrap=True)
    code = 0
    warnings = (
        describe_disturbed_baseline(run.disturbed, len(run.benchmarks)),
        _describe_baseline_without_kernel(run),
    )
    for warning in filter(None, warnings):
        console.print(warning, soft_wrap=True)
        code = arguments.disturbed_exit
    console.print(f"exit code {code} (baseline stored)")
    return code


if __name__ == "__main__":
    raise SystemExit(main())
