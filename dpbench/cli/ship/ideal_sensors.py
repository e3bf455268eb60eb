"""Text on the sensors and the estimator that a scenario in waves lacks."""

from collections.abc import Mapping, Sequence
from typing import Any

from dpbench.report.formats import join_with_and
from dpbench.scenario.conditions import read_conditions

SENSOR_TABLES = {
    "motion": "first-order wave motion ([environment.waves.motion])",
    "noise": "measurement noise ([environment.noise])",
    "estimator": 'an estimator ([estimator] with kind = "kalman")',
}
"""Parts that an ideal scenario in waves lacks, with the tables that add them."""


def describe_ideal_sensors(scenario: Mapping[str, Any]) -> str:
    """Return a sentence on what a scenario in waves lacks of sensors and estimator, or ""."""
    known = read_conditions(scenario)
    has = {
        "motion": known.has_motion,
        "noise": any(known.noise),
        "estimator": known.estimator != "measured",
    }
    return describe_missing_tables([name for name in has if known.has_waves and not has[name]])


def describe_missing_tables(names: Sequence[str]) -> str:
    """Return a sentence on what scenarios lack of `SENSOR_TABLES`, and how to add it, or ""."""
    if not names:
        return ""
    lacks = join_with_and([SENSOR_TABLES[name] for name in names])
    return f"Not in the scenario: {lacks}. The offsets with them may be several times as large."
