"""Frequency at which skewness widens an interval of a study, as the guide on studies states it."""

import re

import numpy as np
import pytest

from dpbench.analysis.suites.study import estimate_mean_over_points
from tests.docs.markdown_blocks import DOCS

TEXT = (DOCS / "guide" / "studies.md").read_text(encoding="utf-8")
TABLE = [
    [cell.strip() for cell in row.strip("|").split("|")]
    for row in re.findall(r"^\| .*%.*\|$", TEXT.split("| differences |")[1], re.M)
]
COUNTS = (10, 30, 100, 200)
DRAWS = 1500


@pytest.mark.slow
@pytest.mark.parametrize("row", TABLE, ids=lambda row: row[0])
def test_the_share_of_marked_intervals_is_documented(row: list[str]) -> None:
    """Within four standard deviations of the count."""
    rng = np.random.default_rng(1)
    draw = {"s": rng.standard_normal, "e": rng.standard_exponential}
    name = "e" if "exponential" in row[0] else "s"
    for text, count in zip(row[1:], COUNTS, strict=True):
        values = draw[name]((DRAWS, 1, count))
        values = np.exp(values) if "lognormal" in row[0] else values
        marked = [estimate_mean_over_points(one).is_clearly_widened for one in values]
        documented = float(text.removesuffix(" %")) / 100.0
        allowed = 4.0 * np.sqrt(max(documented * (1.0 - documented), 0.005) / DRAWS) + 0.005
        assert np.mean(marked) == pytest.approx(documented, abs=allowed), (row[0], count)


def test_the_documented_coverage_is_that_of_the_method() -> None:
    method = (DOCS / "method.md").read_text(encoding="utf-8")
    truths = {
        "96.5": "balanced: 1 point, 10 realisations",
        "96.0": "skewed (exponential): 1 point, 10 realisations",
        "95.8": "very skewed (lognormal): 1 point, 30 realisations",
    }
    assert len(TABLE) == 3
    for share, truth in truths.items():
        assert f"{share} %" in TEXT
        assert re.search(rf"{re.escape(truth)} \| 2000 \| 100 \| {share} ±", method)
