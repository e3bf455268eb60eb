"""Random sequences."""

from dataclasses import asdict, replace
from fractions import Fraction

import numpy as np
import pytest
from scipy.optimize import linprog

from dpbench.errors import InputError
from dpbench.qp.random_sequence import (
    FAMILIES,
    MARGIN,
    NEAR,
    PlantedSequence,
    RandomRecipe,
    generate_random_sequence,
    generate_random_sequence_with_optima,
)
from dpbench.qp.referee.referee import Referee

INF = np.inf


def recipe(family: str, n: int = 12, m: int = 30, seed: int = 1, **more: int) -> RandomRecipe:
    return RandomRecipe(family, n, 0 if family == "no_rows" else m, seed, **more)


def exact(array: np.ndarray) -> np.ndarray:
    """The same numbers as fractions; infinite ones stay."""
    flat = [Fraction(x) if np.isfinite(x) else x for x in array.ravel().tolist()]
    return np.array(flat, dtype=object).reshape(array.shape)


def joint(found: PlantedSequence, k: int) -> tuple[np.ndarray, ...]:
    """C, L, U, multipliers of step k, with C = [A; I]."""
    base, step = found.sequence.base, found.sequence.step(k)
    C = np.vstack((base.A, np.eye(base.n)))
    limits = np.concatenate((step.l, base.lb)), np.concatenate((step.u, base.ub))
    return C, *limits, np.concatenate((found.y[k], found.y_box[k]))


@pytest.mark.parametrize("family", FAMILIES)
def test_a_recipe_gives_the_same_bits_again(family: str) -> None:
    first, again, other = (
        generate_random_sequence(recipe(family, seed=seed)) for seed in (1, 1, 2)
    )
    for name in ("P", "A", "lb", "ub"):
        assert getattr(first.base, name).tobytes() == getattr(again.base, name).tobytes()
    for name in ("q", "l", "u"):
        assert getattr(first, name).tobytes() == getattr(again, name).tobytes()
    assert first.q.tobytes() != other.q.tobytes()


LARGE = [
    pytest.param(family, 120, 300, 2, marks=pytest.mark.slow)
    for family in ("plain", "ill_conditioned")
]


@pytest.mark.parametrize(
    ("family", "n", "m", "steps"), [*((family, 12, 30, 9) for family in FAMILIES), *LARGE]
)
def test_the_planted_optimum_satisfies_the_optimality_conditions_exactly(
    family: str, n: int, m: int, steps: int
) -> None:
    """In rational arithmetic, also with 120 variables and 300 rows."""
    found = generate_random_sequence_with_optima(recipe(family, n, m, steps=steps))
    for k in np.flatnonzero(found.feasible):
        C, L, U, y = (exact(array) for array in joint(found, int(k)))
        z, q = exact(found.z[k]), exact(found.sequence.q[k])
        assert not (exact(found.sequence.base.P) @ z + q + C.T @ y).any()
        assert (C @ z >= L).all() and (C @ z <= U).all()
        assert (C @ z == np.where(y > 0, U, L))[y != 0].all()


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize(
    ("n", "m"), [(2, 4), (12, 30), pytest.param(30, 60, marks=pytest.mark.slow)]
)
def test_the_referee_certifies_what_was_planted(family: str, n: int, m: int) -> None:
    steps = 6 if n == 30 else 24
    found = generate_random_sequence_with_optima(recipe(family, n, m, seed=3, steps=steps))
    base, sequence = found.sequence.base, found.sequence
    referee = Referee(base.P, base.A, base.lb, base.ub)
    for k in range(steps):
        optimum = referee.certify_vectors(sequence.q[k], sequence.l[k], sequence.u[k])
        if found.feasible[k]:
            # The bound grows with the condition; 1e-5 is the finest error an answer is held to.
            assert np.abs(optimum.z - found.z[k]).max() <= optimum.bound <= 1e-8
        else:
            assert optimum.kind == "infeasible"


def test_infeasible_steps_have_no_feasible_point_by_a_margin() -> None:
    """Every third step would need limits moved by 1/40 at least; the planted vector proves it."""
    found = generate_random_sequence_with_optima(recipe("infeasible_steps", seed=4))
    assert (~found.feasible).tolist() == [k % 3 == 2 for k in range(24)]
    for k in np.flatnonzero(~found.feasible):
        C, L, U, y = joint(found, int(k))
        assert not (C.T @ y).any()
        assert np.maximum(y, 0.0) @ U - np.maximum(-y, 0.0) @ L == -MARGIN
        # min t with L − t ≤ Cz ≤ U + t: a row and the bounds share the margin by their size.
        rows, n = np.column_stack((np.vstack((C, -C)), -np.ones(2 * len(C)))), C.shape[1]
        bounds = [(None, None)] * n + [(0, None)]
        answer = linprog(np.eye(n + 1)[n], rows, np.concatenate((U, -L)), bounds=bounds)
        assert answer.fun >= MARGIN / 10


def _met(found: PlantedSequence, k: int) -> np.ndarray:
    """Return the limits that the planted optimum of step k meets."""
    C, L, U, _ = joint(found, k)
    value = C @ found.z[k]
    return (value == L) | (value == U)


