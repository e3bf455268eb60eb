"""Runs by configuration and experiment, each judged alone: the cells of the page's grid.

An experiment has its scenarios in closed loop and sequences in replay, in the order of the suite,
then the realisations of studies. A window counts in its scenario's closed
loop.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, map_first_by_key
from dpbench.analysis.verdict.requirements import Requirements, has_survived
from dpbench.analysis.verdict.time_findings import SpeedMargin, compute_speed_margins
from dpbench.analysis.verdict.verdict import Verdict, Verdicts, judge_configuration
from dpbench.bench.record.cell import Configuration, sort_key_of_settings
from dpbench.scenario.scenario import Scenario, build_scenario_from_documents


@dataclass(frozen=True)
class Experiment:
    """Basis of a verdict: a scenario in closed loop, a replay, or a study's run."""

    mode: str
    name: str
    units: str
    slowdown: float = 0.0
    formulation: str = ""
    study: str = ""
    point: int = 0
    replicate: int = 0

    @classmethod
    def from_run(cls, run: RunRecord, formulation: str = "") -> "Experiment":
        """Return what a run is judged on: scenario, replayed QP sequence or study realisation."""
        if run.study:
            study = run.study, int(run.study_point), int(run.replicate)
            return cls(run.mode, run.scenario, run.units, 0.0, "", *study)
        name = run.sequence if run.mode == "replay" else run.scenario
        slowdown = run.slowdown if run.slowdown > 0.0 else 0.0
        return cls(run.mode, name, run.units, slowdown, formulation)

    @property
    def label(self) -> str:
        """Name of the scenario, replay or study realisation on the report page."""
        if self.study:
            return f"{self.study}: point {self.point}, realisation {self.replicate}"
        extra = ["replay"] if self.mode == "replay" else []
        extra += ["in SI units"] if self.units == "si" else []
        extra += [f"computer × {self.slowdown:g}"] if self.slowdown > 0 else []
        extra += [self.formulation.replace("_", " ")] if self.formulation else []
        return self.name + (f" ({', '.join(extra)})" if extra else "")


