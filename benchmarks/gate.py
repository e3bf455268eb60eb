"""Compare a JSON of pytest-benchmark with the stored one of the same machine; see `make help`.

    python benchmarks/gate.py results/bench-ci.json results/baseline [--renew] [--retries 3]

Exact measures (`extra_info["exact"]`: iterations, rows, peak bytes of Python) gate tightly. A time
is the benchmark's minimum in units of the reference kernel, timed just before and after it in the
same run; it gates where the ratio of the two runs, less what all benchmarks share, is beyond the
margin by more than the ratios scatter, and still is when the benchmark was measured again: noise
only ever makes a minimum larger. Exit 0: nothing worse, or no baseline yet, which is stored;
1: a regression; 2: bad input.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from dpbench.analysis.compare.evidence import (
    Assessment,
    Prior,
    assess_ratios,
    remove_machine_factor,
)
from dpbench.bench.record.machine import describe_machine
from dpbench.errors import InputError

ROOT = Path(__file__).parents[1]
MARGIN, ALPHA = 0.15, 0.05
NOISE = Prior(sd=0.05, df=6.0)
"""Of one benchmark in its few rounds, between two runs of the same code."""
SLACK = {"peak_bytes": (1.1, 128.0)}
"""Factor and number by which an exact measure may grow: when SciPy's garbage goes is not exact."""
PYTEST = ("-m", "pytest", "-q", "--override-ini", "addopts=--import-mode=importlib")
ALLOWED = "a JSON file by `make bench-ci`"


def load(path: Path) -> dict[str, dict[str, Any]]:
    """Benchmarks by name; InputError for a file that is none, or without the reference kernel."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        found = {b["fullname"]: b for b in document["benchmarks"]}
        for benchmark in found.values():
            smallest, reference = benchmark["stats"]["min"], benchmark["extra_info"]["reference_ns"]
            benchmark["relative"] = 1e9 * float(smallest) / float(reference)
    except OSError as error:
        raise InputError(str(path), "", error.strerror or "unreadable", ALLOWED) from error
    except (ValueError, TypeError, ZeroDivisionError) as error:
        raise InputError(str(path), "", f"no such numbers ({error})", ALLOWED) from error
    except KeyError as error:
        raise InputError(str(path), str(error.args[0]), "nothing", ALLOWED) from error
    if not found:
        raise InputError(str(path), "benchmarks", "none", ALLOWED)
    return found


def exact_changes(was: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What grew of the exact measures of one benchmark, in words."""
    before, after = was["extra_info"].get("exact", {}), now["extra_info"].get("exact", {})
    said = []
    for name in sorted(before.keys() & after.keys()):
        factor, more = SLACK.get(name, (1.0, 0.0))
        if after[name] > factor * before[name] + more:
            said.append(f"{name} {before[name]} → {after[name]}")
    said += [f"{name} is no longer measured" for name in sorted(before.keys() - after.keys())]
    return said


def time_changes(
    was: Mapping[str, Mapping[str, Any]], now: Mapping[str, Mapping[str, Any]]
) -> dict[str, Assessment]:
    """A verdict on the time of each benchmark that both runs have."""
    names = [name for name in now if name in was]
    logs = np.log([now[name]["relative"] / was[name]["relative"] for name in names])
    own = np.array([_error(was[name]) + _error(now[name]) for name in names])
    found = assess_ratios(
        remove_machine_factor(logs, own, ["run"] * len(names), NOISE), MARGIN, ALPHA
    )
    return dict(zip(names, found, strict=True))


def _error(benchmark: Mapping[str, Any]) -> float:
    """Rough standard error of log(minimum): a quarter of how far the lower quartile lies above."""
    stats = benchmark["stats"]
    spread = float(np.log(stats["q1"] / stats["min"]))
    return spread / 4.0 / np.sqrt(max(1.0, stats["rounds"] / 10.0))


def measure_again(
    was: dict[str, dict[str, Any]], now: dict[str, dict[str, Any]], retries: int, console: Console
) -> None:
    """Run what looks worse again, up to so many times; what is less stands in `now`."""
    for _ in range(retries):
        times = time_changes(was, now)
        worse = [
            name
            for name, found in times.items()
            if found.verdict == "slower" or exact_changes(was[name], now[name])
        ]
        if not worse:
            return
        console.print(f"measuring {len(worse)} again", soft_wrap=True)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "again.json"
            command = [sys.executable, *PYTEST, *worse, f"--benchmark-json={path}"]
            done = subprocess.run(command, cwd=ROOT, capture_output=True, check=False)
            again = load(path) if done.returncode == 0 else {}
        for name in [name for name in worse if name in again]:
            exact = min(now[name], again[name], key=lambda one: len(exact_changes(was[name], one)))
            quicker = min(now[name], again[name], key=lambda one: float(one["relative"]))
            now[name] = quicker | {"extra_info": exact["extra_info"]}


def compare(was: Mapping[str, Any], now: Mapping[str, Any], console: Console) -> bool:
    """Print what changed; whether anything is worse."""
    table = Table(show_edge=False, pad_edge=False)
    for head in ("benchmark", "time against all others", "exact measures"):
        table.add_column(head, overflow="fold")
    worse = False
    for name, found in time_changes(was, now).items():
        exact = exact_changes(was[name], now[name])
        claimed = found.verdict in ("slower", "faster")
        worse |= bool(exact) or found.verdict == "slower"
        if exact or claimed:
            ratio = found.ratio
            time = f"{found.verdict} {ratio.value:.2f} [{ratio.low:.2f}, {ratio.high:.2f}]"
            table.add_row(Text(name), Text(time), "; ".join(exact) or "no more than before")
    if table.row_count:
        console.print(table)
    for what, names in (("gone", was.keys() - now.keys()), ("new", now.keys() - was.keys())):
        for name in sorted(names):
            console.print(f"{what}: {name}", markup=False)
    return worse


def main(argv: list[str] | None = None) -> int:
    """Compare, or store what there is to compare with next time."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("json", type=Path, help="by `make bench-ci`")
    parser.add_argument("folder", type=Path, help="where baselines are kept, one per machine")
    parser.add_argument("--renew", action="store_true", help="make this run the baseline")
    parser.add_argument("--retries", type=int, default=3, help="of what looks slower (3)")
    asked = parser.parse_args(argv)
    console = Console() if sys.stdout.isatty() else Console(width=200)
    baseline = asked.folder / f"{describe_machine()['id']}.json"
    try:
        now = load(asked.json)
        if asked.renew or not baseline.exists():
            asked.folder.mkdir(parents=True, exist_ok=True)
            baseline.write_bytes(asked.json.read_bytes())
            why = "renewed" if asked.renew else "no baseline of this machine yet"
            console.print(f"{why}: stored {baseline}, nothing compared", soft_wrap=True)
            return 0
        was = load(baseline)
        measure_again(was, now, asked.retries, console)
        worse = compare(was, now, console)
    except InputError as error:
        print(f"gate: {error}", file=sys.stderr)
        return 2
    said = "a regression" if worse else "nothing worse"
    console.print(f"{said} against {baseline}, {len(now)} benchmarks", soft_wrap=True)
    return int(worse)


if __name__ == "__main__":
    raise SystemExit(main())
