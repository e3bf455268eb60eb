"""Which solvers tell a load that thrusters balance from one that they do not, and how fast."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from dpbench.analysis.random_claims import claims_by_run
from dpbench.analysis.records import Records
from dpbench.analysis.run_record import RunRecord
from dpbench.bench.judge.rules import INFEASIBLE
from dpbench.bench.record.result_folder import Results


@dataclass(frozen=True)
class Answers:
    """What a solver said of a batch of static allocations.

    Parameters
    ----------
    solver, outcome : of `runs.parquet`.
    asked : QPs it should have answered; feasible, infeasible : how many it was given of each.
    balanced : claimed optima that are true; refused : infeasible ones rightly called so.
    wrong : untrue claims of either kind; the rest it said nothing of.
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
    def right(self) -> int:
        """Right answers of either kind."""
        return self.balanced + self.refused


def answers_of(results: Results) -> list[Answers]:
    """The answers of each solver on its default route, most right ones first, then the fastest."""
    records = Records(results)
    runs = [run for run in records.runs if run.default_route and run.outcome != "refused"]
    found = [_answers(records, run) for run in runs]
    return sorted(found, key=lambda a: (a.wrong > 0, -a.right, a.wrong, a.p50_ns))


def _answers(records: Records, run: RunRecord) -> Answers:
    steps = records.steps(run)
    steps = steps[steps["counts"]]
    counts = claims_by_run(steps).reindex([run.run_id], fill_value=0).iloc[0]
    infeasible = int((steps["certificate"] == INFEASIBLE).sum())
    times: pd.Series[float] = steps["total_ns"].astype("float64")
    return Answers(
        run.solver,
        run.outcome,
        run.steps_planned,
        len(steps) - infeasible,
        infeasible,
        int(counts["told"]),
        int(counts["empty_right"]),
        int(counts["lies"] + counts["empty_wrong"]),
        float(times.median()),
        float(times.max()),
    )
