"""One benchmark of pytest-benchmark: a pass over a sequence of QPs, its answers checked."""

import math
from collections.abc import Callable, Collection, Iterable
from functools import partial
from importlib.metadata import version
from inspect import signature
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
import pandas as pd
import pytest

from dpbench.analysis.records.records import find_inaccurate_steps
from dpbench.analysis.records.run_record import build_run_records
from dpbench.analysis.verdict.requirements import Requirements, is_right_on_every_step
from dpbench.bench.sequences.sequence_file import as_sequence
from dpbench.bench.sequences.source import thin_sequence
from dpbench.ci.benchmarks import BY_STEP, WRONG_ANSWERS
from dpbench.ci.machine_state import HasInfo, watch_machine
from dpbench.errors import InputError, SituationError, format_allowed_names, require_type
from dpbench.notebook.runs import Run, replay
from dpbench.qp.program import ARRAYS, QPSequence, QPStep, QuadraticProgram
from dpbench.report.formats import format_error, plural
from dpbench.report.verdict.findings_text import describe_caching_sign
from dpbench.solvers.contract import Workspace
from dpbench.solvers.open import open_workspace
from dpbench.solvers.table import load_plugin_solver_from_file

Given = TypeVar("Given")
WHERE = "dpbench_replay"
ARGUMENTS: dict[str, tuple[Any, str]] = {
    "sequence": (QPSequence | str | Path, "a QPSequence, a name or a .npz file"),
    "solver": (Workspace | str | Path, "a name, the .py file of a plug-in or a workspace"),
    "steps": (Integral | None, "a whole number"),
    "error_move": (Real, "a number, such as 0.01 for 1 % of the maximum increment"),
    "failed_steps": (Integral, "a whole number"),
}
"""Types of the arguments of `dpbench_replay`, and these in words."""
OPTIONS = tuple(signature(open_workspace).parameters)[1:]
"""Its further arguments, which open the solver."""


class BenchmarkFixture(HasInfo, Protocol):
    """Part of the fixture `benchmark` of pytest-benchmark, an extra, that is used here."""

    def __call__(self, function: Callable[[], object]) -> object:
        """Time a function in rounds."""


class ReplayBenchmark:
    """Benchmark of one solver's replay of one sequence; the fixture `dpbench_replay`."""

    def __init__(self, benchmark: BenchmarkFixture, *folders: Path) -> None:
        """Time with a benchmark; relative files are looked for in `folders`, then here."""
        self._benchmark, self._folders = benchmark, folders

    def __call__(
        self,
        sequence: QPSequence | str | Path,
        solver: Workspace | str | Path,
        *,
        steps: int | None = None,
        error_move: float = Requirements.error_move,
        failed_steps: int = Requirements.failed_steps,
        **options: Any,
    ) -> Run:
        """Check the answers of a replay, then time passes over its steps.

        Parameters
        ----------
        sequence : an object, a name or a `.npz` file.
        solver : a name, the `.py` file of a plug-in, or a workspace. A relative file is in the
            folder of the test, in pytest's rootdir or in the present folder.
        steps : only the first so many; by default all.
        error_move : largest error of the first move allowed, in maximum increments.
        failed_steps : number of failed steps allowed.
        options : of `open_workspace` (policy, settings, route), not for a workspace.

        Raises
        ------
        pytest.fail.Exception : an answer is beyond these requirements, or answers are remembered.
        InputError : for an unknown name or option, or a file that cannot be read.
        TypeError : for an unknown argument, or one of another type.
        """
        __tracebackhide__ = True
        _require_arguments((sequence, solver, steps, error_move, failed_steps), options)
        try:
            qps = thin_sequence(as_sequence(self._find_given_file(sequence, ".npz")), steps)
            workspace = _open_solver(self._find_given_file(solver, ".py"), options)
        except InputError as error:
            # The mistake is in the test, whose line pytest shows.
            raise error.with_traceback(None) from error.__cause__
        run = replay(qps, workspace, repeats=2)
        self._store_facts(run)
        requirements = Requirements(error_move=error_move, failed_steps=failed_steps)
        _fail_on_wrong_answers(run, requirements)
        base, given = qps.base.for_setup().copy(), [qps.step(k) for k in range(len(qps))]
        with watch_machine(self._benchmark):
            self._benchmark(_make_pass_over_steps(base, given, workspace))
        if not _are_arrays_unchanged(qps, base, given):
            pytest.fail(
                f"{run.label} overwrites the problem, so its time is not that of this problem",
                pytrace=False,
            )
        return run

    def _find_given_file(self, given: Given, suffix: str) -> Given | Path:
        """Return the path of a relative file that is given by name; anything else as it is."""
        if not isinstance(given, (str, Path)) or not str(given).endswith(suffix):
            return given
        places = (folder / given for folder in self._folders)
        return next((place for place in places if place.is_file()), Path(given))

    def _store_facts(self, run: Run) -> None:
        """Store what identifies a replay and what it reached in the JSON of pytest-benchmark."""
        row, info = run.summary, self._benchmark.extra_info
        info["dpbench"] = version("dpbench")
        # Without the settings, as in baselines that are stored.
        info["solver"] = "{solver} ({route}, {policy})".format(**row)
        info["sequence"] = str(row["sequence"] or row["scenario"])
        for name in ("steps_done", "failed_steps", "claimed_not_true"):
            info[name] = int(row[name])
        info["error_move_max"] = float(row["error_move_max"])
        info["true_share"] = float(np.nan_to_num(row["true_share"]))
        first, second = (run.steps.loc[run.steps["repeat"] == r] for r in (1, 2))
        info["active_share"] = float((first["n_active"] > 0).mean())
        # Where rounds differ, the clock has a part in them.
        exact, by_step = info["exact"], info[BY_STEP] = {}, {"k": first["k"].tolist()}
        if first["iterations"].notna().all() and row["iterations_identical_share"] == 1.0:
            exact["iterations"] = int(first["iterations"].sum())
            by_step["iterations"] = first["iterations"].astype(int).tolist()
        if np.array_equal(first["error_move"], second["error_move"]):
            exact["error_move_max"] = info["error_move_max"]
            by_step["error_move_max"] = first["error_move"].tolist()


