"""The weights and horizons of a scenario's controller that are searched, and loops that rate them.

Only ratios of weights count, so the weight of the position stays. Every controller meets the same
seas: common random numbers.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dpbench.bench.judge.control_metrics import compute_force_travel
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.run.assemble import NO_LIMIT_NS, build_closed_loop_setup
from dpbench.bench.run.closed_loop import record_closed_loop
from dpbench.bench.run.exact_loop import compute_largest_offset_share
from dpbench.scenario.own_ship import make_environment_of_dp_number
from dpbench.scenario.scenario import Scenario
from dpbench.scenario.variation import copy_scenario_with_values
from dpbench.ship.environment import WeatherDraw
from dpbench.ship.plant import SUBSTEPS
from dpbench.solvers.contract import Options
from dpbench.solvers.open import open_workspace
from dpbench.tuning.search import OptionRange, SearchSpace, Trial

SOLVER = "paper_active_set"
"""Exact and fast: its loop is that of the controller."""
HEADING_WEIGHTS, INCREMENT_WEIGHTS = (0.01, 100.0), (0.01, 10_000.0)
"""Ranges of weights, in multiples of the scenario's own."""


@dataclass(frozen=True)
class LoopScore:
    """Result of a controller in some seas.

    share : largest offset, in multiples of the station's limits.
    wear_per_h : mean travel of the forces in an hour, in multiples of the largest forces.
    """

    share: float
    wear_per_h: float


@dataclass(frozen=True, eq=False)
class Realisation:
    """One sea of a DP number (None: the scenario's own weather) by its seed, drawn once."""

    number: int | None
    seed: int
    drawn: WeatherDraw = field(default_factory=dict, repr=False)


def make_controller_space(scenario: Scenario) -> SearchSpace:
    """Return the ranges in which a controller's weights and horizons are searched."""
    table = scenario.files["scenario"]["controller"]
    N_p, N_c = table["prediction_horizon"], table["control_horizon"]
    return SearchSpace(
        (
            OptionRange("heading_weight", *HEADING_WEIGHTS),
            OptionRange("increment_weight", *INCREMENT_WEIGHTS),
            OptionRange("prediction_horizon", max(2, N_p // 3), min(max(3, 3 * N_p), 1000)),
            OptionRange("control_horizon", max(1, N_c // 2), min(2 * N_c, 1000)),
        )
    )


def make_unchanged_options(scenario: Scenario) -> Options:
    """Return the options that leave the scenario's controller as it is."""
    table = scenario.files["scenario"]["controller"]
    horizons = {key: table[key] for key in ("prediction_horizon", "control_horizon")}
    return {"heading_weight": 1.0, "increment_weight": 1.0} | horizons


def change_controller(scenario: Scenario, options: Options) -> Scenario:
    """Return the scenario with other weights and horizons of its controller."""
    heading, increment, N_p, N_c = (
        _convert_to_number(options[key]) for key in make_unchanged_options(scenario)
    )
    table = scenario.files["scenario"]["controller"]
    *position, turn = table["output_weight"]
    values: dict[str, Any] = {
        "controller.output_weight": [*position, _scale_weight(turn, heading)],
        "controller.prediction_horizon": int(N_p),
        "controller.control_horizon": int(min(N_c, N_p)),
    }
    for key in ("move_weight", "move_weight_relative"):
        if table[key] is not None:
            values[f"controller.{key}"] = [
                _scale_weight(weight, increment) for weight in table[key]
            ]
    if table.get("kind") == "thrusters":
        key, own = "move_weight_relative", table["thrusters"]["move_weight_relative"]
        values[f"controller.thrusters.{key}"] = _scale_weight(own, increment)
    return copy_scenario_with_values(scenario, values, f"scenario {scenario.name}")


def _convert_to_number(value: object) -> float:
    """Return the value of a controller's option as a number, which its range ensures that it is."""
    assert isinstance(value, int | float), "of a range"
    return value


def _scale_weight(weight: float, factor: float) -> float:
    """Return a controller's weight times a factor, rounded to four digits."""
    return float(f"{weight * factor:.4g}")


def draw_realisations(
    scenario: Scenario, seas: Sequence[int], first: int, count: int, steps: int
) -> list[Realisation]:
    """Return `count` realisations of each sea, from the `first` after the scenario's own on."""
    seed = scenario.files["scenario"]["environment"]["seed"] + first
    found = []
    numbers: Sequence[int | None] = seas or [None]
    for number in numbers:
        for at in range(seed, seed + count):
            env = change_sea_of_scenario(scenario, Realisation(number, at)).environment
            drawn = env.draw_wind_and_waves_at_stages(steps, scenario.sample_s, SUBSTEPS)
            found.append(Realisation(number, at, drawn))
    return found


def change_sea_of_scenario(scenario: Scenario, sea: Realisation) -> Scenario:
    """Return a scenario changed to one sea, the noise of its sensors kept."""
    weather = scenario.files["scenario"]["environment"]
    if sea.number is not None:
        weather = make_environment_of_dp_number(sea.number).model_dump() | {
            "noise": weather["noise"]
        }
    values = {"environment": weather | {"seed": sea.seed}}
    return copy_scenario_with_values(scenario, values, f"scenario {scenario.name}")


def rate_controller(
    scenario: Scenario, options: Options, seas: Iterable[Realisation], steps: int
) -> LoopScore:
    """Run a closed loop with other weights and horizons in each sea; return the score."""
    changed = change_controller(scenario, options)
    shares, wear = [], []
    for sea in seas:
        loop = change_sea_of_scenario(changed, sea).truncate(steps)
        share, travel = _run_loop_in_sea(loop, sea.drawn)
        shares.append(share)
        wear.append(travel * 3600.0 / (loop.steps * loop.sample_s))
    # A ship whose state is no number is off station.
    share, mean = np.nan_to_num([np.max(shares), np.mean(wear)], nan=np.inf, posinf=np.inf)
    return LoopScore(float(share), float(mean))


def _run_loop_in_sea(scenario: Scenario, drawn: WeatherDraw) -> tuple[float, float]:
    """Run a closed loop with `SOLVER`; return largest share of the station and force travel."""
    workspace = open_workspace(SOLVER)
    cell = Cell(
        mode="closed_loop",
        scenario=scenario.files,
        solver=SOLVER,
        route=workspace.route,
        policy=workspace.policy,
        settings="",
        steps=scenario.steps,
    )
    setup = build_closed_loop_setup(cell, scenario, workspace, RawLog.in_memory, NO_LIMIT_NS)
    setup.drawn = drawn
    record_closed_loop(setup)
    return compute_largest_offset_share(scenario, setup.log.state), compute_force_travel(
        scenario, setup.log.tau
    )


def find_pareto_front(trials: Sequence[Trial[LoopScore]]) -> list[Trial[LoopScore]]:
    """Return the trials that no other beats in offset and wear, by growing offset."""
    front: list[Trial[LoopScore]] = []
    for trial in sorted(trials, key=lambda t: (t.score.share, t.score.wear_per_h)):
        if not front or trial.score.wear_per_h < front[-1].score.wear_per_h:
            front.append(trial)
    return front


def choose_controller(trials: Sequence[Trial[LoopScore]], margin: float) -> Trial[LoopScore]:
    """Return the trial of least wear among those within the margin, else that of least offset."""
    within = [trial for trial in trials if trial.score.share <= margin]
    if within:
        return min(within, key=lambda trial: trial.score.wear_per_h)
    return min(trials, key=lambda trial: trial.score.share)
