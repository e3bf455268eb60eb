"""Every command of the guides and the tutorials shows what it prints."""

import re
from pathlib import Path

import pytest

from tests.docs.markdown_blocks import DOCS

SHOWN = [*sorted((DOCS / "guide").glob("*.md")), *sorted((DOCS / "tutorials").glob("*.md"))]
FOLLOWED_BY = re.compile(
    r"^```sh\n(?P<commands>.*?)\n```\n(?P<between>.*?)"
    r"(?:^```(?P<next>\w*)[^\n]*\n(?P<shown>.*?)^```$|\Z)",
    re.M | re.S,
)
CAMPAIGN = "a campaign of some minutes"
OF_CAMPAIGN = "its input is the result of a command that takes minutes"
WITHOUT = {
    "dpbench run standard": CAMPAIGN,
    "dpbench run routes": CAMPAIGN,
    "dpbench run seas": CAMPAIGN,
    "dpbench run thrusters": CAMPAIGN,
    "dpbench cells seas": CAMPAIGN,
    "dpbench paper": CAMPAIGN,
    "dpbench worst-case admm": "300 cases by a plug-in in plain Python take some minutes",
    "dpbench run --sequence worst-cases/admm": OF_CAMPAIGN,
    "dpbench gather": OF_CAMPAIGN,
    "dpbench compare results/before": OF_CAMPAIGN,
    "dpbench report results/standard --": OF_CAMPAIGN,
    "dpbench report results/seas --": OF_CAMPAIGN,
    "dpbench report results/mine --send": OF_CAMPAIGN,
    "dpbench check results/community": OF_CAMPAIGN,
}
"""Beginnings of commands whose output no page shows, with the reason."""
OF_MACHINE = re.compile(r"/(tmp|home|root|work|usr|var)/")


def _uncovered(commands: str) -> list[str]:
    """The commands of a block that are not exempt."""
    lines = [line for line in commands.splitlines() if line.startswith("dpbench")]
    return [line for line in lines if not any(line.startswith(start) for start in WITHOUT)]


@pytest.mark.parametrize("page", SHOWN, ids=lambda page: str(page.stem))
def test_each_command_is_followed_by_its_output(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    starts = [match.start() for match in re.finditer(r"^```sh$", text, re.M)]
    blocks = [block for start in starts if (block := FOLLOWED_BY.match(text, start))]
    assert len(blocks) == len(starts)
    for block in blocks:
        if not (uncovered := _uncovered(block["commands"])):
            continue
        assert block["next"] == "text", uncovered
        assert re.search(r"^#", block["between"], re.M) is None, uncovered
        assert block["shown"].strip() and not OF_MACHINE.search(block["shown"]), uncovered


def test_each_exemption_is_of_a_command_that_a_page_has() -> None:
    text = "\n".join(page.read_text(encoding="utf-8") for page in SHOWN)
    lines = text.splitlines()
    assert [start for start in WITHOUT if not any(line.startswith(start) for line in lines)] == []
