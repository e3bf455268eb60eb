"""Where the QPs of a replay come from: the exactly solved loop of a scenario, or its hardest steps,
the consequence analysis along it, the edge of what thrusters hold, a random recipe, or what others
recorded.

What takes long is done once per source, in a process of its own, and kept in a file that workers
and evaluators read: the loop, or the sequence with its certified optima.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from numpy.typing import NDArray

from dpbench.bench.record.cell import HARDEST, Cell
from dpbench.bench.record.npz import kept
from dpbench.bench.record.raw_log import log_bytes, loop_layout, replay_layout
from dpbench.bench.record.schema import SCHEMA_VERSION
from dpbench.bench.run.exact_loop import ExactLoop, allocation_sizes, sequence_of, solve_exactly
from dpbench.bench.sequences.at_edge import make_at_edge
from dpbench.bench.sequences.consequence import consequence_sequence, steered_rows
from dpbench.bench.sequences.hardest import first_of_hardest
from dpbench.bench.sequences.recording import digest, read_sequence
from dpbench.bench.sequences.sequence_file import load_recorded, save_sequence
from dpbench.errors import InputError, ResultsError
from dpbench.qp.program import QPSequence
from dpbench.qp.random_recipe import RandomRecipe
from dpbench.qp.random_sequence import random_sequence
from dpbench.qp.referee.optimum import Optimum
from dpbench.qp.referee.referee import certified
from dpbench.scenario.problem_files import is_stored, sequence_path
from dpbench.scenario.scenario import scenario_once, vessel_of
from dpbench.ship.layout import AXES

RANDOM = "random"
"""The kind of a source that is a recipe."""
RECORDED = "recorded"
"""The kind of a source that is a file, or a folder of them."""
CONSEQUENCE = "consequence"
"""The kind of a source that is the loss of a failure group along the loop of the scenario."""
CAPABILITY = "capability"
"""The kind of a source that is the edge of what a ship's thrusters hold."""


@dataclass(frozen=True, eq=False)
class Replayed:
    """What a replay needs: the QPs, the time between them [s], and their optima if known."""

    sequence: QPSequence
    sample_s: float
    optima: list[Optimum] | None


class Source(Protocol):
    """Makes the file behind the replays of one problem, and reads it."""

    def make(self, path: Path) -> None:
        """Do what takes long into `path` (.npz); CertificateError when it cannot be done."""

    def load(self, cell: Cell, path: Path) -> Replayed:
        """The QPs of a cell, from what `make` left at `path`."""

    def check(self, path: Path) -> None:
        """Read all of what `make` left; ResultsError or InputError where it is damaged or gone."""

    def size(self, stored: Mapping[str, NDArray[Any]]) -> tuple[int, int]:
        """n and m of the QPs, by the arrays that `make` left."""


def source_of(cell: Cell) -> Source:
    """The source of a cell's QPs; InputError for a kind that is not known."""
    if not cell.source:
        return _Loop(cell.scenario, last_step(cell))
    kind = cell.source.get("kind")
    if kind == HARDEST:
        return _Hardest(cell.scenario, last_step(cell))
    if kind == CONSEQUENCE:
        return _Consequence(cell.scenario, last_step(cell), cell.source["group"])
    if kind == CAPABILITY:
        return _AtEdge(cell.source)
    if kind == RANDOM:
        return _Random(RandomRecipe.from_dict(cell.source["recipe"]))
    if kind == RECORDED:
        return _Recorded(cell.source)
    kinds = ", ".join(map(repr, (RANDOM, RECORDED, HARDEST, CONSEQUENCE, CAPABILITY)))
    raise InputError("cell", "source.kind", repr(kind), kinds)


_latest: dict[tuple[str, Path], Replayed] = {}


def replayed(cell: Cell, path: Path) -> Replayed:
    """What a replay needs, with its optima: read, and if need be certified, once a process for all
    cells in a row that see the same QPs."""
    key = cell.problem_key, path
    if key not in _latest:
        _latest.clear()
        known = source_of(cell).load(cell, path)
        _latest[key] = replace(known, optima=known.optima or certified(known.sequence))
    return _latest[key]


