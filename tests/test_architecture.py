"""Documents for maintainers, the README and worked examples agree with the code."""

import ast
import doctest
import inspect
import re
import tomllib
from collections.abc import Iterator
from functools import cached_property
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

import dpbench

ROOT = Path(__file__).parents[1]
ARCHITECTURE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
HOP = re.compile(r"\| `(dpbench/[\w/]+\.py)` \| `(\w+)` \|")
WALK = HOP.findall(ARCHITECTURE.split("## Data flow")[1].split("\n## ")[0])
# The blocks of layers, one below the other: the names of a line before its text.
LAYERS = [
    [set(re.findall(r"\w+", line.split("  ")[0])) for line in re.findall(r"^\w.*", block, re.M)]
    for block in re.findall(r"^```\n(.*?)^```", ARCHITECTURE, re.M | re.S)
]


def _functions(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {
        node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.ClassDef)
    }


@pytest.mark.parametrize(("file", "function"), HOP.findall(ARCHITECTURE))
def test_every_function_named_is_there(file: str, function: str) -> None:
    """A hop of the walk, and the origin of a quantity, name a file and a function or class."""
    assert function in _functions(ROOT / file)


def test_the_walk_goes_from_the_ship_to_the_page() -> None:
    """It begins in the loop and ends in the report, and no layer is left out."""
    packages = [file.split("/")[1] for file, _ in WALK]
    assert (packages[0], packages[-1]) == ("bench", "report")
    assert set(packages) == {"bench", "mpc", "solvers", "qp", "analysis", "report"}


def test_the_layers_are_those_that_lint_checks() -> None:
    """The page shows the layers of package, analysis, bench and solvers with the same packages in
    the same order."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    checked = [
        [set(re.findall(r"\w+", layer)) for layer in contract["layers"]]
        for contract in contracts["tool"]["importlinter"]["contracts"]
        if contract["type"] == "layers"
    ]
    assert len(LAYERS) == 4
    assert checked == LAYERS


@pytest.mark.parametrize("document", ["CONTRIBUTING.md", "docs/architecture.md", "README.md"])
def test_every_place_a_document_names_exists(document: str) -> None:
    """Files and folders of this repository in backticks or links are there."""
    text = (ROOT / document).read_text(encoding="utf-8")
    named = re.findall(r"[`(]((?:dpbench|tests|benchmarks|problems|docs)/[\w./-]*)[`)]", text)
    assert named
    for name in named:
        assert (ROOT / name).exists() or (ROOT / "docs" / name).exists(), name


@pytest.mark.parametrize("script", ["Makefile", ".ci/run"])
def test_every_test_a_script_names_exists(script: str) -> None:
    """Every test that `make` and CI run exists, in whatever form it is given to pytest."""
    named = re.findall(r"(?:tests|benchmarks)/[\w./]+", (ROOT / script).read_text(encoding="utf-8"))
    assert named
    for name in named:
        assert (ROOT / name).exists(), name


README = ROOT / "README.md"


def test_the_readme_is_short() -> None:
    """At most 150 lines: what is longer stands in the documentation."""
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 120


def test_every_file_the_readme_links_to_exists() -> None:
    """No link of the README leads nowhere."""
    targets = re.findall(r"\]\((?!https?:)([^)#]+)\)", README.read_text(encoding="utf-8"))
    assert targets
    missing = [target for target in targets if not (README.parent / target).exists()]
    assert not missing


PACKAGE = ROOT / "dpbench"
EXPLAINED = sorted(
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
    for path in PACKAGE.rglob("*.py")
    if re.search(r"^ *>>> ", path.read_text(encoding="utf-8"), re.MULTILINE)
)
HARD = {
    "dpbench.qp.referee.kernels",
    "dpbench.qp.referee.guesses",
    "dpbench.qp.referee.rational",
    "dpbench.qp.referee.referee",
    "dpbench.ship.estimation.kalman",
}


@pytest.fixture(scope="module")
def examples_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A working folder with the results that examples read."""
    folder = tmp_path_factory.mktemp("examples")
    dpbench.run_campaign("smoke", folder / "results" / "smoke", steps=5)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPLAINED)
def test_the_examples_of_a_module_are_true(
    name: str, examples_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every line of an example gives what stands below it."""
    monkeypatch.chdir(examples_folder)
    module = import_module(name)
    outcome = doctest.testmod(module)
    # `testmod` does not find the examples of cached properties.
    runner = doctest.DocTestRunner()
    for label, cached in _list_cached_properties(module):
        for test in doctest.DocTestFinder(recurse=False).find(cached.func, label, module):
            runner.run(test)
    assert outcome.attempted > 0
    assert outcome.failed == runner.failures == 0


def _list_cached_properties(module: ModuleType) -> list[tuple[str, cached_property[object]]]:
    """Return the cached properties of the classes that a module defines, with their names."""
    own = [
        one for one in vars(module).values() if getattr(one, "__module__", "") == module.__name__
    ]
    return [
        (f"{cls.__qualname__}.{name}", member)
        for cls in own
        if isinstance(cls, type)
        for name, member in vars(cls).items()
        if isinstance(member, cached_property)
    ]


def _list_public_members(cls: type) -> Iterator[tuple[str, str]]:
    """Yield name and docstring of each public method and property that dpbench defines."""
    # `dir` of an enumeration leaves out its properties.
    for name in sorted({name for base in cls.__mro__ for name in vars(base)}):
        member = inspect.getattr_static(cls, name)
        if name.startswith("_"):
            continue
        if isinstance(member, property | cached_property):
            function: object = getattr(member, "fget", None) or getattr(member, "func", None)
        else:
            function = getattr(member, "__func__", member)
        if inspect.isfunction(function) and function.__module__.startswith("dpbench."):
            yield name, inspect.getdoc(function) or ""


@pytest.mark.parametrize("name", dpbench.__all__)
def test_every_public_name_has_an_example(name: str) -> None:
    """The reference shows how it is used; so does each public method and property of a class."""
    thing = getattr(dpbench, name)
    texts = {name: inspect.getdoc(thing) or ""}
    if inspect.isclass(thing):
        texts |= {f"{name}.{label}": text for label, text in _list_public_members(thing)}
    assert [label for label, text in texts.items() if "\n>>> " not in text] == []
    use = re.compile(r"^(>>>|\.\.\.) .*\bnp\.", re.M)
    own = [text for text in texts.values() if use.search(text)]
    assert [text for text in own if "\n>>> import numpy as np\n" not in text] == []


def test_the_hard_kernels_have_an_example() -> None:
    """None of them has lost its own."""
    assert set(EXPLAINED) >= HARD
