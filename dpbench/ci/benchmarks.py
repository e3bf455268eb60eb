"""JSON files of pytest-benchmark: times, exact measures, the machine's state, tests that failed."""

import json
import sys
import sysconfig
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from dpbench.ci.machine_state import KEY, MachineState
from dpbench.errors import InputError, SituationError, shorten_found
from dpbench.report.formats import plural

FAILED = "dpbench_failed"
"""Key of a JSON file: the reason of each benchmark that failed, by name."""
IMPORTED = "dpbench_imported"
"""Key of a JSON file: the files of imported modules, of site-packages only top-level ones."""
SELECTION = "dpbench_selection"
"""Key of a JSON file: which tests the session was given."""
COLLECTED = "dpbench_collected"
"""Key of a JSON file: the number of benchmarks among the tests."""
PATHS = "dpbench_paths"
"""Key of a JSON file: the arguments of the session that are files, folders or node ids."""
BY_STEP = "exact_by_step"
"""Key of `extra_info`: the exact measures at each step, and the steps as `k`."""
WRONG_ANSWERS = "wrong answers"
"""Beginning of the reason where a replay does not meet its requirements."""
ALLOWED = "a JSON file of pytest-benchmark, written with --benchmark-json"
BLOCKS = 4
"""The rounds of a benchmark are cut into so many consecutive blocks, whose minima scatter."""


@dataclass(frozen=True)
class Benchmark:
    """One benchmark of a run: minimum [s], its rough standard error, what was noted beside it.

    error : of log(minimum), from inside the run.
    solver : "" where none was noted.
    is_verified : whether every answer was verified; True where none was checked.
    by_step : exact measures at each step of the sequence, and the steps as `k`; may be empty.
    complaints : what disturbed the machine meanwhile.
    machine : its state meanwhile; None if unknown.
    """

    name: str
    minimum_s: float
    error: float
    reference_ns: float | None
    exact: Mapping[str, float]
    solver: str
    is_verified: bool = True
    sequence: str = ""
    by_step: Mapping[str, Sequence[float]] = field(default_factory=dict)
    complaints: tuple[str, ...] = ()
    machine: MachineState | None = None

    @classmethod
    def from_json_entry(cls, entry: Mapping[str, Any]) -> "Benchmark":
        """Return the benchmark in a JSON entry; KeyError, TypeError or ValueError if it is none.

        InputError for an exact measure that is no number.
        """
        stats, extra = entry["stats"], entry.get("extra_info", {})
        reference = extra.get("reference_ns")
        times = float(stats["min"]), float(stats["q1"])
        if not (0.0 < times[0] <= times[1] < np.inf and (reference is None or reference > 0)):
            raise ValueError(f"times {times}, reference_ns {reference}")
        name = str(entry["fullname"])
        # Without the route: a change of a solver slows it on each.
        solver = str(extra.get("solver", "")).partition(" (")[0]
        return cls(
            name,
            times[0],
            _estimate_error(*times, int(stats["rounds"]), stats.get("data", [])),
            reference,
            read_exact_measures(name, extra),
            solver,
            extra.get("true_share", 1.0) == 1.0,
            str(extra.get("sequence", "")),
            dict(extra.get(BY_STEP, {})),
            tuple(read_complaints(extra)),
            MachineState.from_stored_state(extra[KEY]) if KEY in extra else None,
        )

    @property
    def name_in_allowance(self) -> str:
        """Name of the solver, or the benchmark's own where none was noted."""
        return self.solver or self.name


def read_exact_measures(name: str, extra: Mapping[str, Any]) -> dict[str, float]:
    """Return the exact measures of a named benchmark; InputError for one that is no number."""
    stored = extra.get("exact", {})
    if not isinstance(stored, Mapping):
        raise InputError(name, 'extra_info["exact"]', shorten_found(stored), "numbers by name")
    for measure, value in stored.items():
        if not isinstance(value, Real) or value != value:  # NaN is larger than nothing
            key = f'extra_info["exact"]["{measure}"]'
            raise InputError(name, key, shorten_found(value), "a number")
    return dict(stored)


def read_complaints(extra: Mapping[str, Any]) -> list[str]:
    """Return what disturbed the machine during a benchmark, from its `extra_info`."""
    return MachineState.from_stored_state(extra[KEY]).complaints() if KEY in extra else []


def describe_disturbed_baseline(disturbed: int, count: int) -> str:
    """Return a warning for stored times of which so many have no verdict; "" for none."""
    if not disturbed:
        return ""
    return (
        f"machine disturbed in {disturbed} of {plural(count, 'benchmark')}: as a baseline, their "
        "times will not be compared; measure again on a quiet machine"
    )


def describe_quiet_baseline(stored: Sequence[Mapping[str, Any]]) -> str:
    """Return a line on stored times of a quiet machine, of each `extra_info`; "" for no state."""
    known = sum(KEY in extra for extra in stored)
    if not known:
        return ""
    return (
        f"machine quiet; reference kernel stored in {known} of {plural(len(stored), 'benchmark')}"
    )


def describe_unusable_times(base: "BenchmarkRun", path: Path) -> str:
    """Return a line on times of a stored baseline that no new run can judge; "" for none."""
    if not base.disturbed:
        return ""
    return (
        f"the machine was disturbed in {base.disturbed} of "
        f"{plural(len(base.benchmarks), 'benchmark')} of the baseline {path}: no repeat of the "
        "head gives a verdict on their times; store the baseline again on a quiet machine"
    )


