"""Control problems of every size, and a second, naive construction of their QPs."""

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import quadprog
from numpy.typing import NDArray

from dpbench.mpc.condense import ControlProblem
from dpbench.mpc.model import StateSpace, augment_to_incremental_model, build_prediction_model
from dpbench.qp.program import QuadraticProgram
from dpbench.scenario.scenario import load_vessel

Array = NDArray[np.float64]

VESSELS = ("supply_fs99", "supply_mss", "supply_tmr", "osv", "cybership2")


def naive_build(problem: ControlProblem, x: Array, Y_d: Array, u_prev: Array) -> Any:
    """Paper eq. 13-25 for one step in SI units, written out; Y_d (N_p, n_y)."""
    A, B, C = problem.model.A, problem.model.B, problem.model.C
    N_p, N_c, zero = problem.N_p, problem.N_c, np.zeros((len(C), B.shape[1]))
    n_u = B.shape[1]
    power = np.linalg.matrix_power
    F = np.vstack([C @ power(A, i) for i in range(1, N_p + 1)])
    Phi = np.block(
        [[C @ power(A, i - j) @ B if i >= j else zero for j in range(N_c)] for i in range(N_p)]
    )
    Q_bar, R_bar = np.kron(np.eye(N_p), problem.Q), np.kron(np.eye(N_c), problem.R)
    C2 = np.zeros((N_c * n_u, N_c * n_u))
    for row in range(N_c):
        for column in range(row + 1):
            for axis in range(n_u):
                C2[row * n_u + axis, column * n_u + axis] = 1.0
    return SimpleNamespace(
        F=F,
        Phi=Phi,
        Q_bar=Q_bar,
        R_bar=R_bar,
        E=Phi.T @ Q_bar @ Phi + R_bar,
        F_k=-Phi.T @ Q_bar @ (Y_d.reshape(-1) - F @ x),
        C2=C2,
        lower=np.concatenate([problem.u_min - u_prev for _ in range(N_c)]),
        upper=np.concatenate([problem.u_max - u_prev for _ in range(N_c)]),
        move=np.concatenate([problem.du_max for _ in range(N_c)]),
    )


def rolled_out_cost(problem: ControlProblem, x: Array, Y_d: Array, moves: Array) -> float:
    """J of Algorithm 1 by stepping the model: outputs k+1..k+N_p, increments k..k+N_c−1."""
    J, state = 0.0, x
    for i in range(problem.N_p):
        du = moves[i] if i < problem.N_c else np.zeros(problem.model.n_u)
        state = problem.model.A @ state + problem.model.B @ du
        error = Y_d[i] - problem.model.C @ state
        J += 0.5 * float(error @ problem.Q @ error) + 0.5 * float(du @ problem.R @ du)
    return J


def assert_close(found: Array, expected: Array, relative: float = 1e-11) -> None:
    """The same infinite entries, and finite ones equal up to `relative` of the largest.

    Constructions that sum in another order differ by some N_p · 1e-16 of it.
    """
    finite = np.isfinite(expected)
    np.testing.assert_array_equal(found[~finite], expected[~finite])
    size = float(np.abs(expected[finite]).max(initial=0.0))
    np.testing.assert_allclose(found[finite], expected[finite], rtol=0, atol=relative * size)


def solve_by_quadprog(qp: QuadraticProgram) -> tuple[Array, Array, Array]:
    """z, y and y_box of a two-sided QP with quadprog (Goldfarb-Idnani), signs as in dpbench."""
    n, m = qp.n, qp.m
    C = np.vstack([-qp.A, qp.A, -np.eye(n), np.eye(n)]).T.copy()
    b = np.concatenate([-qp.u, qp.l, -qp.ub, qp.lb])
    z, _, _, _, lam, _ = quadprog.solve_qp(qp.P.copy(), -qp.q, C, b, 0)
    y = lam[:m] - lam[m : 2 * m]
    return z, y, lam[2 * m : 2 * m + n] - lam[2 * m + n :]


def sample_of(name: str) -> float:
    """The paper's sample time, Froude-scaled for the model ship."""
    return 0.3 if name != "cybership2" else float(0.3 / np.sqrt(70.0))


