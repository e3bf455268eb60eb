"""The QPs at a ship's capability boundary: made for a suite, or written as a file."""

from pathlib import Path
from typing import Any

from dpbench.bench.capability.edge_qps import (
    build_allocation_sequence,
    list_points_at_all_limits,
    make_capability_columns,
)
from dpbench.bench.capability.frontier import Capability, CapabilityPlot, compute_capability
from dpbench.bench.sequences.sequence_file import load_recorded, save_sequence
from dpbench.errors import InputError
from dpbench.ship.vessel import Vessel


def write_capability_boundary(path: Path, vessel: Vessel, sides: int, name: str) -> None:
    """Write a ship's capability plot and its certified QPs to one file."""
    frontier = CapabilityPlot(vessel, sides)
    capability = compute_capability(frontier)
    points = list_points_at_all_limits(frontier, capability)
    documents = {"capability": make_capability_columns(name, capability, points)}
    save_sequence(path, build_allocation_sequence(frontier, points), documents=documents)


def read_capability_plot(path: Path) -> dict[str, list[Any]] | None:
    """Return the capability plot stored in a file with its QPs; None where the file is gone."""
    try:
        documents = load_recorded(path).sequence.documents
    except InputError:
        return None
    table: dict[str, list[Any]] | None = documents.get("capability")
    return table


def write_capability_suite(frontier: CapabilityPlot, capability: Capability, folder: Path) -> Path:
    """Write a capability plot's certified QPs and a suite that replays them; return its path."""
    points = list_points_at_all_limits(frontier, capability)
    folder.mkdir(parents=True, exist_ok=True)
    save_sequence(folder / "capability.npz", build_allocation_sequence(frontier, points))
    suite = folder / "capability.toml"
    text = _SUITE.format(vessel=capability.vessel, sides=frontier.sides)
    suite.write_text(text, encoding="utf-8")
    return suite


_SUITE = """\
title = "Static allocations at the edge of the capability of {vessel}, {sides} sides"
baseline_law = false
rounds = 1
warmup_steps = 20
cell_limit_s = 20.0

[[recorded]]
sequence = "capability.npz"
settings = ["default"]
"""
"""Suite that replays the sequence. One round is enough: claims do not change, and a batch has no
deadline."""
