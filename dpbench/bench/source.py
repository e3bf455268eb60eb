"""Where the QPs of a replay come from: the exactly solved loop of a scenario, or a random recipe.

What takes long is done once per source, in a process of its own, and kept in a file that workers
and graders read: the loop, or the sequence with its certified optima.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from dpbench.bench.cell import Cell
from dpbench.bench.exact import ExactLoop, sequence_of, solve_exactly
from dpbench.errors import InputError
from dpbench.qp.certify import Optimum, Referee
from dpbench.qp.program import QPSequence, QuadraticProgram
from dpbench.qp.random_recipe import RandomRecipe
from dpbench.qp.random_sequence import random_sequence
from dpbench.scenario import scenario_of

RANDOM = "random"
"""The kind of a source that is a recipe."""


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


def source_of(cell: Cell) -> Source:
    """The source of a cell's QPs; InputError for a kind that is not known."""
    if not cell.source:
        return _Loop(cell.scenario)
    kind = cell.source.get("kind")
    if kind == RANDOM:
        return _Random(RandomRecipe.from_dict(cell.source["recipe"]))
    raise InputError("cell", "source.kind", repr(kind), repr(RANDOM))


def source_key(cell: Cell, harness_version: str) -> str:
    """Cells with the same key share one file."""
    text = json.dumps([cell.source or cell.scenario, harness_version], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def is_random(cell: Cell) -> bool:
    """Whether the cell replays a random sequence, whose times nobody compares."""
    return cell.source.get("kind") == RANDOM


def random_source(recipe: RandomRecipe) -> dict[str, Any]:
    """`Cell.source` of a recipe."""
    return {"kind": RANDOM, "name": recipe.name, "recipe": recipe.to_dict()}


@dataclass(frozen=True, eq=False)
class _Loop:
    """The QPs along the exactly solved loop of a scenario."""

    documents: dict[str, Any]

    def make(self, path: Path) -> None:
        solve_exactly(scenario_of(self.documents)).save(path)

    def load(self, cell: Cell, path: Path) -> Replayed:
        scenario, exact = scenario_of(self.documents), ExactLoop.load(path)
        sequence = sequence_of(
            scenario, exact, units=cell.units, first=cell.first, count=cell.steps
        )
        return Replayed(sequence, scenario.sample_s, None)


@dataclass(frozen=True, eq=False)
class _Random:
    """A random sequence; its optima are certified once, as some take a second each."""

    recipe: RandomRecipe

    def make(self, path: Path) -> None:
        sequence = random_sequence(self.recipe)
        save_certified(path, sequence, certified(sequence))

    def load(self, cell: Cell, path: Path) -> Replayed:
        sequence, optima = load_certified(path)
        # Its QPs follow each other by no known time.
        return Replayed(sequence, float("nan"), optima)


def certified(sequence: QPSequence) -> list[Optimum]:
    """The certified optimum of every step, for a sequence in scaled units."""
    base = sequence.base
    referee = Referee(base.P, base.A, base.lb, base.ub)
    steps = (sequence.step(k) for k in range(len(sequence)))
    return [referee.certify(step.q, step.l, step.u) for step in steps]


def save_certified(path: Path, sequence: QPSequence, optima: list[Optimum]) -> None:
    """Write a sequence and its optima to `path` (.npz), together so that they never part."""
    base = sequence.base
    np.savez(
        path,
        allow_pickle=False,
        name=np.array(sequence.name),
        block=np.array(base.block),
        **{name: getattr(base, name) for name in ("P", "A", "lb", "ub")},
        **{name: getattr(sequence, name) for name in ("q", "l", "u")},
        z=np.array([optimum.z for optimum in optima]),
        y=np.array([optimum.y for optimum in optima]),
        y_box=np.array([optimum.y_box for optimum in optima]),
        bound=np.array([optimum.bound for optimum in optima]),
        certificate=np.array([optimum.kind for optimum in optima]),
    )


def load_certified(path: Path) -> tuple[QPSequence, list[Optimum]]:
    """Read what `save_certified` wrote."""
    with np.load(path, allow_pickle=False) as data:
        found = {name: data[name] for name in data.files}
    q, l, u = found["q"], found["l"], found["u"]  # noqa: E741 - as in QuadraticProgram
    base = QuadraticProgram(
        found["P"], q[0], found["A"], l[0], u[0], found["lb"], found["ub"], int(found["block"])
    )
    columns = zip(
        found["z"],
        found["y"],
        found["y_box"],
        found["bound"].tolist(),
        found["certificate"].tolist(),
        strict=True,
    )
    return QPSequence(str(found["name"]), base, q, l, u), [Optimum(*row) for row in columns]
