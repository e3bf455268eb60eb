"""Frontiers that several tests look at, made once."""

from __future__ import annotations

import math

import pytest

from dpbench.bench.capability.frontier import Case, Frontier, WindLimit
from dpbench.bench.capability.study import FROM_DEG
from dpbench.scenario.scenario import load_vessel

INTACT = Case("intact", frozenset())


@pytest.fixture(scope="session")
def circles() -> Frontier:
    return Frontier(load_vessel("ratownik"))


@pytest.fixture(scope="session")
def held_intact(circles: Frontier) -> list[WindLimit]:
    return [circles.held(INTACT, math.radians(from_deg)) for from_deg in FROM_DEG]
