"""Consequence analysis: its QPs against linear programs on corners of polygons, and as cells."""

import copy
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.linalg import block_diag
from scipy.optimize import linprog

from dpbench import load_scenario
from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.suite import ReplayTable, SuiteFile
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.raw_log import compute_log_bytes, make_replay_layout
from dpbench.bench.run.exact_loop import solve_loop_exactly
from dpbench.bench.sequences.loop_sequences import (
    FILTER_S,
    build_consequence_sequence,
    filter_force,
)
from dpbench.bench.sequences.source import log_size, read_replay
from dpbench.errors import InputError
from dpbench.mpc.thruster_rows import build_limit_rows_of_thrusters
from dpbench.mpc.thrusters.allocation_qp import AllocationAfterLoss
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.referee import certify
from dpbench.scenario.scenario import Scenario, build_scenario_from_documents, load_vessel
from dpbench.ship.thrusters import Thruster, ThrusterSet

SIDES = 16
GROUPS = ("board A", "board B", "bow azimuth")
RATOWNIK = load_vessel("ratownik").thrusters
assert RATOWNIK is not None


def qp_of(thrusters: ThrusterSet, force: np.ndarray, group: str) -> QuadraticProgram:
    rows = build_limit_rows_of_thrusters(thrusters, SIDES)
    low, high, _ = rows.limits_after_loss_of_thrusters(
        set(thrusters.indices_by_failure_group[group])
    )
    allocation = AllocationAfterLoss(thrusters, rows)
    l, u = allocation.stack_row_limits_of_demands(force[None], low[None], high[None])  # noqa: E741 - as in the program
    return allocation.make_qp_with_row_limits(l[0], u[0])


def corners(thruster: Thruster) -> np.ndarray:
    if thruster.kind != "azimuth":
        return thruster.thrust_N * np.array([[-1.0, 1.0]])
    angle = 2.0 * math.pi * np.arange(SIDES) / SIDES
    return thruster.thrust_N * np.array([np.cos(angle), np.sin(angle)])


def largest_share(thrusters: ThrusterSet, force: np.ndarray, group: str) -> float:
    """Return the largest multiple of a force that the rest can give: a linear program in shares of
    corners."""
    lost = thrusters.indices_by_failure_group[group]
    kept = [t for i, t in enumerate(thrusters.thrusters) if i not in lost]
    forces = np.hstack([t.configuration_columns @ corners(t) for t in kept])
    sums = block_diag(*(np.ones(corners(t).shape[1]) for t in kept))
    balance = np.column_stack((forces, -force)) / np.array([[1e5], [1e5], [1e7]])
    shares = np.column_stack((sums, np.zeros(len(kept))))
    cost = np.zeros(forces.shape[1] + 1)
    cost[-1] = -1.0
    found = linprog(
        cost,
        A_eq=np.vstack((balance, shares)),
        b_eq=np.concatenate((np.zeros(3), np.ones(len(kept)))),
    )
    assert found.status == 0
    return float(found.x[-1])


@pytest.mark.slow
@pytest.mark.parametrize("group", GROUPS)
@settings(max_examples=15)
@given(
    st.tuples(*(st.floats(-1.0, 1.0) for _ in range(3))).filter(lambda f: max(map(abs, f)) > 0.1)
)
def test_held_losses_reach_the_corners(group: str, direction: tuple[float, float, float]) -> None:
    assert RATOWNIK is not None
    force = np.array(direction) * [3e5, 3e5, 6e6]
    edge = largest_share(RATOWNIK, force, group)
    inside = certify(qp_of(RATOWNIK, (1.0 - 1e-6) * edge * force, group))
    f = inside.z * RATOWNIK.repeat_for_each_force_entry(RATOWNIK.largest_thrusts_N)
    np.testing.assert_allclose(RATOWNIK.T_e @ f, (1.0 - 1e-6) * edge * force, atol=1e-2)
    lost = (
        RATOWNIK.repeat_for_each_force_entry(
            [i in RATOWNIK.indices_by_failure_group[group] for i in range(5)]
        )
        > 0.0
    )
    np.testing.assert_allclose(f[lost], 0.0, atol=1e-6)
    assert certify(qp_of(RATOWNIK, (1.0 + 1e-6) * edge * force, group)).kind == "infeasible"


