"""Random MPC problems: system and reference as defined, the condensed QP against its states."""

import numpy as np
import pytest

from dpbench.errors import InputError
from dpbench.qp.random_mpc import (
    INPUT_COST,
    INPUT_MAX,
    RandomMPC,
    draw_random_system_and_reference,
    generate_qps_and_optima_of_random_mpc,
)

SMALL = RandomMPC(states=3, inputs=2, horizon=4, seed=5)


def test_the_system_is_stable_and_can_follow_its_reference() -> None:
    system = draw_random_system_and_reference(SMALL)
    assert np.linalg.norm(system.A, 2) == pytest.approx(1.0)
    moves = system.reference[1:] - system.reference[:-1] @ system.A.T
    inputs, *_ = np.linalg.lstsq(system.B, moves.T, rcond=None)
    np.testing.assert_allclose(system.B @ inputs, moves.T, atol=1e-12)
    assert 0.8 < inputs.std() < 1.2
    assert (system.Q >= 0.0).all() and (system.Q <= 10.0).all()


def cost(v: np.ndarray, k: int) -> float:
    """The cost of inputs 3·v from the origin at step k, by simulating the states."""
    system, x, total = draw_random_system_and_reference(SMALL), np.zeros(SMALL.states), 0.0
    for i in range(SMALL.horizon):
        u = INPUT_MAX * v[i * SMALL.inputs : (i + 1) * SMALL.inputs]
        x = system.A @ x + system.B @ u
        error = x - system.reference[k + i + 1]
        last = SMALL.horizon - 1 if i == SMALL.horizon - 1 else 1
        total += 0.5 * last * error @ (system.Q * error) + 0.5 * INPUT_COST * u @ u
    return total


def test_the_condensed_cost_is_that_of_the_simulated_states() -> None:
    sequence, _ = generate_qps_and_optima_of_random_mpc(SMALL, 1)
    qp, rng = sequence.base, np.random.default_rng(1)
    for v in rng.uniform(-1.0, 1.0, (5, qp.n)):
        condensed = 0.5 * v @ qp.P @ v + sequence.q[0] @ v
        assert condensed == pytest.approx(cost(v, 0) - cost(np.zeros(qp.n), 0), rel=1e-12)


def test_every_step_is_certified_and_a_seed_gives_the_same_again() -> None:
    sequence, optima = generate_qps_and_optima_of_random_mpc(SMALL)
    again, _ = generate_qps_and_optima_of_random_mpc(RandomMPC.from_sequence_name(sequence.name))
    assert len(sequence) == len(optima) == 200 - SMALL.horizon
    assert max(optimum.bound for optimum in optima) < 1e-12
    np.testing.assert_array_equal(sequence.q, again.q)
    other, _ = generate_qps_and_optima_of_random_mpc(
        RandomMPC.from_sequence_name("random_mpc-3-2-4-s6"), 1
    )
    assert np.abs(other.q[0] - sequence.q[0]).max() > 0.1


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("random_mpc-3-2", r"found 'random_mpc-3-2'; allowed: random_mpc-STATES"),
        ("random_mpc-3-0-4", "inputs 0"),
        ("random_mpc-3-2-200", "horizon 200"),
        ("random_mpc-3-20-20", "found 400 variables, 3 states; allowed: at most 300"),
    ],
)
def test_a_bad_name(name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        RandomMPC.from_sequence_name(name)


def test_more_steps_than_there_are() -> None:
    with pytest.raises(InputError, match=r"steps: found 197; allowed: 1 to 196"):
        generate_qps_and_optima_of_random_mpc(SMALL, 197)
