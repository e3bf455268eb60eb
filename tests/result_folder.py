"""Results of records that no campaign made."""

from collections.abc import Container, Iterator, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from dpbench.bench.record.recorded_steps import ALL_COLUMNS, StepsOnDisk, find_row_ranges_by_label
from dpbench.bench.record.result_folder import Results, write_json
from dpbench.bench.record.schema import convert_to_run_columns, convert_to_step_columns


class StepsInMemory(StepsOnDisk):
    """Steps that were never in a file."""

    def __init__(self, frame: pd.DataFrame) -> None:
        self._frame, self.rows = frame, len(frame)

    def scan(
        self, columns: Sequence[str], run_ids: Container[str] | None = None
    ) -> Iterator[pd.DataFrame]:
        some = self._frame[list(columns)]
        if run_ids is not None:
            wanted = [
                np.full(end - first, name in run_ids)
                for name, (first, end) in self._run_rows.items()
            ]
            some = some[np.concatenate([np.zeros(0, dtype=np.bool_), *wanted])]
        if len(some):
            yield some

    def read_run(self, run_id: str, columns: Sequence[str] = ALL_COLUMNS) -> pd.DataFrame:
        first, end = self._run_rows.get(run_id, (0, 0))
        return self._frame.iloc[first:end][list(columns)]

    def read_all_steps(self) -> pd.DataFrame:
        return self._frame

    @cached_property
    def _run_rows(self) -> dict[str, tuple[int, int]]:
        return find_row_ranges_by_label(self._frame["run_id"])


def write_results(out: Path, results: Results) -> None:
    """Write its four files, their columns in the order and of the types of a campaign."""
    out.mkdir(parents=True, exist_ok=True)
    for name, frame in (
        ("runs", convert_to_run_columns(results.runs)),
        ("steps", convert_to_step_columns(results.steps)),
    ):
        frame.to_parquet(out / f"{name}.parquet", index=False, compression="zstd")
    rows = {"run_rows": len(results.runs), "step_rows": len(results.steps)}
    write_json(out / "machine.json", results.machine)
    write_json(out / "suite.json", results.suite | rows)
