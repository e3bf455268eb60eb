"""Data of the page: the runs by configuration and experiment, both by number, and packed steps."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Self

import numpy as np

from dpbench.analysis.records.kept_runs import FORCES, TRACK, KeptRun, Track, track_of
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.records.run_steps import MEASURES
from dpbench.analysis.suites.study import Study, studies
from dpbench.analysis.verdict.run_matrix import Experiment, RunMatrix, common_configuration
from dpbench.analysis.verdict.verdict import Verdicts
from dpbench.report.formats import as_float
from dpbench.report.page.pack import Block
from dpbench.report.page.steps import MOST_HARD, Room, pack_steps, pack_track
from dpbench.report.page.studies import MOST_LOOPS, opening, shown, study_document


@dataclass(eq=False)
class PageData(RunMatrix):
    """What was run where, and the block that the page's arrays are in."""

    block: Block = field(default_factory=Block)

    @classmethod
    def of(cls, records: Records, verdicts: Verdicts) -> Self:
        """Select the data of some records; of studies the runs that the page has room for."""
        return cls.from_records(records, verdicts, shown(records.study), MOST_LOOPS)

    @cached_property
    def studies(self) -> list[Study]:
        """All studies."""
        return studies(self.records)

    @cached_property
    def study_documents(self) -> list[dict[str, Any]]:
        """What the script of the page knows of each."""
        runs = {run.run_id: run for run in shown(self.records.study)}
        numbers = {run.name: self.index(common_configuration(run)) for run in runs.values()}
        return [study_document(study, runs, numbers) for study in self.studies]

    @property
    def opening(self) -> tuple[int, int] | None:
        """Numbers of the configuration and experiment that a page on studies alone opens with."""
        if self.judged_experiments or not self.studies:
            return None
        run = opening(self.studies[0], shown(self.records.study))
        if run is None:
            return None
        return self.index(common_configuration(run)), self.experiments.index(Experiment.of(run))

    @cached_property
    def kept(self) -> dict[str, KeptRun]:
        """Kept steps of every run with a counting step, by id, in the order of the steps file."""
        runs = {run.run_id: run for run in self.runs.values()}
        room = Room.of([run.steps_done for run in runs.values() if run.has_steps])
        kept: dict[str, KeptRun] = {}
        read = self.records.run_steps(list(runs.values()), (*TRACK, *FORCES))
        for run_id, steps, rows in read:
            run = runs[run_id]
            limits = self._limits(run) if run.mode == "closed_loop" else None
            track = None if limits is None else track_of(rows, limits, room.points)
            kept[run_id] = KeptRun.of(steps, room.steps, track)
        return kept

    @property
    def thinned(self) -> int:
        """Of how many runs the page keeps a part of the steps."""
        return sum(not run.is_whole for run in self.kept.values())

    def cells(self) -> Iterator[dict[str, Any]]:
        """Every run with its packed steps and hardest steps."""
        references: dict[int, Track] = {}
        hard = max(1, min(5, MOST_HARD // max(1, len(MEASURES) * len(self.runs))))
        order = sorted(self.runs, key=lambda key: (key[1], self._deviation(self.runs[key])))
        for c, p in order:
            run = self.runs[c, p]
            entry, kept = self._cell(c, p, run), self.kept.get(run.run_id)
            if kept is not None:
                entry |= pack_steps(self.block, kept) | {"hard": _hard(kept, hard)}
                if kept.track is not None:
                    entry |= pack_track(self.block, kept.track, references.get(p))
                    entry["reference"] = p not in references
                    references.setdefault(p, kept.track)
            yield entry

    def _cell(self, c: int, p: int, run: RunRecord) -> dict[str, Any]:
        return {
            "c": c,
            "p": p,
            "id": run.run_id,
            "verdict": self.state(c, p),
            "outcome": run.outcome,
            "why": run.outcome_detail[:200],
            "infeasible": number(run.infeasible_steps),
            "all_true": run.true_share == 1.0,
            "steps": run.steps_done,
            "answers": int(run.steps_done * max(1.0, run.rounds)),
            "planned": run.steps_planned,
            "error": number(run.error_move_max),
            "failed": number(run.failed_steps),
            "untrue": number(run.claimed_not_true),
            "off_m": number(run.dev_position_max_m),
            "settle_s": number(run.settle_s),
        }

    def _limits(self, run: RunRecord) -> Any:
        scenario = self.scenario(run)
        if scenario is None:
            return None
        vessel = scenario.vessel
        return np.maximum(vessel.tau_max, -vessel.tau_min)

    @staticmethod
    def _deviation(run: RunRecord) -> float:
        return math.inf if math.isnan(run.dev_position_max_m) else run.dev_position_max_m


def _hard(run: KeptRun, count: int) -> list[list[list[Any]]]:
    """Return the hardest steps by each measure: k, figure, status, claimed, true, active limits."""
    return [
        [
            [row.k, number(row.value), row.status, int(row.claimed), int(row.true), row.n_active]
            for row in run.hard[measure][:count]
        ]
        for measure in MEASURES
    ]


def number(value: object) -> float | str | None:
    """Convert a number to JSON: None where it is missing, "inf" where it is infinite."""
    x = as_float(value)
    if math.isnan(x):
        return None
    return x if math.isfinite(x) else "inf"


def columns_of(rows: Sequence[dict[str, Any]]) -> dict[str, list[Any]]:
    """Turn rows of one kind into columns."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return {name: [row.get(name) for row in rows] for name in names}
