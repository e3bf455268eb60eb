"""Result of `dpbench tune-solver`: a table, lines of text, and a TOML file of settings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.verdict.requirements import Requirements, is_right
from dpbench.report.formats import format_error, format_time, join_with_and, significant
from dpbench.report.table import Table
from dpbench.solvers.own_settings import format_options_as_toml
from dpbench.tuning.campaigns import TunedSolver, score_runs, step_times_ns
from dpbench.tuning.request import BEST, SearchRequest
from dpbench.tuning.search import Score, Trial


@dataclass(frozen=True)
class TunedRole:
    """Best settings, presets and the user's own on the training or the test sequences.

    runs : by the name of the settings, the user's as `YOURS`, the best ones as `BEST`.
    """

    title: str
    runs: Mapping[str, Sequence[RunRecord]]

    def summarise_best_settings(self, requirements: Requirements) -> str:
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
        """Table of step time and error of presets, own and best settings on each sequence."""
        limit = self.solver.requirements
        rows = [
            (
                role.title,
                run.sequence,
                name,
                _step_time_text(run),
                format_error(run.error_move_max),
                "yes" if is_right(run, limit) else "no",
            )
            for role in self.roles
            for runs in zip(*role.runs.values(), strict=True)
            for name, run in zip(role.runs, runs, strict=True)
        ]
        heads = ("", "sequence", "settings", "time", "error", "accurate")
        note = (
            "Time: p99 of the steps, each the fastest of its rounds; where a sequence is too short "
            "for it the p95 or p50, named beside it. Error: of the first move, at most "
            f"{limit.error_move:g} of a rate-limit step."
        )
        return Table(heads, tuple(rows), f"Settings of {self.solver.name}", note, text_columns=3)

    @property
    def lines(self) -> list[str]:
        """The result in words: the best settings, and what they gain on either kind of sequence."""
        edges = [
            f"the best lies at the edge of the searched range, {text}"
            for text in self.request.space.describe_edges(self.best.options)
        ]
        if self.path is None:
            return [
                f"none of {self.trials} settings is accurate on every training sequence; the "
                f"nearest, {self.best.name}, misses the requirement on {self.best.score.wrong}",
                *edges,
                *self.request.searched,
                *self._not_done,
            ]
        found = "best so far, of" if self.is_interrupted else "best of"
        lines = [f"{found} {self.trials} settings: {self.best.name}", *edges]
        lines += [*self.request.searched, *self._measured, *self._not_done]
        runs = f"; runs: {self.request.folder / 'final'}" if self.roles else ""
        return [*lines, f"settings: {self.path}{runs}"]

    @property
    def _measured(self) -> list[str]:
        """Accuracy and time of the best settings: in the end, or else in their batch."""
        if not self.roles:
            ratio = significant(self.best.score.ratio)
            names = ", ".join(problem.name for problem in self.request.training)
            return [
                f"training sequences ({names}): accurate; {ratio} times the step time of default"
            ]
        return [
            f"{role.title} sequences ({', '.join(run.sequence for run in role.runs[BEST])}): "
            f"{role.summarise_best_settings(self.solver.requirements)}"
            for role in self.roles
        ]

    @property
    def _not_done(self) -> list[str]:
        """Work that an interrupted search has not done, as phrases."""
        left = self.request.trials - self.drawn
        parts = [f"{left} of {self.request.trials} settings to try"] if left else []
        parts.append("the measurement on test sequences, beside the presets")
        go_on = "the same command goes on"
        return [f"interrupted, not done: {join_with_and(parts)}; {go_on}"] * self.is_interrupted

    @property
    def toml(self) -> str:
        """The table `[settings.NAME]` of a suite, with what was measured in its comments."""
        solver, name = self.solver, self.request.name
        comments = [
            f"Settings of {solver.name}, route {solver.route}, policy {solver.policy}; found by "
            "`dpbench tune-solver`.",
            *self.request.searched,
            *self._measured,
            *self._not_done,
        ]
        options = format_options_as_toml(self.best.options).replace(",", ", ").replace("=", " = ")
        head = "".join(f"# {line}\n" for line in comments)
        return f"{head}[settings.{name}]\n{solver.name} = {{ {options} }}\n"


def _step_time_text(run: RunRecord) -> str:
    """Format the step time that a run is ranked by, with its name unless it is the p99."""
    name, time_ns = next(iter(step_times_ns(run).items()))
    return format_time(time_ns) if name == "p99" else f"{name} {format_time(time_ns)}"
