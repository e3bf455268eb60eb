"""The QPs that settings are searched or tested on: recorded sequences, and loops of scenarios."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dpbench.bench.sequences.recording import read_sequence
from dpbench.errors import SituationError, UnknownNameError
from dpbench.qp.program import CONSTANT, QPSequence
from dpbench.scenario.problem_files import (
    SEQUENCES,
    is_shipped_sequence_name,
    list_shipped_problem_names,
    resolve_sequence_path,
)
from dpbench.scenario.scenario import load_scenario

_HORIZONS = ("prediction_horizon", "control_horizon")


@dataclass(frozen=True)
class TunedProblem:
    """A source of QPs: its name in the results, its table of a suite, and what it consists of.

    loop : the scenario and ship that its QPs belong to, whatever the horizons, as JSON; "" if
        unknown. steps : the QPs of a recorded sequence. every : steps of the loop from one of its
        QPs to the next.
    """

    name: str
    table: dict[str, Any]
    loop: str = ""
    steps: frozenset[bytes] = field(default=frozenset(), repr=False)
    every: int = 1


def load_problem(name: str, steps: int = 0) -> TunedProblem:
    """Return the QPs of a sequence by name or file, or along the loop of a scenario.

    steps : of a scenario, only the first so many; 0 for all.

    Raises
    ------
    InputError : for a bad file. UnknownNameError : there is neither sequence nor scenario.
    """
    if is_shipped_sequence_name(name) or name.endswith(".npz") or Path(name).is_dir():
        path = resolve_sequence_path(name)
        recorded = read_sequence(path)
        origin = name if is_shipped_sequence_name(name) else str(path.resolve())
        sequence = recorded.sequence
        every = sequence.meta.get("every", 1)
        table: dict[str, Any] = {"kind": "recorded", "sequence": origin}
        return TunedProblem(
            sequence.name,
            table,
            _loop_key(recorded.documents),
            _hash_steps(sequence),
            every if isinstance(every, int) else 1,
        )
    try:
        scenario = load_scenario(name)
    except UnknownNameError as error:
        known = [*list_shipped_problem_names("scenarios"), *list_shipped_problem_names(SEQUENCES)]
        allowed = f"{error.allowed}; or one of {len(known)} of `list_sequences()`"
        raise UnknownNameError("tune-solver", "", error.found, allowed) from error
    origin = str(Path(name).resolve()) if name.endswith(".toml") else name
    table = {
        "kind": "replay",
        "scenario": origin,
        "steps": min(steps or scenario.steps, scenario.steps),
    }
    return TunedProblem(scenario.name, table, _loop_key(dict(scenario.files)))


def refuse_overlap(training: Sequence[TunedProblem], test: Sequence[TunedProblem]) -> None:
    """Raise InputError where QPs of the training are among those of the test.

    Sequences overlap that have a QP in common, or are of one closed loop, also at other horizons.
    """
    for mine in training:
        for other in test:
            same_loop = bool(mine.loop) and mine.loop == other.loop
            if mine.name == other.name or same_loop or mine.steps & other.steps:
                why = "QPs of the same loop" if same_loop else "the same QPs"
                raise SituationError(
                    "--test",
                    f"{other.name} has {why} as {mine.name} of the training; name sequences of "
                    "other scenarios",
                )


def _loop_key(documents: dict[str, Any]) -> str:
    """Return a text equal for loops of one scenario and ship at any horizons; "" without them."""
    scenario, vessel = documents.get("scenario"), documents.get("vessel")
    if not isinstance(scenario, dict) or not isinstance(vessel, dict):
        return ""
    controller = scenario.get("controller", {})
    own = {key: value for key, value in controller.items() if key not in _HORIZONS}
    unnamed = {k: v for k, v in scenario.items() if k not in ("title", "shows")}
    return json.dumps([unnamed | {"controller": own}, vessel], sort_keys=True)


def _hash_steps(sequence: QPSequence) -> frozenset[bytes]:
    """Return the SHA-256 of each QP: its matrices, and its vectors."""
    digests = set()
    for k in range(len(sequence)):
        qp = sequence.problem(k)
        digest = hashlib.sha256()
        for name in (*CONSTANT, "q", "l", "u"):
            digest.update(getattr(qp, name).tobytes())
        digests.add(digest.digest())
    return frozenset(digests)
