"""A custom linear MPC, and plants by the public contract."""

import re
from typing import Any

import numpy as np
import pytest

from dpbench import (
    InputError,
    LinearMPC,
    PlantError,
    load_scenario,
    record_sequence,
    replay,
    run_closed_loop,
)
from dpbench.arrays import Vector
from dpbench.bench.run.exact_loop import solve_loop_exactly
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.ship.plant import SUBSTEPS, ShipPlant

A = np.array([[1.0, 0.1], [-0.05, 0.9]])
B = np.array([[0.005], [0.1]])
C = np.array([[1.0, 0.0]])
GIVEN: dict[str, Any] = {
    "name": "cart", "A": A, "B": B, "C": C, "sample_s": 0.1, "steps": 30,
    "prediction_horizon": 12, "control_horizon": 4, "output_weight": [3.0],
    "increment_weight": [0.2], "u_min": [-2.0], "u_max": [4.0], "du_max": [0.5],
    "reference": [1.0], "u_start": [0.3], "inputs": ("force_N",), "outputs": ("position_m",),
}  # fmt: skip


class Cart:
    """The model itself as a plant, with an offset that the model does not have."""

    def __init__(self, offset: float = 0.1) -> None:
        self.state, self._offset = np.array([0.2, 0.0]), offset

    def step(self, u: Vector) -> None:
        self.state = A @ self.state + B @ (u + self._offset)

    def measure(self) -> Vector:
        return self.state


def test_the_qp_is_the_cost_of_simulated_outputs() -> None:
    mpc = LinearMPC(**GIVEN)
    problem, builder = mpc.problem, CondensedQP(mpc.problem, units="si")
    rng = np.random.default_rng(1)
    change, y, wanted, u = rng.normal(size=2), rng.normal(size=1), np.array([1.0]), np.array([0.3])
    step = builder.emit(np.concatenate([change, y]), wanted, u)

    def cost(moves: Vector) -> float:
        """Simulate changes of the state by x⁺ = A x + B u, and sum the cost of the outputs."""
        dx, out, total = change.copy(), y.copy(), 0.0
        for k in range(12):
            du = moves[k : k + 1] if k < 4 else np.zeros(1)
            dx = A @ dx + B @ du
            out = out + C @ dx
            total += 3.0 * float((wanted - out) @ (wanted - out)) + 0.2 * float(du @ du)
        return 0.5 * total

    for moves in rng.normal(size=(4, 4)):
        own = 0.5 * moves @ builder.P @ moves + step.q @ moves
        assert own == pytest.approx(cost(moves) - cost(np.zeros(4)), rel=1e-10)
    np.testing.assert_allclose(step.l, -2.0 - 0.3)
    np.testing.assert_allclose(step.u, 4.0 - 0.3)
    np.testing.assert_allclose(builder.ub, 0.5)
    assert problem.horizons_by_name == {"N_p": 12, "N_c": 4}


@pytest.mark.parametrize("formulation", ["condensed_box", "sparse"])
def test_a_loop_reaches_its_reference_within_all_limits(formulation: Any) -> None:
    mpc = LinearMPC(**GIVEN | {"steps": 80})
    run = run_closed_loop(mpc, "daqp", plant=Cart, formulation=formulation)
    signals = run.signals
    assert signals is not None
    assert list(signals) == ["t_s", "position_m", "position_m_reference", "force_N"]
    # The incremental model takes the offset away.
    assert abs(signals["position_m"].iloc[-1] - 1.0) < 1e-3
    force = np.append(0.3, signals["force_N"])
    assert np.abs(np.diff(force)).max() == pytest.approx(0.5)
    assert signals["force_N"].between(-2.0, 4.0).all()
    assert run.summary["true_share"] == 1.0
    assert run.summary["N_c"] == 4
    # A plant that is no ship has no station, and no force on three axes.
    for name in ("r_rms_m", "dev_position_max_m", "exact_offset_max_m", "total_variation"):
        assert np.isnan(run.summary[name])
    for name in ("n_m", "tau_x_N", "tau_n_Nm"):
        assert run.steps[name].isna().all()
    assert "ship" not in run._repr_html_()
    for draw in (run.plot.ship, run.plot.errors, run.plot.forces):
        with pytest.raises(InputError, match=r"custom plant, which has no ship; .*signals"):
            draw()


