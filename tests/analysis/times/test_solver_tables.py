"""Tables of solvers: their numbers are those of the verdicts and of the runs."""

from __future__ import annotations

from typing import Any

import pytest

from dpbench.analysis.times.solver_tables import tile_table, time_table
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.run_matrix import RunMatrix
from dpbench.analysis.verdict.verdict import verdicts_of
from dpbench.solvers.calibration import COPY_ONLY


def _matrix(records: Any) -> RunMatrix:
    view = records.view()
    return RunMatrix.from_records(view, verdicts_of(view, Requirements()), [], 0)


def test_the_ladder_is_that_of_the_verdicts(records: Any) -> None:
    """Milliseconds of p50, p99, largest step and sample."""
    records.loop("daqp")
    records.replay("daqp", median_us=20.0)
    records.loop("scs")
    assert time_table(_matrix(records))["share"].tolist() == [0.0]
    records.replay(COPY_ONLY, algo_p50_ns=30e3, route="native", policy="reuse")
    matrix = _matrix(records)
    (row,) = time_table(matrix).to_dict("records")
    verdict = matrix.verdicts.references[0]
    assert row["solver"] == "daqp" and row["share"] == 1.0
    times = [row[name] * 1e6 for name in ("p50_ms", "p99_ms", "max_ms")]
    expected = [verdict.p50_ns, verdict.p99_ns, verdict.algo_max_ns]
    assert times == pytest.approx(expected)


def test_a_level_that_was_not_run_somewhere_is_hatched_there(records: Any) -> None:
    records.loop("osqp", "paper", error=0.4)
    records.loop("osqp", "calm", error=0.4)
    records.loop("osqp", "paper", settings="high")
    tiles = tile_table(_matrix(records)).set_index(["settings", "experiment"])["verdict"]
    assert tiles.to_dict() == {
        ("default", "paper"): "fail",
        ("default", "calm"): "fail",
        ("high", "paper"): "pass",
        ("high", "calm"): "not run",
    }
