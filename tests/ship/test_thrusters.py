"""Thrusters: published thrusts, the configuration matrix by the lever rule, what they give at most,
and what is refused."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from dpbench.errors import InputError
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.thrusters import Thruster, ThrusterSet

place = st.floats(-50.0, 50.0)
thrust = st.floats(1e4, 1e6)


def test_the_vessel_file_of_ratownik_has_the_published_thrusts() -> None:
    """Two stern azimuths, one at the bow in a nozzle, two tunnels: within half a per cent [kN]."""
    thrusters = load_vessel("ratownik").thrusters
    assert thrusters is not None
    published_kN = [195.3, 195.3, 146.6, 116.0, 116.0]
    np.testing.assert_allclose(thrusters.largest_thrusts_N / 1e3, published_kN, rtol=0.005)


def azimuth(x_m: float, y_m: float, thrust_N: float = 1e5, **other: object) -> Thruster:
    return Thruster(f"azimuth {x_m} {y_m}", "azimuth", x_m, y_m, thrust_N, 10.0, **other)  # type: ignore[arg-type] # keys of one test each


def ship(*azimuths: Thruster) -> ThrusterSet:
    tunnel = Thruster("tunnel", "tunnel", 30.0, 0.0, 8e4, 8.0, group="board A")
    main = Thruster("main", "main", -40.0, 5.0, 2e5, 20.0, astern=0.6, group="board A")
    return ThrusterSet((tunnel, *azimuths, main))


@given(place, place, thrust, st.floats(-math.pi, math.pi))
def test_force_and_moment_are_those_of_the_lever(
    x_m: float, y_m: float, thrust_N: float, angle: float
) -> None:
    """τ = T_e f of one azimuth is the force and r × F of mechanics."""
    thrusters = ship(azimuth(x_m, y_m, thrust_N))
    force = thrust_N * np.array([math.cos(angle), math.sin(angle), 0.0])
    f = np.zeros(thrusters.n_f)
    f[thrusters.slices_in_force_vector[1]] = force[:2]
    moment = np.cross([x_m, y_m, 0.0], force)[2]
    np.testing.assert_allclose(thrusters.T_e @ f, [force[0], force[1], moment], atol=1e-6)


def allowed_forces(thrusters: ThrusterSet, rng: np.random.Generator, count: int) -> np.ndarray:
    """Random f within the limits, many at the edge."""
    f = np.zeros((count, thrusters.n_f))
    for thruster, at in zip(thrusters.thrusters, thrusters.slices_in_force_vector, strict=True):
        if thruster.kind == "azimuth":
            start, end = thruster.sector_rad or (0.0, 2 * math.pi)
            angle = rng.uniform(start, end, count)
            size = thruster.thrust_N * rng.choice([0.0, 0.5, 1.0], count)
            f[:, at] = (size * np.array([np.cos(angle), np.sin(angle)])).T
        else:
            low = -thruster.astern * thruster.thrust_N
            f[:, at.start] = rng.choice([low, 0.0, thruster.thrust_N], count)
    return f


@pytest.mark.parametrize("sector", [None, (0.5, 2.5), (-2.0, -1.0), (0.5, 5.5)], ids=str)
def test_the_support_is_reached_and_never_exceeded(sector: tuple[float, float] | None) -> None:
    """Against 20 000 forces within the limits, in 40 directions."""
    thrusters = ship(azimuth(-35.0, -6.0, 3e5, sector_rad=sector), azimuth(-35.0, 6.0))
    rng = np.random.default_rng(4)
    tau = allowed_forces(thrusters, rng, 20_000) @ thrusters.T_e.T
    for direction in rng.normal(size=(40, 3)) * [1.0, 1.0, 1 / 40.0]:
        most = thrusters.largest_force_along(direction)
        reached = (tau @ direction).max()
        assert reached <= most * (1 + 1e-12)
        assert reached >= 0.8 * most


def test_limits_of_a_ship_are_those_of_each_axis_by_itself() -> None:
    """By hand: two azimuths of 100 kN, a tunnel of 80 kN at 30 m, a main of 200 kN."""
    thrusters = ship(azimuth(-35.0, -6.0), azimuth(-35.0, 6.0))
    low, high = thrusters.least_and_largest_force_by_axis()
    lever = 1e5 * math.hypot(35, 6)
    np.testing.assert_allclose(low, [-(2e5 + 1.2e5), -2.8e5, -(2 * lever + 2.4e6 + 1e6)])
    np.testing.assert_allclose(high, [4e5, 2.8e5, 2 * lever + 2.4e6 + 6e5])
    np.testing.assert_allclose(thrusters.largest_force_rate_by_axis()[:2], [2e4 + 1e4, 2e4 + 1e4])
    assert thrusters.indices_by_failure_group["board A"] == (0, 3)


@pytest.mark.parametrize(
    ("thrusters", "said"),
    [
        (lambda: ship(azimuth(0, 0), azimuth(0, 0)), "'azimuth 0 0' twice"),
        (
            lambda: ThrusterSet((azimuth(0, 0),)),
            "give surge force, sway force and yaw moment independently",
        ),
        (lambda: azimuth(0, 0, sector_rad=(0.0, 6.28)), "above 0° and at most 359°"),
        (lambda: azimuth(0, 0, controller_sector_rad=(0.0, 3.5)), "above 0° and at most 180°"),
        (
            lambda: Thruster("bow", "tunnel", 30.0, 0.0, 8e4, 8.0, sector_rad=(0.0, 1.0)),
            "sector_deg: found a thruster of kind tunnel; allowed: an azimuth thruster",
        ),
        (
            lambda: azimuth(0, 0, sector_rad=(0.0, 4.0), controller_sector_rad=(1.0, 4.1)),
            "controller_sector_deg: found 57.3° to 234.91°; allowed: part of sector_deg, 0° to 229",
        ),
        (
            lambda: ship(azimuth(-30, 0)).find_indices_of_thrusters_or_groups(
                ["bow"], "my.toml", "faults"
            ),
            "my.toml: faults.*one of tunnel",
        ),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(thrusters: object, said: str) -> None:
    with pytest.raises(InputError, match=said) as refused:
        thrusters()  # type: ignore[operator] # a lambda of the table above
    assert "\n" not in str(refused.value)


def test_mains_alone_aft_after_a_loss_caution_that_rudders_do_not_count() -> None:
    """Two mains on two boards; the tunnel aft is lost with board A, an azimuth on none stays."""
    mains = [Thruster(b, "main", -40.0, 0.0, 2e5, 20.0, group=b) for b in ("board A", "board B")]
    mains.append(Thruster("bow", "tunnel", 30.0, 0.0, 8e4, 8.0))
    tunnel = Thruster("stern", "tunnel", -35.0, 0.0, 8e4, 8.0, group="board A")
    lost = "After the loss of board A, aft of midships only main propellers push. "
    assert ThrusterSet((*mains, tunnel)).caution_on_rudders.startswith(lost)
    second = Thruster("second", "tunnel", 25.0, 0.0, 8e4, 8.0)
    assert ThrusterSet((*mains, second)).caution_on_rudders.startswith("Aft of midships only main")
    assert ThrusterSet((*mains, tunnel, azimuth(-30.0, 0.0))).caution_on_rudders == ""