def test_its_signals_are_plotted_with_their_reference() -> None:
    run = run_closed_loop(LinearMPC(**GIVEN).truncate(5), "daqp", plant=Cart)
    assert repr(run.plot) == "<figures: steps(), signals()>"
    position, force = run.plot.signals(run).to_dict(validate=False)["vconcat"]
    assert position["encoding"]["y"]["title"] == "position_m"
    assert force["encoding"]["y"]["title"] == "force_N"
    both = {"daqp (qpsolvers, fresh) #1", "daqp (qpsolvers, fresh) #2"}
    sets = run.plot.signals(run).to_dict(validate=False)["datasets"]
    labels = [{row["law"] for row in sets[panel["data"]["name"]]} for panel in (position, force)]
    assert labels == [{"reference", *both}, both]
    other = LinearMPC(**GIVEN | {"outputs": ("x_m",)}).truncate(5)
    with pytest.raises(InputError, match=r"x_m.*allowed: runs with the signals t_s, position_m"):
        run.plot.signals(run_closed_loop(other, "daqp", plant=Cart))


def test_a_run_has_one_colour_in_all_panels_of_its_signals() -> None:
    pytest.importorskip("matplotlib", reason="an extra")
    run = run_closed_loop(LinearMPC(**GIVEN).truncate(5), "daqp", plant=Cart)
    panels = run.plot.signals(backend="matplotlib").axes
    assert len(panels) == 2
    assert len({axes.get_lines()[0].get_color() for axes in panels}) == 1


def test_its_sequence_is_replayed() -> None:
    mpc = LinearMPC(**GIVEN).truncate(10)
    sequence = record_sequence(mpc, plant=Cart)
    assert (sequence.name, len(sequence), sequence.base.n) == ("cart", 10, 4)
    run = replay(sequence, "daqp", repeats=1)
    assert run.summary["true_share"] == 1.0
    assert run.signals is None
    with pytest.raises(InputError, match="found a replay"):
        run.plot.ship()
    with pytest.raises(InputError, match="without signals; allowed: closed loops of a `LinearMPC`"):
        run.plot.signals()


def test_a_continuous_model_is_held_over_the_sample() -> None:
    own = {key: value for key, value in GIVEN.items() if key not in "ABC"}
    mpc = LinearMPC.from_continuous(A=[[0.0, 1.0], [0.0, 0.0]], B=[[0.0], [2.0]], C=C, **own)
    np.testing.assert_allclose(mpc.model.A, [[1.0, 0.1], [0.0, 1.0]], atol=1e-15)
    np.testing.assert_allclose(mpc.model.B, [[0.01], [0.2]], atol=1e-15)


