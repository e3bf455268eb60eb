"""Capability plots, and how rightly solvers separate loads that thrusters balance from others."""

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, map_first_by_key
from dpbench.analysis.suites.random_claims import CLAIMS, count_claims_by_run, flag_claims_by_step
from dpbench.bench.capability.frontier import DIRECTIONS, Capability, WindLimit
from dpbench.bench.judge.rules import INFEASIBLE
from dpbench.bench.record.cell import CapabilitySource


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
    """Count each run's right and wrong answers to thrust allocation QPs, the best run first."""
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
    """Tabulate the largest wind at which thrusters hold the ship, by failure and direction."""
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
