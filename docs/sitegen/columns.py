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

`load_results(folder).runs` and `.steps` are the two tables as data frames, with all columns below.
"""
STORAGE = """## How they are stored

Both are Parquet files, compressed with Zstandard, that pandas, polars, DuckDB and others read
alone; each page carries its check sum. The rows of a run follow each other in the order of its
steps, in one row group; the runs of `steps.parquet` stand in the order in which they were finished,
those of `runs.parquet` in that of the suite. What follows from other columns, bit for bit, stands
in no file:
"""
SAME = """Where one of these columns is equal, bit for bit, to the one beside it, it is null in the
file and has that one's value:
"""
READERS = """In SQL, as of DuckDB, with `steps.parquet` alone:

```sql
SELECT run_id, k, coalesce(cmd_x_N, tau_x_N) AS cmd_x_N,
       setup_ns IS NULL AND update_ns IS NULL AND solve_ns IS NULL AND read_ns IS NULL AS untimed,
       coalesce(setup_ns, 0) + coalesce(update_ns, 0) + coalesce(solve_ns, 0) + coalesce(read_ns, 0)
         + coalesce(allocation_ns, 0) AS total_ns
FROM 'steps.parquet'
```

`scan_steps(folder, columns, run_ids)` of `dpbench.bench.record.recorded_steps` gives the columns
that are asked for, derived ones too, as Arrow tables of some hundred thousand rows, whatever the
size of the file; `read_steps` gives them in one table. Files of earlier schemas store all columns,
and are read as well.

While a campaign runs, finished cells stand in `cells/`: in `open.cells`, and in parts of some
hundred cells, `steps-00001.parquet` and `runs-00001.parquet`, of the same columns. A cell whose row
stands there is finished, and is not run again.
"""


def pages() -> dict[str, str]:
    """Markdown by file of the documentation."""
    parts = [INTRODUCTION, "## `runs.parquet`\n"]
    for title, columns in GROUPS.items():
        parts += [f"### {title}\n", _table(columns)]
    parts += ["## `steps.parquet`\n", _table(schema.STEP_COLUMNS)]
    derived = ((code(name), prose(formula)) for name, formula in schema.DERIVED.items())
    same = ((code(name), code(other)) for name, other in schema.SAME_AS.items())
    parts += [STORAGE, table(("derived column", "formula"), derived)]
    parts += [SAME, table(("column", "equal to"), same), READERS]
    return {"reference/columns.md": "\n".join(parts)}


def _table(columns: schema.Columns) -> str:
    rows = ((code(name), code(dtype), prose(text)) for name, (dtype, text) in columns.items())
    return table(("column", "type", "meaning"), rows)
