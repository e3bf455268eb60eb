"""Each guide and tutorial has a picture near its top, and the pictures stay small."""

import re
from pathlib import Path

import pytest

from tests.docs.markdown_blocks import DOCS, PAGES, README

PICTURES = DOCS / "pictures"
NEAR_TOP = 40
"""Lines of a page before which it has a picture."""
LIMITS = {".svg": 60_000, ".png": 80_000}
KEPT = {"README.md", "draw.py"}
FILES = sorted(path for path in PICTURES.iterdir() if path.is_file() and path.name not in KEPT)
GUIDES = [page for page in PAGES if page.parent.name in ("guide", "tutorials")]
_PICTURE = re.compile(r"!\[([^\]]*)\]\(([^)\s]+)\)")


@pytest.mark.parametrize("page", GUIDES, ids=lambda page: page.stem)
def test_a_page_begins_with_a_picture_and_its_caption(page: Path) -> None:
    lines = page.read_text(encoding="utf-8").splitlines()
    found = [i for i, line in enumerate(lines[:NEAR_TOP]) if _PICTURE.fullmatch(line)]
    assert found, "no picture near the top"
    (alt, target), caption = _PICTURE.fullmatch(lines[found[0]]).groups(), lines[found[0] + 2]
    assert len(alt.split()) > 3
    assert (page.parent / target).is_file()
    assert caption.startswith("*")


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_a_picture_is_small_used_and_documented(file: Path) -> None:
    assert file.stat().st_size < LIMITS[file.suffix]
    pages = [page for page in (*PAGES, README) if page.parent != PICTURES]
    used = {link for page in pages for link in _PICTURE.findall(page.read_text(encoding="utf-8"))}
    assert any(target.endswith(f"pictures/{file.name}") for _, target in used)
    assert f"| `{file.name}` |" in (PICTURES / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_a_picture_names_no_folder_and_runs_nothing(file: Path) -> None:
    content = file.read_bytes()
    assert not re.search(rb"/(home|work|tmp|root|Users)/|<script|<metadata", content)
