"""Comparison of two JSON files of pytest-benchmark from one machine.

A time is the benchmark's minimum, in units of the reference kernel where both runs have timed that
beside the benchmark (`extra_info["reference_ns"]`). It is worse where the ratio of the two runs,
without the factor that the benchmarks of other solvers share, is beyond the margin by more than the
ratios scatter. Exact measures (`extra_info["exact"]`: iterations, instructions, error, rows, peak
bytes) are worse where they grow.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
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
from dpbench.ci import MARGIN
from dpbench.errors import InputError

ALPHA = 0.05
NOISE = Prior(sd=0.05, df=6.0)
"""Noise of one benchmark in its few rounds, between two runs of the same code."""
SLACK = {"peak_bytes": (1.1, 128.0), "error_move_max": (1.1, 1e-9)}
"""Factor and number by which an exact measure may grow: when SciPy frees memory is not exact, and
an error below 1e-9 of a rate-limit step is rounding."""
ALLOWED = "a JSON file of pytest-benchmark, written by --benchmark-json"


@dataclass(frozen=True)
class Benchmark:
    """One benchmark of a run: minimum and lower quartile [s], rounds, what was noted beside it.

    `solver` is the benchmark's own name where no solver was noted.
    """

    name: str
    minimum_s: float
    quartile_s: float
    rounds: int
    reference_ns: float | None
    exact: Mapping[str, float]
    solver: str

    @classmethod
    def read(cls, entry: Mapping[str, Any]) -> "Benchmark":
        """Read an entry of a JSON file; KeyError, TypeError or ValueError if it is none."""
        stats, extra = entry["stats"], entry.get("extra_info", {})
        reference = extra.get("reference_ns")
        times = float(stats["min"]), float(stats["q1"])
        if not (0.0 < times[0] <= times[1] < np.inf and (reference is None or reference > 0)):
            raise ValueError(f"times {times}, reference_ns {reference}")
        exact, name = dict(extra.get("exact", {})), str(entry["fullname"])
        # Without the route: a change of a solver slows it on each.
        solver = str(extra.get("solver", name)).partition(" (")[0]
        return cls(name, *times, int(stats["rounds"]), reference, exact, solver)

    @property
    def error(self) -> float:
        """Rough standard error of log(minimum): a quarter of the way to the lower quartile."""
        spread = float(np.log(self.quartile_s / self.minimum_s))
        return spread / 4.0 / float(np.sqrt(max(1.0, self.rounds / 10.0)))


Benchmarks = dict[str, Benchmark]


def index_benchmarks(entries: Iterable[Mapping[str, Any]]) -> Benchmarks:
    """Return the benchmarks of a pytest run by name, from the entries of its JSON file."""
    return {one.name: one for one in map(Benchmark.read, entries)}


def load_benchmarks(path: Path) -> Benchmarks:
    """Read the benchmarks in a JSON file by name; InputError for a file that has none."""
    try:
        found = index_benchmarks(json.loads(path.read_text(encoding="utf-8"))["benchmarks"])
    except OSError as error:
        raise InputError(str(path), "", error.strerror or "unreadable", ALLOWED) from error
    except (ValueError, TypeError, AttributeError) as error:
        raise InputError(str(path), "", f"no such numbers ({error})", ALLOWED) from error
    except KeyError as error:
        raise InputError(str(path), str(error.args[0]), "nothing", ALLOWED) from error
    if not found:
        raise InputError(str(path), "benchmarks", "none", ALLOWED)
    return found


def find_exact_changes(was: Benchmark, now: Benchmark) -> list[str]:
    """Describe which exact measures of one benchmark grew or are missing."""
    changes = []
    for name in sorted(was.exact.keys() & now.exact.keys()):
        factor, more = SLACK.get(name, (1.0, 0.0))
        if now.exact[name] > factor * was.exact[name] + more:
            changes.append(f"{name} {was.exact[name]:.6g} → {now.exact[name]:.6g}")
    missing = sorted(was.exact.keys() - now.exact.keys())
    return changes + [f"{name} is no longer measured" for name in missing]


def assess_times(was: Benchmarks, now: Benchmarks, margin: float = MARGIN) -> dict[str, Assessment]:
    """Assess the time of each benchmark that both runs have.

    Below three benchmarks of other solvers the reference kernel stands for the machine; without it
    there is no verdict.
    """
    pairs = [(was[name], now[name]) for name in now if name in was]
    kernels = np.array([_kernel_factor(*pair) for pair in pairs])
    logs = np.array([np.log(after.minimum_s / before.minimum_s) for before, after in pairs])
    logs -= np.nan_to_num(kernels)
    own = np.array([before.error + after.error for before, after in pairs])
    groups = ["plain" if np.isnan(kernel) else "kernel" for kernel in kernels]
    solvers = [after.solver for _, after in pairs]
    evidence = remove_machine_factor(logs, own, groups, NOISE, 0.0 * kernels, subjects=solvers)
    found = assess_ratios(evidence, margin, ALPHA)
    return {after.name: one for (_, after), one in zip(pairs, found, strict=True)}


def _kernel_factor(was: Benchmark, now: Benchmark) -> float:
    """Return the log ratio of the reference kernel of two runs; NaN where one did not time it."""
    if was.reference_ns is None or now.reference_ns is None:
        return np.nan
    return float(np.log(now.reference_ns / was.reference_ns))


def is_worse(was: Benchmark, now: Benchmark, time: Assessment) -> bool:
    """Return whether a benchmark is slower or an exact measure of it grew."""
    return time.verdict == "slower" or bool(find_exact_changes(was, now))


def print_comparison(
    was: Benchmarks,
    now: Benchmarks,
    console: Console,
    *,
    margin: float = MARGIN,
    only_changes: bool = False,
) -> bool:
    """Print a row for each benchmark that both runs have; return whether any is worse."""
    table = Table(show_edge=False, pad_edge=False)
    for head in ("benchmark", "time", "ratio", "exact measures"):
        table.add_column(head, overflow="fold")
    worse = False
    for name, found in assess_times(was, now, margin).items():
        exact, ratio = find_exact_changes(was[name], now[name]), found.ratio
        worse |= is_worse(was[name], now[name], found)
        if exact or found.verdict in ("slower", "faster") or not only_changes:
            known = np.isfinite(ratio.high)
            number = f"{ratio.value:.2f} [{ratio.low:.2f}, {ratio.high:.2f}]" if known else "–"
            verdict = found.verdict if known else "no reference kernel"
            table.add_row(Text(name), verdict, Text(number), "; ".join(exact) or "not larger")
    if table.row_count:
        console.print(table)
    for what, names in (("gone", was.keys() - now.keys()), ("new", now.keys() - was.keys())):
        for name in sorted(names):
            console.print(f"{what}: {name}", markup=False, soft_wrap=True)
    return worse
