"""The columns of steps from judged columns of three steps, worked by hand."""

from typing import Any

import numpy as np
import pytest

from dpbench.bench.judge.evaluation import CERTIFICATES, EVALUATION, EvaluatedCell
from dpbench.bench.judge.rows import make_step_columns
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.raw_log import PHASES
from dpbench.bench.record.schema import MISSING_INT
from dpbench.qp.solution import Status
from dpbench.scenario.scenario import load_scenario

CONFIGURATION = {"solver": "x", "route": "native", "policy": "fresh", "settings": "default"}
PAPER = load_scenario("paper").files
REPLAY = Cell(mode="replay", scenario=PAPER, steps=3, rounds=2, **CONFIGURATION)
STATUSES = [Status.SOLVED, Status.INACCURATE, Status.ERROR]
KINDS = ["linear", "infeasible", "none"]


def of_qps(times: list[list[int]], **figures: list[float]) -> dict[str, Any]:
    """The columns of three answers; times by phase, figures of the referee by name."""
    evaluations = np.zeros((3, len(EVALUATION)))
    for name, values in figures.items():
        evaluations[:, EVALUATION.index(name)] = values
    return {
        "repeat": np.zeros(3, dtype=np.int32),
        "k": np.arange(3, dtype=np.int32),
        "times": np.array(times),
        "status": np.array(STATUSES),
        "iterations": np.array([4, -7, 0]),
        "reported_ns": np.array([-1, 9, 0]),
        "waited_ns": np.array([7, 0, -1]),
        "certificate": np.array([CERTIFICATES.index(kind) for kind in KINDS], dtype=np.int8),
        "evaluations": evaluations,
    }


# emit, setup, update, solve, read, overhead
STEP_TIMES = [[1, 10, -1, 100, 5, 50], [2, -1, 20, 200, 6, 60], [3, -1, -1, -1, -1, 70]]


def loop(slowdown: float = 0.0, deadline_s: float = 0.0, **columns: Any) -> dict[str, Any]:
    """The columns of a loop of three steps; the state holds a fourth, after the last."""
    of_ship = {
        "t_s": np.array([0.0, 0.3, 0.6]),
        "latency_ns": np.array([345, 10**9, -2]),
        "asked": np.array([True, True, False]),
        "fallback": np.array([False, False, True]),
        "unconverged": np.array([False, True, False]),
        "clipped": np.array([True, False, False]),
        "state": np.arange(24.0).reshape(4, 6),
        "tau": np.array([[1, 2, 3], [5, 7, 9], [4, 4, 4]]),
        "command": np.array([[11.0, 12.0, 13.0], [14.0, 15.0, 16.0], [17.0, 18.0, 19.0]]),
    }
    figures = {
        "true": [1.0, 0.0, np.nan],
        "true_1e4": [0.0, 1.0, np.nan],
        "error_move": [0.5, 0.25, np.nan],
        "n_active": [3.0, 0.0, np.nan],
    }
    evaluated = EvaluatedCell(of_qps(STEP_TIMES, **figures) | of_ship | columns, {})
    delay = {"slowdown": slowdown, "deadline_s": deadline_s}
    cell = Cell("closed_loop", PAPER, steps=3, **delay, **CONFIGURATION)
    return make_step_columns(cell, evaluated)


def test_what_an_answer_claims_and_took() -> None:
    steps = loop()
    assert steps["status"].tolist() == ["SOLVED", "INACCURATE", "ERROR"]
    assert steps["claimed"].tolist() == [True, False, False]
    assert steps["certificate"].tolist() == KINDS
    for i, phase in enumerate(PHASES):
        assert steps[f"{phase}_ns"].tolist() == [times[i] for times in STEP_TIMES]
    assert steps["total_ns"].tolist() == [115, 226, MISSING_INT]
    assert steps["iterations"].tolist() == [4, MISSING_INT, 0]
    assert steps["reported_ns"].tolist() == [MISSING_INT, 9, 0]
    assert steps["waited_ns"].tolist() == [7, 0, MISSING_INT]


def test_what_the_referee_found() -> None:
    steps = loop()
    assert steps["true"].tolist() == [True, False, False]
    assert steps["true_1e4"].tolist() == [False, True, False]
    assert not steps["true_1e6"].any()
    np.testing.assert_array_equal(steps["error_move"], [0.5, 0.25, np.nan])
    assert steps["n_active"].tolist() == [3, 0, 0] and steps["n_active"].dtype == np.int32


