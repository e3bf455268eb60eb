"""`dpbench worst-case`: the worst step of one solver, over starts and disturbances.

A point of the `SearchSpace` makes a scenario; the solver answers the QPs of its reference loop
in a process of its own; the worst of these steps is the point's score. Differential evolution
(Storn & Price 1997, J. Global Optimization 11, as in SciPy) from a Sobol sample maximises it. The
same seed and versions find the same case.
"""

from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dpbench.bench.plan.configurations import find_plugin_file
from dpbench.bench.progress import Progress, Silent
from dpbench.bench.record.cell import Cell
from dpbench.bench.sequences.sequence_file import save_sequence
from dpbench.bench.workers.child import start_forkserver
from dpbench.bench.workers.interrupts import first_signal_only
from dpbench.bench.workers.scratch import open_scratch_folder
from dpbench.bench.worst_case.search import GOALS, Case, Goal, Search, SearchedSolver, WorstStep
from dpbench.bench.worst_case.space import SearchSpace
from dpbench.errors import InputError, SituationError, begin_in_lower_case, require_integer_at_least
from dpbench.scenario.scenario import MAX_STEPS, Scenario, load_scenario
from dpbench.solvers.contract import DEFAULT, Policy, Route
from dpbench.solvers.own_settings import (
    encode_options_as_json,
    format_options_as_toml,
    parse_choice_without_grid,
)
from dpbench.solvers.table import (
    PluginFiles,
    find_solver_availability,
    find_solver_record,
    load_plugin_solvers,
)

BUDGET = 300
STEPS = 60
"""Steps of a case: 18 s of the paper's ship, in which its slowest thruster reaches its limit."""
WARMUP_STEPS = 50
"""Warm-up steps, as many as in `notebook.runs.replay` and a suite."""
_WORDS = {"timed_out": "slow"}


@dataclass(frozen=True, eq=False)
class WorstCase:
    """Result of a search for a solver's worst step: goal, solver, search and saved files.

    `path` is of the best case, if there is one; `failures` are of the first case of each failure.
    """

    goal: Goal
    cell: Cell
    search: Search
    path: Path
    failures: dict[str, Path]

    @property
    def worst(self) -> WorstStep | None:
        """The worst step found; None where no step could be rated by the goal."""
        return None if self.search.best is None else self.search.best.worst

    @property
    def beats_baseline(self) -> bool:
        """Return whether the worst step is worse than any step of the unchanged scenario."""
        own = self.search.baseline
        return self.worst is not None and (own is None or self.worst.objective > own.objective)

    @property
    def lines(self) -> list[str]:
        """The result of a worst-case search in words: worst step, comparison, failures."""
        search, cell, worst = self.search, self.cell, self.worst
        configuration = f"{cell.solver} {cell.route} {cell.policy} {cell.settings}"
        headline = "nothing found"
        if worst is not None:
            headline = f"{worst.describe_figure(self.goal)} at step {worst.step} of {self.path}"
        early = f" ({search.stopped})" if search.stopped else ""
        outcome = search.baseline_outcome
        own = "" if search.baseline is None else search.baseline.describe_figure(self.goal)
        if outcome.outcome != "finished":
            own = f"{own} ({outcome.detail or outcome.outcome})".strip()
        bested = worst is not None and not self.beats_baseline
        lines = [
            f"{configuration}: {headline}; {_count_cases(search.evaluations)} tried{early}",
            f"worst of the {cell.steps} steps of the unchanged scenario {cell.scenario_name}: {own}"
            + "; no case is worse" * bested,
        ]
        for what, path in self.failures.items():
            count, first = search.failures[what]
            words = f"{_WORDS.get(what, what)} in {_count_cases(count)}"
            lines.append(f"{words} ({first.outcome.detail}); the first is {path}")
        return lines


def _count_cases(count: int) -> str:
    """Return a number of cases as text."""
    return f"{count} case{'s' * (count != 1)}"


