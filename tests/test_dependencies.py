"""Packaging: lowest versions that are tried, pins that are allowed, complete distributions."""

import json
import os
import platform
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from itertools import chain
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from dpbench.solvers.own.compiling import links_to_oldest_glibc

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


def test_the_citation_file_has_the_version() -> None:
    assert f"version: {PROJECT['version']}" in _lines("CITATION.cff")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel of this checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*build, "--wheel-dir", str(folder), str(ROOT)], check=True)
    (built,) = folder.glob("dpbench-*.whl")
    return built


@pytest.mark.slow
@pytest.mark.skipif(not links_to_oldest_glibc(), reason="the wheel is of this platform alone")
def test_the_compiled_library_needs_no_newer_glibc_than_the_tag_says(wheel: Path) -> None:
    """The versions of symbols in the ELF file, which the loader compares (PEP 600)."""
    tag = re.fullmatch(r"dpbench-([\d.]+)-py3-none-manylinux_(\d+)_(\d+)_(\w+)\.whl", wheel.name)
    assert tag is not None and tag[1] == PROJECT["version"] and tag[4] == platform.machine()
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [one for one in archive.namelist() if Path(one).name.startswith("_own_")]
        library = archive.read(name)
    needed = {tuple(map(int, found)) for found in re.findall(rb"GLIBC_(\d+)\.(\d+)", library)}
    assert needed and max(needed) <= (int(tag[2]), int(tag[3]))
    assert set(re.findall(rb"lib\w+\.so\.\d+", library)) <= {b"libm.so.6", b"libc.so.6"}


@pytest.mark.slow
def test_the_description_links_to_no_file_of_the_repository(wheel: Path) -> None:
    """A package index shows it alone; the text of each link stays."""
    with zipfile.ZipFile(wheel) as archive:
        name = f"dpbench-{PROJECT['version']}.dist-info/METADATA"
        metadata = archive.read(name).decode("utf-8")
    link = re.compile(r"\[([^\[\]]*)\]\((?!https?://)[^)]*\)")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    texts = [text for text in link.findall(readme) if f"![{text}]" not in readme]
    assert texts and all(text in metadata for text in texts)
    assert link.search(metadata) is None and "![" not in metadata


@pytest.mark.slow
@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="compares with what git tracks")
def test_the_source_distribution_has_every_tracked_file_and_no_other(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "--target", "sdist"]
    subprocess.run(
        [*build, "--directory", str(tmp_path)], cwd=ROOT, check=True, capture_output=True
    )
    (archive,) = tmp_path.glob("dpbench-*.tar.gz")
    with tarfile.open(archive) as source:
        packed = {name.partition("/")[2] for name in source.getnames()}
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    assert packed == {*listed.stdout.splitlines(), "PKG-INFO", "dpbench/built_commit.json"}


@pytest.mark.slow
@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="compares with the commit of a checkout")
def test_a_wheel_has_the_commit_it_was_built_from(wheel: Path) -> None:
    head = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    built = json.loads(zipfile.ZipFile(wheel).read("dpbench/built_commit.json"))
    assert built["commit"] == head.stdout.strip()


@pytest.mark.slow
def test_names_resolve_from_a_wheel_in_an_empty_folder(wheel: Path, tmp_path: Path) -> None:
    """The wheel carries problems, the C library and all parts of the page, and works."""
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
