"""Capability plots and consequence analyses: what thrusters hold, and the answers of solvers.

The QPs of all failure groups at one sample of a consequence analysis are a batch, solved one after
another. Each QP counts once, by the round in which a solver was worst:

    QPs = held rightly + refused rightly + missed alarms + other untrue claims + nothing
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key, map_first_by_key
from dpbench.analysis.suites.random_claims import CLAIMS, count_claims_by_run, flag_claims_by_step
from dpbench.analysis.verdict.ship_results import find_ship_results
from dpbench.analysis.verdict.simulated_losses import list_lost_so_far, list_simulated_losses
from dpbench.bench.capability.frontier import DIRECTIONS, Capability, WindLimit
from dpbench.bench.judge.rules import INFEASIBLE, UNCERTIFIED, UNDECIDED, percentile_or_nan
from dpbench.bench.record.cell import CapabilitySource, ConsequenceSource
from dpbench.scenario.scenario import build_or_reuse_scenario
from dpbench.ship.thrusters import ThrusterSet


@dataclass(frozen=True)
class Answers:
    """Counts of a solver's right and wrong answers to static thrust allocation QPs.

    asked : QPs of the batch; feasible, infeasible : how many of each it reached.
    balanced : true optima; refused : infeasible ones rightly called so; wrong : untrue claims.
    p50_ns, max_ns : of its step times; NaN without any.
    """

    solver: str
    outcome: str
    asked: int
    feasible: int
    infeasible: int
    balanced: int
    refused: int
    wrong: int
    p50_ns: float
    max_ns: float

    @property
    def unanswered_count(self) -> int:
        """Number of QPs that a solver left without an answer, those never reached included."""
        return self.asked - self.right_count - self.wrong

    @property
    def right_count(self) -> int:
        """Number of a solver's correct answers: true optima, true claims of infeasibility."""
        return self.balanced + self.refused

    @property
    def has_only_right_answers(self) -> bool:
        """True if the solver answered every QP correctly."""
        return self.right_count == self.asked


def count_answers_by_run(records: Records, runs: Sequence[RunRecord]) -> list[Answers]:
    """Return each run's counts of right and wrong answers to thrust allocation QPs, best first."""
    answers = []
    for run in runs:
        if run.outcome == "refused":
            continue
        steps = records.read_counting_step_table(run, ("run_id", "total_ns", *CLAIMS))
        counts = count_claims_by_run(steps).reindex([run.run_id], fill_value=0).iloc[0].astype(int)
        infeasible = int((steps["certificate"] == INFEASIBLE).sum())
        times: pd.Series[float] = steps["total_ns"].astype("float64")
        answers.append(
            Answers(
                *(run.solver, run.outcome, run.steps_planned),
                feasible=len(steps) - infeasible,
                infeasible=infeasible,
                balanced=int(counts["right_claims"]),
                refused=int(counts["right_refusals"]),
                wrong=int(counts["false_claims"] + counts["wrong_refusals"]),
                p50_ns=float(times.median()),
                max_ns=float(times.max()),
            )
        )
    return sorted(answers, key=lambda a: (a.wrong > 0, -a.right_count, a.wrong, a.p50_ns))


@dataclass(frozen=True, eq=False)
class CapabilityResult:
    """Capability plot of a vessel, and solvers' answers to QPs at the largest winds held.

    sides : of the polygons of its QPs.
    edges : columns `EDGES`, a row for each case and direction; empty where the folder has no plot.
    answers : the best configuration of each solver; empty where none was run.
    """

    vessel: str
    sides: int
    edges: pd.DataFrame
    answers: tuple[Answers, ...]

    @property
    def qp_count(self) -> int:
        """Number of QPs at the largest winds held that each solver was given."""
        return max((answers.asked for answers in self.answers), default=0)

    @property
    def capability_numbers_text(self) -> str:
        """The four DP capability numbers in the standard's notation; "" of a plot with gaps."""
        held = {
            str(case): tuple(map(WindLimit, own["wind_mps"], own["number"]))
            for case, own in self.edges.sort_values("from_deg").groupby("case", sort=False)
        }
        if len(held) < 2 or any(len(limits) != DIRECTIONS for limits in held.values()):
            return ""
        return Capability(self.vessel, self.sides, held, {}, ()).notation


EDGES = ("case", "lost", "from_deg", "wind_mps", "number", "untrue")
"""Columns of a direction: what has failed, the thrusters lost, the direction of the weather, the
largest wind held, the DP capability number, and how many solvers made an untrue claim of a QP
there."""