def test_degenerate_vertices_meet_more_limits_than_there_are_variables() -> None:
    found = generate_random_sequence_with_optima(recipe("degenerate"))
    A = found.sequence.base.A
    copies = [(i, j) for i in range(30) for j in range(i) if (np.abs(A[i]) == np.abs(A[j])).all()]
    assert copies
    met = [_met(found, k) for k in range(24)]
    assert all(limits.sum() > 12 for limits in met)
    assert any(limits[list(pair)].all() for limits in met for pair in copies)


def test_weakly_active_limits_are_met_without_a_multiplier_or_nearly_met() -> None:
    """On every step some limit is met with a zero multiplier; others are missed by 2⁻²⁶."""
    found = generate_random_sequence_with_optima(recipe("weakly_active"))
    near = 0
    for k in range(24):
        C, L, U, y = joint(found, k)
        value = C @ found.z[k]
        assert (_met(found, k) & (y == 0.0)).any()
        near += int(((U - value == NEAR) | (value - L == NEAR)).sum())
    assert near >= 12


def test_plain_problems_are_strictly_complementary() -> None:
    """Every limit that is met has a multiplier, and every other one a slack of 1/50 at least."""
    found = generate_random_sequence_with_optima(recipe("plain"))
    for k in range(24):
        C, L, U, y = joint(found, k)
        value = C @ found.z[k]
        np.testing.assert_array_equal(_met(found, k), y != 0.0)
        assert np.minimum(U - value, value - L)[y == 0.0].min() > 0.02


def test_equal_free_and_infinite_limits_are_there() -> None:
    equal = generate_random_sequence(recipe("equal"))
    assert (equal.l == equal.u).sum(axis=1).min() == 4
    free = generate_random_sequence(recipe("free"))
    assert (np.isinf(free.l) & np.isinf(free.u)).sum(axis=1).min() == 12
    assert (np.isinf(free.l) != np.isinf(free.u)).any()
    base = generate_random_sequence(recipe("infinite_bounds")).base
    assert 6 <= np.isinf(base.lb).sum() + np.isinf(base.ub).sum() <= 18
    assert generate_random_sequence(recipe("no_rows")).base.m == 0


@pytest.mark.parametrize(("family", "cond"), [("plain", 1e2), ("ill_conditioned", 1e8)])
@pytest.mark.parametrize("n", [2, 12, 120])
def test_cost_matrices_have_the_condition_they_name(family: str, cond: float, n: int) -> None:
    """The condition of P is that of its family to 1 %, which its grid of 36 bits allows."""
    eigenvalues = np.linalg.eigvalsh(generate_random_sequence(recipe(family, n, 4, steps=1)).base.P)
    assert eigenvalues[-1] / eigenvalues[0] == pytest.approx(cond, rel=1e-2)


def test_semidefinite_costs_lose_a_fifth_of_their_rank() -> None:
    eigenvalues = np.linalg.eigvalsh(
        generate_random_sequence(recipe("semidefinite", 30, 60)).base.P
    )
    assert (np.abs(eigenvalues) < 1e-13 * eigenvalues[-1]).sum() == 6
    assert eigenvalues[6] > 1e-3 * eigenvalues[-1]


@pytest.mark.parametrize("family", FAMILIES)
def test_rows_have_unit_norm_and_paths_are_smooth_but_for_jumps(family: str) -> None:
    """Norms are 1 to 1e-4, the grid of A; between most steps a third of the limits met stays."""
    found = generate_random_sequence_with_optima(recipe(family))
    norms = np.linalg.norm(found.sequence.base.A, axis=1)
    np.testing.assert_allclose(norms, 1.0, atol=1e-4)
    active = np.hstack((found.y, found.y_box)) != 0.0
    pairs = [k for k in range(23) if found.feasible[k] and found.feasible[k + 1]]
    shared = [(active[k] & active[k + 1]).sum() / active[k].sum() for k in pairs]
    assert np.median(shared) > 1 / 3


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"family": "plane"}, "one of plain"),
        ({"n": 121}, "n: found 121; allowed: 2 to 120"),
        ({"m": 301}, "0 to 300 for plain"),
        ({"family": "no_rows"}, "0 to 0 for no_rows"),
        ({"family": "degenerate", "m": 5}, "12 to 300 for degenerate"),
        ({"block": 5}, "0, or a divisor of n = 12 such that n / block divides m = 30"),
        ({"cond": 1e9}, "1 to 1e8"),
        ({"steps": 0}, "0 or more, 1 or more"),
    ],
)
def test_a_recipe_that_cannot_be_is_refused_in_one_line(
    values: dict[str, object], said: str
) -> None:
    usual: dict[str, object] = {"family": "plain", "n": 12, "m": 30, "seed": 1}
    with pytest.raises(InputError, match="random recipe") as caught:
        RandomRecipe(**(usual | values))  # type: ignore[arg-type] # wrong on purpose
    assert said in str(caught.value)


def test_names_tell_recipes_apart_and_recipes_survive_json() -> None:
    changes = {"n": 6, "m": 6, "seed": 2, "steps": 3, "block": 2, "cond": 1e4, "family": "free"}
    usual = recipe("plain")
    variants = [usual, *(replace(usual, **{key: value}) for key, value in changes.items())]
    assert len({variant.sequence_name for variant in variants}) == len(variants)
    assert all(RandomRecipe(**asdict(variant)) == variant for variant in variants)
