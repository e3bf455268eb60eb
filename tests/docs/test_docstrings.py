"""Docstrings: every function of the package has one, and none opens with a bare clause."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
CLAUSES = "What|Whether|Where|How|Of|Who|Whom|Which|That|When|Why"
PREPOSITIONS = "At|By|For|From|If|In|On|With|Without"
BARE = re.compile(
    r"^( *)def (?!__)\w+\((?:.*|\n(?:\1 .*\n)+\1\).*):(?: +#.*)?\n(?:\1 +#.*\n)*(?!\1 +r?\"\"\")",
    re.M,
)
"""Function without a docstring, a nested one too; far faster than parsing all files."""


def _sources(*folders: str) -> Iterator[tuple[Path, str]]:
    for folder in folders:
        for path in sorted((ROOT / folder).rglob("*.py")):
            yield path.relative_to(ROOT), path.read_text(encoding="utf-8")


def find_openings(source: str, words: str) -> list[str]:
    """Docstrings and comments `#:` that open with one of some words, with their lines."""
    opening = re.compile(rf'^ *(?:r?"""|#: )((?:{words})\b.*)')
    numbered = enumerate(source.splitlines(), 1)
    return [f"{n}: {match[1][:60]}" for n, line in numbered if (match := opening.match(line))]


def find_undocumented(node: ast.AST) -> Iterator[str]:
    """Names of functions and methods without a docstring, but for special and overloaded ones."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.ClassDef):
            yield from find_undocumented(child)
        elif isinstance(child, ast.FunctionDef) and not child.name.startswith("__"):
            overloaded = any(ast.unparse(one) == "overload" for one in child.decorator_list)
            if not overloaded and ast.get_docstring(child) is None:
                yield child.name


def test_no_docstring_opens_with_a_bare_clause() -> None:
    of_product = f"{CLAUSES}|{PREPOSITIONS}"
    checked = [(of_product, *one) for one in _sources("dpbench", "docs", "benchmarks")]
    checked += [(CLAUSES, *one) for one in _sources("tests")]
    found = [
        f"{path}:{text}" for words, path, source in checked for text in find_openings(source, words)
    ]
    assert found == []


def test_every_function_of_the_package_has_a_docstring() -> None:
    found = [
        f"{path}: {name}"
        for path, source in _sources("dpbench")
        if BARE.search(source)
        for name in find_undocumented(ast.parse(source))
    ]
    assert found == []


def test_a_missing_docstring_and_a_bare_clause_are_found() -> None:
    lines = [
        "A = 1",
        '"""Of zlib."""',
        "#: Who calls.",
        "def f():",
        '    """Whoever."""',
        "def g(): # h",
    ]
    source = "\n".join([*lines, "    pass", ""])
    assert find_openings(source, CLAUSES) == ['2: Of zlib."""', "3: Who calls."]
    assert BARE.search(source) and list(find_undocumented(ast.parse(source))) == ["g"]
