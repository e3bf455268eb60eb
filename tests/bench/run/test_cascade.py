"""Closed loops of a cascade: against a loop written out here, solvers of several kinds, lost
thrusters, what acts without an answer, the log, and its allocations as a sequence."""

import copy
import itertools
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import quadprog

from dpbench import open_workspace, run_closed_loop
from dpbench.bench.judge.evaluation import evaluate_replay_log
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.raw_log import RawLog, compute_log_bytes, make_loop_layout
from dpbench.bench.run.assemble import (
    NO_LIMIT_NS,
    build_closed_loop_setup,
    build_sequence_solver_and_log,
)
from dpbench.bench.run.closed_loop import ClosedLoopSetup, record_closed_loop
from dpbench.bench.run.exact_loop import (
    ExactLoop,
    ExactWorkspace,
    rebuild_sequence,
    solve_loop_exactly,
)
from dpbench.bench.run.formulation import QPBuilder
from dpbench.bench.run.replay import ReplayRun
from dpbench.bench.sequences.source import log_size
from dpbench.errors import InputError
from dpbench.mpc.thruster_rows import RAMP_DOWN_SHARE
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.referee import certify_all_steps
from dpbench.qp.solution import Solution, Status
from dpbench.scenario.scenario import Scenario, build_scenario_from_documents, load_scenario
from dpbench.ship.plant import SUBSTEPS, ShipPlant
from dpbench.solvers.contract import Workspace
from dpbench.solvers.function import FunctionWorkspace
from tests.bench.run.loops import limit_violations


def scenario(steps: int = 60, **changes: Any) -> Scenario:
    """The cascade of the library thrown 2 m and 5° off, with other horizons; tables changed."""
    files = copy.deepcopy(load_scenario("thrusters_cascade").files)
    own = files["scenario"]
    own |= {"duration_s": 0.3 * steps} | changes.pop("tables", {})
    own["start"] = {"north_m": 2.0, "east_m": -1.0, "heading_deg": 5.0}
    own["controller"] |= {"prediction_horizon": 30, "control_horizon": 3}
    own["controller"]["thrusters"] |= changes
    return build_scenario_from_documents(files)


def cell(case: Scenario, solver: str = "daqp", **fields: Any) -> Cell:
    return Cell("closed_loop", case.files, solver, "native", "fresh", "high", case.steps, **fields)


def steered_by(case: Scenario, workspace: Workspace, **fields: Any) -> ClosedLoopSetup:
    described = cell(case, workspace.solver, **fields)
    setup = build_closed_loop_setup(described, case, workspace, RawLog.in_memory, NO_LIMIT_NS)
    assert record_closed_loop(setup)
    return setup


def daqp() -> Workspace:
    return open_workspace("daqp", route="native", settings="high")


@pytest.fixture(scope="module")
def case() -> Scenario:
    return scenario()


@pytest.fixture(scope="module")
def exact(case: Scenario) -> ExactLoop:
    return solve_loop_exactly(case)