def build_capability_results(
    records: Records, table: pd.DataFrame | None
) -> list[CapabilityResult]:
    """Return a folder's capability plots (wind held by direction), in suite order.

    table : of `load_capability_plots`; None where the folder has none.
    """
    at_edge = [run for run in records.at_edge if run.has_steps]
    names = dict.fromkeys(run.sequence for run in at_edge)
    known = {} if table is None else dict(iter(table.groupby("sequence", sort=False)))
    plots = []
    for name in {**names, **dict.fromkeys(map(str, known))}:
        runs = [run for run in at_edge if run.sequence == name]
        answers = map_first_by_key(
            count_answers_by_run(records, runs), lambda of_solver: of_solver.solver
        )
        own = known.get(name)
        if own is not None:
            vessel, sides = str(own["vessel"].iloc[0]), int(own["sides"].iloc[0])
        else:
            source = runs[0].source
            assert isinstance(source, CapabilitySource), "runs at the boundary"
            vessel, sides = source.vessel_name, source.sides
        edges = (
            pd.DataFrame(columns=list(EDGES))
            if own is None
            else _tabulate_wind_by_direction(records, own, runs)
        )
        plots.append(CapabilityResult(vessel, sides, edges, tuple(answers.values())))
    return plots


def _tabulate_wind_by_direction(
    records: Records, points: pd.DataFrame, runs: Sequence[RunRecord]
) -> pd.DataFrame:
    """Return a table of the largest wind that thrusters hold, by failure and direction."""
    false_claimants: dict[int, set[str]] = {}
    for run in runs:
        steps = records.read_counting_step_table(run, ("k", *CLAIMS))
        claims = flag_claims_by_step(steps)
        for k in steps["k"][claims["false_claims"] | claims["wrong_refusals"]]:
            false_claimants.setdefault(int(k), set()).add(run.solver)
    rows = []
    for (case, from_deg), of_direction in points.groupby(["case", "from_deg"], sort=False):
        first = of_direction.iloc[0]
        said = set().union(*(false_claimants.get(int(k), set()) for k in of_direction["k"]))
        wind_mps, number = first["edge_mps"], first["number"]
        rows.append((case, first["lost"], from_deg, wind_mps, number, len(said)))
    return pd.DataFrame(rows, columns=list(EDGES))


HELD, LOST, UNKNOWN = "can be held", "cannot be held", "not known"
"""Proven states of the loss of a group at a sample."""
SPAN = ("group", "from_s", "to_s", "state", "losses")
"""Columns of a span of time: the group lost, the state, and how many losses the loop of the
analysis simulates before it; with any, the loss of the group is a further one."""


@dataclass(frozen=True)
class BatchAnswers:
    """Counts of a configuration's right and wrong answers on possible thruster losses.

    asked : all QPs; feasible, infeasible : how many of each it reached.
    held : feasible, with a true optimum; refused : infeasible, and rightly called so.
    missed : infeasible, and claimed solved; untrue : all untrue claims, those included.
    p99, largest : share of the sample that a batch takes; NaN for too few, or an unfinished group.
    """

    solver: str
    name: str
    asked: int
    feasible: int
    infeasible: int
    held: int
    refused: int
    missed: int
    untrue: int
    p99: float
    largest: float

    @property
    def unanswered_count(self) -> int:
        """Number of QPs that a configuration left without an answer or never reached."""
        return self.asked - self.held - self.refused - self.untrue

    @property
    def has_only_right_answers(self) -> bool:
        """True if the solver configuration answered every QP correctly."""
        return self.held + self.refused == self.asked


@dataclass(frozen=True, eq=False)
class ConsequenceAnalysis:
    """Results of a consequence analysis: losses after which position is held, answers of solvers.

    margin : by which the force to hold is multiplied.
    run : one of the runs, all along the same loop; None in a table without runs.
    spans : columns `SPAN`: for each loss, spans of time and what is proven of them. A group that
        the loop has lost already has no further ones.
    answers : of every configuration, right ones first, then the fastest.
    ship_left_s : when the ship of the loop leaves its station [s], before the end of the analysed
        steps or of the intact ship; NaN for a ship that is held.
    departures : group and scenario of each simulated loss of one group after which this ship, in
        any weather, leaves its station; group "" for the loop of the analysis without a loss.
    overload : share of its thrust that the mean load takes if it exceeds 1, else NaN.
    """

    name: str
    groups: tuple[str, ...]
    margin: float
    spans: pd.DataFrame
    answers: tuple[BatchAnswers, ...]
    run: RunRecord | None = None
    ship_left_s: float = math.nan
    departures: tuple[tuple[str, str], ...] = ()
    overload: float = math.nan

    @property
    def single_losses(self) -> pd.DataFrame:
        """Spans before any simulated loss: those in which the loss of a group is the only one."""
        return self.spans[self.spans["losses"] == 0]

    @property
    def is_alarm_due(self) -> bool:
        """True if a QP is infeasible: the loss of a group cannot be held at some sample."""
        return any(own.infeasible for own in self.answers)

    @property
    def best_answers_by_solver(self) -> dict[str, BatchAnswers]:
        """Answers of each solver's best configuration, by solver name."""
        return map_first_by_key(self.answers, lambda answers: answers.solver)


