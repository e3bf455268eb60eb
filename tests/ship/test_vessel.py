"""Vessel data: the Bis scaling, time constants, mismatch, and what a vessel refuses."""

import numpy as np
import pytest
from scipy.linalg import expm

from dpbench.errors import InputError
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.characteristics import compute_axis_time_constants_s
from dpbench.ship.vessel import Vessel, convert_bis_damping_to_si, convert_bis_inertia_to_si

GOOD = {
    "M": np.diag([5e6, 8e6, 4e9]),
    "D": np.array([[5e4, 0.0, 0.0], [0.0, 3e5, -4e6], [0.0, -4e6, 4e8]]),
    "tau_min": np.array([-1e6, -4e5, -2e7]),
    "tau_max": np.array([1.2e6, 4e5, 2e7]),
    "rate_max": np.array([1e5, 4e4, 1.6e6]),
}


def vessel(**changes: object) -> Vessel:
    return Vessel("id", "title", "source", 76.2, where="ship.toml", **{**GOOD, **changes})  # type: ignore[arg-type] # bad on purpose


@pytest.mark.parametrize(
    ("key", "value", "found", "allowed"),
    [
        ("M", np.array([[5e6, 0, 0], [0, 8e6, 1e7], [0, 0, 4e9]]), "10000000.0", "symmetric"),
        ("M", np.diag([5e6, -8e6, 4e9]), "-8e+06", "positive definite"),
        ("D", np.diag([5e4, 3e5, 0.0]), "eigenvalue 0", "positive definite"),
        ("tau_min", np.array([-1e6, 1.0, -2e7]), "1.0", "a minimum below 0"),
        ("tau_max", np.array([1e6, 4e5, 0.0]), "0.0]", "a minimum below 0"),
    ],
)
def test_a_vessel_that_cannot_exist_is_refused_in_one_line(
    key: str, value: np.ndarray, found: str, allowed: str
) -> None:
    with pytest.raises(InputError) as caught:
        vessel(**{key: value})
    error = caught.value
    assert error.where == "ship.toml"
    # Limits are named by their axis, as in the file of a vessel.
    assert {"tau_min": "sway", "tau_max": "yaw"}.get(key, key) in error.key
    assert found in str(error.found)
    assert allowed in error.allowed
    assert "\n" not in str(error)


def test_bis_scaling_follows_from_the_units_of_each_entry() -> None:
    """An entry of M counts m·L^k and one of D m·√(g/L)·L^k, k the number of its yaw indices."""
    m, L, g = 6e6, 76.2, 9.81
    rng = np.random.default_rng(1)
    Mb, Db = rng.normal(size=(2, 3, 3))
    M, D = convert_bis_inertia_to_si(Mb, m, L), convert_bis_damping_to_si(Db, m, L, g)
    for i in range(3):
        for j in range(3):
            lever = L ** ((i == 2) + (j == 2))
            assert M[i, j] == pytest.approx(m * lever * Mb[i, j], rel=1e-14)
            assert D[i, j] == pytest.approx(m * (g / L) ** 0.5 * lever * Db[i, j], rel=1e-14)


def test_time_constants_of_the_default_ship_by_hand() -> None:
    """Surge is M11/D11; sway and yaw are the roots of the characteristic quadratic.

    det(λM − D) = 0 with M22 = 8.2831e6, M33 = 3.7454e9, D22 = 2.7229e5, D33 = 4.1894e8 and
    D23 D32 = 1.93011e13: λ² − 0.1447271 λ + 3.0548e-3 = 0, so λ = 0.1190, 0.02567 1/s.
    """
    np.testing.assert_allclose(
        compute_axis_time_constants_s(load_vessel("supply_fs99")),
        [105.73, 38.96, 8.403],
        rtol=1e-3,
    )


@pytest.mark.parametrize("name", ["supply_fs99", "supply_mss", "supply_tmr", "osv", "cybership2"])
def test_a_mode_decays_by_its_time_constant(name: str) -> None:
    ship = load_vessel(name)
    slow = compute_axis_time_constants_s(ship).max()
    decay = expm(-slow * np.linalg.solve(ship.M, ship.D))
    # e⁻¹ is the largest factor of the free motion over one such time.
    assert np.abs(np.linalg.eigvals(decay)).max() == pytest.approx(np.exp(-1.0), rel=1e-9)


def test_reachable_accelerations_are_force_over_mass() -> None:
    """The default ship reaches 0.233 m/s² ahead, 0.184 m/s² astern, 0.0503 m/s² sideways."""
    reach = load_vessel("supply_fs99").accelerations_at_force_limits()
    np.testing.assert_allclose(reach[1], [0.23343, 0.050344, 4.8059e-3], rtol=1e-4)
    np.testing.assert_allclose(reach[0], [-0.18448, -0.050344, -4.8059e-3], rtol=1e-4)
