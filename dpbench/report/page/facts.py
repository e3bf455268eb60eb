"""What the page knows of a result folder: configurations, places, cells, and their steps.

    configurations   one row each: solver, way, settings, outcome and its figures
    places           scenarios steered through and sequences replayed, in the order of the suite,
                     then the seas of studies
    cells            a configuration in a place: its run, its state, its packed steps

The page refers to a configuration and a place by their position in these lists.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, as_float
from dpbench.analysis.records.run_steps import MEASURES
from dpbench.analysis.suites.slowdown import survived
from dpbench.analysis.suites.study import Study, studies
from dpbench.analysis.verdict.demand import Demand
from dpbench.analysis.verdict.verdict import Verdict, Verdicts, verdict_of
from dpbench.bench.record.configuration import Configuration, settings_level
from dpbench.report.page.pack import Block
from dpbench.report.page.steps import (
    FORCES,
    MOST_HARD,
    TRACK,
    KeptRun,
    Room,
    Track,
    pack_steps,
    pack_track,
    track_of,
)
from dpbench.report.page.studies import MOST_LOOPS, opening, shown, study_document
from dpbench.scenario.scenario import Scenario, scenario_of


@dataclass(frozen=True)
class Place:
    """Where configurations were run: a scenario in closed loop, or a sequence in replay.

    study, point, replicate : of a sea of a study.
    """

    mode: str
    name: str
    units: str
    slowdown: float = 0.0
    formulation: str = ""
    study: str = ""
    point: int = 0
    replicate: int = 0

    @classmethod
    def of(cls, run: RunRecord, formulation: str = "") -> Place:
        """The place of a run; `formulation` where it is another than the common one there."""
        if run.study:
            study = run.study, int(run.study_point), int(run.replicate)
            return cls(run.mode, run.scenario, run.units, 0.0, "", *study)
        name = run.sequence if run.mode == "replay" else run.scenario
        slowdown = run.slowdown if run.slowdown > 0.0 else 0.0
        return cls(run.mode, name, run.units, slowdown, formulation)

    @property
    def order(self) -> tuple[bool, bool, bool]:
        """Sort key: loops before replays, SI units after both, studies last."""
        return self.study != "", self.mode == "replay", self.units == "si"

    @property
    def label(self) -> str:
        """As it is called on the page."""
        if self.study:
            return f"{self.study}: point {self.point}, sea {self.replicate}"
        extra = ["replay"] if self.mode == "replay" else []
        extra += ["in N and N·m"] if self.units == "si" else []
        extra += [f"computer × {self.slowdown:g}"] if self.slowdown > 0 else []
        extra += [self.formulation.replace("_", " ")] if self.formulation else []
        return self.name + (f" ({', '.join(extra)})" if extra else "")


@dataclass(eq=False)
class Facts:
    """The lists above, and the block their arrays are in."""

    records: Records
    demand: Demand
    verdicts: Verdicts
    block: Block = field(default_factory=Block)
    configurations: list[Configuration] = field(default_factory=list)
    places: list[Place] = field(default_factory=list)
    runs: dict[tuple[int, int], RunRecord] = field(default_factory=dict)
    states: dict[tuple[int, int], Verdict] = field(default_factory=dict)
    _seas: dict[Place, Scenario | None] = field(default_factory=dict)

    @classmethod
    def of(cls, records: Records, demand: Demand, verdicts: Verdicts) -> Facts:
        """The facts of some records; of two runs of one configuration in one place the longer."""
        runs: dict[tuple[Configuration, Place], RunRecord] = {}
        common = {run.run_id for run in records.runs}
        ships = [r for r in records.all_runs if not (r.is_baseline_law or r.has_topic)]
        studied = shown(records.study)
        for run in [*ships, *studied[:MOST_LOOPS]]:
            usual = run.slowdown > 0.0 or run.run_id in common
            key = _numbered(run), Place.of(run, "" if usual else run.formulation)
            other = runs.get(key)
            if other is None or run.steps_planned > other.steps_planned:
                runs[key] = run
        configurations = list(dict.fromkeys([*(c for c, _ in runs), *map(_numbered, studied)]))
        known = dict.fromkeys([*(place for _, place in runs), *map(Place.of, studied)])
        places = sorted(known, key=lambda place: place.order)
        numbers = {place: p for p, place in enumerate(places)}
        facts = cls(records, demand, verdicts, Block(), configurations, places)
        for (configuration, place), run in runs.items():
            c, p = configurations.index(configuration), numbers[place]
            facts.runs[c, p] = run
            facts.states[c, p] = facts._judged(configuration, run)
        return facts

    @property
    def references(self) -> list[Configuration]:
        """The configuration each solver is judged by; its first where nothing was judged."""
        judged = [verdict.configuration for verdict in self.verdicts.references]
        of_solver: dict[str, Configuration] = {}
        for configuration in self.configurations:
            of_solver.setdefault(configuration.solver, configuration)
        return judged or list(of_solver.values())

    @property
    def levels(self) -> list[str]:
        """The settings levels that were run outside studies, the most usual first."""
        run = [self.configurations[c] for c, p in self.runs if not self.places[p].study]
        return sorted(dict.fromkeys(c.settings for c in run), key=settings_level)

    @property
    def judged_places(self) -> list[int]:
        """The numbers of the places that enter verdicts: all but the seas of studies."""
        return [p for p, place in enumerate(self.places) if not place.study]

    @cached_property
    def studies(self) -> list[Study]:
        """All studies."""
        return studies(self.records)

    @cached_property
    def study_documents(self) -> list[dict[str, Any]]:
        """What the script of the page knows of each."""
        runs = {run.run_id: run for run in shown(self.records.study)}
        numbers = {run.name: self.index(_numbered(run)) for run in runs.values()}
        return [study_document(study, runs, numbers) for study in self.studies]

    @property
    def opening(self) -> tuple[int, int] | None:
        """Configuration and place that a page opens with on which nothing is judged but a study;
        None of another."""
        if self.judged_places or not self.studies:
            return None
        run = opening(self.studies[0], shown(self.records.study))
        if run is None:
            return None
        return self.index(_numbered(run)), self.places.index(Place.of(run))

    def scenario(self, run: RunRecord) -> Scenario | None:
        """The scenario of a run, in a study that of its sea; None where its row carries none."""
        if not run.study:
            return self.records.scenario(run.scenario)
        place = Place.of(run)
        if place not in self._seas:
            files = run.scenario_files
            self._seas[place] = None if files is None else scenario_of(files)
        return self._seas[place]

    @cached_property
    def kept(self) -> dict[str, KeptRun]:
        """What the page keeps of every run that left a counting step, by its id; in the order of
        the steps, which are read once."""
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

    def _judged(self, configuration: Configuration, run: RunRecord) -> Verdict:
        place = "", ""
        return verdict_of(self.records, configuration, {place: run}, [], self.demand)

    def state(self, c: int, p: int) -> str:
        """What a run alone says of the demand: meets, late, wrong, open or not run.

        On a slower computer the ship has to be held, too, or the answers were late: see
        `analysis.suites.slowdown`.
        """
        verdict = self.states.get((c, p))
        if verdict is None or verdict.outcome == "not run":
            return "not run"
        run = self.runs[c, p]
        if verdict.causes:
            return verdict.state
        if run.slowdown > 0.0 and not survived(run):
            return "late"
        return "open" if verdict.doubts else "meets"

    def timed_at(self, verdict: Verdict) -> int | None:
        """The number of the replay behind the p99 of a verdict; None where nothing was timed."""
        wanted = Place("replay", verdict.timed_on, "scaled")
        return self.places.index(wanted) if wanted in self.places else None

    def longest_timing(self, configuration: Configuration) -> tuple[Place, RunRecord] | None:
        """The run with its largest single timing, of everything judged that it ran: loops and
        replays alike; None where none left one."""
        return self._largest(configuration, "raw_max_ns", lambda place: place.units == "scaled")

    def longest_step(self, run: RunRecord) -> tuple[int, float, float] | None:
        """The step of a run with its largest single timing: k, its iterations and active limits;
        None where the page does not keep that step."""
        kept = self.kept.get(run.run_id)
        if kept is None:
            return None
        steps = kept.steps
        at = int(np.nanargmax(steps.raw_ns))
        if steps.raw_ns[at] != run.raw_max_ns:
            return None
        return int(steps.k[at]), float(steps.iterations[at]), float(steps.n_active[at])

    def hardest_loop(self, configuration: Configuration) -> tuple[Place, RunRecord] | None:
        """The judged closed loop with its largest median of timings; None where none left any."""
        return self._largest(
            configuration, "raw_p50_ns", lambda p: p.mode == "closed_loop" and p.units == "scaled"
        )

    def without_solution(self, configuration: Configuration) -> tuple[int, bool]:
        """How many steps of its judged runs had no solution, and whether it said so of all."""
        known = [
            run
            for (c, p), run in self.runs.items()
            if self.configurations[c] == configuration
            and self.places[p].units == "scaled"
            and not self.places[p].study
            and run.infeasible_steps > 0
        ]
        # A replay counts a step in each of its rounds.
        steps = sum(round(run.infeasible_steps / max(1.0, run.rounds)) for run in known)
        return steps, all(run.true_share == 1.0 for run in known)

    def _largest(
        self, configuration: Configuration, column: str, wanted: Callable[[Place], bool]
    ) -> tuple[Place, RunRecord] | None:
        known = [
            (self.places[p], run)
            for (c, p), run in self.runs.items()
            if self.configurations[c] == configuration
            and not self.places[p].study
            and wanted(self.places[p])
            and not math.isnan(getattr(run, column))
        ]
        return max(known, key=lambda one: float(getattr(one[1], column)), default=None)

    def index(self, configuration: Configuration) -> int:
        """The number of a configuration; −1 for one that was not run."""
        known = self.configurations
        return known.index(configuration) if configuration in known else -1

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
            "state": self.state(c, p),
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


def _numbered(run: RunRecord) -> Configuration:
    """The configuration of a run whatever its units and formulation: those belong to the place."""
    return replace(run.configuration.in_common_formulation, units="scaled")


def _hard(run: KeptRun, count: int) -> list[list[list[Any]]]:
    """The hardest steps by each measure: k, figure, status, claimed, true, active limits."""
    return [
        [
            [row.k, number(row.value), row.status, int(row.claimed), int(row.true), row.n_active]
            for row in run.hard[measure][:count]
        ]
        for measure in MEASURES
    ]


def number(value: object) -> float | str | None:
    """A number as JSON has it: None where it is missing, "inf" where it is infinite."""
    x = as_float(value)
    if math.isnan(x):
        return None
    return x if math.isfinite(x) else "inf"


def columns_of(rows: Sequence[dict[str, Any]]) -> dict[str, list[Any]]:
    """Rows of one kind as columns."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return {name: [row.get(name) for row in rows] for name in names}
