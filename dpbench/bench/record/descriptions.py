"""What `machine.json` and `suite.json` have to contain for readers: keys, and types of values.

Any key may be missing but the ones without a default, and further ones may be there: earlier
releases wrote fewer, later ones may write more.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from dpbench.errors import ResultsError

_Kind = TypeVar("_Kind")


class _Table(BaseModel):
    model_config = ConfigDict(strict=True, extra="allow", allow_inf_nan=False)


class MachineFile(_Table):
    """`machine.json`."""

    id: str
    cpu_model: str = ""
    cores: int = 0
    governor: str = ""
    throttle_counters: str = ""
    python: str = ""
    versions: dict[str, str] = {}
    affinity: list[int] | None = None
    blas: list[str] | None = None
    others: list[dict[str, Any]] = []


class _Demand(_Table):
    error_move: float = 0.0
    failed_steps: int = 0
    p99_ms: float = 0.0
    deadline_ms: float = 0.0


class _Report(_Table):
    baseline: str | None = None
    step: int | None = None
    configuration: str | None = None


class _Study(_Table):
    base: str
    name: str | None = None
    radius_m: float = 0.0


class _Revision(_Table):
    commit: str
    clean: bool


class SuiteFile(_Table):
    """`suite.json`."""

    name: str = ""
    title: str = ""
    harness_version: str = ""
    started_utc: str = ""
    run_rows: int
    step_rows: int
    lost_cells: int = 0
    lost_designs: int = 0
    remarks: list[str] = []
    revisions: list[_Revision] = []
    demand: _Demand = _Demand()
    report: _Report = _Report()
    study: list[_Study] = []


def validated(document: dict[str, Any], kind: type[_Kind], path: Path) -> _Kind:
    """The document of a file as a type; ResultsError, naming the key, where it has others."""
    try:
        # As JSON: a list is a tuple there, and a whole number a float.
        return TypeAdapter(kind).validate_json(json.dumps(document))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"])
        value = "nothing" if first["type"] == "missing" else repr(first["input"])[:80]
        allowed = f"what `dpbench run` writes ({first['msg']}); run again"
        raise ResultsError(str(path), key, value, allowed) from error
