"""Packaging: lowest versions that are tried, pins that are allowed, a wheel that is complete."""

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from itertools import chain
from pathlib import Path

import pytest
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
        EXTRAS[extra]
        for extra in ("solvers", "cluster", "matplotlib", "peers", "dev", "mutants", "docs")
    )
    for text in chain(PROJECT["dependencies"], *installed):
        requirement = Requirement(text)
        assert requirement.specifier.contains(versions[requirement.name.lower()]), text


@pytest.mark.slow
def test_names_resolve_from_a_wheel_in_an_empty_folder(tmp_path: Path) -> None:
    """The wheel carries problems, the C library and all parts of the page, and works."""
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*build, "--wheel-dir", str(tmp_path), str(ROOT)], check=True)
    (wheel,) = tmp_path.glob("dpbench-*.whl")
    site, empty = tmp_path / "site", tmp_path / "empty"
    empty.mkdir()
    zipfile.ZipFile(wheel).extractall(site)
    script = (
        "import dpbench, dpbench.report.write as w; from dpbench.cli.main import main;"
        "print(dpbench.__file__, dpbench.load_scenario('rough').steps,"
        " dpbench.load_sequence('rough-60-10').base.n);"
        "raise SystemExit(main(['list', 'scenarios']))"
    )
    environment = {**os.environ, "PYTHONPATH": str(site)}
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=empty,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert str(site) in done.stdout.splitlines()[0]
    assert done.stdout.splitlines()[0].endswith(" 2000 30")
    assert "paper_tight" in done.stdout
    assert [*(site / "dpbench" / "solvers" / "own").glob("_own_*")]
    page = site / "dpbench" / "report" / "page"
    templates = ("templates/page.html.j2", "templates/compare.html.j2", "templates/page.css")
    for part in (*templates, "scripts/page.js", "vendor/vega.min.js"):
        assert (page / part).stat().st_size > 0
    assert (page.parent / "glossary.toml").is_file()
