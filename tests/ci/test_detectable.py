"""The slowdowns that the guide states as detectable, from the intervals of equal pairs of runs."""

import re

import pytest

from dpbench.ci import MARGIN
from dpbench.ci.comparison import compare_runs
from tests.ci.test_comparison import entry, run_of
from tests.docs.markdown_blocks import DOCS

ROW = re.compile(r"^\| (\d+) \| × ([\d.]+) \| × ([\d.]+) \|$", re.M)
TABLE = ROW.findall((DOCS / "guide" / "ci.md").read_text("utf-8"))


@pytest.mark.parametrize(("pairs", "alone", "four"), TABLE)
def test_the_guide_states_the_detectable_slowdown(pairs: str, alone: str, four: str) -> None:
    """A slowdown of that size is found, and one below the margin is not."""
    for solvers, stated in ((1, alone), (4, four)):
        for factor, verdict in ((float(stated), "slower"), (1.0 + MARGIN, "no difference shown")):
            base, head = (
                run_of(
                    *(entry(f"t{i}", s if i == 0 else 1e-3, solver=f"{i}") for i in range(solvers))
                )
                for s in (1e-3, factor * 1e-3)
            )
            found = {row.name: row for row in compare_runs([(base, head)] * int(pairs)).rows}
            assert found["t0"].verdict == verdict
    ratio = compare_runs([(base, base)] * int(pairs)).rows[0].ratio
    assert ratio is not None
    assert (1.0 + MARGIN) * ratio.high == pytest.approx(float(four), abs=0.006)


def test_the_guide_has_a_table_and_more_pairs_find_smaller_slowdowns() -> None:
    columns = [[float(x) for x in column] for column in zip(*TABLE, strict=True)]
    assert len(TABLE) > 3 and columns[0] == sorted(columns[0])
    assert all(column == sorted(column, reverse=True) for column in columns[1:])
