"""Compare a JSON file of pytest-benchmark with the stored one of the same machine.

    python -m dpbench.ci.gate bench.json BASELINE [--renew] [--retries 3] [--allow-gone]

BASELINE is a JSON file, or a folder that keeps one for each machine. What looks worse or was
disturbed is measured again: noise only ever makes a minimum larger. The baseline is not: to measure
both by turns is the task of `dpbench.ci.revisions`. Exit 0: no regression shown, or no baseline
yet, which is stored; 1: a regression, a benchmark that failed or is gone; 2: bad input.
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from dpbench.bench.record.machine import describe_machine
from dpbench.ci.benchmarks import Benchmark, BenchmarkRun, load_run
from dpbench.ci.comparison import (
    DISTURBED,
    SLOWER,
    WORSE,
    compare_runs,
    describe_end,
    find_exact_changes,
)
from dpbench.errors import InputError


def measure_suspects_again(
    was: BenchmarkRun, now: BenchmarkRun, retries: int, console: Console
) -> BenchmarkRun:
    """Repeat benchmarks that look worse or disturbed; return the run with the better times."""
    for _ in range(retries):
        rows = compare_runs([(was, now)]).rows
        doubtful = [row.name for row in rows if row.verdict in (SLOWER, WORSE, DISTURBED)]
        if not doubtful:
            break
        console.print(f"measuring {len(doubtful)} again, not the baseline", soft_wrap=True)
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


def main(argv: list[str] | None = None) -> int:
    """Compare benchmarks with a baseline, or store it if missing; return the exit code."""
    parser = argparse.ArgumentParser(prog="dpbench.ci.gate", description=__doc__.splitlines()[0])
    parser.add_argument("json", type=Path, metavar="FILE", help="written by --benchmark-json")
    parser.add_argument(
        "baseline", type=Path, help="a JSON file, or a folder that keeps one for each machine"
    )
    parser.add_argument("--renew", action="store_true", help="make this run the baseline")
    parser.add_argument(
        "--retries", type=int, default=3, help="of what looks worse or was disturbed (3)"
    )
    parser.add_argument(
        "--allow-gone", action="store_true", help="pass where a benchmark of the baseline is gone"
    )
    arguments = parser.parse_args(argv)
    console = Console() if sys.stdout.isatty() else Console(width=200)
    baseline: Path = arguments.baseline
    if baseline.suffix != ".json":
        baseline = baseline / f"{describe_machine()['id']}.json"
    try:
        now = load_run(arguments.json)
        if arguments.renew or not baseline.exists():
            baseline.parent.mkdir(parents=True, exist_ok=True)
            baseline.write_bytes(arguments.json.read_bytes())
            why = "renewed" if arguments.renew else "no baseline of this machine yet"
            console.print(f"{why}: stored {baseline}, nothing compared", soft_wrap=True)
            return 0
        was = load_run(baseline)
        now = measure_suspects_again(was, now, arguments.retries, console)
    except InputError as error:
        print(f"gate: {error}", file=sys.stderr)
        return 2
    found = compare_runs([(was, now)], allow_gone=arguments.allow_gone)
    found.print(console, [describe_end(found, str(baseline))])
    return int(found.worse)


if __name__ == "__main__":
    raise SystemExit(main())
