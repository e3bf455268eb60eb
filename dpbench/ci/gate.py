"""Compare a JSON file of pytest-benchmark with the stored one of the same machine.

    python -m dpbench.ci.gate bench.json BASELINE [--renew] [--retries 3]

BASELINE is a JSON file, or a folder that keeps one for each machine. What looks worse is measured
again: noise only ever makes a minimum larger. Exit 0: nothing worse, or no baseline yet, which is
stored; 1: a regression, or no benchmark that both have; 2: bad input.
"""

import argparse
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from dpbench.bench.record.machine import describe_machine
from dpbench.ci.comparison import (
    Benchmark,
    Benchmarks,
    assess_times,
    find_exact_changes,
    is_worse,
    load_benchmarks,
    print_comparison,
)
from dpbench.errors import InputError


def measure_again(was: Benchmarks, now: Benchmarks, retries: int, console: Console) -> None:
    """Run what looks worse again, at most so many times; keep the smaller numbers in `now`."""
    for _ in range(retries):
        times = assess_times(was, now)
        worse = [name for name, time in times.items() if is_worse(was[name], now[name], time)]
        if not worse:
            return
        console.print(f"measuring {len(worse)} again", soft_wrap=True)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "again.json"
            command = [sys.executable, "-m", "pytest", "-q", *worse, f"--benchmark-json={path}"]
            done = subprocess.run(command, capture_output=True, check=False)
            again = load_benchmarks(path) if done.returncode == 0 else {}
        for name in [name for name in worse if name in again]:
            now[name] = _merge_best(was[name], now[name], again[name])


def _merge_best(was: Benchmark, *measured: Benchmark) -> Benchmark:
    """Return the fastest of several measurements, with the exact measures that grew least."""
    exact = min(measured, key=lambda one: len(find_exact_changes(was, one))).exact
    fastest = min(measured, key=lambda one: one.minimum_s / (one.reference_ns or 1.0))
    return replace(fastest, exact=exact)


def main(argv: list[str] | None = None) -> int:
    """Compare with the baseline, or store it where there is none; return the exit code."""
    parser = argparse.ArgumentParser(prog="dpbench.ci.gate", description=__doc__.splitlines()[0])
    parser.add_argument("json", type=Path, metavar="FILE", help="written by --benchmark-json")
    parser.add_argument(
        "baseline", type=Path, help="a JSON file, or a folder that keeps one for each machine"
    )
    parser.add_argument("--renew", action="store_true", help="make this run the baseline")
    parser.add_argument("--retries", type=int, default=3, help="of what looks worse (3)")
    arguments = parser.parse_args(argv)
    console = Console() if sys.stdout.isatty() else Console(width=200)
    baseline: Path = arguments.baseline
    if baseline.suffix != ".json":
        baseline = baseline / f"{describe_machine()['id']}.json"
    try:
        now = load_benchmarks(arguments.json)
        if arguments.renew or not baseline.exists():
            baseline.parent.mkdir(parents=True, exist_ok=True)
            baseline.write_bytes(arguments.json.read_bytes())
            why = "renewed" if arguments.renew else "no baseline of this machine yet"
            console.print(f"{why}: stored {baseline}, nothing compared", soft_wrap=True)
            return 0
        was = load_benchmarks(baseline)
        if not was.keys() & now.keys():
            console.print(f"no benchmark that {baseline} has too, nothing compared", soft_wrap=True)
            return 1
        measure_again(was, now, arguments.retries, console)
        worse = print_comparison(was, now, console, only_changes=True)
    except InputError as error:
        print(f"gate: {error}", file=sys.stderr)
        return 2
    result = "a regression" if worse else "nothing worse"
    console.print(
        f"{result} against {baseline}, {len(was.keys() & now.keys())} benchmarks compared",
        soft_wrap=True,
    )
    return int(worse)


if __name__ == "__main__":
    raise SystemExit(main())
