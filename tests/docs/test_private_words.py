"""Texts for users have standard terms, and headings are nouns or tasks."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from sitegen import columns, command_line, library, python_names, solvers, toml_keys
from tests.docs.markdown_blocks import DOCS, PAGES

ROOT = DOCS.parent
REPORT = ROOT / "dpbench" / "report"
PRIVATE = re.compile(
    r"(?<![\w.-])(?:"
    "aboard|anew|asks|asked|beside|chips?|dearer|knows|ladders?|lies|lying|load kernel|nobody|"
    "rate-limit steps?|says?|said|saying|slow-downs?|stands?|stood|steered|tells?|telling|tiles?|"
    "told|exactly solved|house's own|left open|leaves open|of one's own|many seas|of seas|"
    "seas for|put together|take away|taken away|take home|ways in|write over"
    r")(?![\w-])",
    re.IGNORECASE,
)
"""Private words of this project and words of speech, of which programs and files have none."""
RIDDLE = re.compile(
    "(?:Who|Whose|What|Which|Where|Whether|How|Why|Is|Are|Does|Do|Can|Could|Would|Has|Of)\\b"
)


def _drop(pattern: str, text: str, flags: re.RegexFlag = re.NOFLAG) -> str:
    """Remove what matches, but for its ends of lines."""
    return re.sub(pattern, lambda found: "\n" * found[0].count("\n"), text, flags=flags)


def _read_markdown(text: str) -> str:
    """Return the prose of Markdown: without blocks, code, links' targets and comments."""
    for pattern in ("```.*?^ *```", "<!--.*?-->"):
        text = _drop(pattern, text, re.S | re.M)
    return _drop(r"`[^`]*`|\]\([^)]*\)", text)


def _read_template(text: str) -> str:
    """Return the text of an HTML template: without tags, but with what Jinja prints."""
    for pattern in ("{%.*?%}", "{#.*?#}", "<style.*?</style>", "<script.*?</script>", "<[^>]*>"):
        text = _drop(pattern, text, re.S)
    return re.sub(
        r"\{\{(.*?)\}\}", lambda found: " ".join(re.findall(r'terms\("([^"]*)"', found[1])), text
    )


def _yield_texts() -> Iterator[tuple[str, str]]:
    """Yield name and prose of every text that users read."""
    for path in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *PAGES]:
        yield path.relative_to(ROOT).as_posix(), _read_markdown(path.read_text(encoding="utf-8"))
    for maker in (toml_keys, library, columns, command_line, python_names, solvers):
        for name, text in maker.pages().items():
            yield name, _read_markdown(text)
    for path in sorted(REPORT.rglob("*.toml")):
        text = re.sub(r"^[\w\"]+ = ", "", path.read_text(encoding="utf-8"), flags=re.M)  # keys
        yield path.relative_to(ROOT).as_posix(), _drop("`[^`]*`", text)
    for path in sorted(REPORT.rglob("*.j2")):
        text = _read_template(path.read_text(encoding="utf-8"))
        yield path.relative_to(ROOT).as_posix(), _drop("`[^`]*`", text)


TEXTS = dict(_yield_texts())
BARE = re.compile(
    r"(?:^|(?<=[.:!?]\s)|(?<=[|-] )|(?<== \"))(?:Of|What|Who|Whose|Whom)\b.{,80}", re.M
)
"""A sentence that begins with a bare clause."""


@pytest.mark.parametrize("name", TEXTS)
def test_no_private_word_is_left(name: str) -> None:
    lines = enumerate(TEXTS[name].splitlines(), 1)
    found = [
        f"{n}: {word}: {line.strip()[:120]}" for n, line in lines for word in PRIVATE.findall(line)
    ]
    assert found == []


@pytest.mark.parametrize("name", TEXTS)
def test_no_sentence_begins_with_a_bare_clause(name: str) -> None:
    assert BARE.findall(TEXTS[name]) == []


@pytest.mark.parametrize("path", [ROOT / "README.md", *PAGES], ids=lambda path: path.name)
def test_headings_are_nouns_or_tasks(path: Path) -> None:
    text = _drop("```.*?^ *```", path.read_text(encoding="utf-8"), re.S | re.M)
    heads = re.findall(r"^#+ (?:\d+\. )?(.*)", text, re.M)
    assert [head for head in heads if head.endswith("?") or RIDDLE.match(head)] == []