def find_worst_case(
    solver: str,
    *,
    scenario: str | Path = "paper",
    goal: Goal = "iterations",
    route: Route | None = None,
    policy: Policy = "fresh",
    settings: str = DEFAULT,
    budget: int = BUDGET,
    steps: int = STEPS,
    seed: int = 1,
    out: str | Path | None = None,
    solver_module: PluginFiles = None,
    progress: Progress | None = None,
) -> WorstCase:
    """Search scenario variants for a solver's worst step, save its QPs, and return the result.

    Ctrl-C ends the search early with the best case so far.

    Parameters
    ----------
    solver : a name, or a name with options as `osqp[rho=1.6]`.
    scenario : whose ship, controller and weather the cases share; goal : as in `find_worst_step`.
    route, policy, settings : of the solver; no route is native where it has that.
    budget : cases tried; steps : length of each.
    out : the `.npz`; by default `worst-cases/<solver>-<goal>.npz`. The first case that crashes or
        hangs the solver is saved beside it.

    Raises
    ------
    InputError : for bad input, or a configuration that cannot run.
    """
    load_plugin_solvers(solver_module)
    _refuse_bad_options(goal, budget, steps, seed)
    solver, own = parse_choice_without_grid(solver, "worst-case", "one value per option")
    if own and settings != DEFAULT:
        found = f"{settings!r} with the options of {solver}"
        raise InputError("--settings", "", found, "a preset or options, not both")
    path = Path("worst-cases") / f"{solver}-{goal}.npz" if out is None else Path(out)
    if path.suffix != ".npz":
        raise InputError("--out", "", repr(path.name), "a file name that ends in .npz")
    base = load_scenario(scenario)
    cell = _make_baseline_cell(solver, route, policy, settings, base)
    if own:
        options = encode_options_as_json(own)
        cell = replace(cell, settings=format_options_as_toml(own), options=options)
    _refuse_unwritable(path)
    space = SearchSpace(base, steps, f"{base.name}-worst-{solver}-{goal}")
    with first_signal_only():
        context = start_forkserver()
        with (
            open_scratch_folder() as folder,
            closing(SearchedSolver(context, folder, cell)) as solver_process,
        ):
            search = Search(solver_process, space, goal, budget, progress or Silent())
            search.run(base, seed)
        return _save_findings(WorstCase(goal, cell, search, path, {}), seed)


def _refuse_bad_options(goal: str, budget: int, steps: int, seed: int) -> None:
    """Raise InputError, naming the option, for a bad goal, budget, number of steps or seed."""
    if goal not in GOALS:
        raise InputError("--goal", "", repr(goal), ", ".join(GOALS))
    require_integer_at_least("--budget", budget, 1)
    require_integer_at_least("--seed", seed, 0)
    if not 1 <= steps <= MAX_STEPS:
        raise InputError("--steps", "", steps, f"a whole number from 1 to {MAX_STEPS}")


def _refuse_unwritable(path: Path) -> None:
    """Raise InputError where a result file cannot be written, before a search of minutes."""
    trial = path.with_name(path.name + ".part")
    missing = [folder for folder in path.parents if not folder.exists()]
    try:
        if path.is_dir():
            raise IsADirectoryError(None, "it is a folder", str(path))
        path.parent.mkdir(parents=True, exist_ok=True)
        trial.touch()
        trial.unlink()
        for folder in missing:
            folder.rmdir()  # Nothing may be found.
    except OSError as error:
        fault = f"cannot write {path} ({begin_in_lower_case(error.strerror or str(error))})"
        raise SituationError("--out", f"{fault}; required: a file that can be written") from error


def _make_baseline_cell(
    solver: str, route: Route | None, policy: Policy, settings: str, base: Scenario
) -> Cell:
    """Return the run that replays the QPs of the unchanged scenario with the solver."""
    row = find_solver_record(solver)
    # Many libraries count their iterations, and qpsolvers does not pass the count on.
    own: Route = "native" if "native" in row.policies_by_route else row.default_route
    return Cell(
        mode="replay",
        scenario=base.files,
        solver=solver,
        route=route or own,
        policy=policy,
        settings=settings,
        steps=base.steps,
        rounds=1,
        warmup_steps=WARMUP_STEPS,
        solver_module=find_plugin_file(solver),
    )


def _save_findings(worst_case: WorstCase, seed: int) -> WorstCase:
    """Save the QPs of the worst case and each failure's first; return the result with paths."""
    search, cell, path = worst_case.search, worst_case.cell, worst_case.path
    facts = {
        "goal": worst_case.goal,
        "solver": cell.solver,
        "solver_version": find_solver_availability(cell.solver).version,
        "route": cell.route,
        "policy": cell.policy,
        "settings": cell.settings,
        "scenario": cell.scenario_name,
        "seed": seed,
        "evaluations": search.evaluations,
    }
    if search.best is not None:
        _save_case(path, search.best, facts)
    places = {
        what: path.with_name(f"{path.stem}-{_WORDS.get(what, what)}.npz")
        for what in search.failures
    }
    for what, place in places.items():
        _save_case(place, search.failures[what][1], facts)
    return replace(worst_case, failures=places)


def _save_case(path: Path, case: Case, facts: dict[str, Any]) -> None:
    """Save the QPs of one scenario variant, with what happened to the solver as metadata."""
    worst = case.worst
    facts = facts | {"outcome": case.outcome.outcome}
    if worst is not None:
        facts |= {
            "step": worst.step,
            "iterations": worst.iterations,
            # JSON has no word for an infinite error.
            "error_plan": repr(worst.error_plan),
            "status": worst.status.name.lower(),
        }
    meta = case.sequence.meta | {f"worst_case_{name}": fact for name, fact in facts.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    save_sequence(path, replace(case.sequence, meta=meta))
