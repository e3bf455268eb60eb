"""Random MPC problems of a linear system, a family that embedded solvers are compared by.

The family is that of "TinyMPC: Model-Predictive Control on Resource-Constrained Microcontrollers"
(Nguyen et al., ICRA 2024) and its repository `mcu-solver-benchmarks`: a stable, controllable system
follows a reference of its own, under limits of its inputs. States are condensed out here.

    min ½ Σ_{i=1..N} (x_i − r_i)ᵀQ_i(x_i − r_i) + ½ Σ_{i<N} u_iᵀR u_i
    x_{i+1} = A x_i + B u_i,   |u_i| ≤ 3,   R = 0.1 I,   Q_i = Q = diag(0 … 10),   Q_N = (N − 1) Q

A is divided by its largest singular value, and the reference is the path under inputs of a standard
normal distribution. The variables are v = u / 3, so that |v| ≤ 1 and an error is a share of the
limit. Limits of ±1e4 on states, never met, are left out. The noise, uniform in ±0.01, is what that
repository describes; its code adds −0.01.
"""

import re
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.errors import InputError
from dpbench.qp.program import QPSequence, QuadraticProgram
from dpbench.qp.referee.optimum import Optimum
from dpbench.qp.referee.referee import certify

INPUT_MAX = 3.0
INPUT_COST = 0.1
NOISE = 0.01  # Largest disturbance of each state in a step
REFERENCE_STEPS = 200
MOST_VARIABLES = 300
_NAME = re.compile(r"random_mpc-(\d{1,3})-(\d{1,3})-(\d{1,3})(?:-s(\d{1,9}))?")
FORM = "random_mpc-STATES-INPUTS-HORIZON or random_mpc-STATES-INPUTS-HORIZON-sSEED"


@dataclass(frozen=True)
class RandomMPC:
    """Size and seed of a random MPC problem: states, inputs, horizon N of both kinds."""

    states: int = 10
    inputs: int = 4
    horizon: int = 10
    seed: int = 123

    def __post_init__(self) -> None:
        n = self.inputs * self.horizon
        if min(self.states, self.inputs) < 1 or not 2 <= self.horizon < REFERENCE_STEPS:
            found = f"states {self.states}, inputs {self.inputs}, horizon {self.horizon}"
            allowed = f"1 or more states and inputs, and a horizon of 2 to {REFERENCE_STEPS - 1}"
            raise InputError("random MPC", "size", found, allowed)
        if max(n, self.states) > MOST_VARIABLES:
            found = f"{n} variables, {self.states} states"
            raise InputError("random MPC", "size", found, f"at most {MOST_VARIABLES} of each")

    @classmethod
    def from_sequence_name(cls, name: str) -> Self:
        """Read `random_mpc-10-4-10-s123`; InputError for another form or an impossible size."""
        match = _NAME.fullmatch(name)
        if match is None:
            raise InputError("sequence name", "", repr(name[:80]), FORM)
        states, inputs, horizon, seed = match.groups()
        return cls(int(states), int(inputs), int(horizon), int(seed or cls.seed))

    @property
    def sequence_name(self) -> str:
        """Unique name, e.g. `random_mpc-10-4-10-s123`."""
        return f"random_mpc-{self.states}-{self.inputs}-{self.horizon}-s{self.seed}"

    @property
    def steps(self) -> int:
        """Steps whose horizon ends within the reference."""
        return REFERENCE_STEPS - self.horizon


@dataclass(frozen=True, eq=False)
class RandomSystem:
    """System of a random MPC problem: A, B, diagonal of Q, reference (steps, states)."""

    A: Matrix
    B: Matrix
    Q: Vector
    reference: Matrix


def is_random_mpc_sequence_name(name: object) -> bool:
    """Return whether a sequence's name is one of this family."""
    return str(name).startswith("random_mpc-") and not str(name).endswith(".npz")


def draw_random_system_and_reference(recipe: RandomMPC) -> RandomSystem:
    """Draw a system whose largest singular value is 1, and a reference that it can follow."""
    nx, nu = recipe.states, recipe.inputs
    rng = np.random.default_rng(recipe.seed)
    Q = rng.uniform(0.0, 10.0, nx)
    u = rng.normal(size=(nu, REFERENCE_STEPS - 1))
    rank = -1
    while rank < nx:
        A = rng.uniform(-1.0, 1.0, (nx, nx))
        A /= np.linalg.norm(A, 2)
        B = rng.uniform(-1.0, 1.0, (nx, nu))
        reached = [B]
        while len(reached) < nx:
            reached.append(A @ reached[-1])
        rank = int(np.linalg.matrix_rank(np.hstack(reached)))
    reference = np.zeros((REFERENCE_STEPS, nx))
    for k in range(REFERENCE_STEPS - 1):
        reference[k + 1] = A @ reference[k] + B @ u[:, k]
    return RandomSystem(A, B, Q, reference)


def _build_prediction_matrices(system: RandomSystem, N: int) -> tuple[Matrix, Matrix]:
    """Return Φ (N·nx, nx) and Γ (N·nx, N·nu) of x_1 … x_N = Φ x_0 + Γ u."""
    nx, nu = system.B.shape
    powers = [np.eye(nx)]
    while len(powers) <= N:
        powers.append(system.A @ powers[-1])
    effect = np.zeros((N, nx, N, nu))
    for i in range(N):
        for j in range(i + 1):
            effect[i, :, j] = powers[i - j] @ system.B
    return np.vstack(powers[1:]), effect.reshape(N * nx, N * nu)


def generate_qps_and_optima_of_random_mpc(
    recipe: RandomMPC, steps: int | None = None
) -> tuple[QPSequence, list[Optimum]]:
    """Generate the QPs of a closed loop that applies the first input of each certified optimum.

    InputError for more steps than there are.
    """
    K, N, nx = recipe.steps if steps is None else steps, recipe.horizon, recipe.states
    if not 1 <= K <= recipe.steps:
        raise InputError(recipe.sequence_name, "steps", K, f"1 to {recipe.steps}")
    system, n = draw_random_system_and_reference(recipe), recipe.inputs * N
    free, effect = _build_prediction_matrices(system, N)
    weight = np.tile(system.Q, N)
    weight[-nx:] *= N - 1
    weighted = INPUT_MAX * effect.T * weight
    P = INPUT_MAX * weighted @ effect + INPUT_MAX**2 * INPUT_COST * np.eye(n)
    noise = np.random.default_rng(recipe.seed).uniform(-NOISE, NOISE, (K, nx))
    x, q, optima = np.zeros(nx), np.empty((K, n)), []
    base = QuadraticProgram(P, np.zeros(n), lb=-np.ones(n), ub=np.ones(n), block=recipe.inputs)
    for k in range(K):
        q[k] = weighted @ (free @ x - system.reference[k + 1 : k + 1 + N].ravel())
        optima.append(certify(replace(base, q=q[k])))
        u = INPUT_MAX * optima[-1].z[: recipe.inputs]
        x = system.A @ x + system.B @ u + noise[k]
    nothing = np.empty((K, 0))
    meta: dict[str, str | float | int] = {"family": "random_mpc"}
    sequence = QPSequence(
        recipe.sequence_name, replace(base, q=q[0]), q, nothing, nothing, meta=meta
    )
    return sequence, optima