def describe_disjoint_runs(base: "BenchmarkRun", head: "BenchmarkRun", path: Path) -> str:
    """Return the fault of a head without a benchmark of the baseline `path`; "" for none."""
    is_disjoint = head.names and base.names.isdisjoint(head.names)
    return f"no benchmark in common with {path}" if is_disjoint else ""


def _estimate_error(
    minimum_s: float, quartile_s: float, rounds: int, data: Iterable[float]
) -> float:
    """Estimate the standard error of log(minimum) from the quartile, and from blocks of rounds."""
    spread = float(np.log(quartile_s / minimum_s))
    error = spread / 4.0 / float(np.sqrt(max(1.0, rounds / 10.0)))
    times = np.array(list(data), dtype=np.float64)
    if len(times) < BLOCKS:
        return error
    least = [np.log(block.min()) for block in np.array_split(times, BLOCKS)]
    return max(error, float(np.std(least, ddof=1)) / float(np.sqrt(BLOCKS)))


@dataclass(frozen=True)
class Selection:
    """Tests of a pytest session: node ids of its arguments, and of tests deselected as by -k."""

    given: tuple[str, ...] = (".",)
    deselected: frozenset[str] = frozenset()

    @classmethod
    def from_json_entry(cls, entry: Mapping[str, Iterable[str]]) -> "Selection":
        """Return the selection in a JSON file; KeyError or TypeError if it is none."""
        return cls(tuple(map(str, entry["given"])), frozenset(map(str, entry["deselected"])))

    @property
    def json_entry(self) -> dict[str, list[str]]:
        """The selection as stored in a JSON file."""
        return {"given": [*self.given], "deselected": sorted(self.deselected)}

    def leaves_out(self, name: str) -> bool:
        """Return True if a test was deselected, or is in none of the files that were given."""
        file, _, own = name.partition("::")
        for argument in self.given:
            place, _, test = argument.partition("::")
            is_named = not test or f"{own}[".startswith((f"{test}[", f"{test}::"))
            if is_named and Path(file).is_relative_to(place):
                return name in self.deselected
        return True


@dataclass(frozen=True)
class BenchmarkRun:
    """The benchmarks of one run of pytest by name, and the reasons of those that failed.

    imported : files of the modules that `list_imported_files` found.
    collected : number of benchmarks among the tests; None if unknown.
    paths : arguments of the session that are files, folders or node ids.
    """

    benchmarks: dict[str, Benchmark] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    imported: tuple[str, ...] = ()
    selection: Selection = Selection()
    collected: int | None = None
    paths: tuple[str, ...] = ()

    @classmethod
    def from_json_entries(
        cls, entries: Iterable[Mapping[str, Any]], failed: Mapping[str, str]
    ) -> "BenchmarkRun":
        """Return the run of the entries of a JSON file; one that failed has no time."""
        timed = (entry for entry in entries if entry["fullname"] not in failed)
        found = {one.name: one for one in map(Benchmark.from_json_entry, timed)}
        return cls(found, dict(failed))

    @property
    def disturbed(self) -> int:
        """Number of benchmarks during which other load disturbed the machine."""
        return sum(bool(one.complaints) for one in self.benchmarks.values())

    @property
    def names(self) -> set[str]:
        """Names of all benchmarks, those that failed included."""
        return {*self.benchmarks, *self.failed}


def list_imported_files() -> list[str]:
    """Return the files of imported modules, without the standard library.

    Of site-packages only those of top-level modules and packages.
    """
    standard = [Path(sysconfig.get_path(name)).resolve() for name in ("stdlib", "platstdlib")]
    found = set()
    for module, name in [(one, getattr(one, "__file__", None)) for one in [*sys.modules.values()]]:
        if not isinstance(name, str):
            continue
        file = Path(name).resolve()
        if is_in_site_packages(file):
            if "." not in module.__name__:
                found.add(file)
        elif not any(file.is_relative_to(folder) for folder in standard):
            found.add(file)
    return sorted(map(str, found))


def find_source_files(folder: Path) -> list[str]:
    """Return the files that Python would import for the modules and packages in a folder."""
    sources = (*folder.glob("*.py"), *folder.glob("*/__init__.py"))
    names = {one.parent.name if one.stem == "__init__" else one.stem for one in sources}
    specs = [find_spec(name) for name in sorted(names) if name.isidentifier()]
    return [str(Path(one.origin).resolve()) for one in specs if one is not None and one.origin]


def is_in_site_packages(file: Path) -> bool:
    """Return True if a file is in site-packages."""
    return not {"site-packages", "dist-packages"}.isdisjoint(file.parts)


def load_run(path: Path) -> BenchmarkRun:
    """Read the benchmarks in a JSON file; InputError for a file that has none."""
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        run = BenchmarkRun.from_json_entries(stored["benchmarks"], stored.get(FAILED, {}))
        run = replace(run, imported=tuple(map(str, stored.get(IMPORTED, ()))))
        if SELECTION in stored:
            run = replace(run, selection=Selection.from_json_entry(stored[SELECTION]))
    except OSError as error:
        raise InputError(str(path), "", error.strerror or "an unreadable file", ALLOWED) from error
    except InputError as error:
        key = f"{error.where}: {error.key}"
        raise InputError(str(path), key, error.found, error.allowed) from error
    except (ValueError, TypeError, AttributeError) as error:
        raise SituationError(str(path), f"cannot be read ({error}); required: {ALLOWED}") from error
    except KeyError as error:
        raise InputError(str(path), str(error.args[0]), "nothing", ALLOWED) from error
    if not run.names:
        raise InputError(str(path), "benchmarks", "none", ALLOWED)
    return run
