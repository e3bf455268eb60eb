"""Counts as tables: one row a step in `embedded.parquet`, one row a run in a summary."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from dpbench.embedded.count import StepCounts
from dpbench.embedded.toolchain import compiler_version
from dpbench.files.writing import make_folder, replace_file

FILE = "embedded.parquet"
SIZES = ("code", "constants", "static", "heap")


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
    path = make_folder(folder) / FILE
    with replace_file(path) as part:
        tabulate_steps(counts).to_parquet(part, index=False)
    return path


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
