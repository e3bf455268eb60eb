"""The public tables of a campaign."""

from __future__ import annotations

import pandas as pd

from dpbench.bench.record.schema import RUN_COLUMNS, as_runs
from dpbench.bench.tabulate import RequestedRuns


def test_a_shard_without_cells_has_a_table_without_rows() -> None:
    rows = RequestedRuns([]).rows(as_runs(pd.DataFrame()).set_index("run_id", drop=False))
    assert len(rows) == 0 and set(RUN_COLUMNS) <= set(rows)