@lru_cache(maxsize=2)
def build_consequence_analyses(records: Records) -> list[ConsequenceAnalysis]:
    """Return the folder's analyses of thruster losses, those in which a QP was solved."""
    asked = [run for run in records.consequence if run.outcome != "refused"]
    batches = group_by_key(
        asked, lambda run: run.sequence.removesuffix(f", {run.lost_thruster_group} lost")
    )
    return [
        _build_consequence_analysis(records, name, runs)
        for name, runs in batches.items()
        if any(run.has_steps for run in runs)
    ]


def _build_consequence_analysis(
    records: Records, name: str, runs: Sequence[RunRecord]
) -> ConsequenceAnalysis:
    """Return a consequence analysis of its runs: answers, losses held, time of each solver."""
    groups = group_by_key(runs, lambda run: run.lost_thruster_group)
    longest = [max(of_group, key=lambda run: run.steps_done) for of_group in groups.values()]
    files = runs[0].scenario_documents
    sample_s = math.nan if files is None else build_or_reuse_scenario(files).sample_s
    by_configuration = group_by_key(runs, lambda run: run.solver_label)
    answers = [
        _sum_answers_over_losses(records, own, len(groups), sample_s)
        for own in by_configuration.values()
    ]
    answers.sort(key=lambda a: (a.untrue > 0, -(a.held + a.refused), a.untrue, a.largest))
    spans = pd.concat(
        [_tabulate_loss_state_spans(records, run, sample_s) for run in longest if run.has_steps]
    )
    source = runs[0].source
    margin = source.margin if isinstance(source, ConsequenceSource) else math.nan
    left_s = _find_time_ship_left_s(records, runs, before_s=spans["to_s"].max())
    departures, overload = _find_departures(records, runs[0], tuple(groups))
    known = name, tuple(groups), margin, spans, tuple(answers), runs[0], left_s
    return ConsequenceAnalysis(*known, departures, overload)


def _find_departures(
    records: Records, run: RunRecord, groups: Sequence[str]
) -> tuple[tuple[tuple[str, str], ...], float]:
    """Return the departures and the overload of an analysis along the loop of a run."""
    if (files := run.scenario_documents) is None:
        return (), math.nan
    ships = [
        ship
        for ship in find_ship_results(records)
        if not ship.run.study
        and (ship.run.scenario_documents or {}).get("vessel") == files.get("vessel")
    ]
    thrusters = _get_thrusters(run)
    own = [ship for ship in ships if ship.run.scenario == run.scenario]
    intact = [
        ("", ship.name)
        for ship in own
        if ship.has_left_station
        and all(ship.run.exact_left_s < at_s for at_s, _ in list_lost_so_far(ship.run, thrusters))
    ]
    after = [
        (group, loss.ship.name)
        for group in groups
        for loss in list_simulated_losses(group, thrusters, ships)
        if loss.has_ship_left
    ]
    overloads = [ship.overload for ship in own if ship.overload > 1.0]
    return tuple(dict.fromkeys([*after, *intact])), max(overloads, default=math.nan)


def _find_time_ship_left_s(records: Records, runs: Sequence[RunRecord], before_s: float) -> float:
    """Return when the ship of an analysed loop leaves its station [s], NaN if it is held there.

    before_s : end of the analysed steps; what the ship does later says nothing of them.
    """
    others = (run for run in records.all_runs if run.scenario == runs[0].scenario and not run.study)
    left_s = [run.exact_left_s for run in (*runs, *others) if run.exact_left_s < before_s]
    return min(left_s, default=math.nan)


