"""`dpbench tune-solver`: the fastest settings of a solver that meet the accuracy requirement.

The search sees the training sequences alone. In the end the best settings and the default ones are
timed anew side by side, on these and on the test sequences.
"""

import hashlib
import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import count
from pathlib import Path

import numpy as np

from dpbench.analysis.records.machine import sum_disturbances
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.verdict.requirements import (
    LATE,
    Finding,
    Requirements,
    is_right_on_every_step,
)
from dpbench.analysis.verdict.verdict import ALIKE
from dpbench.bench.plan.run_request import NO_P99
from dpbench.bench.progress import Progress, Silent
from dpbench.files.regular_files import write_text_atomically
from dpbench.report.commands_text import describe_machine_states
from dpbench.report.formats import (
    Table,
    format_error,
    format_share,
    format_time,
    join_with_and,
    significant,
    strip_markdown,
)
from dpbench.report.verdict.findings_text import describe_finding
from dpbench.solvers.contract import DEFAULT, Options, Policy, Route
from dpbench.solvers.own_settings import format_options_as_toml
from dpbench.solvers.settings import find_options_of_preset, format_library_call
from dpbench.solvers.table import PluginFiles, list_plugin_files
from dpbench.tuning.campaigns import (
    MeasuredRuns,
    TunedSolver,
    count_steps_of_settings,
    find_step_of_largest_error,
    group_runs_by_settings,
    measure_settings,
    name_step_times_ns,
    score_runs,
    score_settings,
    split_off_presets,
)
from dpbench.tuning.request import (
    BEST,
    TRIALS,
    YOURS,
    SearchRequest,
    forecast_search,
    list_edges,
    make_request,
)
from dpbench.tuning.search import Score, SettingsSearch, Trial, split_into_batches

FINAL = "final"
"""Result folder, of the search's, of the best settings beside the presets."""
NEAR = 0.5
"""Share of the limit of error, or of iterations, beyond which accurate settings may fail on other
steps."""


@dataclass(frozen=True)
class TunedRole:
    """Best settings, presets and the user's own on the training or the test sequences.

    runs : by the name of the settings, the user's as `YOURS`, the best ones as `BEST`.
    measured : all runs, with their faults.
    """

    title: str
    runs: Mapping[str, Sequence[RunRecord]]
    measured: MeasuredRuns = field(default_factory=lambda: MeasuredRuns(()))

    def summarise_best_settings(self, requirements: Requirements) -> str:
        """Return as text if the best settings are accurate, late, and their time beside others.

        The others are `default`, the fastest preset that is accurate here and your own.
        """
        best = self.runs[BEST]
        wrong = sum(not is_right_on_every_step(run, requirements) for run in best)
        if wrong:
            return f"inaccurate on {wrong} of {len(best)}"
        late = [finding for run in best if (finding := self.measured.find_late(run))]
        parts = [_describe_accuracy(late, len(best))]
        worst = min(best, key=lambda run: run.true_share)
        if worst.true_share < 1.0:
            share = format_share(1.0 - worst.true_share)
            parts.append(f"{share} of the solutions of {worst.sequence} not verified")
        others = {name: runs for name, runs in self.runs.items() if name != BEST}
        ratios = {n: score_runs(best, runs, requirements).ratio for n, runs in others.items()}
        faults = {n: self._describe_faults(runs, requirements) for n, runs in others.items()}
        fastest = next((n for n in self.rank_others(requirements) if n != YOURS), "")
        for name in (name for name in others if name in {DEFAULT, fastest, YOURS}):
            known = f", which is {faults[name]}" if faults[name] else ""
            known += ", the fastest preset that is accurate on them" * (name == fastest)
            known += ": no gain" * (name == fastest and ratios[name] > 1.0 - ALIKE)
            parts.append(f"{significant(ratios[name])} times the step time of {name}{known}")
        return "; ".join(parts)

    def rank_others(self, requirements: Requirements) -> list[str]:
        """Return the presets and the user's own settings by step time, the fastest first.

        Of those that are accurate and in time on all sequences.
        """
        logs = {
            name: sum(math.log(next(iter(name_step_times_ns(run).values()))) for run in runs)
            for name, runs in self.runs.items()
            if name != BEST and not self._describe_faults(runs, requirements)
        }
        return sorted(logs, key=lambda name: logs[name])

    def _describe_faults(self, runs: Sequence[RunRecord], requirements: Requirements) -> str:
        """Return in words on how many sequences settings are inaccurate or late; "" for none."""
        score = score_runs(runs, runs, requirements, self.measured)
        faults = [f"inaccurate on {score.wrong} of {len(runs)}"] * bool(score.wrong)
        faults += [f"late on {len(score.late)} of {len(runs)}"] * bool(score.late)
        return join_with_and(faults)

    def passes(self, requirements: Requirements) -> bool:
        """Return whether the best settings are accurate and in time on all sequences."""
        best = self.runs[BEST]
        is_right = all(is_right_on_every_step(run, requirements) for run in best)
        return is_right and not any(self.measured.find_late(run) for run in best)

    def describe_failed_steps(self) -> Iterator[str]:
        """Yield a line on the failed steps of each run that has some, with the reason."""
        for name, runs in self.runs.items():
            for run in runs:
                for finding in self.measured.faults.get(run.run_id, ()):
                    if finding.kind == "failed":
                        yield f"{name}: {strip_markdown(describe_finding(finding))}"

    def describe_result(self, run: RunRecord, requirements: Requirements) -> str:
        """Return in a word or two if a run is accurate, how many steps failed, if it is late."""
        faults = self.measured.faults.get(run.run_id, ())
        words = [f"{f.steps or f.value:.0f} failed" for f in faults if f.kind == "failed"]
        if not words and not is_right_on_every_step(run, requirements):
            words = ["inaccurate"]
        words += ["late"] * any(f.kind in LATE for f in faults)
        return ", ".join(words) or "accurate"


