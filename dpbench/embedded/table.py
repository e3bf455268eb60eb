"""Counts as tables: one row a step in `embedded.parquet`, one row a run in a summary."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa

from dpbench.embedded.count import COUNTED, StepCounts
from dpbench.embedded.toolchain import compiler_version
from dpbench.errors import ResultsError
from dpbench.files.tables import decode_words, open_table
from dpbench.files.writing import make_folder, replace_file

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


def tabulate_steps(counts: Sequence[StepCounts]) -> pd.DataFrame:
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


def save_steps(counts: Sequence[StepCounts], folder: Path) -> Path:
    """Write `embedded.parquet` to a folder, made if missing; return its path."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    path = make_folder(folder) / EMBEDDED_FILE
    write_steps(tabulate_steps(counts), path)
    return path


def write_steps(steps: pd.DataFrame, path: Path) -> None:
    """Write counted steps to a file, whole or not at all."""
    with replace_file(path) as part:
        steps[list(COLUMNS)].astype(COLUMNS).to_parquet(part, index=False, compression="zstd")


def read_steps(path: Path) -> pd.DataFrame:
    """Return the counted steps in a file; ResultsError where it is damaged or has no rows."""
    try:
        with open_table(path, error=ResultsError) as file:
            table = decode_words(file.read(columns=list(COLUMNS)), path, error=ResultsError)
        frame: pd.DataFrame = table.to_pandas(ignore_metadata=True)[list(COLUMNS)]
        steps = frame.astype(COLUMNS)
    except ResultsError:
        raise
    except (OSError, ValueError, TypeError, KeyError, pa.ArrowException) as error:
        found = f"a damaged file ({str(error)[:80]})"
        raise ResultsError(str(path), "", found, "a table of counts; run again") from error
    if steps.empty or (steps["instructions"] < 1).any():
        raise ResultsError(str(path), "instructions", "a step of none", "1 or more; run again")
    return steps


def load_counts(folder: Path) -> pd.DataFrame | None:
    """Return `embedded.parquet` of a folder, None without one; ResultsError if damaged."""
    path = folder / EMBEDDED_FILE
    return read_steps(path) if path.exists() else None


def summarise(run: StepCounts) -> dict[str, Any]:
    """Return one run in a few numbers: instructions a step, its worst step, sizes, errors."""
    worst = run.worst
    return {
        "solver": run.solver,
        "target": run.target,
        "sequence": run.sequence,
        "single": run.single,
        "settings": dict(run.settings),
        "steps": len(run.z),
        "instructions_p50": run.percentile(0.5),
        "instructions_p99": run.percentile(0.99),
        "instructions_max": int(run.steps["instructions"][worst]),
        "worst_step": worst,
        "worst_iterations": int(run.steps["iterations"][worst]),
        "worst_active": int(run.steps["active"][worst]),
        "failed_steps": int((run.steps["status"] != 0).sum()),
        "error_move": float(run.error_move.max()),
        "error_plan": float(run.error_plan.max()),
        **{f"{name}_bytes": run.sizes[name] for name in SIZES},
        "stack_bytes": int(run.steps["stack"].max()),
    }
