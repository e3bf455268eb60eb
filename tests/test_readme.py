"""The README is short, and leads where it says; its commands are followed in `tests/docs`."""

from __future__ import annotations

import re
from pathlib import Path

README = Path(__file__).parents[1] / "README.md"


def test_it_is_a_front_door() -> None:
    """At most 150 lines: what is longer stands in the documentation."""
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 150


def test_every_file_the_readme_links_to_exists() -> None:
    """No link of the README leads nowhere."""
    targets = re.findall(r"\]\((?!https?:)([^)#]+)\)", README.read_text(encoding="utf-8"))
    assert targets
    missing = [target for target in targets if not (README.parent / target).exists()]
    assert not missing