def ship_problem(
    name: str, *, psi0_rad: float = 0.0, N_p: int = 30, N_c: int = 5, robust: bool = False
) -> ControlProblem:
    """A vessel of the collection under tuning `paper`, or `robust`, in its own scale."""
    ship = load_vessel(name)
    du_max = ship.largest_force_change_per_sample(sample_of(name))
    model = build_prediction_model(ship.M, ship.D, psi0_rad, sample_of(name))
    Q = np.diag([1.0, 1.0, 3000.0 if robust else 100.0])
    R = np.diag(0.1 / du_max**2) if robust else np.diag([1e-10, 1e-10, 1e-14])
    if name == "cybership2":
        # Froude: lengths /70 make position weights ·70², forces /70³ and moments /70⁴.
        Q = np.diag([4900.0, 4900.0, Q[2, 2]])
        R = R if robust else R * np.diag([70.0**6, 70.0**6, 70.0**8])
    return ControlProblem(model, N_p, N_c, Q, R, ship.tau_min, ship.tau_max, du_max)


def random_problem(seed: int, n_u: int, n_y: int, N_p: int, N_c: int) -> ControlProblem:
    """A stable random plant with full weights and limits of different size in every axis."""
    rng = np.random.default_rng(seed)
    n_m = n_y + 2
    A_m = rng.normal(size=(n_m, n_m))
    A_m *= 0.95 / np.abs(np.linalg.eigvals(A_m)).max()
    plant = StateSpace(A_m, rng.normal(size=(n_m, n_u)), rng.normal(size=(n_y, n_m)))
    root_Q, root_R = rng.normal(size=(n_y, n_y)), rng.normal(size=(n_u, n_u))
    weights = root_Q @ root_Q.T + 0.1 * np.eye(n_y), root_R @ root_R.T + 0.5 * np.eye(n_u)
    limits = (rng.uniform(*ends, n_u) for ends in ((0.5, 2.0), (0.5, 2.0), (0.1, 0.6)))
    low, high, move = limits
    return ControlProblem(augment_to_incremental_model(plant), N_p, N_c, *weights, -low, high, move)


@dataclass
class Case:
    """A control problem with a point θ and a preview at which to compare constructions."""

    problem: ControlProblem
    x: Array
    y_ref: Array
    u_prev: Array
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    @property
    def held(self) -> Array:
        """The constant reference as (N_p, n_y)."""
        return np.tile(self.y_ref, (self.problem.N_p, 1))

    def preview(self) -> Array:
        walk = self.rng.normal(size=(self.problem.N_p, self.problem.model.n_y))
        return self.y_ref + 0.1 * np.cumsum(walk, axis=0)


def at_sea(problem: ControlProblem, seed: int = 0) -> Case:
    """A ship off its reference, moving, with thrust on; about half of the limits become active."""
    rng = np.random.default_rng(seed)
    n_m = problem.model.n_x - problem.model.n_y
    x = np.concatenate([0.02 * rng.normal(size=n_m), rng.normal(size=problem.model.n_y)])
    y_ref = 0.3 * rng.normal(size=problem.model.n_y)
    u_prev = rng.uniform(0.9, 1.0) * np.where(
        rng.uniform(size=problem.model.n_u) < 0.5, problem.u_min, problem.u_max
    )
    return Case(problem, x, y_ref, u_prev, rng)


CASES: dict[str, Callable[[], Case]] = {
    **{name: (lambda name=name: at_sea(ship_problem(name, psi0_rad=0.7))) for name in VESSELS},
    "heading 0": lambda: at_sea(ship_problem("supply_fs99")),
    "heading -2.5, robust": lambda: at_sea(
        ship_problem("supply_mss", psi0_rad=-2.5, N_p=60, N_c=10, robust=True)
    ),
    "N_c = 1": lambda: at_sea(ship_problem("supply_fs99", psi0_rad=1.0, N_c=1)),
    "N_c = N_p": lambda: at_sea(ship_problem("supply_tmr", N_p=12, N_c=12)),
    "N_p = N_c = 1": lambda: at_sea(ship_problem("supply_fs99", N_p=1, N_c=1)),
    "two inputs, three outputs": lambda: at_sea(random_problem(1, 2, 3, 17, 6)),
    "two inputs, N_c = 2": lambda: at_sea(random_problem(2, 2, 2, 5, 2)),
    "three inputs, two outputs": lambda: at_sea(random_problem(3, 3, 2, 11, 11)),
    "one input": lambda: at_sea(random_problem(4, 1, 1, 8, 3)),
}


@pytest.fixture(params=list(CASES))
def case(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]()
