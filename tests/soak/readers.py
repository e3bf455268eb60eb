"""Subjects of the soak test: real files of each kind, their mutation, and their readers."""

import json
import random
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path

import numpy as np
import scipy.io

from dpbench.bench.capability.edge_qps import COLUMNS, load_capability_plots, write_capability_plots
from dpbench.bench.design import load_stability_records
from dpbench.bench.engines.shards import SHARD_FILE, Shard, ShardRecord
from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.run_request import RunRequest
from dpbench.bench.plan.suite import load_path_and_suite
from dpbench.bench.record.cell_store import CellStore
from dpbench.bench.record.recorded_steps import ALL_COLUMNS
from dpbench.bench.record.result_folder import load_results, read_lost_count_and_remarks
from dpbench.bench.record.step_table import make_batch_part, make_step_record_batch
from dpbench.bench.sequences.shipped import load_rules
from dpbench.bench.sequences.source import read_sequence
from dpbench.embedded.table import (
    EMBEDDED_FILE,
    load_counted_steps_of_folder,
    write_counted_steps_atomically,
)
from dpbench.report.report import Report
from dpbench.scenario.hull_files import read_hull_from_csv_table, read_hull_from_mss_file
from dpbench.scenario.problem_files import find_folder_of_shipped_problems
from dpbench.scenario.scenario import load_scenario, load_vessel
from tests.bench.sequences.test_foreign_qps import maros_meszaros, two_stages
from tests.conftest import MadeRecords
from tests.embedded.made_counts import make_counts
from tests.soak.mutations import of_archive, of_bytes, of_json, of_part, of_table, of_text

Mutation = Callable[[bytes, random.Random], bytes]
ROOT = Path(__file__).resolve().parents[2]


class Soaked(ABC):
    """Files of one kind.

    Attributes
    ----------
    files : their content by name, in a folder that the reader is given.
    """

    files: dict[str, bytes]

    @abstractmethod
    def mutate(self, name: str, data: bytes, rng: random.Random) -> bytes:
        """Another content for a file."""

    @abstractmethod
    def read(self, folder: Path, name: str, rng: random.Random) -> None:
        """Read the folder, or the file in it that was changed."""

    def choose(self, rng: random.Random) -> str:
        return rng.choice(sorted(self.files))

    whole = False
    """True where the reader needs the other files too."""


def _contents(root: Path, pattern: str) -> dict[str, bytes]:
    return {str(p.relative_to(root)): p.read_bytes() for p in sorted(root.rglob(pattern))}


class Toml(Soaked):
    """Vessels, scenarios and suites as they ship, and the manifest of the sequences."""

    def __init__(self, folder: Path) -> None:
        self.files = _contents(find_folder_of_shipped_problems(), "*.toml")

    def mutate(self, name: str, data: bytes, rng: random.Random) -> bytes:
        return of_text(data, rng)

    def read(self, folder: Path, name: str, rng: random.Random) -> None:
        path = folder / name
        if name.startswith("vessels"):
            load_vessel(path)
        elif name.startswith("scenarios"):
            load_scenario(path)
        elif name.startswith("sequences"):
            load_rules(path)
        else:
            path, suite = load_path_and_suite(path)
            if rng.random() < 0.2:
                plan_suite(suite, beside=path.parent)


class Sequences(Soaked):
    """Some of the sequences that ship, and QPs of others: by qpsolvers, acados, Maros-Meszaros.

    One of twenty is a `.mat` file, which takes a process each.
    """

    def __init__(self, folder: Path) -> None:
        some = ("paper-30-5", "thruster_loss_soft-30-5", "thrusters_cascade-30-5")
        sequences = find_folder_of_shipped_problems() / "sequences"
        self.files = {f"{n}.npz": (sequences / f"{n}.npz").read_bytes() for n in some}
        path = folder / "problem.npz"
        np.savez(path, P=np.eye(3), q=np.ones(3), G=np.ones((2, 3)), h=np.ones(2), lb=-np.ones(3))
        self.files[path.name] = path.read_bytes()
        self.files["acados.json"] = json.dumps(two_stages()).encode()
        scipy.io.savemat(folder / "HS99.mat", maros_meszaros())
        self.files["HS99.mat"] = (folder / "HS99.mat").read_bytes()

    def choose(self, rng: random.Random) -> str:
        quick = sorted(name for name in self.files if not name.endswith(".mat"))
        return "HS99.mat" if rng.random() < 0.05 else rng.choice(quick)

    def mutate(self, name: str, data: bytes, rng: random.Random) -> bytes:
        by_ending = {".npz": of_archive, ".json": of_json, ".mat": of_bytes}
        return by_ending[Path(name).suffix](data, rng)

    def read(self, folder: Path, name: str, rng: random.Random) -> None:
        read_sequence(folder / name)


