"""Write a result folder of records that no campaign made."""

from pathlib import Path

from dpbench.bench.record.result_folder import Results, write_json
from dpbench.bench.record.schema import as_runs, as_steps


def write_results(out: Path, results: Results) -> None:
    """Write its four files, their columns in the order and of the types of a campaign."""
    out.mkdir(parents=True, exist_ok=True)
    for name, frame in (("runs", as_runs(results.runs)), ("steps", as_steps(results.steps))):
        frame.to_parquet(out / f"{name}.parquet", index=False, compression="zstd")
    rows = {"run_rows": len(results.runs), "step_rows": len(results.steps)}
    write_json(out / "machine.json", results.machine)
    write_json(out / "suite.json", results.suite | rows)
