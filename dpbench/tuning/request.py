"""Request of `dpbench tune-solver`, checked before anything runs, and forecast of its time."""

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from dpbench.analysis.verdict.requirements import Requirements
from dpbench.bench.engines.open_engine import count_slots
from dpbench.bench.estimate import (
    COMPILE_S,
    STATED_RATES,
    describe_what_is_not_forecast,
    estimate_run_seconds,
    find_finished_cells,
    format_duration,
)
from dpbench.bench.record.result_folder import load_results
from dpbench.bench.workers.child import has_compiled_kernels
from dpbench.errors import InputError, PolicyError, ResultsError, require_integer_at_least
from dpbench.report.formats import join_with_and
from dpbench.solvers.adapter import NativeAdapter, QpsolversAdapter, list_public_settings_attributes
from dpbench.solvers.contract import DEFAULT, POLICIES, Options, Policy, Route
from dpbench.solvers.own_settings import parse_choice_without_grid
from dpbench.solvers.settings import (
    has_preset_or_tolerance,
    list_tolerance_options,
    resolve_settings_to_options,
    resolve_settings_with_fixed_options,
)
from dpbench.solvers.table import (
    PluginFiles,
    find_solver_record,
    get_native_adapter,
    get_qpsolvers_adapter,
    load_plugin_solvers,
    require_solver_available,
)
from dpbench.tuning.campaigns import (
    TunedProblem,
    TunedSolver,
    find_trial_presets,
    load_measured_runs,
    load_tuned_problem,
    plan_settings,
    refuse_training_qps_in_test,
    score_settings,
    split_off_presets,
)
from dpbench.tuning.search import Score, SearchSpace, SettingsSearch, make_space, split_into_batches

TRAINING = ("paper", "rough", "turn")
TEST = ("move", "extreme", "weather")
TRIALS = 48
DOMINATES = 100.0
"""Ratio of two tolerances from which the smaller one does not change when a solve ends."""
YOURS, BEST = "yours", "best"
_ITERATION_LIMIT = re.compile(
    r"(inner_)?max_iters?(_in)?|maxiters?|iter_max|iter_limit|qp_iteration_limit"
)
"""Names of options that end a solve without an answer, in the libraries."""
_Adapter = NativeAdapter | QpsolversAdapter


@dataclass(frozen=True)
class SearchRequest:
    """A search for settings of a solver: where it looks, on which QPs, how long.

    start : the user's settings, None without any; first_trials : these and the presets, tried in
    the first batch; searched : lines on the options that are searched and on limits that are not;
    remarks : on what makes the result doubtful.
    """

    solver: TunedSolver
    space: SearchSpace
    start: Options | None
    first_trials: Sequence[Options]
    training: Sequence[TunedProblem]
    test: Sequence[TunedProblem]
    trials: int
    seed: int
    name: str
    folder: Path
    searched: Sequence[str]
    remarks: Sequence[str]

    @property
    def presets(self) -> list[str]:
        """Presets of the solver that the best settings are measured beside."""
        return [DEFAULT, *find_trial_presets(self.solver.name)]

    @property
    def settings_count(self) -> int:
        """Number of settings that the search tries: those it draws, the user's and presets."""
        return self.trials + len(self.first_trials)

    @property
    def sequences_by_purpose(self) -> str:
        """Names of the training and of the test sequences as a text."""
        training, test = (
            ", ".join(problem.name for problem in problems)
            for problems in (self.training, self.test)
        )
        return f"training: {training}; test: {test}"

    @property
    def given(self) -> str:
        """Names of the settings that are tried besides those the search draws; "" for none."""
        yours, names = int(self.start is not None), join_with_and(self.presets[1:])
        presets = len(self.first_trials) > yours
        return join_with_and(["yours"] * yours + [f"the presets {names}"] * presets)

    def find_iteration_limit(self, options: Options) -> tuple[str, float] | None:
        """Return name and value of the solver's limit of iterations, or None if it is unknown.

        None also where the solver counts its iterations in another way than the limit does.
        """
        record = find_solver_record(self.solver.name)
        if not record.iteration_limit or record.limits_outer_iterations:
            return None
        adapter = _get_adapter(self.solver.name, self.solver.route)
        target = None if adapter.make_settings is None else adapter.make_settings()
        usual = getattr(target, record.iteration_limit, None)
        set_to = resolve_settings_with_fixed_options(options, record.name)
        value = set_to.get(record.iteration_limit, usual)
        return (record.iteration_limit, value) if isinstance(value, int | float) else None

    def name_settings(self, best: Options) -> dict[str, Options]:
        """Return by name the user's and the best settings, to be measured beside the presets."""
        return ({} if self.start is None else {YOURS: self.start}) | {BEST: best}


