"""Published data of the rescue ship Ratownik, and the ship itself."""

from pathlib import Path

import pandas as pd
import pytest

from dpbench.scenario.scenario import load_vessel
from dpbench.ship.capability.loads import CapabilityHull
from dpbench.ship.thrusters import ThrusterSet
from dpbench.ship.vessel import Vessel


@pytest.fixture(scope="session")
def published() -> pd.DataFrame:
    """Its results for 36 directions; see the head of the file."""
    return pd.read_csv(Path(__file__).with_name("ratownik_published.csv"), comment="#")


@pytest.fixture(scope="session")
def ratownik() -> Vessel:
    return load_vessel("ratownik")


@pytest.fixture(scope="session")
def hull(ratownik: Vessel) -> CapabilityHull:
    assert ratownik.capability is not None
    return ratownik.capability


@pytest.fixture(scope="session")
def thrusters(ratownik: Vessel) -> ThrusterSet:
    assert ratownik.thrusters is not None
    return ratownik.thrusters