def source_key(cell: Cell, harness_version: str) -> str:
    """Cells with the same key share one file."""
    # A loop is solved once, whatever is made of it.
    text = json.dumps(
        [cell.scenario or cell.source, harness_version, SCHEMA_VERSION], sort_keys=True
    )
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def last_step(cell: Cell) -> int:
    """The sample behind the last that a cell needs of its source."""
    return cell.first + int(cell.source.get("of", cell.steps))


def is_sound(cell: Cell, path: Path) -> bool:
    """Whether the file behind a cell's QPs can be read to its end."""
    try:
        source_of(cell).check(path)
    except InputError:
        return False
    return True


def log_size(cell: Cell, path: Path) -> int:
    """Bytes of the raw log of a cell, by the sizes in the file behind its QPs.

    Raises
    ------
    ResultsError : the file is damaged or gone.
    """
    with kept(path) as stored:
        n, m = source_of(cell).size(stored)
        if cell.mode == "closed_loop":
            n_theta, n_f = stored["theta"].shape[1], stored["thrust"].shape[1]
            second = allocation_sizes(stored)
            return log_bytes(
                loop_layout(cell.steps, n, m, n_theta, n_f, second, backup=bool(cell.backup))
            )
    return log_bytes(replay_layout(cell.rounds + 1, cell.steps, n, m))


def is_untimed(cell: Cell) -> bool:
    """Whether the cell replays QPs that have no deadline, whose times nobody compares."""
    return cell.source.get("kind") in (RANDOM, CAPABILITY)


def is_recorded(cell: Cell) -> bool:
    """Whether its QPs come from a file that others recorded."""
    return cell.source.get("kind") == RECORDED


def is_timed(cell: Cell) -> bool:
    """Whether the cell is a replay whose times are compared."""
    return cell.mode == "replay" and not is_untimed(cell)


def is_at_edge(cell: Cell) -> bool:
    """Whether its QPs are those at the edge of what thrusters hold."""
    return cell.source.get("kind") == CAPABILITY


def random_source(recipe: RandomRecipe) -> dict[str, Any]:
    """`Cell.source` of a recipe."""
    return {"kind": RANDOM, "name": recipe.name, "recipe": recipe.to_dict()}


def hardest_source(replay: str, steps: int, of: int) -> dict[str, Any]:
    """`Cell.source` of the hardest `steps` steps in a row of a replay of `of` steps."""
    return {"kind": HARDEST, "name": f"{replay} hardest {steps}", "of": of}


def consequence_source(sequence: str, group: str) -> dict[str, Any]:
    """`Cell.source` of the loss of a failure group, beside the replay called `sequence`."""
    return {"kind": CONSEQUENCE, "name": f"{sequence}, {group} lost", "group": group}


def capability_source(files: dict[str, Any], sides: int) -> dict[str, Any]:
    """`Cell.source` of the edge of a ship, given by `vessel_files`, with polygons of some sides."""
    name = f"{files['vessel_name']} capability, {sides} sides"
    return {"kind": CAPABILITY, "name": name, "sides": sides, **files}


def recorded_source(what: str, path: Path, name: str) -> dict[str, Any]:
    """`Cell.source` of the sequence called `name` at `path`, as it is at this moment.

    Where `what`, as which it was asked for, is the name of a stored one, the name stands for it:
    another installation has it in another folder.
    """
    place = what if is_stored(what) else str(path)
    return {"kind": RECORDED, "name": name, "path": place, "sha256": digest(path)}