def _tabulate_loss_state_spans(records: Records, run: RunRecord, sample_s: float) -> pd.DataFrame:
    """Return time spans in which the loss of this run's group can, cannot, or may be held.

    A span ends where the loop loses thrusters, the last one where it loses this group.
    """
    rows = records.read_counting_step_table(run, ("k", "t_s", "certificate"))
    steps = rows.drop_duplicates("k").sort_values("k")
    certificate, t_s = steps["certificate"], steps["t_s"].to_numpy()
    known = np.where(certificate == INFEASIBLE, LOST, HELD)
    state = np.where(certificate.isin((UNCERTIFIED, UNDECIDED)), UNKNOWN, known)
    thrusters = None if run.scenario_documents is None else _get_thrusters(run)
    so_far = [] if thrusters is None else list_lost_so_far(run, thrusters)
    # A loss acts from the sample nearest to its time on.
    losses = np.searchsorted([at_s for at_s, _ in so_far], t_s + 0.5 * sample_s)
    is_new = (state[1:] != state[:-1]) | (losses[1:] != losses[:-1])
    starts = np.flatnonzero(np.append(True, is_new)[: len(state)])
    ends = np.append(t_s[starts[1:]], t_s[-1:] + sample_s)
    spans = zip(t_s[starts], ends, state[starts], losses[starts], strict=True)
    group = run.lost_thruster_group
    members = set() if thrusters is None else set(thrusters.indices_by_failure_group[group])
    with_group = [k for k, (_, lost) in enumerate(so_far) if members <= lost]
    kept = [(group, *span) for span in spans if span[-1] <= min(with_group, default=math.inf)]
    return pd.DataFrame(kept, columns=list(SPAN))


def _get_thrusters(run: RunRecord) -> ThrusterSet:
    """Return the thrusters of the ship in a run of a consequence analysis with documents."""
    assert run.scenario_documents is not None, "documents of the run"
    thrusters = build_or_reuse_scenario(run.scenario_documents).vessel.thrusters
    assert thrusters is not None, "a consequence analysis is of a ship with thrusters"
    return thrusters


def _sum_answers_over_losses(
    records: Records, runs: Sequence[RunRecord], groups: int, sample_s: float
) -> BatchAnswers:
    """Return a configuration's answers summed over thruster losses; times per control sample."""
    of_runs = []
    for run in runs:
        steps = records.read_counting_step_table(run, ("k", *CLAIMS))
        claims, infeasible = flag_claims_by_step(steps), steps["certificate"] == INFEASIBLE
        lies = claims["false_claims"]
        always = {"feasible": claims["steps"] & ~infeasible, "infeasible": infeasible}
        always["held"] = claims["right_claims"]
        always["refused"] = claims["right_refusals"] & infeasible
        ever = {"missed": lies & infeasible, "untrue": lies | claims["wrong_refusals"]}
        by_step = [pd.DataFrame(columns).groupby(steps["k"]) for columns in (always, ever)]
        of_runs.append(pd.concat([by_step[0].all().sum(), by_step[1].any().sum()]))
    counts = pd.concat(of_runs, axis=1).sum(axis=1)
    # The time of a sample's batch is known where every group was run to its end.
    times = [known.algo_ns for known in map(records.get_step_times, runs) if known is not None]
    lengths = {len(algo) for algo in times} | {run.steps_planned for run in runs}
    is_whole = len(times) == len(runs) == groups and len(lengths) == 1
    shares = np.sum(times, axis=0) / (1e9 * sample_s) if is_whole else np.zeros(0)
    return BatchAnswers(
        solver=runs[0].solver,
        name=runs[0].solver_label,
        asked=sum(run.steps_planned for run in runs),
        p99=percentile_or_nan(shares, 99),
        largest=float(shares.max()) if len(shares) else math.nan,
        **{str(name): int(count) for name, count in counts.items()},
    )


def select_configurations_in_all_analyses(
    analyses: Sequence[ConsequenceAnalysis],
) -> dict[str, list[BatchAnswers]]:
    """Return, by name, the configurations run in every consequence analysis with their answers."""
    answers = [own for analysis in analyses for own in analysis.answers]
    by_name = group_by_key(answers, lambda own: own.name)
    return {name: own for name, own in by_name.items() if len(own) == len(analyses)}


def find_largest_solve_time_share(answers: Sequence[BatchAnswers]) -> float:
    """Return the largest share of a sample that an analysis takes; NaN if one is unknown."""
    shares = [own.largest for own in answers]
    return max(shares) if all(map(math.isfinite, shares)) else math.nan