def make_request(
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
    solver_module: PluginFiles = None,
) -> SearchRequest:
    """Return the checked request of a search; parameters and errors as in `tune_solver`."""
    load_plugin_solvers(solver_module)
    _refuse_bad_numbers(trials, steps, seed, error_move)
    one = "one value per option; --range or --widen 'OPTION=[MIN,MAX]' for a range"
    solver, given = parse_choice_without_grid(solver, "tune-solver", one)
    tuned = _choose_call_mode(
        solver, route, policy, Requirements(error_move=error_move), solver_module
    )
    if has_preset_or_tolerance(solver, name) or not re.fullmatch(r"[\w-]{1,80}", name, re.ASCII):
        allowed = f"1 to 80 letters, digits, _ and -, and not the name of a preset of {solver}"
        raise InputError("--name", "", repr(name)[:90], allowed)
    space = make_space(solver, ranges, widened, given)
    start = space.convert_to_range_types(given) if given else None
    # Custom options hold in every trial, and so do ranges in place of the stated ones.
    known = {} if ranges else find_trial_presets(solver)
    presets = [{**options, **space.fixed} for options in known.values()]
    adapter = _get_adapter(solver, tuned.route)
    _refuse_bad_options(adapter, space, start)
    learned = [load_tuned_problem(one, steps) for one in training or TRAINING]
    other = [load_tuned_problem(one, steps) for one in test or TEST]
    refuse_training_qps_in_test(learned, other)
    return SearchRequest(
        tuned,
        space,
        start,
        [*([] if start is None else [start]), *presets],
        learned,
        other,
        trials,
        seed,
        name,
        Path(out) if out is not None else Path("results") / f"tune-{solver}",
        _describe_searched_options(adapter, space),
        _list_remarks(policy, [*learned, *other], list_edges(solver, space, start or {})),
    )


def list_edges(solver: str, space: SearchSpace, options: Options) -> list[str]:
    """Return a remark on each option at the edge of its range, with a wider range.

    None on a tolerance at its least value while another is `DOMINATES` times as large: that one
    ends the solve.
    """
    tolerances = {
        name: value
        for name in list_tolerance_options(solver)
        if isinstance(value := options.get(name), int | float)
    }
    largest = max(tolerances.values(), default=0.0)
    dominated = {name for name, value in tolerances.items() if largest >= DOMINATES * value}
    others = {name: value for name, value in options.items() if name not in dominated}
    return space.describe_edges(others)


def _list_remarks(
    policy: Policy, problems: Sequence[TunedProblem], edges: Sequence[str]
) -> list[str]:
    """Return remarks on a warm start from a distant step, and on a start at the edge of a range."""
    thinned = [f"{one.name} (one step of {one.every})" for one in problems if one.every > 1]
    remarks = []
    if policy == "warm" and thinned:
        remarks.append(
            f"warm starts on {join_with_and(thinned)} begin far from the solution, and their times "
            "are not those of a control loop; name scenarios, such as --train paper --steps 300"
        )
    return remarks + [f"your settings are at the edge of the searched range, {e}" for e in edges]


def _refuse_bad_numbers(trials: int, steps: int, seed: int, error_move: float) -> None:
    """Raise InputError for an impossible number of trials, steps, seed or error limit."""
    require_integer_at_least("--trials", trials, 1)
    require_integer_at_least("--steps", steps, 0)
    require_integer_at_least("--seed", seed, 0)
    if not 0.0 < error_move < float("inf"):
        raise InputError("--error", "", error_move, "a number above 0")


