"""Scripts of others: what lies there is what the list says, with its licence."""

from __future__ import annotations

from importlib.resources import files

import pytest

from dpbench.report.page.vendored import Vendored, digest, script, vendored

VENDOR = files("dpbench.report.page").joinpath("vendor")


@pytest.mark.parametrize("entry", vendored(), ids=lambda entry: entry.file)
def test_a_script_is_what_the_list_says(entry: Vendored) -> None:
    assert digest(entry) == entry.sha256
    assert "Redistribution" in VENDOR.joinpath(entry.licence_file).read_text()
    assert entry.version in script(entry)
    assert "</script" not in script(entry)


def test_nothing_lies_there_unlisted() -> None:
    listed = {name for entry in vendored() for name in (entry.file, entry.licence_file)}
    assert {item.name for item in VENDOR.iterdir()} == listed | {"vendored.json"}
