"""Texts for people fit 80 columns and a dumb terminal, and have no codes in them."""

import json
import os
import pty
import re
import subprocess
import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from rich.progress import Progress

from dpbench.cli import doctor
from dpbench.cli.main import _CALLS, main
from dpbench.cli.ship import check_ship
from dpbench.cli.terminal import (
    WIDTH,
    ProgressBar,
    _TimeLeftColumn,
    format_heading_and_paragraphs,
    make_report_table,
    print_ending,
    print_wrapped,
)
from dpbench.report.formats import Table
from tests.cli.conftest import Say

CODES = re.compile(r"[\x00-\x09\x0b-\x1f\x7f-\x9f]")
NUMBERS = {"length": 80, "breadth": 18, "draught": 6, "displacement": 6000, "thrust": 300}
SHIP = [word for key, number in NUMBERS.items() for word in (f"--{key}", str(number))]
EXPORT = ["export", "rough", "--steps", "2", "--out", "rough.npz"]
KINDS = ("vessels", "scenarios", "suites", "sequences", "solvers")


def assert_readable(text: str) -> None:
    """No code, and no line over 80 columns that could have been broken at a space."""
    assert text.strip() and not CODES.search(text)
    wide = [line for line in text.splitlines() if len(line) > WIDTH]
    assert not [line for line in wide if " " in line.strip()]


@pytest.fixture(autouse=True)
def _dumb(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setenv("COLUMNS", str(WIDTH))


@pytest.mark.parametrize("command", ["", *_CALLS])
def test_help_fits(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main([*command.split(), "--help"])
    assert_readable(capsys.readouterr().out)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_lists_fit(kind: str, say: Say) -> None:
    said = say("list", kind.removesuffix("s"))
    assert_readable(said)
    known = dict(zip(KINDS, ("osv", "paper_tight", "standard", "rough-60-10", "daqp"), strict=True))
    assert re.search(rf"^{known[kind]} *\b", said, re.M)


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ["check", "osv"],
        ["check", "rough@osv"],
        ["check", "smoke"],
        ["check", "paper-30-5"],
        ["init", "my_ship", *SHIP],
        EXPORT,
        ["worst-case", "daqp", "--budget", "1", "--steps", "3"],
        ["doctor", "--offline"],
        ["paper"],
        ["run", "smoke", "--solver", "quadprog", "--settings", "default", "--steps", "20"],
        ["run", "smoke", "--solver", "quadprog", "--steps", "20", "--json", "--out", "b"],
    ],
    ids=lambda words: "-".join(words[:2]),
)
def test_what_a_command_says_fits(
    words: list[str], say: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        check_ship, "can_recover_from_offset", lambda trial, offset_m, sides: offset_m <= 1.0
    )
    said = say(*words)
    if "--json" not in words:
        assert_readable(said)
    assert not CODES.search(said)


@pytest.mark.slow
def test_a_report_and_a_comparison_fit(campaign: Path, say: Say) -> None:
    assert_readable(say("report", str(campaign)))
    assert_readable(say("compare", str(campaign), str(campaign)))


@pytest.mark.slow
@pytest.mark.parametrize("setting", [{"TERM": "dumb"}, {"TERM": "xterm", "NO_COLOR": "1"}])
@pytest.mark.parametrize("words", [["list", "vessels"], EXPORT], ids=lambda words: words[0])
def test_a_terminal_of_80_columns(words: list[str], setting: dict[str, str]) -> None:
    primary, secondary = pty.openpty()
    environment = {k: v for k, v in os.environ.items() if k != "NO_COLOR"} | setting
    program = [sys.executable, "-m", "dpbench", *words]
    with subprocess.Popen(program, env=environment, stdout=secondary) as process:
        os.close(secondary)
        said = b""
        while part := _read(primary):
            said += part
    os.close(primary)
    assert process.returncode == 0
    text = said.decode().replace("\r\n", "\n")
    bold = re.compile(r"\x1b\[[0-9]m" if setting["TERM"] == "xterm" else r"$^")
    assert_readable(bold.sub("", text))


def _read(terminal: int) -> bytes:
    """Read from a terminal; nothing once nobody writes to it, which Linux reports as an error."""
    try:
        return os.read(terminal, 1 << 16)
    except OSError:
        return b""


def wide_table(words: int) -> Table:
    heads = tuple(f"column{i}" for i in range(words))
    return Table(("name", *heads), (("daqp", *heads[:-1], "slower"),), "Wide", "A note.")


def test_a_table_that_does_not_fit_is_told_row_by_row(capsys: pytest.CaptureFixture[str]) -> None:
    screen = Console(width=WIDTH)
    screen.print(make_report_table(wide_table(4), screen))
    assert "┃" in capsys.readouterr().out
    screen.print(make_report_table(wide_table(12), screen))
    said = capsys.readouterr().out
    assert "┃" not in said and "…" not in said
    assert "column11 slower" in " ".join(said.split())
    assert_readable(said)


