"""QP sources: the origin of the QPs of a cell, and the properties of each kind.

A source is part of its cell's description. `sequences/source.py` makes and reads its QPs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cache
from typing import Any, ClassVar

from pydantic import TypeAdapter

from dpbench.errors import InputError
from dpbench.qp.random_recipe import RandomRecipe


@dataclass(frozen=True)
class QPSource:
    """A source of QPs; `name` is that of the replayed sequence.

    Attributes
    ----------
    kind : its name in descriptions of cells.
    is_timed : whether its QPs follow each other in time, so that times of replays are compared.
    is_judged : whether replays of it are part of verdicts.
    is_of_controller : whether its QPs are those of the scenario's controller.
    """

    kind: ClassVar[str] = ""
    is_timed: ClassVar[bool] = True
    is_judged: ClassVar[bool] = True
    is_of_controller: ClassVar[bool] = False

    name: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return the description as plain values for JSON; none without a source."""
        return {"kind": self.kind, **asdict(self)} if self.kind else {}

    def stretch(self, steps: int) -> int:
        """Return the steps of its loop or sequence from which so many are chosen."""
        return steps


class ControllerSource(QPSource):
    """The controller of the cell's scenario, along the reference loop."""

    is_of_controller = True


@dataclass(frozen=True)
class HardestSource(QPSource):
    """The hardest consecutive steps of a stretch of `of` steps of the reference loop."""

    kind = "hardest"
    is_of_controller = True

    of: int = 0

    def stretch(self, steps: int) -> int:
        """Return the length of the stretch."""
        return self.of


@dataclass(frozen=True)
class ConsequenceSource(QPSource):
    """The loss of the failure group `group` along the reference loop."""

    kind = "consequence"
    is_judged = False

    group: str = ""


@dataclass(frozen=True)
class CapabilitySource(QPSource):
    """The capability boundary of a ship (`vessel_files`), by polygons of some sides."""

    kind = "capability"
    is_timed = is_judged = False

    sides: int = 0
    vessel_name: str = ""
    vessel: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class RandomSource(QPSource):
    """A random sequence."""

    kind = "random"
    is_timed = is_judged = False

    recipe: RandomRecipe

    @classmethod
    def of(cls, recipe: RandomRecipe) -> RandomSource:
        """Return the source of a recipe, named after it."""
        return cls(name=recipe.name, recipe=recipe)


@dataclass(frozen=True)
class RecordedSource(QPSource):
    """A recorded file or folder, by its SHA-256."""

    kind = "recorded"

    path: str = ""
    sha256: str = ""


CONTROLLER = ControllerSource()
_KINDS = (RandomSource, RecordedSource, HardestSource, ConsequenceSource, CapabilitySource)
SOURCES: Mapping[str, type[QPSource]] = {source.kind: source for source in _KINDS}


def source_from(values: Mapping[str, Any]) -> QPSource:
    """Return the source of a description.

    Raises
    ------
    InputError : for an unknown kind.
    ValidationError : for invalid values.
    """
    if not values:
        return CONTROLLER
    kind = str(values.get("kind"))
    if kind not in SOURCES:
        raise InputError("cell", "source.kind", repr(kind), ", ".join(map(repr, SOURCES)))
    return _adapter(kind).validate_python(values)


@cache
def _adapter(kind: str) -> TypeAdapter[QPSource]:
    return TypeAdapter(SOURCES[kind])
