"""`dpbench tune-solver`: the fastest settings of a solver that meet the accuracy requirement.

The search sees the training sequences alone. In the end the best settings and the default ones are
timed anew side by side, on these and on the test sequences.
"""

from collections.abc import Sequence
from itertools import count
from pathlib import Path

from dpbench.analysis.verdict.requirements import Requirements
from dpbench.bench.plan.run_request import NO_P99
from dpbench.bench.progress import Progress, Silent
from dpbench.files.writing import write_text_atomically
from dpbench.solvers.contract import Options, Policy, Route
from dpbench.solvers.own_settings import format_options_as_toml
from dpbench.tuning.campaigns import (
    count_steps_of_settings,
    measure_settings,
    runs_by_settings,
    score_settings,
)
from dpbench.tuning.request import TRIALS, SearchRequest, make_request
from dpbench.tuning.search import Score, SettingsSearch, split_into_batches
from dpbench.tuning.solver_tuning import TunedRole, Tuning


class _SearchProgress:
    """The progress of all campaigns of a search as that of one, with the batch before each text."""

    def __init__(self, progress: Progress, request: SearchRequest) -> None:
        self._progress, self._batch, self._planned = progress, 0, 0
        self._batches = len(split_into_batches(request.trials)) + 1
        self._training = count_steps_of_settings(request.solver, request.training)
        self._all = self._training + count_steps_of_settings(request.solver, request.test)
        in_end = len(request.presets) + len(request.name_settings({}))
        started = request.trials + (request.start is not None) + self._batches - 1
        self._remarks: set[str] = set()
        progress.start(started * self._training + in_end * self._all)

    def plan(self, settings: int, *, with_test: bool = False) -> None:
        """Announce a campaign with so many settings, presets included."""
        self._batch += 1
        self._planned = settings * (self._all if with_test else self._training)

    def start(self, work: int) -> None:
        """Begin the campaign; what it has not to do any more is finished."""
        if work < self._planned:
            self.advance(self._planned - work, "finished before")

    def advance(self, work: int, what: str) -> None:
        """Add finished work [steps] of this campaign."""
        self._progress.advance(work, f"batch {self._batch}/{self._batches}: {what}")

    def remark(self, text: str) -> None:
        """Show a remark of the campaigns once, even if several make it."""
        if text not in self._remarks and not text.startswith(NO_P99):
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

    Finished runs are kept: the same call goes on after an interruption. Ctrl-C ends the search with
    the best settings of its finished batches, if there are any.

    Parameters
    ----------
    solver : a name, or with settings of one's own as `osqp[rho=1.6]`: the search starts with these,
        keeps those of their options that it does not search, and measures them beside the best.
    training, test : recorded sequences or scenarios; by default those in `request.py`.
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
    request = make_request(
        solver,
        training=training,
        test=test,
        ranges=ranges,
        widened=widened,
        route=route,
        policy=policy,
        error_move=error_move,
        trials=trials,
        steps=steps,
        seed=seed,
        name=name,
        out=out,
        solver_module=solver_module,
    )
    bar = _SearchProgress(progress or Silent(), request)
    for remark in request.remarks:
        bar.remark(remark)
    search = _make_search(request, bar, wait_s)
    roles: tuple[TunedRole, ...] = ()
    is_interrupted = False
    try:
        search.run(request.trials, request.start)
        if search.best.score.is_right:
            roles = _measure_roles(request, search.best.options, bar, wait_s)
    except KeyboardInterrupt:
        if not search.trials:
            raise
        is_interrupted = True
    tuning = Tuning(request, search.best, len(search.trials), search.drawn, roles, is_interrupted)
    if tuning.path is not None:
        write_text_atomically(tuning.path, tuning.toml)
    return tuning


def _make_search(
    request: SearchRequest, progress: _SearchProgress, wait_s: float | None
) -> SettingsSearch:
    """Make the search on the training sequences, one campaign for each batch."""
    numbers, tuned, problems = count(1), request.solver, request.training

    def evaluate(settings: Sequence[Options]) -> list[Score]:
        place = request.folder / f"batch-{next(numbers):02d}"
        progress.plan(len(settings) + 1)
        runs = measure_settings(tuned, problems, settings, place, progress, wait_s=wait_s)
        return score_settings(settings, runs_by_settings(runs, problems), tuned.requirements)

    return SettingsSearch(request.space, evaluate, request.seed)


def _measure_roles(
    request: SearchRequest, best: Options, progress: _SearchProgress, wait_s: float | None
) -> tuple[TunedRole, ...]:
    """Time presets, the settings to start from and the best ones side by side."""
    presets, named = request.presets, request.name_settings(best)
    progress.plan(len(presets) + len(named), with_test=True)
    runs = measure_settings(
        request.solver,
        [*request.training, *request.test],
        list(named.values()),
        request.folder / "final",
        progress,
        presets,
        wait_s=wait_s,
    )
    roles = []
    for title, problems in (("training", request.training), ("test", request.test)):
        found = runs_by_settings(runs, problems)
        own = {name: found[format_options_as_toml(options)] for name, options in named.items()}
        roles.append(TunedRole(title, {name: found[name] for name in presets} | own))
    return tuple(roles)
