"""Vessel data: the Bis scaling and what a vessel refuses."""

from __future__ import annotations

import numpy as np
import pytest

from dpbench.errors import InputError, ShapeError
from dpbench.ship.vessel import Vessel, bis_descaled, bis_descaled_damping

GOOD = {
    "M": np.diag([5e6, 8e6, 4e9]),
    "D": np.array([[5e4, 0.0, 0.0], [0.0, 3e5, -4e6], [0.0, -4e6, 4e8]]),
    "tau_min": np.array([-1e6, -4e5, -2e7]),
    "tau_max": np.array([1.2e6, 4e5, 2e7]),
    "rate_max": np.array([1e5, 4e4, 1.6e6]),
}


def vessel(**changes: object) -> Vessel:
    """A plain ship with some entries replaced."""
    return Vessel("id", "title", "source", 76.2, where="ship.toml", **{**GOOD, **changes})  # type: ignore[arg-type] # bad on purpose


@pytest.mark.parametrize(
    ("key", "value", "found", "allowed"),
    [
        ("M", np.eye(2), "shape (2, 2)", "shape (3, 3)"),
        ("tau_max", np.ones(4), "shape (4,)", "shape (3,)"),
        ("D", np.full((3, 3), np.nan), "nan", "finite"),
        ("M", np.array([[5e6, 0, 0], [0, 8e6, 1e7], [0, 0, 4e9]]), "10000000.0", "symmetric"),
        ("M", np.diag([5e6, -8e6, 4e9]), "-8e+06", "positive definite"),
        ("D", np.diag([5e4, 3e5, 0.0]), "eigenvalue 0", "positive definite"),
        ("tau_min", np.array([-1e6, 1.0, -2e7]), "1.0", "zero inside"),
        ("tau_max", np.array([1e6, 4e5, 0.0]), "0.0]", "zero inside"),
        ("rate_max", np.array([1e5, 0.0, 1e6]), "0.0", "positive"),
        ("rate_max", np.array([1e5, np.inf, 1e6]), "inf", "finite"),
    ],
)
def test_a_vessel_that_cannot_exist_is_refused_in_one_line(
    key: str, value: np.ndarray, found: str, allowed: str
) -> None:
    """Shape, finiteness, symmetry, definiteness and limits around zero are checked by name."""
    with pytest.raises(InputError) as caught:
        vessel(**{key: value})
    error = caught.value
    assert error.where == "ship.toml"
    assert key in error.key
    assert found in str(error.found)
    assert allowed in error.allowed
    assert "\n" not in str(error)


def test_a_wrong_shape_is_an_error_of_its_own_kind() -> None:
    """A caller can tell a wrong shape from a wrong value."""
    with pytest.raises(ShapeError):
        vessel(D=np.ones(3))


def test_unsymmetric_damping_is_allowed() -> None:
    """Damping of a moving hull need not be symmetric, only dissipative."""
    D = np.array([[5e4, 0.0, 0.0], [0.0, 3e5, -2e6], [0.0, -6e5, 4e8]])
    np.testing.assert_array_equal(vessel(D=D).D, D)


def test_largest_step_is_rate_times_sample() -> None:
    """Δu_max is the rate limit over one sample."""
    np.testing.assert_allclose(vessel().step_max(0.3), [3e4, 1.2e4, 4.8e5], rtol=1e-15)


def test_bis_scaling_follows_from_the_units_of_each_entry() -> None:
    """An entry of M counts m·L^k and one of D m·√(g/L)·L^k, k the number of its yaw indices."""
    m, L, g = 6e6, 76.2, 9.81
    rng = np.random.default_rng(1)
    Mb, Db = rng.normal(size=(2, 3, 3))
    M, D = bis_descaled(Mb, m, L), bis_descaled_damping(Db, m, L, g)
    for i in range(3):
        for j in range(3):
            lever = L ** ((i == 2) + (j == 2))
            assert M[i, j] == pytest.approx(m * lever * Mb[i, j], rel=1e-14)
            assert D[i, j] == pytest.approx(m * (g / L) ** 0.5 * lever * Db[i, j], rel=1e-14)
