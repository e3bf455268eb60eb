"""The reference of columns, from the schema of the records."""

from __future__ import annotations

from dpbench.bench.record import schema
from sitegen.markup import code, prose, table

GROUPS = {
    "What a run is": schema.IDENTITY_COLUMNS,
    "Accuracy": schema.ACCURACY_COLUMNS,
    "Times": schema.TIMING_COLUMNS,
    "Machine and repeatability": schema.MACHINE_COLUMNS,
    "Control": schema.CONTROL_COLUMNS,
}
INTRODUCTION = f"""# Columns

A result folder has two tables. `runs.parquet` has a row for each cell: a problem, a solver, a way
to run it. `steps.parquet` has a row for each step of each. Times are whole nanoseconds, everything
else is in SI units. What is not known is missing (NaN or null), never made up; `Int64` is a whole
number that may be missing. This is version {schema.SCHEMA_VERSION} of the schema. How the figures
are computed stands in [Method](../method.md).

`load_results(folder).runs` and `.steps` are the two tables as data frames.
"""


def pages() -> dict[str, str]:
    """Markdown by file of the documentation."""
    parts = [INTRODUCTION, "## `runs.parquet`\n"]
    for title, columns in GROUPS.items():
        parts += [f"### {title}\n", _table(columns)]
    parts += ["## `steps.parquet`\n", _table(schema.STEP_COLUMNS)]
    return {"reference/columns.md": "\n".join(parts)}


def _table(columns: schema.Columns) -> str:
    rows = ((code(name), code(dtype), prose(text)) for name, (dtype, text) in columns.items())
    return table(("column", "type", "meaning"), rows)