def _describe_accuracy(late: Sequence[Finding], sequences: int) -> str:
    """Return that settings are accurate, and where their step times are above a limit."""
    if not late:
        return "accurate"
    reasons = ", and ".join(strip_markdown(describe_finding(finding)) for finding in late)
    return f"accurate but late on {len(late)} of {sequences}: {reasons}"


@dataclass(frozen=True)
class Tuning:
    """Result of a search: the best trial, and its runs on training and test sequences.

    trials : settings that were tried; drawn : of these and equal ones, those of the search's own
    choice. roles : none where no trial met the requirement, or the search was interrupted.
    """

    request: SearchRequest
    best: Trial[Score]
    trials: int
    drawn: int
    roles: tuple[TunedRole, ...]
    is_interrupted: bool = False

    @property
    def solver(self) -> TunedSolver:
        """The solver that was tuned."""
        return self.request.solver

    @property
    def path(self) -> Path | None:
        """The file of the best settings; None where no trial met the requirement."""
        is_right = self.best.score.is_right
        return self.request.folder / f"{self.request.name}.toml" if is_right else None

    @property
    def table(self) -> Table:
        """Table of step time, error and result of presets, own and best settings by sequence."""
        limit = self.solver.requirements
        rows = [
            (
                role.title,
                run.sequence,
                name,
                _format_step_time(run),
                format_error(run.error_move_max),
                role.describe_result(run, limit),
            )
            for role in self.roles
            for runs in zip(*role.runs.values(), strict=True)
            for name, run in zip(role.runs, runs, strict=True)
        ]
        title = f"Settings of {self._call}"
        heads = ("", "sequence", "settings", "time", "error", "result")
        note = (
            "Time: p99 over steps, each timed by its fastest round; if the sequence is too short "
            "for a p99, the p95 or p50, as marked. Error: of the first move, at most "
            f"{limit.error_move:g} of the maximum increment. Late: this time exceeds the "
            f"limit of {limit.p99_ms:g} ms by more than its uncertainty, even without waits for "
            "the processor core."
        )
        return Table(heads, tuple(rows), title, note, text_columns=3)

    @property
    def _call(self) -> str:
        """The solver with the call mode in which all its settings are measured."""
        return f"{self.solver.name} ({self.solver.route} {self.solver.policy})"

    @property
    def lines(self) -> list[str]:
        """The result in words: the best settings, and what they gain on either kind of sequence."""
        edges = [
            f"the best is at the edge of the searched range, {text}"
            for text in list_edges(self.solver.name, self.request.space, self.best.options)
        ]
        if self.path is None:
            return [
                f"none of {self.trials} settings of {self._call} is accurate on every training "
                f"sequence; the nearest, {self.best.name}, misses the requirement on "
                f"{self.best.score.wrong}",
                *edges,
                *self.request.searched,
                *self._not_done,
            ]
        found = "best so far, of" if self.is_interrupted else "best of"
        given = f", including {self.request.given}" if self.request.given else ""
        lines = [
            f"{found} {self.trials} settings of {self._call}{given}: {self.best.name}",
            "this is not a proven optimum; a higher --trials or another --seed may find better "
            "settings",
            *edges,
        ]
        if self.best.score.late:
            lines.append("all accurate settings that were tried are late on a training sequence")
        lines.append("only this call mode was measured; --route and --policy select another")
        lines += [*self.request.searched, *self._iterations, *self._measured]
        lines += [line for role in self.roles for line in role.describe_failed_steps()]
        lines += [*self._cautions, *self._not_done]
        runs = f"; runs: {self.request.folder / FINAL}" if self.roles else ""
        code = format_library_call(
            self.solver.name, self.solver.route, self.solver.policy, self.best.options
        )
        with_code = " (with the library's own call in Python)" if code else ""
        lines += [*self._machine, f"settings: {self.path}{with_code}{runs}"]
        return [*lines, *self._conclusion]

    @property
    def _conclusion(self) -> list[str]:
        """Line on which settings to use; none before the measurement on test sequences.

        These are the fastest preset, or the user's own settings if these are faster, of those that
        are accurate and in time on all sequences; the best ones if they pass and are faster.
        """
        if not self.roles:
            return []
        limits, test = self.solver.requirements, self.roles[-1]
        passing = [set(role.rank_others(limits)) for role in self.roles]
        ranked = [name for name in test.rank_others(limits) if all(name in own for own in passing)]
        fastest = next(iter(ranked), "")
        use = "keep your settings" if fastest == YOURS else f"use the preset {fastest}"
        if failed := join_with_and([role.title for role in self._failed_roles]):
            advice = f"; {use}" if fastest else ""
            return [f"the best settings fail on the {failed} sequences: do not use them{advice}"]
        if fastest in ("", YOURS) and self.best.options == self.request.start:
            return ["keep your settings: the search found none faster"]
        on_all = "accurate and in time on all sequences"
        use_best = "use the best settings if they pass in closed loops"
        if not fastest:
            return [f"{use_best}: no others that were measured are {on_all}"]
        ratio = score_runs(test.runs[BEST], test.runs[fastest], limits).ratio
        if ratio > 1.0 - ALIKE:
            gain = f"not more than {100.0 * ALIKE:g} % faster on the test sequences"
            return [f"{use}: the best settings are {gain} (ratio {significant(ratio)})"]
        name = "your settings" if fastest == YOURS else f"the preset {fastest}"
        return [
            f"{use_best}: on the test sequences, they take {significant(ratio)} times the step "
            f"time of {name}, the fastest of the others that are {on_all}"
        ]

    @property
    def is_successful(self) -> bool:
        """True if settings were found that pass on the training and the test sequences."""
        return self.path is not None and not self._failed_roles

    @property
    def _failed_roles(self) -> list[TunedRole]:
        """The training or test sequences on which the best settings are inaccurate or late."""
        return [role for role in self.roles if not role.passes(self.solver.requirements)]

    @property
    def _machine(self) -> list[str]:
        """Line on what disturbed the last comparison; none where that is not known."""
        runs = [run for role in self.roles for own in role.runs.values() for run in own]
        known = sum_disturbances(runs).seconds > 0
        return [f"machine: {describe_machine_states(runs)}"] if known else []

    @property
    def _measured(self) -> list[str]:
        """Accuracy and time of the best settings: in the end, or else in their batch."""
        if not self.roles:
            ratio = significant(self.best.score.ratio)
            names = ", ".join(problem.name for problem in self.request.training)
            known = _describe_accuracy(self.best.score.late, len(self.request.training))
            return [
                f"training sequences ({names}): {known}; {ratio} times the step time of default"
            ]
        return [
            f"{role.title} sequences ({', '.join(run.sequence for run in role.runs[BEST])}): "
            f"{role.summarise_best_settings(self.solver.requirements)}"
            for role in self.roles
        ]

    @property
    def _iterations(self) -> list[str]:
        """Line on the largest number of iterations of the best settings if near their limit."""
        limit = self.request.find_iteration_limit(self.best.options)
        runs = [run for role in self.roles for run in role.runs[BEST]]
        worst = max(runs, key=lambda run: np.nan_to_num(run.iterations_max), default=None)
        if limit is None or worst is None or not worst.iterations_max > NEAR * limit[1]:
            return []
        name, most = limit
        return [
            f"iterations of the best: up to {worst.iterations_max:.0f} of {name} = {most:g}, in "
            f"{worst.sequence}"
        ]

    @cached_property
    def _largest_error(self) -> str:
        """The error of best settings near its limit, or tried on some steps only; "" otherwise."""
        limit = self.solver.requirements.error_move
        every = {one.name: one.every for one in (*self.request.training, *self.request.test)}
        runs = [
            run
            for role in self.roles
            for run in role.runs[BEST]
            if is_right_on_every_step(run, self.solver.requirements)
            and (run.error_move_max > NEAR * limit or every.get(run.sequence, 1) > 1)
        ]
        if not runs:
            return ""
        worst = max(runs, key=lambda run: run.error_move_max)
        steps = worst.steps_done * every.get(worst.sequence, 1)
        k = find_step_of_largest_error(self.request.folder / FINAL, worst)
        return (
            f"largest error {100 * worst.error_move_max / limit:.2g} % of the limit, at step {k} "
            f"of {worst.sequence} ({worst.steps_done:.0f} of {steps:.0f} steps measured)"
        )

    @property
    def _cautions(self) -> list[str]:
        """The command that checks closed loops, and the largest error where it calls for caution.

        The command has a result folder for these settings alone, as `run` refuses one of others.
        """
        mode = f"--route {self.solver.route} --policy {self.solver.policy}"
        for file in list_plugin_files(self.solver.solver_module):
            mode += f" --solver-module {file}"
        choice = f"{self.solver.name}[{format_options_as_toml(self.best.options)}]"
        own = hashlib.sha256(f"{choice} {mode}".encode()).hexdigest()[:8]
        out = shlex.quote(str(self.request.folder / f"loops-{own}"))
        return [
            *filter(None, [self._largest_error]),
            "check these settings in closed loops, in the call mode of their search:",
            f"dpbench run standard --solver '{choice}' {mode} --out {out}",
        ]

    @property
    def _not_done(self) -> list[str]:
        """Work that an interrupted search has not done, as phrases."""
        left = self.request.trials - self.drawn
        parts = [f"{left} of {self.request.trials} settings to try"] if left else []
        parts.append("the measurement on test sequences, with the presets")
        go_on = "the same command continues"
        return [f"interrupted, not done: {join_with_and(parts)}; {go_on}"] * self.is_interrupted

    @property
    def toml(self) -> str:
        """The table `[settings.NAME]` of a suite, with what was measured in its comments."""
        solver, name = self.solver, self.request.name
        comments = [
            *self._conclusion,
            f"Settings of {solver.name} in the call mode of their search; found by "
            "`dpbench tune-solver`.",
            *self.request.searched,
            *self._iterations,
            *self._measured,
            *filter(None, [self._largest_error]),
            *self._not_done,
        ]
        options = format_options_as_toml(self.best.options).replace(",", ", ").replace("=", " = ")
        head = "".join(f"# {line}\n" for line in comments)
        mode = f'route = "{solver.route}"\npolicy = "{solver.policy}"\n'
        table = f"[settings.{name}]\n{mode}{solver.name} = {{ {options} }}\n"
        call = format_library_call(
            solver.name, solver.route, solver.policy, self.best.options
        ).splitlines()
        code = ["", "Without dpbench:", *call] if call else []
        return head + table + "".join(f"# {line}".rstrip() + "\n" for line in code)