def test_port_and_starboard_are_alike() -> None:
    port = Thruster("port", "azimuth", -30.0, -5.0, 1e5, 10.0)
    starboard = Thruster("starboard", "azimuth", -30.0, 5.0, 1e5, 10.0)
    ship = ThrusterSet((port, starboard, Thruster("bow", "tunnel", 30.0, 0.0, 8e4, 8.0)))
    mirror = np.array([1.0, -1.0, -1.0])
    for share in (0.9, 1.1):
        force = np.array([3e4, 5e4, 1e6])
        force = share * largest_share(ship, force, "port") * force
        left = certify(qp_of(ship, force, "port"))
        right = certify(qp_of(ship, mirror * force, "starboard"))
        assert (left.kind == "infeasible") == (right.kind == "infeasible") == (share > 1.0)
        if share < 1.0:
            swapped = right.z[[2, 3, 0, 1, 4]] * [1.0, -1.0, 1.0, -1.0, -1.0]
            np.testing.assert_allclose(left.z, swapped, atol=1e-12)


def regrouped(groups: dict[str, str]) -> Scenario:
    files = copy.deepcopy(load_scenario("thrusters").files)
    for table in files["vessel"]["thrusters"]:
        table["group"] = groups.get(table["name"], "")
    return build_scenario_from_documents(files)


def test_a_group_without_which_no_sway_is_left_is_never_held() -> None:
    """Along a run of growing sway force every QP of the one group is proven empty, and that of the
    other, a tunnel, has an optimum until the force is too large."""
    most = ("stern port", "stern starboard", "bow azimuth", "bow 1")
    case = regrouped(dict.fromkeys(most, "all"))
    tau = np.outer(np.arange(1, 13), [0.0, 3e5, 0.0])
    kinds = {}
    for group in ("all", "bow 2"):
        sequence = build_consequence_sequence(case, tau, group, 1.0)
        assert (sequence.P, sequence.A, sequence.base.n, sequence.base.m) == (None, None, 8, 29)
        kinds[group] = [certify(sequence.problem(k)).kind for k in range(12)]
    assert set(kinds["all"]) == {"infeasible"}
    assert kinds["bow 2"][0] != "infeasible"


def test_what_is_required_passes_a_filter_from_the_first_sample() -> None:
    """A steady force is there at once, a step is approached by 1 − exp(−t/60 s); wave forces hardly
    remain."""
    sample_s, steps = 0.3, 800
    t = sample_s * np.arange(steps)
    force = np.array([1e5, -2e5, 3e6])
    np.testing.assert_allclose(filter_force(np.tile(force, (steps, 1)), sample_s)[0], force)
    step = filter_force(np.outer(t > 0.0, force), sample_s)
    approach = 1.0 - np.exp(-t / FILTER_S)
    np.testing.assert_allclose(step, approach[:, None] * force, rtol=1e-12)
    waves = filter_force(np.outer(np.sin(2.0 * np.pi * t / 9.5), np.ones(3)), sample_s)
    assert np.abs(waves[400:]).max() < 0.05


def test_a_dynamic_margin_multiplies_what_is_required() -> None:
    case = load_scenario("thrusters")
    tau = np.tile([1e5, -2e5, 3e6], (4, 1))
    plain, more = (build_consequence_sequence(case, tau, "board A", x) for x in (1.0, 1.25))
    np.testing.assert_allclose(more.l[:, :3], 1.25 * plain.l[:, :3])
    np.testing.assert_array_equal(more.u[:, 3:], plain.u[:, 3:])
    assert ReplayTable(scenario="thrusters", consequence=True).margin == 1.25


def test_a_margin_belongs_to_a_consequence_analysis() -> None:
    table = ReplayTable(scenario="thrusters", margin=1.1)
    suite = SuiteFile(title="", solvers=["daqp"], cell_limit_s=1.0, replay=[table])
    with pytest.raises(InputError, match=r"margin: found 1\.1; allowed: margin only with conseq"):
        plan_suite(suite)


