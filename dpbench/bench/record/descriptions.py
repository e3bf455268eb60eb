"""Types of `machine.json` and `suite.json`.

All keys but the required ones may be missing, and unknown ones may be present: releases differ.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any, Required, TypeVar

from pydantic import ConfigDict, TypeAdapter, ValidationError, with_config
from typing_extensions import TypedDict

from dpbench.errors import ResultsError

_Kind = TypeVar("_Kind")
_OPEN = ConfigDict(strict=True, extra="allow", allow_inf_nan=False)


class ComparedMachine(TypedDict, total=False):
    """Properties that make times of two machines comparable."""

    cpu_model: str
    cores: int
    memory_GiB: int
    kernel: str
    python: str
    versions: dict[str, str]


@with_config(_OPEN)
class MachineDescription(ComparedMachine, total=False):
    """`machine.json`; `others` are machines whose cells were gathered too."""

    id: Required[str]
    governor: str
    frequency_MHz: float | str
    blas: list[str] | None
    throttle_counters: str
    affinity: list[int] | None
    clock_read_ns: float
    timer_resolution_ns: float
    load_average: list[float]
    others: list[MachineDescription]


class _Demand(TypedDict, total=False):
    error_move: float
    failed_steps: int
    p99_ms: float
    deadline_ms: float


class _Report(TypedDict, total=False):
    baseline: str | None
    step: int | None
    configuration: str | None


class StudyDescription(TypedDict, total=False):
    """A `[[study]]` of `suite.json`."""

    base: Required[str]
    name: str | None
    radius_m: float


class RevisionDescription(TypedDict):
    """A revision of dpbench."""

    commit: str
    clean: bool


@with_config(_OPEN)
class SuiteDescription(TypedDict, total=False):
    """`suite.json`."""

    name: str
    title: str
    harness_version: str
    started_utc: str
    run_rows: Required[int]
    step_rows: Required[int]
    lost_cells: int
    lost_designs: int
    remarks: list[str]
    revisions: list[RevisionDescription]
    demand: _Demand
    report: _Report
    study: list[StudyDescription]


def validated(document: dict[str, Any], kind: type[_Kind], path: Path) -> _Kind:
    """Return the document of a file as a type; ResultsError, naming the key, for other types."""
    try:
        # As JSON: a list is a tuple there, and a whole number a float.
        return _adapter(kind).validate_json(json.dumps(document))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"])
        value = "nothing" if first["type"] == "missing" else repr(first["input"])[:80]
        allowed = f"what `dpbench run` writes ({first['msg']}); run again"
        raise ResultsError(str(path), key, value, allowed) from error


@cache
def _adapter(kind: type[_Kind]) -> TypeAdapter[_Kind]:
    return TypeAdapter(kind)
