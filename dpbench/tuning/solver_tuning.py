"""Result of `dpbench tune-solver`: a table, lines of text, and a TOML file of settings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.verdict.requirements import Requirements, is_right
from dpbench.report.formats import error_text, significant, time_text
from dpbench.report.table import Table
from dpbench.solvers.own_settings import format_options_as_toml
from dpbench.tuning.campaigns import TunedSolver, score_runs, step_times_ns
from dpbench.tuning.search import Score, Trial

YOURS, BEST = "yours", "best"


@dataclass(frozen=True)
class TunedRole:
    """Best settings, presets and the user's own on the training or the test sequences.

    runs : by the name of the settings, the user's as `YOURS`, the best ones as `BEST`.
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

    edges : options whose best value is at the edge of its range. folder : of the runs; path : of
    the settings as TOML, None where no trial met the requirement.
    """

    solver: TunedSolver
    best: Trial[Score]
    trials: int
    edges: Sequence[str]
    roles: tuple[TunedRole, ...]
    folder: Path
    path: Path | None

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
                error_text(run.error_move_max),
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
        edges = [f"the best lies at the edge of the searched range, {text}" for text in self.edges]
        if self.path is None:
            return [
                f"none of {self.trials} settings is accurate on every training sequence; the "
                f"nearest, {self.best.name}, misses the requirement on {self.best.score.wrong}",
                *edges,
            ]
        lines = [f"best of {self.trials} settings: {self.best.name}", *edges]
        for role in self.roles:
            lines.append(f"{role.title} sequences: {role.summary(self.solver.requirements)}")
        return [*lines, f"settings: {self.path}; runs: {self.folder / 'final'}"]


def _step_time_text(run: RunRecord) -> str:
    """Format the step time that a run is ranked by, with its name unless it is the p99."""
    name, time_ns = next(iter(step_times_ns(run).items()))
    return time_text(time_ns) if name == "p99" else f"{name} {time_text(time_ns)}"


def settings_toml(tuning: Tuning, name: str) -> str:
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
    options = format_options_as_toml(tuning.best.options).replace(",", ", ").replace("=", " = ")
    head = "".join(f"# {line}\n" for line in comments)
    return f"{head}[settings.{name}]\n{solver.name} = {{ {options} }}\n"
