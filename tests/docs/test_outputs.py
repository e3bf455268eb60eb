"""Every command of the guides and the tutorials shows what it prints."""

import re
from pathlib import Path

import pytest

from tests.docs.markdown_blocks import DOCS, README

SHOWN = [
    README,
    DOCS / "index.md",
    *sorted((DOCS / "guide").glob("*.md")),
    *sorted((DOCS / "tutorials").glob("*.md")),
]
FOLLOWED_BY = re.compile(
    r"^```sh\n(?P<commands>.*?)\n```\n(?P<between>.*?)"
    r"(?:^```(?P<next>\w*)[^\n]*\n(?P<shown>.*?)^```$|\Z)",
    re.M | re.S,
)
LINKED = "the README has at most 120 lines; the guide of its task shows the output"
WITHOUT = {
    "README.md": {
        "dpbench doctor": LINKED,
        "dpbench run standard --solver daqp --solver osqp --scenario rough": LINKED,
        "dpbench report results/standard-part --statement statement.pdf": LINKED,
        "dpbench worst-case osqp --budget 100": LINKED,
        "dpbench run routes --solver osqp --out results/before": LINKED,
        "dpbench run routes --solver osqp --out results/after": LINKED,
        "dpbench compare results/before results/after --markdown compare.md"
        " --html compare.html": LINKED,
        "dpbench init my_ship --length 80 --breadth 18 --draught 6 --displacement 6000"
        " --thrust 300": LINKED,
        "dpbench check my_ship.toml": LINKED,
        "dpbench run my_ship_suite.toml --open": LINKED,
    },
    "containers.md": {"python -m dpbench.cli.compiling": "it prints nothing"},
}
"""Commands whose output their page does not show, by page, with the reason."""
PROMPT = "$ "
OF_MACHINE = re.compile(r"/(tmp|home|root|work|usr|var)/")


def _without_comment(line: str) -> str:
    return re.sub(r"\s+#.*$", "", line)


def _missing(block: re.Match[str]) -> list[str]:
    """The commands of a block whose output does not follow it."""
    lines = [_without_comment(line) for line in block["commands"].splitlines() if line.strip()]
    if block["next"] != "text" or re.search(r"^#", block["between"], re.M):
        return lines
    shown = block["shown"]
    assert shown.strip() and not OF_MACHINE.search(shown), lines
    if len(lines) == 1 and not shown.startswith(PROMPT):
        return []
    prompts = {line.removeprefix(PROMPT) for line in shown.splitlines() if line.startswith(PROMPT)}
    return [line for line in lines if line not in prompts]


def _blocks(page: Path) -> list[re.Match[str]]:
    text = page.read_text(encoding="utf-8")
    starts = [match.start() for match in re.finditer(r"^```sh$", text, re.M)]
    blocks = [block for start in starts if (block := FOLLOWED_BY.match(text, start))]
    assert len(blocks) == len(starts)
    return blocks


@pytest.mark.parametrize("page", SHOWN, ids=lambda page: str(page.stem))
def test_each_command_is_followed_by_its_output(page: Path) -> None:
    missing = {line for block in _blocks(page) for line in _missing(block)}
    assert missing == set(WITHOUT.get(page.name, {}))
