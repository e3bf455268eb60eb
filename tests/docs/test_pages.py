"""Names in the documentation exist, and what the code has is in the documentation."""

import ast
import fnmatch
import re
import shlex
from collections import defaultdict
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import pytest

import dpbench
from dpbench.bench.record import schema
from dpbench.cli.arguments import make_parser
from dpbench.solvers.table import TABLE
from sitegen import columns, command_line, library, notebook, python_names, solvers, toml_keys
from tests.docs.markdown_blocks import DOCS, PAGES, blocks_of

ROOT = DOCS.parent
TEXT = {page.relative_to(DOCS).as_posix(): page.read_text(encoding="utf-8") for page in PAGES}
PLACES = [
    (page, file, name)
    for page, text in TEXT.items()
    for file, name in re.findall(r"\| `((?:dpbench|tests)/[\w/]+\.py)` \| `(\w+)` \|", text)
]
MAKERS = (toml_keys, library, columns, command_line, notebook, python_names, solvers)


@cache
def _defined(file: str) -> set[str]:
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    kinds = (ast.FunctionDef, ast.ClassDef)
    return {node.name for node in ast.walk(tree) if isinstance(node, kinds)}


@cache
def _commands() -> tuple[Mapping[str, object], Callable[[list[str]], object]]:
    """The commands, and what reads a command line."""
    return command_line.commands(), make_parser(defaultdict(lambda: lambda arguments: 0)).parse_args


@pytest.mark.parametrize(("page", "file", "name"), PLACES)
def test_a_function_that_a_page_names_is_where_it_says(page: str, file: str, name: str) -> None:
    assert name in _defined(file), page


@pytest.mark.parametrize("page", TEXT)
def test_every_place_that_a_page_names_exists(page: str) -> None:
    named = re.findall(r"`((?:dpbench|tests|benchmarks|problems|docs)/[\w./-]*)`", TEXT[page])
    assert [name for name in named if not (ROOT / name).exists()] == []


@pytest.mark.parametrize("page", TEXT)
def test_every_link_works_in_the_repository(page: str) -> None:
    links = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", TEXT[page])
    paths = [link for link in links if "://" not in link]
    assert [link for link in paths if not ((DOCS / page).parent / link).exists()] == []


def test_every_equation_has_its_code() -> None:
    """The paper's equations 1 to 36."""
    rows = re.findall(r"^\| ([\d, -]+) \|.*\| `(?:dpbench|tests)/", TEXT["paper.md"], re.M)
    numbered: set[int] = set()
    for part in ", ".join(rows).split(", "):
        first, _, last = part.partition("-")
        numbered |= set(range(int(first), int(last or first) + 1))
    assert numbered == set(range(1, 37))


def test_every_figure_of_a_run_has_its_formula() -> None:
    named = set(re.findall(r"`([\w*]+)`", TEXT["method.md"]))
    figures = set(schema.RUN_COLUMNS) - set(schema.IDENTITY_COLUMNS)
    missing = [name for name in figures if not any(fnmatch.fnmatch(name, n) for n in named)]
    assert missing == []


def test_the_columns_that_the_guide_of_python_lists_are_those_of_a_run() -> None:
    _, table = TEXT["guide/python.md"].split("| column of `run.summary` | meaning |\n|---|---|\n")
    rows = table.split("\n\n")[0].splitlines()
    named = [name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])]
    assert len(named) > len(rows) and set(named) <= set(schema.RUN_COLUMNS)


@pytest.mark.parametrize("page", TEXT)
def test_every_command_that_a_page_prints_is_one(page: str) -> None:
    commands = [
        line
        for block in blocks_of(ROOT / "docs" / page)
        if block.language == "sh"
        for line in (*block.commands, *block.tested)
        if line.startswith("dpbench")
    ]
    commands += re.findall(r"`(dpbench [a-z][^`]*)`", TEXT[page])
    known, read = _commands()
    for command in commands:
        name, *words = shlex.split(command)[1:]
        assert name in known, command
        if words:
            read([name, *words])