def _choose_call_mode(
    solver: str,
    route: Route | None,
    policy: Policy,
    requirements: Requirements,
    solver_module: PluginFiles,
) -> TunedSolver:
    """Return the solver with its call mode; an error where it is missing or lacks the mode."""
    row = find_solver_record(solver)
    require_solver_available(solver)
    own: Route = "native" if "native" in row.routes else row.default_route
    chosen = route or own
    if chosen not in row.routes:
        raise PolicyError("`route`", "", f"{chosen!r} for {solver}", ", ".join(row.routes))
    if reason := row.state_why_policy_is_unavailable(chosen, policy):
        runs = ", ".join(row.get_route_record(chosen).policies)
        why = f" ({reason})" if policy in POLICIES else ""
        raise PolicyError("`policy`", "", f"{policy!r} for {solver}{why}", runs)
    return TunedSolver(solver, chosen, policy, requirements, solver_module)


def _get_adapter(solver: str, route: str) -> _Adapter:
    """Return a solver's adapter on a route."""
    return get_native_adapter(solver) if route == "native" else get_qpsolvers_adapter(solver)


def _refuse_bad_options(adapter: _Adapter, space: SearchSpace, start: Options | None) -> None:
    """Raise SettingsError where the solver lacks an option, or refuses one or an end of a range."""
    for share in (0.0, 1.0):
        resolve_settings_to_options(space.options_at(np.full(len(space.ranges), share)), adapter)
    resolve_settings_to_options(start or {}, adapter)


def _describe_searched_options(adapter: _Adapter, space: SearchSpace) -> list[str]:
    """Return lines on the options that are searched and on iteration limits, searched or not."""
    target = None if adapter.make_settings is None else adapter.make_settings()
    names = [] if target is None else list_public_settings_attributes(target)
    names = names if adapter.list_options is None else [*adapter.list_options()]
    limits = [name for name in names if _ITERATION_LIMIT.fullmatch(name)]
    searched = {own.name for own in space.ranges}
    set_to = resolve_settings_with_fixed_options(space.fixed, adapter.record.name)
    lines = ["searched: " + ", ".join(f"{r.name} {r.low:g} to {r.high:g}" for r in space.ranges)]
    kept = [
        f"{name} ({set_to.get(name, getattr(target, name, 'as in the library'))})"
        for name in limits
        if name not in searched
    ]
    lines += [
        f"{name} is only an initial value in {adapter.record.name}, as {switch} is on (fix it with "
        f"{switch}=false)"
        for name, switch in adapter.record.adapted.items()
        if name in searched and set_to.get(switch)
    ]
    if kept:
        lines.append(
            f"not searched: {join_with_and(kept)}; a step that needs more iterations fails"
        )
    if among := [name for name in limits if name in searched]:
        lines.append(f"{join_with_and(among)}: a step that needs more iterations fails")
    return lines


@dataclass(frozen=True)
class SearchForecast:
    """Expected time of a search [s], with `compile_s` for kernels; how many batches are finished.

    measured : whether the time is by finished batches of this search, else by stated rates.
    """

    request: SearchRequest
    finished: int
    time_s: float
    compile_s: float
    measured: bool
    remarks: Sequence[str]

    @property
    def summary(self) -> str:
        """One line on the number of settings and batches, and the expected time."""
        request = self.request
        return (
            f"{request.settings_count} settings of {request.solver.name} in {self._batches}, "
            f"then the measurement of the best: about {format_duration(self.time_s)}, plus "
            "waits for an idle machine"
        )

    @property
    def _batches(self) -> str:
        """Number of batches as text, and how many of them are finished."""
        done = f", {self.finished} of them finished" if self.finished else ""
        return f"{len(split_into_batches(self.request.trials))} batches{done}"

    @property
    def lines(self) -> list[str]:
        """Lines of text on the expected time of a settings search, for `--dry-run`."""
        request = self.request
        training, test = (
            ", ".join(problem.name for problem in problems)
            for problems in (request.training, request.test)
        )
        names = ", ".join([*request.presets, *request.name_settings({})])
        compiled = f", including {format_duration(self.compile_s)} to compile kernels, once"
        rates = "finished batches" if self.measured else STATED_RATES.origin.partition(";")[0]
        return [
            f"{request.settings_count} settings of {request.solver.name} on {training}: "
            f"{self._batches}",
            *([f"the first batch includes {request.given}"] if request.given else []),
            f"then {names} are measured on these and on {test}",
            f"about {format_duration(self.time_s)} on this machine"
            f"{compiled if self.compile_s else ''}, estimated from {rates}",
            *self.remarks,
            *request.searched,
            *request.remarks,
        ]


