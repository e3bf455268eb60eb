"""The reference of columns, from the schema of the records."""

from dpbench.bench.record import schema
from sitegen.markup import code, prose, table

GROUPS = {
    "Identity of a run": schema.IDENTITY_COLUMNS,
    "Accuracy": schema.ACCURACY_COLUMNS,
    "Times": schema.TIMING_COLUMNS,
    "Machine and repeatability": schema.MACHINE_COLUMNS,
    "Control": schema.CONTROL_COLUMNS,
}
INTRODUCTION = f"""# Columns

A result folder has two tables. `runs.parquet` has one row per cell: a problem, a solver and its
call mode. `steps.parquet` has one row per step of each cell. Times are whole
nanoseconds; all other quantities are in SI units. An unknown value is missing (NaN or null).
`Int64` is a whole number that may be missing. The schema has version {schema.SCHEMA_VERSION}.
[Method](../method.md) has the formulas.

`load_results(folder).runs` and `.steps` are the two tables as data frames, with all columns below.
"""
STORAGE = """## Storage

Both are Parquet files, compressed with Zstandard, that pandas, polars, DuckDB and others read
alone; each page carries its check sum. All columns above are in the file. The rows of a run follow
each other in the order of its steps, in one row group. The runs of `steps.parquet` are in the order
in which they finished, those of `runs.parquet` in the order of the suite. In SQL, for example with
DuckDB:

```sql
SELECT solver, max(total_ns) / 1e6 AS longest_ms
FROM 'steps.parquet' JOIN 'runs.parquet' USING (run_id)
WHERE counts GROUP BY solver
```

`scan_steps(folder, columns, run_ids)` of `dpbench.bench.record.recorded_steps` gives the
requested columns as Arrow tables of some hundred thousand rows, whatever the size of the file;
`read_steps` gives them in one table. A column that a file does not have is read as missing. Files
of other versions of the schema are refused.

While a campaign runs, finished cells are in `cells/`, the cells of a batch in one file, a part. It
has the columns of `steps.parquet`, and in its metadata, under `runs`, those of `runs.parquet` as
JSON; its name, `part-00001-0a1b2c3d.parquet`, ends with the CRC-32 of the file. A cell of a part is
finished, and is not run again. At the end of the campaign the steps of the parts become
`steps.parquet`.
"""


def pages() -> dict[str, str]:
    """Markdown by file of the documentation."""
    parts = [INTRODUCTION, "## `runs.parquet`\n"]
    for title, columns in GROUPS.items():
        parts += [f"### {title}\n", _table(columns)]
    parts += ["## `steps.parquet`\n", _table(schema.STEP_COLUMNS)]
    parts += [STORAGE]
    return {"reference/columns.md": "\n".join(parts)}


def _table(columns: schema.Columns) -> str:
    rows = ((code(name), code(dtype), prose(text)) for name, (dtype, text) in columns.items())
    return table(("column", "type", "meaning"), rows)