@pytest.mark.parametrize("kind", toml_keys.FILES)
def test_every_key_has_a_meaning(kind: str) -> None:
    for section in toml_keys.sections(toml_keys.FILES[kind]):
        texts = toml_keys.meanings(section.model)
        assert set(texts) == set(section.model.model_fields), section.header
        assert all(text.endswith(".") for text in texts.values()), section.header


def test_the_stored_pages_of_keys_are_those_of_the_models() -> None:
    """`make keys` writes them. Guides lead there, not to Python files."""
    for name, text in toml_keys.pages().items():
        assert TEXT[name] == text, f"{name}: run `make keys`"
    files = r"\]\([./]*dpbench/(?:scenario/tables/(?:vessel|scenario)_file|bench/plan/suite)\.py\)"
    assert [page for page, text in TEXT.items() if re.search(files, text)] == []


def test_keys_have_type_bounds_and_default() -> None:
    pages = toml_keys.pages()
    vessel, scenario, suite = (pages[f"reference/{kind}.md"] for kind in toml_keys.FILES)
    assert "| `length_m` | number | ≥ 0.001, ≤ 1e+06 | **required** | Length" in vessel
    assert "| `inertia` | 3 × 3 × number |" in vessel
    assert '| `gusts` | text | `norsok`, `harris`, `none` | `"norsok"` |' in scenario
    assert "## `[[environment.squalls]]`" in scenario
    assert "## `[controller.outputs]`" in scenario
    assert "| `sizes` | list of 2 × whole number | ≥ 0, at least 1 | **required** |" in suite


def test_every_column_name_and_solver_has_its_entry() -> None:
    made = columns.pages()["reference/columns.md"]
    assert all(f"| `{name}` |" in made for name in (*schema.RUN_COLUMNS, *schema.STEP_COLUMNS))
    python = python_names.pages()["reference/python.md"]
    assert all(f"## `{name}`\n" in python for name in dpbench.__all__)
    assert set(solvers.pages()) == {f"solvers/{name}.md" for name in (*TABLE, "index")}
    assert set(solvers.PITFALLS) <= set(TABLE)


@pytest.mark.parametrize("maker", MAKERS, ids=lambda maker: str(maker.__name__))
def test_generated_tables_have_as_many_cells_in_each_row(maker: Any) -> None:
    for name, text in maker.pages().items():
        for run in re.findall(r"(?:^\|.*\n)+", text, re.M):
            widths = {line.count(" | ") for line in run.splitlines() if not line.startswith("| --")}
            assert len(widths) == 1, (name, run[:200])


def test_a_page_of_a_solver_says_what_its_record_says() -> None:
    page = solvers.pages()["solvers/clarabel.md"]
    assert "| licence | Apache-2.0 |" in page
    assert "no: Clarabel has no interface for a starting point |" in page
    assert "`tol_feas=1e-09`" in page
    assert "a kept workspace also keeps | the equilibration" in page
    assert "- Its presolve drops rows" in page
    assert "a nan in u" in solvers.pages()["solvers/piqp.md"]


def test_the_navigation_leads_to_every_page() -> None:
    listed = set(re.findall(r"([\w/-]+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.M))
    generated = {name for maker in MAKERS for name in maker.pages()}
    assert listed - generated - {"contributing.md"} == set(TEXT) - generated
    assert {name for name in generated if name.startswith("reference/")} <= listed


def test_a_docstring_becomes_prose_lists_and_formulas() -> None:
    from sitegen.markup import docstring

    def documented() -> None:
        """A* of [x] with `a|b`.

            J = ½ xᵀ P x

        Parameters
        ----------
        x : (n,) start; y : (m,) rows
            of it.

        Examples
        --------
        A sum*.

        >>> [1 + 1]
        [2]
        """

    text = docstring(documented)
    assert text.startswith(r"A\* of \[x\] with a&#124;b.")
    assert "```text\nJ = ½ xᵀ P x\n```" in text
    assert "*Parameters*\n\n- `x`: (n,) start; `y`: (m,) rows of it." in text
    assert text.endswith("*Examples*\n\nA sum\\*.\n\n```pycon\n>>> [1 + 1]\n[2]\n```")
