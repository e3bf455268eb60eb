"""A scenario in waves with exact sensors is named as such, with the tables to add."""

from typing import Any

import pytest

from dpbench.cli.ship.ideal_sensors import describe_ideal_sensors


@pytest.mark.parametrize(
    ("tables", "missing"),
    [
        ({}, []),
        ({"environment": {"waves": {"hs_m": 2.0}}}, ["waves.motion]", "noise]", "[estimator]"]),
        (
            {
                "environment": {"waves": {"hs_m": 2.0, "motion": {}}},
                "estimator": {"kind": "kalman"},
            },
            ["noise]"],
        ),
        (
            {
                "environment": {
                    "waves": {"hs_m": 2.0, "motion": {}},
                    "noise": {"position_m": 0.1, "heading_deg": 0.1},
                },
                "estimator": {"kind": "passive"},
            },
            [],
        ),
    ],
)
def test_tables_that_a_scenario_in_waves_lacks_are_named(
    tables: dict[str, Any], missing: list[str]
) -> None:
    text = describe_ideal_sensors(tables)
    assert bool(text) == bool(missing) and all(name in text for name in missing)
    assert text.count("[e") == len(missing)