def test_where_the_ship_was_and_what_moved_it() -> None:
    steps = loop()
    names = ("u_mps", "v_mps", "r_radps", "n_m", "e_m", "psi_rad")
    for i, name in enumerate(names):
        assert steps[name].tolist() == [i, 6 + i, 12 + i]
    assert steps["tau_x_N"].tolist() == [1, 5, 4] and steps["dtau_x_N"].tolist() == [1, 4, -1]
    assert steps["tau_y_N"].tolist() == [2, 7, 4] and steps["dtau_y_N"].tolist() == [2, 5, -3]
    assert steps["tau_n_Nm"].tolist() == [3, 9, 4] and steps["dtau_n_Nm"].tolist() == [3, 6, -5]
    assert steps["cmd_x_N"].tolist() == [11, 14, 17] and steps["cmd_n_Nm"].tolist() == [13, 16, 19]
    assert steps["t_s"].tolist() == [0.0, 0.3, 0.6] and steps["counts"].tolist() == [True] * 3
    assert steps["clipped"].tolist() == [True, False, False]
    assert not {"latency_ns", "thrust_share"} & set(steps)
    assert loop(thrust_share=np.ones(3))["thrust_share"].tolist() == [1.0] * 3


def test_a_step_without_a_computation_claims_nothing() -> None:
    steps = loop(slowdown=3.0)
    assert steps["status"].tolist() == ["SOLVED", "INACCURATE", ""]
    assert steps["emit_ns"].tolist() == [1, 2, MISSING_INT]
    assert steps["solve_ns"].tolist() == [100, 200, MISSING_INT]
    assert steps["overhead_ns"].tolist() == [50, 60, 70]
    assert steps["late"].tolist() == [False, True, True]
    assert steps["latency_ns"].tolist() == [345, 10**9, MISSING_INT]


def with_backup(ready_ns: list[int], solve_ns: list[int], **given: Any) -> dict[str, Any]:
    """The columns of a loop whose backup is usable in all steps."""
    own = of_qps([[-1, -1, -1, ns, 1, -1] for ns in solve_ns]) | {
        "status": np.array([Status.SOLVED] * 3),
        "asked": np.ones(3, dtype=np.bool_),
        "acted": np.array([True, True, False]),
        "ready_ns": np.array(ready_ns),
    }
    return loop(**given, **{f"backup_{name}": own[name] for name in own})


@pytest.mark.parametrize(
    ("ready_ms", "late", "failed"),
    [
        ([100, 200, 201], [False, False, True], [False] * 3),
        ([299, 300, 301], [True] * 3, [False, False, True]),
    ],
)
def test_a_backup_that_is_ready_too_late(
    ready_ms: list[int], late: list[bool], failed: list[bool]
) -> None:
    """On a slow computer, with 0.2 s of the sample of 0.3 s as the budget."""
    ready_ns = [10**6 * ms for ms in ready_ms]
    steps = with_backup(ready_ns, [7] * 3, slowdown=3.0, deadline_s=0.2, latency_ns=np.zeros(3))
    assert steps["backup_failed"].tolist() == failed and steps["late"].tolist() == late
    assert steps["backup"].tolist() == [True, True, False]


def test_a_loop_that_waits_for_its_backup_is_late_by_both_times() -> None:
    """Solver and backup take 115 + 299999885 ns, the sample, then a nanosecond more."""
    steps = with_backup([-1] * 3, [299_999_884, 299_999_774, 7])
    assert steps["late"].tolist() == [False, True, False]
    assert steps["backup_ns"].tolist() == [299_999_885, 299_999_775, 8]


@pytest.mark.parametrize(
    ("kernels", "disturbed", "counts"),
    [
        ([4.0, 4.0, 4.0], [False] * 3, [False, True, True]),
        ([9.0, 9.0, 4.0], [True, True, False], [False, False, True]),
    ],
)
def test_replay_rounds(kernels: list[float], disturbed: list[bool], counts: list[bool]) -> None:
    columns = of_qps(STEP_TIMES) | {
        "repeat": np.array([0, 1, 2], dtype=np.int32),
        "t_s": np.zeros(3),
        "reference_kernel_ns": np.array(kernels)[:, np.newaxis] * [1.0, 1.0],
    }
    steps = make_step_columns(REPLAY, EvaluatedCell(columns, {}))
    assert steps["warmup"].tolist() == [True, False, False]
    assert steps["disturbed"].tolist() == disturbed and steps["counts"].tolist() == counts
    assert steps["unconverged"].tolist() == [False, True, False]
    assert steps["fallback"].tolist() == [False, False, True]
    assert not {"late", "n_m", "clipped"} & set(steps)