class Results(Soaked):
    """A small folder of results, with a design and a capability plot."""

    whole = True

    def __init__(self, folder: Path) -> None:
        records = MadeRecords()
        for solver in ("daqp", "osqp"):
            records.loop(solver, steps=12)
            records.replay(solver, steps=20)
        records.refused("qpax", "it is not installed")
        out = records.write(folder / "made")
        row = ("plot", 0, "psv", 8, "intact", "", 0.0, 20.0, True, 20.0, 7)
        write_capability_plots(out, [{n: [value] for n, value in zip(COLUMNS, row, strict=True)}])
        write_counted_steps_atomically(
            make_counts("daqp", [1000, 2000], "paper[0:2]"), out / EMBEDDED_FILE
        )
        held = {"still water": {"holds_m": 8.0, "fails_m": None}}
        design = {"vessel": "psv", "controller": "paper", "tuning": "paper", "N_p": 30, "N_c": 5}
        design |= {"eigenvalues": [[0.9, 0.1]], "held": held}
        document = {"records": [design], "missing": [], "schema": 2}
        (out / "design.json").write_text(json.dumps(document), encoding="utf-8")
        self.files = _contents(out, "*.*")

    def choose(self, rng: random.Random) -> str:
        names = ("runs.parquet", "steps.parquet", "suite.json", "machine.json")
        rare = ("design.json", "capability.parquet", EMBEDDED_FILE)
        return rng.choice((*3 * names, *rare))

    def mutate(self, name: str, data: bytes, rng: random.Random) -> bytes:
        return (of_table if name.endswith(".parquet") else of_json)(data, rng)

    def read(self, folder: Path, name: str, rng: random.Random) -> None:
        results = load_results(folder)
        designs, plots = load_stability_records(folder), load_capability_plots(folder)
        counts = load_counted_steps_of_folder(folder)
        read_lost_count_and_remarks(folder)
        for table in results.recorded.scan(ALL_COLUMNS):
            len(table)
        if rng.random() < REPORTED:
            _ = Report.from_results(results, designs, None, plots, counts).figures


REPORTED = 0.05
"""The share of folders that can be read of which a report is made: it takes a second each."""


class Shards(Soaked):
    """The folder of a shard: its description, and two parts, whose names have the check sums of
    whatever is in them."""

    whole = True

    def __init__(self, folder: Path) -> None:
        records = MadeRecords()
        for solver in ("daqp", "osqp", "proxqp"):
            records.loop(solver, steps=5)
        results = records.results()
        out = folder / "shard"
        store = CellStore(out)
        rows = json.loads(results.runs.to_json(orient="records"))
        steps = make_step_record_batch({"k": np.arange(5)})
        store.write_part_file(make_batch_part({row["run_id"]: (row, steps) for row in rows[:2]}))
        store.write_part_file(make_batch_part({rows[2]["run_id"]: (rows[2], steps)}))
        about = {"id": "abc", "cpu_model": "x"}
        ShardRecord(RunRequest(suite="smoke"), Shard(1, 2), "0" * 16, about).write(out)
        self.files = _contents(out, "*.*")

    def choose(self, rng: random.Random) -> str:
        return rng.choice([SHARD_FILE, *sorted(self.files)])

    def mutate(self, name: str, data: bytes, rng: random.Random) -> bytes:
        if name.endswith(".json"):
            return of_json(data, rng)
        return (of_table if rng.random() < 0.3 else of_part)(data, rng)

    def read(self, folder: Path, name: str, rng: random.Random) -> None:
        ShardRecord.read(folder)
        for path in list((folder / "cells").iterdir()):
            sound = f"{path.name[:10]}-{zlib.crc32(path.read_bytes()):08x}.parquet"
            path.rename(path.with_name(sound))
        store = CellStore(folder)
        store.read_finished_runs()
        CellStore(folder / "gathered").copy_runs_of_other_folder(store)


class Hulls(Soaked):
    """Tables of coefficients, and one of twenty a MATLAB file, which takes a process each."""

    def __init__(self, folder: Path) -> None:
        mat = ROOT / "tests" / "scenario" / "mss" / "supply_cut.mat"
        table = "# hull\ncoefficient,value,remark\nlength_m,82.8\nM11,7e6\nM22,8e6,with added\n"
        table += 'M66,4e9\nD11,2e5\nD22,8e5\n"D66",3e8\nD26,-3e6\n'
        self.files = {"hull.mat": mat.read_bytes(), "hull.csv": table.encode()}

    def choose(self, rng: random.Random) -> str:
        return "hull.mat" if rng.random() < 0.05 else "hull.csv"

    def mutate(self, name: str, data: bytes, rng: random.Random) -> bytes:
        return of_bytes(data, rng) if name.endswith(".mat") else of_text(data, rng)

    def read(self, folder: Path, name: str, rng: random.Random) -> None:
        (read_hull_from_mss_file if name.endswith(".mat") else read_hull_from_csv_table)(
            folder / name
        )


KINDS: dict[str, type[Soaked]] = {
    "toml": Toml,
    "sequences": Sequences,
    "results": Results,
    "shards": Shards,
    "hulls": Hulls,
}