@dataclass(frozen=True, eq=False)
class _Loop:
    """The QPs along the first steps of the exactly solved loop of a scenario."""

    documents: dict[str, Any]
    steps: int

    def make(self, path: Path) -> None:
        solve_exactly(scenario_once(self.documents).first(self.steps)).save(path)

    def load(self, cell: Cell, path: Path) -> Replayed:
        scenario, exact = scenario_once(self.documents), ExactLoop.load(path)
        first = self.first_step(cell, exact)
        sequence = sequence_of(scenario, exact, units=cell.units, first=first, count=cell.steps)
        optima = exact.optima[first : first + cell.steps]
        return Replayed(sequence, scenario.sample_s, optima)

    def first_step(self, cell: Cell, exact: ExactLoop) -> int:
        """The step of the loop that the replay begins with."""
        return cell.first

    def check(self, path: Path) -> None:
        stored_steps = len(ExactLoop.load(path).theta)
        if stored_steps < self.steps:
            raise ResultsError(str(path), "theta", f"{stored_steps} steps", f"{self.steps} of them")

    def size(self, stored: Mapping[str, NDArray[Any]]) -> tuple[int, int]:
        return stored["z"].shape[1], stored["optimum_y"].shape[1]


@dataclass(frozen=True, eq=False)
class _Hardest(_Loop):
    """The QPs of the hardest window of the same loop."""

    def first_step(self, cell: Cell, exact: ExactLoop) -> int:
        return first_of_hardest(exact.optima, cell.first, cell.source["of"], cell.steps)


@dataclass(frozen=True, eq=False)
class _Consequence(_Loop):
    """What remains after the loss of a failure group, at each sample of the same loop."""

    group: str

    def load(self, cell: Cell, path: Path) -> Replayed:
        scenario = scenario_once(self.documents)
        whole = consequence_sequence(scenario, ExactLoop.load(path).tau, self.group)
        last = cell.first + cell.steps
        sequence = replace(
            whole,
            name=cell.sequence,
            base=whole.problem(cell.first),
            meta=whole.meta | {"first": cell.first},
            **{name: getattr(whole, name)[cell.first : last] for name in ("q", "l", "u")},
        )
        return Replayed(sequence, scenario.sample_s, None)

    def size(self, stored: Mapping[str, NDArray[Any]]) -> tuple[int, int]:
        thrusters, rows = steered_rows(scenario_once(self.documents))
        return thrusters.n_f, AXES + len(rows.low)


class _Stored:
    """A sequence with its optima in a file of our own, whatever it was made from."""

    def load(self, cell: Cell, path: Path) -> Replayed:
        recorded = load_recorded(path)
        # Random QPs, and some that others recorded, follow each other by no known time.
        sample_s = float(recorded.sequence.meta.get("sample_s", float("nan")))
        return Replayed(recorded.sequence, sample_s, recorded.optima)

    def check(self, path: Path) -> None:
        load_recorded(path)

    def size(self, stored: Mapping[str, NDArray[Any]]) -> tuple[int, int]:
        return stored["q"].shape[1], stored["A"].shape[0]


@dataclass(frozen=True, eq=False)
class _Random(_Stored):
    """A random sequence; its optima are certified once, as some take a second each."""

    recipe: RandomRecipe

    def make(self, path: Path) -> None:
        sequence = random_sequence(self.recipe)
        save_sequence(path, sequence, certified(sequence))


@dataclass(frozen=True, eq=False)
class _AtEdge(_Stored):
    """The QPs at the edge of what thrusters hold; in the same file the plot they are around."""

    described: dict[str, Any]

    def make(self, path: Path) -> None:
        described = self.described
        make_at_edge(path, vessel_of(described), described["sides"], described["name"])


@dataclass(frozen=True, eq=False)
class _Recorded(_Stored):
    """What others recorded; their optima are not believed but certified again."""

    described: dict[str, Any]

    def make(self, path: Path) -> None:
        place = sequence_path(self.described["path"])
        actual, planned = digest(place), self.described["sha256"]
        if actual != planned:
            allowed = f"the file the cell was planned with, SHA-256 {planned[:12]}…"
            raise InputError(str(place), "", f"SHA-256 {actual[:12]}…", allowed)
        recorded = read_sequence(place)
        save_sequence(path, recorded.sequence, units=recorded.units, documents=recorded.documents)