def test_a_line_is_broken_at_spaces_and_a_path_is_not(capsys: pytest.CaptureFixture[str]) -> None:
    path = "/".join(["folder"] * 20)
    print_wrapped(["short", "word " * 30, f"see {path}"])
    said = capsys.readouterr().out
    assert_readable(said)
    assert path in said.splitlines()[-1]
    assert (
        format_heading_and_paragraphs("daqp", ["word " * 30]).splitlines()[1].startswith("    word")
    )


@pytest.mark.slow
def test_doctor_puts_a_long_fact_beside_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    machine: dict[str, Any] = {"load_average": [], "memory_GiB": 8, "kernel": "k", "python": "p"}
    versions = {f"library{i}": "1.0" for i in range(20)}
    monkeypatch.setattr(doctor, "describe_machine", lambda: machine | {"versions": versions})
    said = "\n".join(doctor.describe_machine_and_clock(offline=True))
    assert_readable(said)
    assert f"\n{' ' * 32}library" in said


def test_a_remark_keeps_what_is_in_brackets(capsys: pytest.CaptureFixture[str]) -> None:
    """Tables of a suite and options of a solver are no markup."""
    with ProgressBar() as bar:
        bar.remark("left out: [[capability]], osqp[rho=1]")
    shown = capsys.readouterr()
    assert "left out: [[capability]], osqp[rho=1]" in shown.out + shown.err


def test_a_remark_is_said_where_no_bar_can_be(capsys: pytest.CaptureFixture[str]) -> None:
    with ProgressBar(transient=True) as bar:
        bar.remark("compiling")
    with ProgressBar(quiet=True) as bar:
        bar.remark("nothing")
    assert capsys.readouterr() == ("", "dpbench: compiling\n")


def test_progress_without_a_terminal_is_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each minute, or each tenth that takes ten seconds; none where it is quick or quiet."""
    now_s = 0.0
    monkeypatch.setattr("dpbench.bench.progress.time.monotonic", lambda: now_s)
    with ProgressBar() as bar, ProgressBar(quiet=True) as silent:
        for one in (bar, silent):
            one.start(100)
        for at_s, work in ((3.0, 40), (11.0, 5), (21.0, 1), (72.0, 4), (73.0, 50)):
            now_s = at_s
            for one in (bar, silent):
                one.advance(work, "daqp")
    shown = capsys.readouterr()
    assert not shown.out
    assert shown.err.splitlines() == [
        "dpbench: 45 % after 11 s: daqp",
        "dpbench: 50 % after 72 s: daqp",
    ]


def test_what_takes_long_after_all_work_is_a_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Tables and page of a run, and of one whose cells were all finished before."""
    now_s = 0.0
    monkeypatch.setattr("dpbench.bench.progress.time.monotonic", lambda: now_s)
    for work in (4, 0):
        now_s = 0.0
        with ProgressBar() as bar:
            bar.start(work)
            bar.advance(work, "daqp")
            for at_s, what in (
                (9.0, "tables"),
                (12.0, "charts"),
                (13.0, "figure"),
                (23.0, "page"),
            ):
                now_s = at_s
                bar.advance(0, what)
    lines = capsys.readouterr().err.splitlines()
    assert lines == 2 * [
        "dpbench: all steps done after 12 s: charts",
        "dpbench: all steps done after 23 s: page",
    ]


@pytest.mark.parametrize(
    ("elapsed_s", "done", "said"),
    [
        (4.0, 22, ""),
        (60.0, 0, ""),
        (22.0, 22, "left 0:01:18"),
        (60.0, 100, "left 0:00:00"),
        (60.0, 120, "left 0:00:00"),
        (86_400.0, 25, "left 3 days, 0:00:00"),
    ],
)
def test_the_time_left_is_that_at_the_mean_rate(elapsed_s: float, done: int, said: str) -> None:
    """Two results of one batch, which are there at once, are no rate."""
    now_s = [0.0]
    bar = Progress(_TimeLeftColumn(), get_time=lambda: now_s[0])
    task = bar.add_task("", total=100)
    now_s[0] = elapsed_s
    for part in (done // 2, done - done // 2):
        bar.advance(task, part)
        now_s[0] += 1e-6
    now_s[0] = elapsed_s
    assert str(_TimeLeftColumn().render(bar.tasks[0])) == said


def test_json_has_every_line_of_one_keyword(capsys: pytest.CaptureFixture[str]) -> None:
    """One's own settings have a line each."""
    rows = [("options", "osqp[rho=1]: fail."), ("options", "osqp[rho=2]: pass.")]
    how = Namespace(json=True, quiet=False, open=False, strict=False)
    assert print_ending(Path("report.html"), rows, how) == 0
    assert json.loads(capsys.readouterr().out)["options"] == "\n".join(text for _, text in rows)


def test_no_number_of_a_table_is_broken(capsys: pytest.CaptureFixture[str]) -> None:
    """Thousands are separated where the table then fits, at 80 columns."""
    screen = Console(width=WIDTH)
    for numbers, printed in ((5, "11\u202f692\u202f634"), (6, "11692634")):
        heads = ("solver", *(f"n{i}" for i in range(numbers)))
        cells = ("osqp", *["11\u202f692\u202f634"] * numbers)
        screen.print(make_report_table(Table(heads, (cells,)), screen))
        assert capsys.readouterr().out.count(printed) == numbers
