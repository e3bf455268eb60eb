"""Columns and figures of a closed loop whose log is written by hand."""

import pytest

from dpbench import load_scenario
from dpbench.bench.judge.evaluation import EvaluatedCell, evaluate_loop_log
from dpbench.bench.judge.rows import make_step_columns
from dpbench.bench.judge.rules import StepColumns
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.raw_log import PHASES, RawLog, make_loop_layout
from dpbench.bench.run.formulation import QPBuilder
from dpbench.scenario.scenario import build_scenario_from_documents
from tests.bench.judge.known_runs import exact_loop

STEPS, DONE = 4, 3
NORTH = [0.0, 1.0, 2.0, 4.0, 99.0]
"""Positions against a reference 2 m ahead: errors -2, -1, 0 at the samples of the three steps, 2
after them."""
SURGE = [16e3, 16e3, 15e3]
"""From the third sample on the most is 12.4 kN."""


@pytest.fixture(scope="module")
def judged() -> tuple[EvaluatedCell, StepColumns, Cell]:
    """Three of four planned steps of `calm` with a reference, and a fault at 0.6 s."""
    calm = load_scenario("calm").files
    changes = {
        "reference": {"north_m": 2.0},
        "faults": [{"at_s": 0.6, "limit_share": [0.01, 1.0, 1.0]}],
        "duration_s": 0.3 * STEPS,
    }
    case = build_scenario_from_documents(calm | {"scenario": calm["scenario"] | changes})
    log = RawLog.in_memory(make_loop_layout(STEPS, *QPBuilder(case).sizes))
    log.done[0] = DONE
    log.state[:, 3] = NORTH
    log.state[:, 0] = [0.5, 0.0, 1.0, 50.0, 50.0]
    log.tau[:DONE, 0], log.command[:DONE, 0] = SURGE, [17e3, 18e3, 19e3]
    log.flags[:DONE] = [[1, 0, 0], [0, 1, 0], [0, 1, 1]]
    log.times[:] = 0
    log.times[0, :, PHASES.index("solve")] = [100, 200, 300, 400]
    cell = Cell("closed_loop", case.files, "daqp", "native", "warm", "high", STEPS)
    exact = exact_loop([[0.0, 0.0, 0.0]] * (STEPS + 1), [[1e3, 0.0, 0.0]] * STEPS)
    evaluated = evaluate_loop_log(cell, log, exact)
    return evaluated, make_step_columns(cell, evaluated), cell


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("r_max_m", 2.0),
        ("iae_n", 0.9),
        # t = 0.3 s: 0.3·1·0.3
        ("itae_n", 0.09),
        # ½ (1 + 0 + 4) and ½ 1e-10 (16000² + 0 + 1000²)
        ("closed_loop_cost", 2.5 + 0.01285),
        # ½ 3·4 and ½ 1e-10·1000²
        ("exact_cost", 6.0 + 0.00005),
        # 0.5·16 kN and 1·15 kN of 0.3 s
        ("work_J", 6900.0),
        ("dev_position_max_m", 2.0),
        ("dev_force_max_N", 15e3),
        # From 16 kN the limit of 12.4 kN is within the rate of 32.7 kN
        ("limit_violations", 1.0),
        ("at_amplitude_surge", 1 / 3),
        ("sample_s", 0.3),
    ],
)
def test_figures_of_a_written_log(
    name: str, value: float, judged: tuple[EvaluatedCell, StepColumns, Cell]
) -> None:
    assert judged[0].metrics[name] == pytest.approx(value)


def test_a_ship_that_follows_a_filtered_reference_has_no_error() -> None:
    case = load_scenario("move_filtered").truncate(STEPS)
    log = RawLog.in_memory(make_loop_layout(STEPS, *QPBuilder(case).sizes))
    log.done[0] = STEPS
    log.state[:, 3:] = case.build_reference_table(STEPS + 1)
    assert log.state[1, 3:].any()
    exact = exact_loop(log.state[:, 3:].tolist(), [[0.0, 0.0, 0.0]] * STEPS)
    cell = Cell("closed_loop", case.files, "daqp", "native", "warm", "high", STEPS)
    metrics = evaluate_loop_log(cell, log, exact).metrics
    assert metrics["r_max_m"] == metrics["heading_max_deg"] == 0.0
    assert metrics["closed_loop_cost"] == metrics["exact_cost"] == 0.0