def test_a_reference_over_time_keeps_its_last_row() -> None:
    mpc = LinearMPC(**GIVEN | {"reference": [[0.0], [1.0], [2.0]]})
    assert mpc.build_reference_table(5).ravel().tolist() == [0.0, 1.0, 2.0, 2.0, 2.0]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"u_max": [-3.0]}, "cart: u_max: found .*allowed: above u_min"),
        ({"du_max": [0.0]}, "cart: du_max: .*above 0"),
        ({"u_min": [0.0, 0.0]}, r"cart: u_min: found shape \(2,\); allowed: shape \(1,\)"),
        ({"output_weight": np.eye(2)}, r"output_weight: found shape \(2, 2\)"),
        ({"reference": [1.0, 2.0]}, "cart: reference: found"),
        (
            {"control_horizon": 20},
            "control_horizon: found 20; allowed: 1 to prediction_horizon \\(12\\)",
        ),
        ({"B": [0.5, 1.0]}, r"B: found shape .2,.; allowed: a matrix, such as \[\[1"),
        ({"A": [[np.nan]]}, "cart: A: .*finite"),
        ({"du_max": [np.inf]}, "cart: du_max: found the value inf; allowed: finite numbers"),
        ({"inputs": "force_N"}, r"found 'force_N'; .*sequence of names, such as \('force_N',\)"),
        ({"sample_s": 0.0}, "cart: sample_s: found 0.0"),
        ({"inputs": ("a", "b")}, r"inputs: found 2 names, \('a', 'b'\); allowed: 1 name$"),
        ({"name": "../cart"}, "a name without a path"),
        ({"increment_weight": [-1.0]}, r"cart: increment_weight: found \[-1.0\]; .*at least 0"),
        ({"output_weight": [np.nan]}, "cart: output_weight: found the value nan; .*finite"),
        ({"A": "x"}, "cart: A: found 'x'; allowed: finite numbers"),
        (
            {"increment_weight": [0.0], "output_weight": [0.0]},
            "a Hessian whose smallest eigenvalue is 0; allowed: .*positive definite",
        ),
    ],
)
def test_what_cannot_be_is_refused_when_it_is_made(changed: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        LinearMPC(**GIVEN | changed)


def test_a_plant_that_does_not_fit_is_named() -> None:
    mpc = LinearMPC(**GIVEN)
    with pytest.raises(InputError, match="a LinearMPC has no simulator"):
        run_closed_loop(mpc, "daqp")

    class Short(Cart):
        def measure(self) -> Vector:
            return self.state[:1]

    with pytest.raises(PlantError, match=r"plant Short: measure\(\) has shape \(1,\), not \(2,\)"):
        run_closed_loop(mpc, "daqp", plant=Short)

    class Blind:
        def step(self, u: Vector) -> None:
            """Do nothing."""

    with pytest.raises(PlantError, match="plant Blind: state is missing; a plant has state, step"):
        run_closed_loop(mpc, "daqp", plant=Blind)  # type: ignore[arg-type] # is no plant
    with pytest.raises(TypeError, match=r"an object of class Cart; .*such as plant=Cart"):
        run_closed_loop(mpc, "daqp", plant=Cart())  # type: ignore[arg-type] # is no maker
    with pytest.raises(PlantError, match="plant Cart: the state is not finite"):
        run_closed_loop(mpc, "daqp", plant=lambda: Cart(np.inf))


class Failing(Cart):
    """A cart that fails at its third sample, by an exception or by a state that is no number."""

    raises, calls = True, 0

    def step(self, u: Vector) -> None:
        self.calls += 1
        if self.calls < 3:
            super().step(u)
        elif self.raises:
            raise ValueError("the axle broke")
        else:
            self.state = np.full(2, np.nan)


def test_a_failure_of_a_plant_names_the_sample_and_the_input() -> None:
    mpc = LinearMPC(**GIVEN)
    with pytest.raises(ValueError, match="the axle broke") as caught:
        run_closed_loop(mpc, "daqp", plant=Failing)
    (note,) = caught.value.__notes__
    assert re.fullmatch(r"plant Failing: step\(u\) of sample 2, u = \[-?[\d.e-]+\]", note)

    class Vanishing(Failing):
        raises = False

    where = r"not finite after step\(u\) of sample 2: state = \[nan nan\], u = \["
    with pytest.raises(PlantError, match=where):
        run_closed_loop(mpc, "daqp", plant=Vanishing)


class OwnShip:
    """The ship of a scenario behind the public contract."""

    def __init__(self) -> None:
        case = load_scenario("paper")
        self._ship = ShipPlant(case.true_ship, case.first_state, case.sample_s)

    @property
    def state(self) -> Vector:
        return self._ship.state

    def step(self, u: Vector) -> None:
        self._ship.advance_by_one_sample(u, np.zeros((2 * SUBSTEPS + 1, 3)))

    def measure(self) -> Vector:
        return self.state


class WrappingShip(OwnShip):
    """A ship whose heading jumps by whole turns."""

    jumps = 0

    @property
    def state(self) -> Vector:
        self.jumps += 1
        return self._ship.state + np.array([0.0] * 5 + [2 * np.pi * (self.jumps % 3 - 1)])


def test_a_heading_that_wraps_is_unwrapped() -> None:
    calm = load_scenario("paper").with_keys({"environment.amplitude_kN": [0.0, 0.0, 0.0]})
    own, theirs = (
        solve_loop_exactly(calm.truncate(8), plant=ship) for ship in (OwnShip, WrappingShip)
    )
    turned = theirs.state - own.state
    assert np.abs(turned - turned[0]).max() < 1e-12
    np.testing.assert_allclose(theirs.tau, own.tau, atol=1e-6)


def test_a_ship_of_ones_own_steers_as_the_ship() -> None:
    calm = load_scenario("paper").with_keys({"environment.amplitude_kN": [0.0, 0.0, 0.0]})
    calm = calm.truncate(40)
    own, theirs = solve_loop_exactly(calm), solve_loop_exactly(calm, plant=OwnShip)
    np.testing.assert_array_equal(own.state, theirs.state)
    run = run_closed_loop(calm, "daqp", plant=OwnShip)
    assert run.summary["dev_position_max_m"] < 1e-9
    with pytest.raises(InputError, match=r"environment\.amplitude_kN: found a load on the ship"):
        run_closed_loop("paper", "daqp", plant=OwnShip)
