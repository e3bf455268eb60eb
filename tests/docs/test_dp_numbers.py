"""The table of DP capability numbers in the guide, beside the weather that the program uses."""

import re
from pathlib import Path

from dpbench.ship.capability.loads import DP_CONDITIONS

GUIDE = Path(__file__).parents[2] / "docs" / "guide" / "capability.md"
BEAUFORT_MPS = [0.3, 1.6, 3.4, 5.5, 8.0, 10.8, 13.9, 17.2, 20.8, 24.5, 28.5, 32.7]
"""Least wind of Beaufort numbers 1 to 12 (WMO)."""


def test_the_table_is_the_weather_of_the_program() -> None:
    """Every number once; the wind is within its Beaufort number; 2 ends at 3.4 m/s here."""
    guide = GUIDE.read_text(encoding="utf-8")
    text = guide.split("## DP capability numbers")[1].split("## ")[0]
    rows = [line.strip("| ").split(" | ") for line in re.findall(r"^\| \d.*$", text, re.MULTILINE)]
    assert {int(row[0]): tuple(map(float, row[2:])) for row in rows} == DP_CONDITIONS
    for _, beaufort, wind_mps, *_ in rows:
        low, high = BEAUFORT_MPS[int(beaufort) - 1 : int(beaufort) + 1]
        assert low <= float(wind_mps) <= high
