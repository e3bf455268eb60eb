"""What solvers said of a batch: right, wrong or nothing, and who comes first."""

from __future__ import annotations

from typing import Any

import pandas as pd

from dpbench.analysis.capability import Answers, answers_of
from dpbench.analysis.records import Records
from dpbench.bench.record.result_folder import Results
from dpbench.bench.record.schema import as_steps

TRUE = {"true": True, "true_1e4": True, "true_1e6": True}
REFUSED = {"status": "PRIMAL_INFEASIBLE", "claimed": False}
EMPTY = {"certificate": "infeasible"}
SILENT = {"status": "UNKNOWN", "claimed": False}


def results_of(records: Any, said: dict[str, list[dict[str, Any]]]) -> Results:
    """Replays of four QPs by solver, each answer a step of 1, 2, 3 and 4 µs."""
    usual: dict[str, Any] = {"status": "SOLVED", "claimed": True, "certificate": "linear"}
    usual |= {"counts": True, "primal": 0.0, "error_plan": 0.0}
    usual |= {"true": False, "true_1e4": False, "true_1e6": False}
    rows = []
    for solver, answers in said.items():
        records.replay(solver, steps=4, rounds=1, steps_planned=4, steps_done=len(answers))
        run_id = records.results().runs["run_id"].iloc[-1]
        rows += [
            {"run_id": run_id, "k": k, "total_ns": 1000 * (k + 1)} | usual | answer
            for k, answer in enumerate(answers)
        ]
    return Results(records.results().runs, as_steps(pd.DataFrame(rows)), {}, {})


def asked(results: Results) -> list[Answers]:
    """The answers of all runs."""
    records = Records(results)
    return answers_of(records, records.runs)


def test_claims_are_held_against_certificates(records: Any) -> None:
    """Two QPs are feasible and two are not; a wrong claim of either kind counts as wrong."""
    held, refused = TRUE, TRUE | REFUSED | EMPTY
    results = results_of(
        records,
        {
            "osqp": [held, REFUSED, refused, EMPTY],
            "daqp": [held, held, SILENT | EMPTY, SILENT | EMPTY],
            "quadprog": [held, held, refused, refused],
        },
    )
    answers = asked(results)
    assert [a.solver for a in answers] == ["quadprog", "daqp", "osqp"]
    counts = {a.solver: (a.balanced, a.refused, a.wrong, a.right) for a in answers}
    assert counts == {"quadprog": (2, 2, 0, 4), "daqp": (2, 0, 0, 2), "osqp": (1, 1, 2, 2)}
    assert {(a.asked, a.feasible, a.infeasible) for a in answers} == {(4, 2, 2)}
    assert (answers[0].p50_ns, answers[0].max_ns) == (2500.0, 4000.0)


def test_who_was_stopped_is_judged_on_what_it_was_given(records: Any) -> None:
    """Of four QPs it saw one."""
    (answer,) = asked(results_of(records, {"osqp": [TRUE]}))
    assert (answer.asked, answer.feasible, answer.infeasible, answer.balanced) == (4, 1, 0, 1)
