"""FMUs of the project's own ship, built once."""

from pathlib import Path

import pytest

from tests.scenario.plants.fmus import build_ship_fmu


@pytest.fixture(scope="session")
def fmu2(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The ship as an FMU of version 2.0, in SI units."""
    return build_ship_fmu(tmp_path_factory.mktemp("fmu2"), 2)


@pytest.fixture(scope="session")
def fmu3(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The ship as an FMU of version 3.0, in kN and degrees."""
    return build_ship_fmu(tmp_path_factory.mktemp("fmu3"), 3)


@pytest.fixture(params=["fmu2", "fmu3"])
def fmu(request: pytest.FixtureRequest) -> Path:
    """The ship as an FMU, of either version."""
    return Path(request.getfixturevalue(request.param))
