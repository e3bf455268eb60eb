"""Shared problems of the benchmarks: the paper's scenario, scaled."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest

from dpbench import load_scenario
from dpbench.bench.exact import ExactLoop, solve_exactly
from dpbench.mpc.condense import ControlProblem
from dpbench.scenario import Scenario


@pytest.fixture(scope="session")
def scenario() -> Scenario:
    """The paper's scenario, its first 120 steps: transfer and first steps at rest."""
    return load_scenario("paper").first(120)


@pytest.fixture(scope="session")
def problem(scenario: Scenario) -> ControlProblem:
    """Its control problem: 30/5, nine states, three inputs."""
    return scenario.control_problem()


@pytest.fixture(scope="session")
def exact(scenario: Scenario) -> ExactLoop:
    """Its exactly solved loop."""
    return solve_exactly(scenario)


@pytest.fixture(autouse=True)
def no_garbage_collection() -> Iterator[None]:
    """Nothing collects garbage between two clock reads."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()