def _require_arguments(given: Iterable[object], options: Collection[str]) -> None:
    """Raise TypeError for a given argument of another type, or for the name of an unknown one."""
    __tracebackhide__ = True
    for name in options:
        if name not in OPTIONS:
            allowed = format_allowed_names(name, [*ARGUMENTS, *OPTIONS])
            raise TypeError(f"{WHERE}: found argument {name}; allowed: {allowed}")
    try:
        for value, (name, (kind, allowed)) in zip(given, ARGUMENTS.items(), strict=True):
            require_type(f"{WHERE}: {name}", value, kind, allowed)
    except TypeError as error:
        raise error.with_traceback(None) from None


def _open_solver(solver: Workspace | str | Path, options: dict[str, Any]) -> Workspace:
    """Open a solver by name or file; a workspace is returned as it is."""
    if isinstance(solver, Workspace):
        if options:
            raise SituationError(
                WHERE,
                "found options with an open workspace; give them to open_workspace",
            )
        return solver
    if isinstance(solver, Path) or solver.endswith(".py"):
        solver = load_plugin_solver_from_file(solver).name
    return open_workspace(solver, **options)


def _fail_on_wrong_answers(run: Run, requirements: Requirements) -> None:
    """Fail the test where a replay does not meet the requirements, with what was found."""
    (record,) = build_run_records(pd.DataFrame([run.summary]))
    if is_right_on_every_step(record, requirements):
        return
    error = format_error(record.error_move_max)
    unit = " maximum increments" if math.isfinite(record.error_move_max) else ""
    count, _ = find_inaccurate_steps(run.steps, requirements.error_move)
    worst = (
        f" at step {run.steps['k'].iloc[np.nanargmax(run.steps['error_move'])]}" if count else ""
    )
    over = f", exceeded in {count} of {plural(record.steps_planned, 'step')}" if count else ""
    found = (
        f"{run.label} on {run.summary['sequence'] or run.summary['scenario']}: largest error of "
        f"the first move {error}{unit}{worst} (allowed {requirements.error_move:g}{over}), "
        f"{record.steps_done:g} of {plural(record.steps_planned, 'step')} done, "
        f"{record.failed_steps:g} failed (allowed {requirements.failed_steps})"
    )
    reason = describe_caching_sign(record.configuration.solver, record.caching_sign)
    reason = reason or WRONG_ANSWERS
    pytest.fail(f"{reason}: {found}", pytrace=False)


def _make_pass_over_steps(
    base: QuadraticProgram, steps: list[QPStep], workspace: Workspace
) -> Callable[[], None]:
    """Return a function that solves all steps once, without the harness's clocks and records."""
    if workspace.setup_every_step:
        starts = [partial(workspace.setup, base.at(step)) for step in steps]
    else:
        workspace.setup(base)
        starts = [partial(workspace.update, step) for step in steps]

    def solve_all() -> None:
        workspace.reset()
        for start in starts:
            start()
            workspace.solve()
            if not workspace.read().status.is_usable:
                workspace.reset()

    return solve_all


def _are_arrays_unchanged(
    sequence: QPSequence, base: QuadraticProgram, steps: list[QPStep]
) -> bool:
    """Return whether a solver has left the arrays as they were that it was given."""
    fresh = [sequence.base.for_setup(), *(sequence.step(k) for k in range(len(sequence)))]
    pairs = zip(fresh, [base, *steps], strict=True)
    arrays = ((getattr(a, name), getattr(b, name)) for a, b in pairs for name in ARRAYS)
    return all(a is b or np.array_equal(a, b) for a, b in arrays)
