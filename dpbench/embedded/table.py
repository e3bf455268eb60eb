"""Counts as tables: one row a step in `embedded.parquet`, one row a run in a summary."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa

from dpbench.arrays import Ints, Matrix, Vector
from dpbench.embedded.recipe import Settings
from dpbench.embedded.toolchain import compiler_version
from dpbench.errors import ResultsError
from dpbench.files.regular_files import make_folder_if_missing, write_file_atomically
from dpbench.files.tables import decode_dictionary_columns_to_text, open_untrusted_parquet_table

COUNTED = ("instructions", "loads", "stores", "stack", "iterations", "active", "status")
"""Columns of each step: executed, bytes of stack, then what the solver reports."""
EMBEDDED_FILE = "embedded.parquet"
SIZES = ("code", "constants", "static", "heap")
COLUMNS = {
    **dict.fromkeys(("solver", "target", "sequence"), "str"),
    "single": "bool",
    "k": "int64",
    **{name if name != "stack" else "stack_bytes": "int64" for name in COUNTED},
    **dict.fromkeys(("error_move", "error_plan"), "float64"),
    **{f"{name}_bytes": "int64" for name in SIZES},
    **dict.fromkeys(("settings", "compiler"), "str"),
}
"""Columns of `embedded.parquet` and their types."""


@dataclass(frozen=True, eq=False)
class StepCounts:
    """Counts of a solver's C along a sequence of K QPs.

    Parameters
    ----------
    solver, target, sequence : names.
    single : whether in single precision.
    settings : of the solver.
    steps : (K,) of each of `COUNTED`; −1 where not counted or reported.
    z : (K, n) answers, in the units of the sequence.
    error_move, error_plan : (K,) distance to the certified optimum, of first move and whole plan.
    sizes : bytes of code, constants, static data and heap.
    """

    solver: str
    target: str
    sequence: str
    single: bool
    settings: Settings
    steps: dict[str, Ints]
    z: Matrix
    error_move: Vector
    error_plan: Vector
    sizes: dict[str, int]


def tabulate_counted_steps(counts: Sequence[StepCounts]) -> pd.DataFrame:
    """Return one row a step: names, what was executed, errors; sizes and settings of the run."""
    frames = []
    for run in counts:
        frame = pd.DataFrame({"k": range(len(run.z)), **run.steps})
        frame["error_move"], frame["error_plan"] = run.error_move, run.error_plan
        names: dict[str, Any] = {"solver": run.solver, "target": run.target}
        names |= {"sequence": run.sequence, "single": run.single}
        for place, (name, value) in enumerate(names.items()):
            frame.insert(place, name, value)
        for name in SIZES:
            frame[f"{name}_bytes"] = run.sizes[name]
        frame["settings"] = json.dumps(dict(run.settings))
        frame["compiler"] = f"ziglang {compiler_version()}"
        frames.append(frame.rename(columns={"stack": "stack_bytes"}))
    return pd.concat(frames, ignore_index=True)


def save_counted_steps_in_folder(counts: Sequence[StepCounts], folder: Path) -> Path:
    """Write `embedded.parquet` to a folder, made if missing; return its path."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    path = make_folder_if_missing(folder) / EMBEDDED_FILE
    write_counted_steps_atomically(tabulate_counted_steps(counts), path)
    return path


def write_counted_steps_atomically(steps: pd.DataFrame, path: Path) -> None:
    """Write counted steps to a Parquet file, whole or not at all."""
    with write_file_atomically(path) as part:
        steps[list(COLUMNS)].astype(COLUMNS).to_parquet(part, index=False, compression="zstd")


def read_counted_steps_of_file(path: Path) -> pd.DataFrame:
    """Return the counted steps in a file; ResultsError where it is damaged or has no rows."""
    try:
        with open_untrusted_parquet_table(path, error=ResultsError) as file:
            table = decode_dictionary_columns_to_text(
                file.read(columns=list(COLUMNS)), path, error=ResultsError
            )
        frame: pd.DataFrame = table.to_pandas(ignore_metadata=True)[list(COLUMNS)]
        steps = frame.astype(COLUMNS)
        for text in steps["settings"].unique():
            json.loads(text)
    except ResultsError:
        raise
    except (OSError, ValueError, TypeError, KeyError, pa.ArrowException) as error:
        found = "a damaged file"
        raise ResultsError(
            str(path), "", found, "a table of counts; run the suite again"
        ) from error
    if steps.empty or (steps["instructions"] < 1).any():
        raise ResultsError(
            str(path),
            "instructions",
            "a step without instructions",
            "1 or more; run the suite again",
        )
    return steps


def load_counted_steps_of_folder(folder: Path) -> pd.DataFrame | None:
    """Return `embedded.parquet` of a folder, None without one; ResultsError if damaged."""
    path = folder / EMBEDDED_FILE
    return read_counted_steps_of_file(path) if path.exists() else None


def summarise_counted_runs(steps: pd.DataFrame) -> list[dict[str, Any]]:
    """Return each run of a table in a few numbers: instructions a step, worst step, sizes, errors.

    steps : as of `tabulate_counted_steps`; a run has one solver, core, sequence and precision.
    """
    runs = steps.groupby(["solver", "target", "sequence", "single"], sort=False)
    return [_summarise_counted_run(run) for _, run in runs]


def _summarise_counted_run(run: pd.DataFrame) -> dict[str, Any]:
    """Summarise a run's instruction counts: percentiles, worst step, failures, memory."""
    row = run["instructions"].argmax()
    worst: dict[Any, Any] = run.iloc[row].to_dict()
    return {
        "solver": str(worst["solver"]),
        "target": str(worst["target"]),
        "sequence": str(worst["sequence"]),
        "single": bool(worst["single"]),
        "settings": json.loads(worst["settings"]),
        "steps": len(run),
        "instructions_p50": round(float(run["instructions"].quantile(0.5))),
        "instructions_p99": round(float(run["instructions"].quantile(0.99))),
        "instructions_max": int(worst["instructions"]),
        "worst_step": int(worst["k"]),
        "worst_iterations": int(worst["iterations"]),
        "worst_active": int(worst["active"]),
        "failed_steps": int((run["status"] != 0).sum()),
        "error_move": float(run["error_move"].max()),
        "error_plan": float(run["error_plan"].max()),
        **{f"{name}_bytes": int(worst[f"{name}_bytes"]) for name in SIZES},
        "stack_bytes": int(run["stack_bytes"].max()),
    }