def _format_step_time(run: RunRecord) -> str:
    """Format the step time that a run is ranked by, with its name unless it is the p99."""
    name, time_ns = next(iter(name_step_times_ns(run).items()))
    return format_time(time_ns) if name == "p99" else f"{name} {format_time(time_ns)}"


class _SearchProgress:
    """The progress of all campaigns of a search as that of one, with its part before each text."""

    def __init__(self, progress: Progress, request: SearchRequest) -> None:
        self._progress, self._batch, self._planned = progress, 0, 0
        self._part = ""
        self._batches = len(split_into_batches(request.trials))
        self._training = count_steps_of_settings(request.solver, request.training)
        self._all = self._training + count_steps_of_settings(request.solver, request.test)
        in_end = len(request.presets) + len(request.name_settings({}))
        started = request.trials + len(request.first_trials) + self._batches
        self._remarks: set[str] = set()
        progress.start(started * self._training + in_end * self._all)

    def plan(self, settings: int, *, with_test: bool = False) -> None:
        """Store the work of a search's next campaign, of so many settings with the presets."""
        self._batch += 1
        self._part = f"batch {self._batch}/{self._batches}"
        if with_test:
            self._part = "measurement of the best"
        self._planned = settings * (self._all if with_test else self._training)

    def start(self, work: int) -> None:
        """Report as finished what a campaign of the search need not do again."""
        if work < self._planned:
            self.advance(self._planned - work, "finished before")

    def advance(self, work: int, what: str) -> None:
        """Add finished work [steps] of this campaign."""
        self._progress.advance(work, f"{self._part}: {what}")

    def remark(self, text: str) -> None:
        """Show a remark of the campaigns once, even if several make it."""
        if text not in self._remarks and NO_P99 not in text:
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
    solver_module: PluginFiles = None,
    wait_s: float | None = None,
    progress: Progress | None = None,
) -> Tuning:
    """Search a solver's settings on training sequences; return the best, measured on test ones.

    Finished runs are kept: the same call goes on after an interruption. Ctrl-C ends the search with
    the best settings of its finished batches, if there are any.

    Parameters
    ----------
    solver : a name, or with custom settings as `osqp[rho=1.6]`: the search starts with these,
        keeps those of their options that it does not search, and measures them beside the best.
    training, test : recorded sequences or scenarios; by default those in `request.py`.
    ranges : texts such as `rho=[1e-3,10]`, in place of the stated ranges of the solver.
    widened : such texts beside the other ranges.
    route, policy : of the solver; no route is native where it has that.
    error_move : the accuracy requirement, largest error of the first move [maximum increments].
    trials : settings to try, beside one's own and the presets; steps : of a scenario, 0 for all.
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
    for remark in (forecast_search(request).summary, *request.remarks):
        bar.remark(remark)
    search = _make_search(request, bar, wait_s)
    roles: tuple[TunedRole, ...] = ()
    is_interrupted = False
    try:
        search.run(request.trials, request.first_trials)
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
    """Return a search that measures each batch of settings in a campaign on training sequences."""
    numbers, tuned, problems = count(1), request.solver, request.training

    def evaluate(settings: Sequence[Options]) -> list[Score]:
        place = request.folder / f"batch-{next(numbers):02d}"
        progress.plan(len(settings) + 1)
        own, presets = split_off_presets(tuned.name, settings)
        measured = measure_settings(tuned, problems, own, place, progress, presets, wait_s=wait_s)
        return score_settings(tuned, settings, measured, problems)

    return SettingsSearch(request.space, evaluate, request.seed)


def _measure_roles(
    request: SearchRequest, best: Options, progress: _SearchProgress, wait_s: float | None
) -> tuple[TunedRole, ...]:
    """Time presets, own and best settings side by side; return their training and test runs."""
    presets, named = request.presets, request.name_settings(best)
    progress.plan(len(presets) + len(named), with_test=True)
    measured = measure_settings(
        request.solver,
        [*request.training, *request.test],
        named,
        request.folder / FINAL,
        progress,
        presets,
        purpose=f" ({request.sequences_by_purpose})",
        wait_s=wait_s,
    )
    roles = []
    for title, problems in (("training", request.training), ("test", request.test)):
        found = group_runs_by_settings(measured.runs, problems)
        # Of two names with equal options the results have one, a preset's before one's own.
        of_presets = {name: find_options_of_preset(name, request.solver.name) for name in presets}
        known = of_presets | named
        alike = {
            format_options_as_toml(known[name]): found[name] for name in known if name in found
        }
        own = {name: alike[format_options_as_toml(options)] for name, options in named.items()}
        others = {name: found[name] for name in presets if name in found}
        roles.append(TunedRole(title, others | own, measured))
    return tuple(roles)
