"""`dpbench tune-solver`: the fastest settings of a solver that meet the accuracy requirement.

The search sees the training sequences alone. In the end the best settings and the default ones are
timed anew side by side, on these and on the test sequences.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np

from dpbench.analysis.verdict.requirements import Requirements
from dpbench.bench.progress import Progress, Silent
from dpbench.errors import InputError, PolicyError, require_integer_at_least
from dpbench.files.writing import write_text_atomically
from dpbench.report.formats import and_list
from dpbench.solvers.contract import Options, Policy, Route
from dpbench.solvers.own_settings import (
    expand_option_grid,
    format_options_as_toml,
    parse_options_of_choice,
    split_into_solver_and_options_text,
)
from dpbench.solvers.record import HIGH
from dpbench.solvers.settings import (
    has_distinct_tolerance_presets,
    has_preset_or_tolerance,
    resolve_settings_to_options,
)
from dpbench.solvers.table import (
    find_solver_record,
    get_native_adapter,
    get_qpsolvers_adapter,
    load_plugin_solver_from_file,
    require_solver_available,
)
from dpbench.tuning.campaigns import (
    DEFAULT,
    TunedSolver,
    measure_settings,
    runs_by_settings,
    score_settings,
)
from dpbench.tuning.search import Score, SettingsSearch, split_into_batches
from dpbench.tuning.sequences import TunedProblem, load_problem, refuse_overlap
from dpbench.tuning.solver_tuning import BEST, YOURS, TunedRole, Tuning, settings_toml
from dpbench.tuning.space import SearchSpace, make_space

TRAINING = ("paper", "rough", "turn")
TEST = ("move", "extreme", "weather")
TRIALS = 48


class _BatchProgress:
    """The progress of several campaigns as that of one, with the batch in front of each text."""

    def __init__(self, progress: Progress, batches: int) -> None:
        self._progress, self._batches = progress, batches
        self._batch = 0
        self._remarks: set[str] = set()

    def start(self, work: int) -> None:
        """Begin the next campaign; the first one sets the total work of all of them."""
        self._batch += 1
        if self._batch == 1:
            self._progress.start(work * self._batches)

    def advance(self, work: int, what: str) -> None:
        """Add finished work [steps] of this campaign."""
        self._progress.advance(work, f"batch {self._batch}/{self._batches}: {what}")

    def remark(self, text: str) -> None:
        """Show a remark of the campaigns once, even if several make it."""
        if text not in self._remarks:
            self._remarks.add(text)
            self._progress.remark(text)

    def waiting(self, text: str) -> None:
        """Show why a campaign of the search waits."""
        self._progress.waiting(text)


def tune_solver(
    solver: str,
    *,
    training: Sequence[str] = (),
    test: Sequence[str] = (),
    ranges: Sequence[str] = (),
    widened: Sequence[str] = (),
    route: Route | None = None,
    policy: Policy = "fresh",
    error_move: float = Requirements.error_move,
    trials: int = TRIALS,
    steps: int = 0,
    seed: int = 1,
    name: str = "tuned",
    out: str | Path | None = None,
    solver_module: str | None = None,
    wait_s: float | None = None,
    progress: Progress | None = None,
) -> Tuning:
    """Search a solver's settings on training sequences and measure the best on test sequences.

    Finished runs are kept: the same call goes on after an interruption.

    Parameters
    ----------
    solver : a name, or with settings of one's own as `osqp[rho=1.6]`: the search starts with these,
        keeps those of their options that it does not search, and measures them beside the best.
    training, test : recorded sequences or scenarios; by default `TRAINING` and `TEST`.
    ranges : texts such as `rho=[1e-3,10]`, in place of the stated ranges of the solver.
    widened : such texts beside the other ranges.
    route, policy : of the solver; no route is native where it has that.
    error_move : the accuracy requirement, largest error of the first move [rate-limit steps].
    trials : settings to try, beside one's own; steps : of a scenario, 0 for all.
    name : of the settings in the TOML file that is written.
    out : folder; by default `results/tune-SOLVER`.
    wait_s : the longest wait of a batch for another campaign on this machine; None without a
        limit, 0 for none.

    Raises
    ------
    InputError : for bad input, training and test sequences that overlap, or a solver that is
        missing or has no stated ranges.
    BusyError : the machine was busy longer than `wait_s`; finished runs are kept.
    """
    if solver_module is not None:
        load_plugin_solver_from_file(solver_module)
    _check_numbers(trials, steps, seed, error_move)
    solver, given = _read_start(solver)
    tuned = _choose_call(solver, route, policy, Requirements(error_move=error_move), solver_module)
    if has_preset_or_tolerance(solver, name) or not re.fullmatch(r"[\w-]{1,80}", name, re.ASCII):
        allowed = f"letters, digits, _ and -; no preset of {solver}"
        raise InputError("--name", "", repr(name)[:90], allowed)
    space = make_space(solver, ranges, widened, given)
    start = space.with_types(given) if given else None
    _check_options(tuned, space, start)
    learned = [load_problem(one, steps) for one in training or TRAINING]
    other = [load_problem(one, steps) for one in test or TEST]
    refuse_overlap(learned, other)
    folder = Path(out) if out is not None else Path("results") / f"tune-{solver}"
    bar = _BatchProgress(progress or Silent(), len(split_into_batches(trials)) + 1)
    for remark in _list_remarks(policy, [*learned, *other], space, start):
        bar.remark(remark)
    search = _search_settings(tuned, learned, space, folder, trials, seed, bar, start, wait_s)
    best = search.best
    tuning = Tuning(
        tuned, best, len(search.trials), space.describe_edges(best.options), (), folder, None
    )
    if not best.score.is_right:
        return tuning
    roles = _measure_roles(tuned, best.options, start, learned, other, folder, bar, wait_s)
    tuning = replace(tuning, roles=roles, path=folder / f"{name}.toml")
    write_text_atomically(folder / f"{name}.toml", settings_toml(tuning, name))
    return tuning


def _read_start(choice: str) -> tuple[str, Options]:
    """Return solver and options of a choice such as `osqp[rho=1.6]`; InputError for a grid."""
    solver, _ = split_into_solver_and_options_text(choice)
    points = expand_option_grid(parse_options_of_choice(choice), f"solver {solver}")
    if len(points) != 1:
        allowed = "one value an option; --range or --widen 'OPTION=[LEAST,LARGEST]' for a range"
        raise InputError("tune-solver", "", choice[:90], allowed)
    return solver, points[0]


def _list_remarks(
    policy: Policy, problems: Sequence[TunedProblem], space: SearchSpace, start: Options | None
) -> list[str]:
    """Return remarks on a warm start from a distant step, and on a start at the edge of a range."""
    thinned = [f"{one.name} (one step of {one.every})" for one in problems if one.every > 1]
    remarks = []
    if policy == "warm" and thinned:
        remarks.append(
            f"warm starts on {and_list(thinned)} begin far from the solution, and their times are "
            "not those of a control loop; name scenarios, as --train paper --steps 300"
        )
    edges = space.describe_edges(start or {})
    return remarks + [f"your settings lie at the edge of the searched range, {e}" for e in edges]


def _measure_roles(
    tuned: TunedSolver,
    best: Options,
    start: Options | None,
    training: Sequence[TunedProblem],
    test: Sequence[TunedProblem],
    folder: Path,
    progress: Progress,
    wait_s: float | None,
) -> tuple[TunedRole, ...]:
    """Time presets, the settings to start from and the best ones side by side."""
    presets = [DEFAULT, HIGH] if has_distinct_tolerance_presets(tuned.name) else [DEFAULT]
    named = ({} if start is None else {YOURS: start}) | {BEST: best}
    runs = measure_settings(
        tuned,
        [*training, *test],
        list(named.values()),
        folder / "final",
        progress,
        presets,
        wait_s=wait_s,
    )
    roles = []
    for title, problems in (("training", training), ("test", test)):
        found = runs_by_settings(runs, problems)
        own = {name: found[format_options_as_toml(options)] for name, options in named.items()}
        roles.append(TunedRole(title, {name: found[name] for name in presets} | own))
    return tuple(roles)


def _check_numbers(trials: int, steps: int, seed: int, error_move: float) -> None:
    """Raise InputError for an impossible number of trials, steps, seed or error limit."""
    require_integer_at_least("--trials", trials, 1)
    require_integer_at_least("--steps", steps, 0)
    require_integer_at_least("--seed", seed, 0)
    if not 0.0 < error_move < float("inf"):
        raise InputError("--error", "", error_move, "a number above 0")


def _choose_call(
    solver: str,
    route: Route | None,
    policy: Policy,
    requirements: Requirements,
    solver_module: str | None,
) -> TunedSolver:
    """Return the solver with its call mode; an error where it is missing or lacks the mode."""
    row = find_solver_record(solver)
    require_solver_available(solver)
    own: Route = "native" if "native" in row.routes else row.default_route
    chosen = route or own
    if chosen not in row.routes:
        raise PolicyError(f"solver {solver}", "route", repr(chosen), " | ".join(row.routes))
    if reason := row.state_why_policy_is_unavailable(chosen, policy):
        runs = " | ".join(row.get_route_record(chosen).policies)
        raise PolicyError(f"solver {solver}", "policy", repr(policy), f"{runs} ({reason})")
    return TunedSolver(solver, chosen, policy, requirements, solver_module)


def _check_options(tuned: TunedSolver, space: SearchSpace, start: Options | None) -> None:
    """Raise SettingsError where the solver lacks an option, or refuses one or an end of a range."""
    native = tuned.route == "native"
    adapter = get_native_adapter(tuned.name) if native else get_qpsolvers_adapter(tuned.name)
    for share in (0.0, 1.0):
        resolve_settings_to_options(space.options_at(np.full(len(space.ranges), share)), adapter)
    resolve_settings_to_options(start or {}, adapter)


def _search_settings(
    tuned: TunedSolver,
    problems: Sequence[TunedProblem],
    space: SearchSpace,
    folder: Path,
    trials: int,
    seed: int,
    progress: Progress,
    start: Options | None,
    wait_s: float | None,
) -> SettingsSearch:
    """Run the search on the training sequences, one campaign for each batch; return it."""
    numbers = count(1)

    def evaluate(settings: Sequence[Options]) -> list[Score]:
        place = folder / f"batch-{next(numbers):02d}"
        runs = measure_settings(tuned, problems, settings, place, progress, wait_s=wait_s)
        return score_settings(settings, runs_by_settings(runs, problems), tuned.requirements)

    search = SettingsSearch(space, evaluate, seed)
    search.run(trials, start)
    return search