@dataclass(eq=False)
class RunMatrix:
    """Runs and verdicts of a result folder by configuration and scenario, replay or study."""

    records: Records
    requirements: Requirements
    verdicts: Verdicts
    configurations: list[Configuration]
    experiments: list[Experiment]
    runs: dict[tuple[int, int], RunRecord] = field(default_factory=dict)
    states: dict[tuple[int, int], Verdict] = field(default_factory=dict)
    _seas: dict[Experiment, Scenario | None] = field(default_factory=dict)

    @classmethod
    def from_records(
        cls, records: Records, verdicts: Verdicts, studied: Sequence[RunRecord], kept: int
    ) -> Self:
        """Return a folder's runs by configuration and scenario or replay, each one judged.

        studied : runs of studies that are experiments; the first `kept` are among the runs.
        """
        runs: dict[tuple[Configuration, Experiment], RunRecord] = {}
        windows: dict[tuple[Configuration, str], RunRecord] = {}
        common = {run.run_id for run in records.runs}
        ships = [r for r in records.all_runs if not (r.is_baseline_law or r.is_outside_verdicts)]
        for run in [*ships, *studied[:kept]]:
            usual = run.slowdown > 0.0 or run.run_id in common
            if run.steps_searched_for_hardest:
                if usual and run.units == "scaled":
                    windows[get_configuration_in_common_form(run), run.scenario] = run
                continue
            key = (
                get_configuration_in_common_form(run),
                Experiment.from_run(run, "" if usual else run.formulation),
            )
            other = runs.get(key)
            if other is None or run.steps_planned > other.steps_planned:
                runs[key] = run
        of_studies = map(get_configuration_in_common_form, studied)
        configurations = list(dict.fromkeys([*(c for c, _ in runs), *of_studies]))
        known = dict.fromkeys(
            [*(experiment for _, experiment in runs), *map(Experiment.from_run, studied)]
        )
        # Closed loops before replays, problems in SI units after both, studies last.
        experiments = sorted(
            known, key=lambda e: (e.study != "", e.mode == "replay", e.units == "si")
        )
        numbers = {experiment: p for p, experiment in enumerate(experiments)}
        matrix = cls(records, verdicts.requirements, verdicts, configurations, experiments)
        for (configuration, experiment), run in runs.items():
            at = configurations.index(configuration), numbers[experiment]
            matrix.runs[at] = run
            judged = [run]
            window = windows.get((configuration, run.scenario))
            where = experiment.mode, experiment.units, experiment.slowdown
            if window is not None and where == ("closed_loop", "scaled", 0.0):
                judged.append(window)
            verdict = judge_configuration(records, configuration, judged, [], matrix.requirements)
            matrix.states[at] = verdict
        return matrix

    @property
    def reference_configurations(self) -> list[Configuration]:
        """Configuration of each solver on which the verdict on the solver rests."""
        judged = [verdict.configuration for verdict in self.verdicts.verdicts_on_references]
        first = map_first_by_key(self.configurations, lambda configuration: configuration.solver)
        return judged or list(first.values())

    @property
    def settings_levels(self) -> list[str]:
        """Names of the solver settings run outside studies, the most usual first."""
        run = [self.configurations[c] for c, p in self.runs if not self.experiments[p].study]
        return sorted(dict.fromkeys(c.settings for c in run), key=sort_key_of_settings)

    @property
    def judged_experiment_indices(self) -> list[int]:
        """Indices of the scenarios and replays that enter verdicts: all but studies."""
        return [p for p, experiment in enumerate(self.experiments) if not experiment.study]

    @cached_property
    def first_run_by_experiment(self) -> dict[int, RunRecord]:
        """First run of each scenario, replay or study realisation, by its index."""
        keys = map_first_by_key(self.runs, lambda key: key[1])
        return {p: self.runs[key] for p, key in keys.items()}

    def build_scenario_of_run(self, run: RunRecord) -> Scenario | None:
        """Return the scenario of a run, for a study with the run's own sea; None without one."""
        if not run.study:
            return self.records.build_scenario(run.scenario)
        experiment = Experiment.from_run(run)
        if experiment not in self._seas:
            files = run.scenario_documents
            self._seas[experiment] = None if files is None else build_scenario_from_documents(files)
        return self._seas[experiment]

    def get_state_in_experiment(self, c: int, p: int) -> str:
        """Return the verdict on configuration `c` in scenario or replay `p` alone.

        On a slower computer the ship has to be held, too, or the answers were late.
        """
        verdict = self.states.get((c, p))
        if verdict is None or verdict.state == "not run":
            return "not run"
        run = self.runs[c, p]
        if verdict.causes:
            return verdict.state
        if run.slowdown > 0.0 and not has_survived(run):
            return "late"
        return "inconclusive" if verdict.doubts else "borderline" if verdict.near else "pass"

    def find_timed_experiment_index(self, verdict: Verdict) -> int | None:
        """Return the index of the replay on which a verdict's times rest; None without one."""
        wanted = Experiment("replay", verdict.timed_on, "scaled")
        return self.experiments.index(wanted) if wanted in self.experiments else None

    @cached_property
    def windows(self) -> list[tuple[Configuration, RunRecord]]:
        """Windows in scaled units, with their configuration."""
        return [
            (get_configuration_in_common_form(run), run)
            for run in self.records.select_runs(mode="replay", units="scaled")
            if run.steps_searched_for_hardest
        ]

    def find_longest_timing(self, configuration: Configuration) -> RunRecord | None:
        """Return a configuration's judged run with its largest single timing; None if not timed."""
        judged = [run for _, run in self._list_judged_runs(configuration)]
        judged += [run for c, run in self.windows if c == configuration]
        timed = [run for run in judged if not math.isnan(run.raw_max_ns)]
        return max(timed, key=lambda run: run.raw_max_ns, default=None)

    def get_speed_margin(self, configuration: Configuration) -> SpeedMargin | None:
        """Return how much slower a computer may be for a configuration; None if not timed."""
        return compute_speed_margins(self.records, self.requirements).get(configuration)

    def list_runs_with_infeasible_steps(self, configuration: Configuration) -> list[RunRecord]:
        """Return a configuration's judged runs that have QPs without a feasible solution."""
        judged = self._list_judged_runs(configuration)
        return [run for _, run in judged if run.infeasible_steps > 0]

    def _list_judged_runs(self, configuration: Configuration) -> list[tuple[Experiment, RunRecord]]:
        """Return a configuration's runs that enter verdicts, with their scenario or replay."""
        c = self.find_index(configuration)
        known = [(self.experiments[p], run) for (at, p), run in self.runs.items() if at == c]
        return [one for one in known if one[0].units == "scaled" and not one[0].study]

    def find_index(self, configuration: Configuration) -> int:
        """Return the index of a configuration; −1 for one that was not run."""
        known = self.configurations
        return known.index(configuration) if configuration in known else -1


def get_configuration_in_common_form(run: RunRecord) -> Configuration:
    """Return a run's solver configuration, as if in scaled units and the common QP form."""
    return replace(run.configuration.moved_to_common_formulation, units="scaled")
