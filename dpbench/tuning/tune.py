"""`dpbench tune-solver`: the fastest settings of a solver that meet the accuracy requirement.

The search sees the training sequences alone. In the end the best settings and the default ones are
timed anew side by side, on these and on the test sequences.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.verdict.requirements import Requirements, is_right
from dpbench.bench.progress import Progress, Silent
from dpbench.errors import InputError, PolicyError, require_at_least
from dpbench.files.writing import write_text
from dpbench.report.formats import error_text, significant, time_text
from dpbench.report.table import Table
from dpbench.solvers.contract import Options, Policy, Route
from dpbench.solvers.own_settings import describe_options
from dpbench.solvers.record import HIGH
from dpbench.solvers.settings import has_setting, has_tolerance_levels, resolve_options
from dpbench.solvers.table import (
    check_available,
    find_record,
    load_solver_module,
    native_adapter,
    qpsolvers_adapter,
)
from dpbench.tuning.campaigns import (
    DEFAULT,
    TunedSolver,
    measure_settings,
    runs_by_settings,
    score_runs,
    score_settings,
    step_time_ns,
)
from dpbench.tuning.search import BATCH, Score, SettingsSearch, Trial
from dpbench.tuning.sequences import TunedProblem, load_problem, refuse_overlap
from dpbench.tuning.space import SearchSpace, make_space

TRAINING = ("paper", "rough", "turn")
TEST = ("move", "squall", "weather")
TRIALS = 48
BEST = "best"


@dataclass(frozen=True)
class TunedRole:
    """The best settings and presets on the training or on the test sequences, side by side.

    runs : by the name of the settings, the best ones as `BEST`.
    """

    title: str
    runs: Mapping[str, Sequence[RunRecord]]

    def summary(self, requirements: Requirements) -> str:
        """State whether the best settings are right, and their step time beside the presets."""
        best = self.runs[BEST]
        wrong = sum(not is_right(run, requirements) for run in best)
        if wrong:
            return f"inaccurate on {wrong} of {len(best)}"
        parts = ["accurate"]
        for name, runs in self.runs.items():
            if name != BEST:
                preset = score_runs(runs, runs, requirements)
                known = (
                    f", which is inaccurate on {preset.wrong} of {len(runs)}"
                    if preset.wrong
                    else ""
                )
                ratio = significant(score_runs(best, runs, requirements).ratio)
                parts.append(f"{ratio} times the step time of {name}{known}")
        return "; ".join(parts)


@dataclass(frozen=True)
class Tuning:
    """Result of a search: the best trial, its runs on training and test sequences, its file.

    folder : of the runs; path : of the settings as TOML, None where no trial met the requirement.
    """

    solver: TunedSolver
    best: Trial[Score]
    trials: int
    roles: tuple[TunedRole, ...]
    folder: Path
    path: Path | None

    @property
    def table(self) -> Table:
        """Table of step time and error of presets and best settings on each sequence."""
        limit = self.solver.requirements
        rows = [
            (
                role.title,
                run.sequence,
                name,
                time_text(step_time_ns(run)),
                error_text(run.error_move_max),
                "yes" if is_right(run, limit) else "no",
            )
            for role in self.roles
            for runs in zip(*role.runs.values(), strict=True)
            for name, run in zip(role.runs, runs, strict=True)
        ]
        heads = ("", "sequence", "settings", "time", "error", "accurate")
        note = (
            "Time: p99 step time, or the largest where a sequence is too short for a p99. Error: "
            f"of the first move, at most {limit.error_move:g} of a rate-limit step."
        )
        return Table(heads, tuple(rows), f"Settings of {self.solver.name}", note, text_columns=3)

    @property
    def lines(self) -> list[str]:
        """The result in words: the best settings, and what they gain on either kind of sequence."""
        if self.path is None:
            return [
                f"none of {self.trials} settings is accurate on every training sequence; the "
                f"nearest, {self.best.name}, misses the requirement on {self.best.score.wrong}"
            ]
        lines = [f"best of {self.trials} settings: {self.best.name}"]
        for role in self.roles:
            lines.append(f"{role.title} sequences: {role.summary(self.solver.requirements)}")
        return [*lines, f"settings: {self.path}; runs: {self.folder / 'final'}"]


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
    route: Route | None = None,
    policy: Policy = "fresh",
    error_move: float = Requirements.error_move,
    trials: int = TRIALS,
    steps: int = 0,
    seed: int = 1,
    name: str = "tuned",
    out: str | Path | None = None,
    solver_module: str | None = None,
    progress: Progress | None = None,
) -> Tuning:
    """Search a solver's settings on training sequences and measure the best on test sequences.

    Finished runs are kept: the same call goes on after an interruption.

    Parameters
    ----------
    training, test : recorded sequences or scenarios; by default `TRAINING` and `TEST`.
    ranges : texts such as `rho=[1e-3,10]`, in place of the stated ranges of the solver.
    route, policy : of the solver; no route is native where it has that.
    error_move : the accuracy requirement, largest error of the first move [rate-limit steps].
    trials : settings to try, rounded up to whole batches; steps : of a scenario, 0 for all.
    name : of the settings in the TOML file that is written.
    out : folder; by default `results/tune-SOLVER`.

    Raises
    ------
    InputError : for bad input, training and test sequences that overlap, or a solver that is
        missing or has no stated ranges.
    """
    if solver_module is not None:
        load_solver_module(solver_module)
    _check_numbers(trials, steps, seed, error_move)
    tuned = _choose_call(solver, route, policy, Requirements(error_move=error_move), solver_module)
    if has_setting(solver, name) or not re.fullmatch(r"[\w-]{1,80}", name, re.ASCII):
        allowed = f"letters, digits, _ and -; no preset of {solver}"
        raise InputError("--name", "", repr(name)[:90], allowed)
    space = make_space(solver, ranges)
    _check_ends(tuned, space)
    learned = [load_problem(one, steps) for one in training or TRAINING]
    other = [load_problem(one, steps) for one in test or TEST]
    refuse_overlap(learned, other)
    folder = Path(out) if out is not None else Path("results") / f"tune-{solver}"
    batches = max(2, -(-trials // BATCH))
    bar = _BatchProgress(progress or Silent(), batches + 1)
    search = _search_settings(tuned, learned, space, folder, batches, seed, bar)
    best = search.best
    if not best.score.is_right:
        return Tuning(tuned, best, len(search.trials), (), folder, None)
    presets = [DEFAULT, HIGH] if has_tolerance_levels(solver) else [DEFAULT]
    everything = [*learned, *other]
    runs = measure_settings(tuned, everything, [best.options], folder / "final", bar, presets)
    roles = []
    for title, problems in (("training", learned), ("test", other)):
        found = runs_by_settings(runs, problems)
        roles.append(TunedRole(title, {n: found[n] for n in presets} | {BEST: found[best.name]}))
    path = folder / f"{name}.toml"
    tuning = Tuning(tuned, best, len(search.trials), tuple(roles), folder, path)
    write_text(path, _settings_toml(tuning, name))
    return tuning


def _check_numbers(trials: int, steps: int, seed: int, error_move: float) -> None:
    """Raise InputError for an impossible number of trials, steps, seed or error limit."""
    require_at_least("--trials", trials, 1)
    require_at_least("--steps", steps, 0)
    require_at_least("--seed", seed, 0)
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
    row = find_record(solver)
    check_available(solver)
    own: Route = "native" if "native" in row.routes else row.default_route
    chosen = route or own
    if chosen not in row.routes:
        raise PolicyError(f"solver {solver}", "route", repr(chosen), " | ".join(row.routes))
    if reason := row.refusal(chosen, policy):
        runs = " | ".join(row.on(chosen).policies)
        raise PolicyError(f"solver {solver}", "policy", repr(policy), f"{runs} ({reason})")
    return TunedSolver(solver, chosen, policy, requirements, solver_module)


def _check_ends(tuned: TunedSolver, space: SearchSpace) -> None:
    """Raise SettingsError where the solver lacks an option or refuses an end of its range."""
    native = tuned.route == "native"
    adapter = native_adapter(tuned.name) if native else qpsolvers_adapter(tuned.name)
    for end in ("low", "high"):
        resolve_options({own.name: getattr(own, end) for own in space.ranges}, adapter)


def _search_settings(
    tuned: TunedSolver,
    problems: Sequence[TunedProblem],
    space: SearchSpace,
    folder: Path,
    batches: int,
    seed: int,
    progress: Progress,
) -> SettingsSearch:
    """Run the search on the training sequences, one campaign for each batch; return it."""
    numbers = count(1)

    def evaluate(settings: Sequence[Options]) -> list[Score]:
        place = folder / f"batch-{next(numbers):02d}"
        runs = measure_settings(tuned, problems, settings, place, progress)
        return score_settings(settings, runs_by_settings(runs, problems), tuned.requirements)

    search = SettingsSearch(space, evaluate, seed)
    search.run(batches)
    return search


def _settings_toml(tuning: Tuning, name: str) -> str:
    """Return `[settings.NAME]` of a suite, with what was measured in its comments."""
    solver = tuning.solver
    comments = [
        f"Settings of {solver.name}, route {solver.route}, policy {solver.policy}; found by "
        "`dpbench tune-solver`.",
        *(
            f"{role.title} sequences ({', '.join(run.sequence for run in role.runs[BEST])}): "
            f"{role.summary(solver.requirements)}"
            for role in tuning.roles
        ),
    ]
    options = describe_options(tuning.best.options).replace(",", ", ").replace("=", " = ")
    head = "".join(f"# {line}\n" for line in comments)
    return f"{head}[settings.{name}]\n{solver.name} = {{ {options} }}\n"