def test_what_the_run_has_lost_stays_lost() -> None:
    case = load_scenario("thrusters_loss")
    (fault,) = (k for k, _ in case.controller.changes)
    assert case.controller.commanded_thrusters is not None
    thrusters = case.controller.commanded_thrusters.thrusters
    entries = {
        group: thrusters.repeat_for_each_force_entry(
            [i in thrusters.indices_by_failure_group[group] for i in range(5)]
        )
        > 0.0
        for group in GROUPS
    }
    tau = np.tile([1e3, 0.0, 0.0], (case.steps, 1))
    for group in GROUPS:
        sequence = build_consequence_sequence(case, tau, group, 1.0)
        for k in (fault - 1, fault):
            qp = sequence.problem(k)
            lost = entries[group] | (entries["board A"] if k == fault else False)
            pinned = block_diag(np.zeros((3, 0)), qp.A[3:][qp.l[3:] == qp.u[3:]])[3:]
            assert np.linalg.matrix_rank(pinned) == lost.sum()
            assert not pinned[:, ~lost].any()


def test_a_cascade_has_an_analysis_too() -> None:
    case = load_scenario("thrusters_cascade")
    assert case.controller.commanded_thrusters is not None
    thrusters = case.controller.commanded_thrusters.thrusters
    tau = np.array([np.zeros(3), [1e9, 0.0, 0.0]])
    for group in thrusters.indices_by_failure_group:
        sequence = build_consequence_sequence(case, tau, group, 1.0)
        assert sequence.base.n == thrusters.n_f
        kinds = [certify(sequence.problem(k)).kind == "infeasible" for k in range(2)]
        assert kinds == [False, True]


def suite_of(scenario: str = "thrusters_loss", **keys: Any) -> SuiteFile:
    table = ReplayTable(scenario=scenario, consequence=True, **keys)
    return SuiteFile(title="x", solvers=["daqp"], baseline_law=False, replay=[table])


def test_each_group_is_a_cell_of_its_own_beside_one_loop() -> None:
    suite = suite_of(first=100, steps=50)
    suite = suite.model_copy(update={"calibration": True})
    cells = [planned.cell for planned in plan_suite(suite)]
    names = [f"thrusters_loss[100:150], {group} lost" for group in GROUPS]
    assert [cell.sequence for cell in cells] == names
    assert {cell.solver for cell in cells} == {"daqp"}
    assert len({cell.problem_key for cell in cells}) == 3
    (loop,) = plan_suite(
        suite_of().model_copy(update={"replay": [ReplayTable(scenario="thrusters_loss")]})
    )
    keys = {cell.source_key("1") for cell in (*cells, loop.cell)}
    assert len(keys) == 1 and loop.cell.sequence == "thrusters_loss"
    assert all(Cell.from_json(cell.to_json()) == cell for cell in cells)


def test_what_has_no_consequence_analysis_is_refused_in_one_line() -> None:
    with pytest.raises(InputError, match=r"consequence analysis of paper: controller\.kind"):
        plan_suite(suite_of("paper"))
    with pytest.raises(InputError, match="units"):
        plan_suite(suite_of(units=["si"]))


def test_the_window_of_a_cell_is_that_of_the_run(tmp_path: Path) -> None:
    """A replay from step 3 on sees the QPs that the whole run has there, its mean included."""
    case = load_scenario("thrusters").truncate(9)
    exact = solve_loop_exactly(case)
    exact.save(tmp_path / "loop.npz")
    cells = [planned.cell for planned in plan_suite(suite_of("thrusters", first=3, steps=5))]
    for cell, group in zip(cells, GROUPS, strict=True):
        found = read_replay(cell, tmp_path / "loop.npz")
        whole = build_consequence_sequence(case, exact.tau, group, 1.25)
        np.testing.assert_array_equal(found.sequence.l, whole.l[3:8])
        np.testing.assert_array_equal(found.sequence.base.u, whole.u[3])
        assert (found.sequence.name, found.sample_s) == (cell.sequence, 0.3)
        assert found.optima is not None and len(found.optima) == 5
        size = compute_log_bytes(make_replay_layout(cell.rounds + 1, 5, whole.base.n, whole.base.m))
        assert log_size(cell, tmp_path / "loop.npz") == size
