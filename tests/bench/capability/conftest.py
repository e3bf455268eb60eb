"""Frontiers that several tests look at, made once."""

import math

import pytest

from dpbench.bench.capability.frontier import FROM_DEG, CapabilityPlot, Case, WindLimit
from dpbench.scenario.scenario import load_vessel

INTACT = Case("intact", frozenset())


@pytest.fixture(scope="session")
def circles() -> CapabilityPlot:
    return CapabilityPlot(load_vessel("ratownik"))


@pytest.fixture(scope="session")
def held_intact(circles: CapabilityPlot) -> list[WindLimit]:
    return [circles.find_wind_limit(INTACT, math.radians(from_deg)) for from_deg in FROM_DEG]
