"""Receivers of the progress of a campaign."""

import sys

import pytest

from dpbench.bench.progress import ProgressLines, Silent, choose_progress


@pytest.mark.parametrize(
    ("given", "is_terminal", "kernel", "kind"),
    [
        (True, False, False, ProgressLines),
        (False, True, True, Silent),
        (None, False, False, Silent),
        (None, True, False, ProgressLines),
        (None, False, True, ProgressLines),
    ],
)
def test_lines_are_printed_on_request_or_where_somebody_looks_on(
    given: bool | None,
    is_terminal: bool,
    kernel: bool,
    kind: type,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: is_terminal)
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    if kernel:
        monkeypatch.setitem(sys.modules, "ipykernel", sys)
    assert type(choose_progress(given)) is kind


def test_an_object_is_taken_as_it_is() -> None:
    own = Silent()
    assert choose_progress(own) is own


def test_waits_and_remarks_are_lines_on_standard_error(capsys: pytest.CaptureFixture[str]) -> None:
    lines = choose_progress(True)
    lines.waiting("waiting for process 1")
    lines.remark("a remark")
    lines.advance(5, "of no work")
    assert capsys.readouterr() == ("", "dpbench: waiting for process 1\ndpbench: a remark\n")
