"""What is declared of other packages: lowest versions that are tried, pins that are allowed."""

from __future__ import annotations

import re
import tomllib
from itertools import chain
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]


def _lines(name: str) -> list[str]:
    return (ROOT / name).read_text(encoding="utf-8").splitlines()


def test_the_lowest_versions_tried_are_those_declared() -> None:
    """`make test-lowest` installs each direct dependency at its lower bound and nothing else."""
    declared = [Requirement(text) for text in (*PROJECT["dependencies"], *EXTRAS["solvers"])]
    lowest = [
        f"{requirement.name}=={bound.version}"
        for requirement in declared
        for bound in requirement.specifier
        if bound.operator == ">="
    ]
    assert len(lowest) == len(declared), "a dependency without a lower bound"
    assert _lines("constraints-lowest.txt") == sorted(lowest)


def test_every_pin_is_a_version_that_is_declared() -> None:
    """The pins of `make setup` are plain versions, and lie within the bounds."""
    pins = dict(line.split("==") for line in _lines("constraints.txt"))
    assert all(re.fullmatch(r"[\w.-]+", part) for pin in pins.items() for part in pin)
    versions = {name.lower().replace("_", "-"): version for name, version in pins.items()}
    installed = (
        EXTRAS[extra] for extra in ("solvers", "cluster", "peers", "dev", "mutants", "docs")
    )
    for text in chain(PROJECT["dependencies"], *installed):
        requirement = Requirement(text)
        assert requirement.specifier.contains(versions[requirement.name.lower()]), text