class _NotFinishedError(Exception):
    """End of the part of a search whose batches are finished."""


def estimate_tuning(solver: str, **asked: Any) -> SearchForecast:
    """Return the expected time of `tune_solver` with the same arguments; errors as there."""
    return forecast_search(make_request(solver, **asked))


def forecast_search(request: SearchRequest) -> SearchForecast:
    """Return the expected time of a requested search."""
    search, finished_s, wall_s = _repeat_finished_batches(request)
    sizes = split_into_batches(request.trials)
    sizes[0] += len(request.first_trials)
    left = sizes[len(finished_s) :]
    of_size = {size: _estimate_batch_seconds(request, size) for size in set(left)}
    seconds = [of_size[size] for size in left]
    is_final_done = not left and _is_final_finished(request, search)
    if not is_final_done:
        seconds.append(_estimate_final_seconds(request))
    factor = sum(wall_s) / sum(finished_s) if finished_s else 1.0
    compile_s = 0.0 if has_compiled_kernels() or is_final_done else COMPILE_S
    return SearchForecast(
        request,
        len(finished_s),
        factor * sum(seconds) + compile_s,
        compile_s,
        bool(finished_s),
        describe_what_is_not_forecast(1) if seconds else (),
    )


def _repeat_finished_batches(
    request: SearchRequest,
) -> tuple[SettingsSearch, list[float], list[float]]:
    """Repeat a settings search as far as its batches are finished; return it and their times.

    Returns it, and for each such batch the forecast time and the time it took [s].
    """
    numbers, finished_s, wall_s = count(1), list[float](), list[float]()

    def evaluate(settings: Sequence[Options]) -> list[Score]:
        folder = request.folder / f"batch-{next(numbers):02d}"
        own = split_off_presets(request.solver.name, settings)
        cells = plan_settings(request.solver, request.training, *own)
        if len(find_finished_cells(cells, folder)) < len(cells):
            raise _NotFinishedError
        try:
            measured = load_measured_runs(folder, request.solver.requirements)
        except ResultsError as error:
            # Its runs are in parts yet, without a table.
            raise _NotFinishedError from error
        finished_s.append(estimate_run_seconds(cells, count_slots(None), STATED_RATES))
        wall_s.append(load_results(folder).suite.get("wall_s", finished_s[-1]))
        return score_settings(request.solver, settings, measured, request.training)

    search = SettingsSearch(request.space, evaluate, request.seed)
    with suppress(_NotFinishedError):  # the forecast is made of the trials before it
        search.run(request.trials, request.first_trials)
    return search, finished_s, wall_s


def _estimate_batch_seconds(request: SearchRequest, size: int) -> float:
    """Return the expected time of a batch of so many settings by stated rates [s]."""
    shares = (np.arange(size) + 0.5) / size
    settings = [request.space.options_at(np.full(len(request.space.ranges), s)) for s in shares]
    cells = plan_settings(request.solver, request.training, settings)
    return estimate_run_seconds(cells, count_slots(None), STATED_RATES)


def _estimate_final_seconds(request: SearchRequest) -> float:
    """Return the expected time of the measurement on all sequences by stated rates [s]."""
    middle = request.space.options_at(np.full(len(request.space.ranges), 0.5))
    return estimate_run_seconds(
        plan_settings(
            request.solver,
            [*request.training, *request.test],
            request.name_settings(middle),
            request.presets,
        ),
        count_slots(None),
        STATED_RATES,
    )


def _is_final_finished(request: SearchRequest, search: SettingsSearch) -> bool:
    """Return whether a search's best settings are measured, or need not be: none is accurate."""
    if not search.best.score.is_right:
        return True
    named = request.name_settings(search.best.options)
    problems = [*request.training, *request.test]
    cells = plan_settings(request.solver, problems, named, request.presets)
    return len(find_finished_cells(cells, request.folder / "final")) == len(cells)
