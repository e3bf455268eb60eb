"""Tables of counts as `dpbench embedded` writes them, of given instructions."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from dpbench.embedded.table import COLUMNS


def make_counts(
    solver: str,
    instructions: Sequence[int],
    sequence: str = "paper[0:200]",
    *,
    error: float = 1e-9,
    target: str = "m7",
    settings: str = "{}",
) -> pd.DataFrame:
    """Return a row for each step of one solver."""
    steps = len(instructions)
    columns: dict[str, object] = {
        **{"solver": solver, "target": target, "sequence": sequence, "single": False},
        **{"k": np.arange(steps), "instructions": instructions, "loads": -1, "stores": -1},
        **{"stack_bytes": 400, "iterations": 7, "active": 3, "status": 0},
        **{"error_move": error, "error_plan": error},
        **{"code_bytes": 20_000, "constants_bytes": 500, "static_bytes": 3_000, "heap_bytes": 64},
        **{"settings": settings, "compiler": "ziglang 0.0.0"},
    }
    return pd.DataFrame(columns)[list(COLUMNS)].astype(COLUMNS)