def planned_force(case: Scenario, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The first move of the force, by quadprog on matrices made here; u may be beyond a limit."""
    control, N_c = case.problem, 3
    model, du = control.model, control.du_max
    H, g = np.zeros((3 * N_c, 3 * N_c)), np.zeros(3 * N_c)
    for i in range(1, control.N_p + 1):
        zero, power = np.zeros((3, 3)), np.linalg.matrix_power
        moved = [
            model.C @ power(model.A, i - 1 - j) @ model.B * du if j < i else zero
            for j in range(N_c)
        ]
        effect = np.hstack(moved)
        free = model.C @ power(model.A, i) @ x - case.reference
        H += effect.T @ case.problem.Q @ effect
        g += effect.T @ case.problem.Q @ free
    H += np.diag(np.tile(np.diag(case.problem.R) * du**2, N_c))
    sums, one = np.kron(np.tri(N_c), np.eye(3)), np.eye(3 * N_c)
    steps = np.repeat(np.arange(1.0, N_c + 1), 3)
    high = np.maximum(np.tile((control.u_max - u) / du, N_c), -steps)
    low = np.minimum(np.tile((control.u_min - u) / du, N_c), steps)
    C = np.vstack([-sums, sums, -one, one])
    b = np.concatenate([-high, low, -np.ones(6 * N_c)])
    z: np.ndarray = quadprog.solve_qp(H, -g, C.T.copy(), b)[0]
    return z[:3] * du


def allocated_forces(case: Scenario, demand: np.ndarray, f: np.ndarray) -> np.ndarray:
    """The forces of the thrusters, by quadprog on moves and slacks of a problem made here."""
    assert case.controller.commanded_thrusters is not None
    table = case.files["scenario"]["controller"]["thrusters"]
    thrusters, rows = (
        case.controller.commanded_thrusters.thrusters,
        case.controller.commanded_thrusters.rows,
    )
    n_f = thrusters.n_f
    T, step = (
        thrusters.repeat_for_each_force_entry(thrusters.largest_thrusts_N),
        thrusters.largest_force_changes_per_sample(case.sample_s),
    )
    unit = np.concatenate([step, case.force_step_max])
    H, g = np.zeros((n_f + 3, n_f + 3)), np.zeros(n_f + 3)
    weight = table["thrust_weight_relative"] * (step / T) ** 2
    H[:n_f, :n_f] = np.diag(weight + table["move_weight_relative"])
    H[n_f:, n_f:] = table["slack_weight_relative"] * np.eye(3)
    g[:n_f] = weight * f / step
    balance = np.hstack([thrusters.T_e, np.eye(3)]) * unit / case.force_step_max[:, np.newaxis]
    short = (demand - thrusters.T_e @ f) / case.force_step_max
    G = np.hstack([rows.G * step, np.zeros((len(rows.G), 3))]) / 1e4
    d = np.eye(n_f + 3)[:n_f]
    C = np.vstack([balance, -G, G, -d, d])
    before = rows.G @ f
    limits = (before - rows.high) / 1e4, (rows.low - before) / 1e4
    z = quadprog.solve_qp(H, -g, C.T.copy(), np.concatenate([short, *limits, -np.ones(2 * n_f)]), 3)
    forces: np.ndarray = f + z[0][:n_f] * step
    return forces


def test_the_loop_is_the_one_written_out_here(case: Scenario, exact: ExactLoop) -> None:
    assert case.controller.commanded_thrusters is not None
    T_e = case.controller.commanded_thrusters.thrusters.T_e
    plant = ShipPlant(case.true_ship, case.first_state, case.sample_s)
    sea = case.environment.build_weather_table_at_stages(case.steps, case.sample_s, SUBSTEPS)
    f, previous = np.zeros(6), case.first_state
    for k in range(12):
        x = np.concatenate([plant.state - previous, plant.state[3:]])
        previous = plant.state.copy()
        demand = T_e @ f + planned_force(case, x, T_e @ f)
        f = allocated_forces(case, demand, f)
        assert exact.demand is not None
        np.testing.assert_allclose(exact.demand[k], demand, rtol=1e-8, atol=1e-2)
        np.testing.assert_allclose(exact.thrust[k], f, rtol=1e-8, atol=1e-2)
        np.testing.assert_allclose(exact.tau[k], T_e @ f, rtol=1e-8, atol=0.1)
        plant.advance_by_one_sample(T_e @ f, sea[k])
        np.testing.assert_allclose(exact.state[k + 1], plant.state, atol=1e-9)


@pytest.mark.parametrize(
    ("solver", "fields"),
    [
        ("daqp", {}),
        ("daqp", {"units": "si"}),
        ("paper_active_set", {}),
        ("quadprog", {"formulation": "condensed_stacked"}),
        pytest.param("piqp", {"formulation": "sparse"}, marks=pytest.mark.slow),
    ],
)
def test_every_form_steers_as_the_exact_loop_does(
    case: Scenario, exact: ExactLoop, solver: str, fields: dict[str, Any]
) -> None:
    workspace = open_workspace(solver, route="native", settings="high")
    log = steered_by(case, workspace, **fields).log
    away = np.abs(log.state - exact.state).max(axis=0)
    # In SI an answer of the same settings is less exact.
    most = np.array([1e-6, 1e-6, 1e-8, 1e-5, 1e-5, 1e-7]) * (100.0 if "units" in fields else 1.0)
    assert (away <= most).all(), away
    assert limit_violations(case, log) == 0.0
    assert not log.flags.any()


@pytest.mark.slow
def test_a_lost_board_gives_nothing_as_soon_as_its_rate_allows() -> None:
    """Lost at 6 s: every step has an answer, no limit is broken, the others go on."""
    lost = scenario(80, tables={"faults": [{"at_s": 6.0, "lost": ["board A"]}]})
    log = steered_by(lost, daqp()).log
    assert not log.flags.any()
    assert limit_violations(lost, log) == 0.0
    gone = 20 + math.ceil(12.0 / 0.3 / RAMP_DOWN_SHARE) + 1
    assert np.abs(log.thrust[gone:, [0, 2, 3]]).max() < 1e-5
    assert np.abs(log.thrust[19, [0, 2, 3]]).max() > 1e4
    assert np.abs(log.thrust[gone:, [1, 4, 5]]).max() > 1e4


def test_a_tripped_board_gives_nothing_at_once_and_its_allocations_are_rebuilt() -> None:
    """The second QPs start from the forces that are left, in the loop and in its sequence."""
    fault = {"at_s": 6.0, "lost": ["board A"], "loss": "trip"}
    case = scenario(30, tables={"faults": [fault]})
    exact = solve_loop_exactly(case)
    np.testing.assert_allclose(exact.thrust[20:, [0, 2, 3]], 0.0, atol=1e-6)
    assert np.abs(exact.thrust[19, [0, 2, 3]]).max() > 1e3
    sequence = rebuild_sequence(case, exact, part="allocation", first=18, count=5)
    for optimum, known in zip(certify_all_steps(sequence), exact.allocated[18:23], strict=True):
        np.testing.assert_allclose(optimum.z, known.z, atol=1e-12)


def test_without_commanded_thrusters_none_can_trip() -> None:
    files = copy.deepcopy(load_scenario("thrusters_cascade").files)
    files["scenario"]["controller"] |= {"kind": "forces", "limits": "attainable"}
    del files["scenario"]["controller"]["thrusters"]
    files["scenario"]["faults"] = [{"at_s": 6.0, "lost": ["board A"], "loss": "trip"}]
    with pytest.raises(InputError, match='loss: found "trip"'):
        build_scenario_from_documents(files)


def test_with_the_attainable_set_both_halves_know_what_is_lost() -> None:
    missing = {}
    for limits in ("box", "attainable"):
        files = copy.deepcopy(load_scenario("thrusters_cascade").files)
        files["scenario"] |= {"duration_s": 36.0, "faults": [{"at_s": 15.0, "lost": ["board B"]}]}
        files["scenario"]["controller"] |= {"limits": limits, "control_horizon": 3}
        case = build_scenario_from_documents(files)
        log = steered_by(case, daqp()).log
        assert not log.flags[:, :2].any()
        assert limit_violations(case, log) == 0.0
        away = np.abs(log.demand - log.tau) / case.vessel.tau_max
        missing[limits] = float(away[100:].max(axis=1).mean())
    assert missing["box"] > 0.01
    assert missing["attainable"] < 0.2 * missing["box"]


def test_both_kinds_of_faults_hold_in_a_cascade() -> None:
    faults = [{"at_s": 3.0, "lost": ["bow 1"]}, {"at_s": 1.5, "limit_share": [0.5, 0.5, 0.5]}]
    case = scenario(20, tables={"faults": faults})
    builder = QPBuilder(case)
    vessel, thrusters = case.vessel, case.vessel.thrusters
    assert thrusters is not None
    np.testing.assert_array_equal(builder.limits[4].high, vessel.tau_max)
    np.testing.assert_array_equal(builder.limits[5].high, 0.5 * vessel.tau_max)
    np.testing.assert_array_equal(builder.limits[10].high, 0.5 * vessel.tau_max)
    in_force = builder.thruster_limits
    assert (in_force[9].high[0], in_force[10].high[0]) == (thrusters.largest_thrusts_N[0], 0.0)


def only_the_controller(qp: QuadraticProgram, **_: object) -> Solution:
    """Solves what has three variables a move, and fails at the rest."""
    if qp.n == 9 and qp.m == 9:
        C = np.vstack([-qp.A, qp.A, -np.eye(9), np.eye(9)]).T.copy()
        b = np.concatenate([-qp.u, qp.l, -qp.ub, qp.lb])
        return Solution(Status.SOLVED, quadprog.solve_qp(qp.P, -qp.q, C, b)[0], 0 * qp.l, 0 * qp.q)
    raise ArithmeticError("no allocation")


def function_workspace() -> FunctionWorkspace:
    workspace = FunctionWorkspace("function", "fresh", only_the_controller, {})
    workspace.reopen = function_workspace
    return workspace


def test_without_an_allocation_the_pseudo_inverse_acts_within_all_limits(case: Scenario) -> None:
    setup = steered_by(case, function_workspace())
    log = setup.log
    assert log.flags[:, 0].all()
    assert (log.status[0] == Status.SOLVED).all()
    assert log.allocation is not None
    assert (log.allocation.status[0] == Status.ERROR).all()
    assert setup.solver.details == {"ArithmeticError: no allocation": case.steps}
    assert limit_violations(case, log) == 0.0
    plain = scenario(allocation="pseudo_inverse")
    other = steered_by(plain, function_workspace()).log
    np.testing.assert_array_equal(other.thrust, log.thrust)
    assert other.allocation is None
    assert not other.flags[:, 0].any()
    assert other.flags[:, 2].any()


def test_the_pseudo_inverse_is_exact_until_a_limit_acts() -> None:
    still = scenario(20, allocation="pseudo_inverse", tables={"environment": {}, "start": {}})
    moved = build_scenario_from_documents(copy.deepcopy(still.files))
    log = steered_by(moved, daqp()).log
    free = log.flags[:, 2] == 0
    assert free.any()
    np.testing.assert_allclose(log.tau[free], log.demand[free], rtol=1e-9, atol=1e-3)


def test_the_time_of_both_solvers_is_no_overhead(case: Scenario) -> None:
    counts = []
    for allocation in ("qp", "pseudo_inverse"):
        steered = scenario(5, allocation=allocation)
        workspace = daqp()
        described = cell(steered)
        setup = build_closed_loop_setup(
            described, steered, workspace, RawLog.in_memory, NO_LIMIT_NS
        )
        setup.clock = itertools.count().__next__
        for solver in (setup.solver, setup.allocating):
            if solver is not None:
                solver._clock = setup.clock
        assert record_closed_loop(setup)
        counts.append(setup.log.times[0, :, 5].tolist())
        if setup.log.allocation is not None:
            assert (setup.log.allocation.times[0, :, 3] == 1).all()
    # Two readings before the second solver's answer: of emitting.
    assert counts[0] == [count + 2 for count in counts[1]]


def test_stored_loops_have_allocations(case: Scenario, exact: ExactLoop, tmp_path: Path) -> None:
    path = tmp_path / "loop.npz"
    for loop in (exact, solve_loop_exactly(scenario(3, allocation="pseudo_inverse"))):
        loop.save(path)
        read = ExactLoop.load(path)
        assert read.demand is not None and loop.demand is not None
        np.testing.assert_array_equal(read.demand, loop.demand)
        assert [optimum.z.tolist() for optimum in read.allocated] == [
            optimum.z.tolist() for optimum in loop.allocated
        ]
    exact.save(path)
    layout = make_loop_layout(case.steps, *QPBuilder(case).sizes)
    assert log_size(cell(case), path) == compute_log_bytes(layout)


@pytest.mark.parametrize("units", ["scaled", "si"])
def test_the_allocations_are_a_sequence(case: Scenario, exact: ExactLoop, units: str) -> None:
    sequence = rebuild_sequence(case, exact, part="allocation", units=units, first=7, count=20)  # type: ignore[arg-type] # one of the two
    assert (sequence.name, len(sequence)) == ("thrusters_cascade-allocation[7:27]", 20)
    assert sequence.sparse_equivalent is None
    workspace = open_workspace("daqp", route="native", policy="warm", settings="high")
    steps, solver, log = build_sequence_solver_and_log(
        sequence, workspace, "condensed_box", 1, RawLog.in_memory
    )
    run = ReplayRun(
        steps, solver, log, warmup_steps=5, limit_ns=NO_LIMIT_NS, clock=time.perf_counter_ns
    )
    assert run.run_round(0) and run.run_round(1)
    evaluated = evaluate_replay_log(log, sequence, case.sample_s, exact.allocated[7:27])
    errors = evaluated.columns["evaluations"]
    assert errors[:, 10].all()
    assert errors[:, 6].max() < 1e-8


def test_other_scenarios_have_no_allocations(case: Scenario) -> None:
    for other in (load_scenario("calm").truncate(2), scenario(2, allocation="pseudo_inverse")):
        with pytest.raises(InputError, match="a cascade with allocation"):
            rebuild_sequence(other, solve_loop_exactly(other), part="allocation")


def test_a_cascade_waits_for_its_answers_and_opens_its_solver_twice(case: Scenario) -> None:
    with pytest.raises(InputError, match="allowed: 0 for a cascade"):
        run_closed_loop(case, open_workspace("daqp"), slowdown=10.0)
    with pytest.raises(
        InputError, match="needs two workspaces; open this solver with open_workspace"
    ):
        run_closed_loop(case, ExactWorkspace())
