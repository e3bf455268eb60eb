"""A result folder that is sent to us: made whole, and every fault of one said in a line."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from dpbench.bench.capability.edge_qps import (
    CAPABILITY_FILE,
    COLUMNS,
    load_capability_plots,
    write_capability_plots,
)
from dpbench.cli.main import main
from dpbench.errors import ResultsError
from dpbench.report.documents.sent import (
    MOST_BYTES,
    SENDER,
    SENT,
    check_sent_folder,
    refuse_active_page,
)

COMMUNITY = Path(__file__).parents[3] / "results" / "community"
SIGNED = 'who = "Ada"\nwhen = 2026-11-22\ncommand = "dpbench run smoke"\n'


@pytest.fixture(scope="module")
def sent(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small campaign as it is sent."""
    from tests.conftest import MadeRecords

    records, base = MadeRecords(), tmp_path_factory.mktemp("sent")
    for solver in ("daqp", "osqp"):
        records.loop(solver)
        records.replay(solver, spread=0.1)
    out = records.write(base / "out")
    assert main(["report", str(out), "--send", str(base / "folder"), "--quiet"]) == 0
    assert (base / "folder" / SENDER).read_text("utf-8").startswith("# Who ran this")
    (base / "folder" / SENDER).write_text(SIGNED, encoding="utf-8")
    return base / "folder"


@pytest.fixture
def copy(sent: Path, tmp_path: Path) -> Path:
    """One that a test may spoil."""
    return Path(shutil.copytree(sent, tmp_path / "sent"))


@pytest.mark.slow
def test_what_is_sent_is_whole_and_small(sent: Path, capsys: Any) -> None:
    assert sorted(path.name for path in sent.iterdir()) == sorted(SENT)
    page = (sent / "report.html").read_text("utf-8")
    assert "<script" not in page and "steps.parquet" not in page and "<svg" in page
    for name in ("one", "two"):
        assert f'id="{name}"' not in page and f'href="#{name}"' not in page, "a script fills it"
    assert "figures/" not in page and "tables/runs.csv" not in page
    assert sum(path.stat().st_size for path in sent.iterdir()) < MOST_BYTES / 2
    assert main(["check", str(sent)]) == 0
    output = " ".join(capsys.readouterr().out.split())
    assert "4 runs of 2 solvers" in output and "submitted by Ada on 2026-11-22" in output


@pytest.mark.slow
def test_capability_plots_go_along(records: Any, tmp_path: Path) -> None:
    records.loop("daqp", steps=20)
    out, folder = records.write(tmp_path / "out"), tmp_path / "folder"
    row = ("plot", 0, "psv", 8, "intact", "", 0.0, 20.0, True, 20.0, 7)
    write_capability_plots(out, [{name: [value] for name, value in zip(COLUMNS, row, strict=True)}])
    assert main(["report", str(out), "--send", str(folder), "--quiet"]) == 0
    (folder / SENDER).write_text(SIGNED, encoding="utf-8")
    assert (folder / CAPABILITY_FILE).read_bytes() == (out / CAPABILITY_FILE).read_bytes()
    assert 'id="capability"' in (folder / "report.html").read_text("utf-8")
    check_sent_folder(folder)
    load_capability_plots(folder).assign(wind_mps=30.0).to_parquet(folder / CAPABILITY_FILE)
    with pytest.raises(ResultsError, match=r"a page of another capability\.parquet"):
        check_sent_folder(folder)
    (out / CAPABILITY_FILE).unlink()
    assert main(["report", str(out), "--send", str(folder), "--quiet"]) == 0
    assert not (folder / CAPABILITY_FILE).exists()


def test_the_command_says_what_is_left_to_do(records: Any, tmp_path: Path, capsys: Any) -> None:
    """The text it wrote, and the form that is still empty, in place of the results."""
    records.loop("daqp", steps=20)
    out, folder = records.write(tmp_path / "out"), tmp_path / "folder"
    assert main(["report", str(out), "--send", str(folder)]) == 0
    printed = "".join(capsys.readouterr().out.split())
    assert "report.html,runs.parquet,machine.json,suite.jsonandsender.toml" in printed
    assert f"Fillinwhoandcommandin{folder}/sender.toml,thencheck" in printed
    assert f"dpbenchcheck{folder}" in printed and "solvers" not in printed.split("sent")[0]
    (folder / SENDER).write_text(SIGNED, encoding="utf-8")
    assert main(["report", str(out), "--send", str(folder)]) == 0
    assert "Fillin" not in "".join(capsys.readouterr().out.split())


def test_sending_again_keeps_the_signature(written: Any, copy: Path, tmp_path: Path) -> None:
    from dpbench.report.documents.sent import prepare_sent_folder

    prepare_sent_folder(written.folder, copy)
    assert (copy / SENDER).read_text("utf-8") == SIGNED
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("", encoding="utf-8")
    for place in (tmp_path / "other", written.folder):
        with pytest.raises(ValueError, match=r"--send: found .*a folder of its own"):
            prepare_sent_folder(written.folder, place)


def _edit(name: str, change: Callable[[dict[str, Any]], None]) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        document = json.loads((folder / name).read_text("utf-8"))
        change(document)
        (folder / name).write_text(json.dumps(document), encoding="utf-8")

    return spoil


def _runs(**columns: Any) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        table = pd.read_parquet(folder / "runs.parquet").assign(**columns)
        table.to_parquet(folder / "runs.parquet", index=False)

    return spoil


def _written(name: str, text: str) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        (folder / name).write_text(text, encoding="utf-8")

    return spoil


def _gone(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


@pytest.mark.parametrize(
    ("spoil", "parts"),
    [
        *((_gone(name), (name, "o such file")) for name in SENT),
        (_written("runs.parquet", "PAR1"), ("runs.parquet", "a damaged file")),
        (_written("suite.json", "{"), ("suite.json", "invalid JSON")),
        (_written("report.html", " " * MOST_BYTES), (f"at most {MOST_BYTES} in all",)),
        (_written("notes.txt", ""), ("notes.txt", "an unexpected file", "only report.html")),
        (_written(SENDER, ""), (SENDER, "who", "missing")),
        (_written(SENDER, SIGNED.replace("Ada", " ")), (SENDER, "who: found ' '")),
        (_written(SENDER, SIGNED.replace("2026-11-22", '"today"')), (SENDER, "when")),
        (_written(SENDER, f'{SIGNED}mail = "a"\n'), (SENDER, "mail: found an unknown key")),
        (_edit("suite.json", lambda suite: suite.update(run_rows=3)), ("run_rows", "4 rows")),
        (_edit("machine.json", lambda machine: machine.update(id="x")), ("machine_id", "'x'")),
        (_edit("suite.json", lambda suite: suite.update(name="y")), ("a page of another suite",)),
        (_runs(outcome="lost"), ("outcome", "4 runs with a harness error (lost)")),
        (_runs(schema=1), ("schema", "run the suite again")),
    ],
)
def test_faults(
    copy: Path, spoil: Callable[[Path], None], parts: tuple[str, ...], capsys: Any
) -> None:
    """It names the file, what is found there and what could be; exit 2."""
    spoil(copy)
    assert main(["check", str(copy)]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert all(part in line for part in parts), line


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ("</main>", "</main><script>alert(1)</script>", "<script>"),
        ("</main>", "</main><SCRIPT src=//evil.example/x.js>", "<SCRIPT src="),
        ("</main>", '</main><iframe height="1">', "<iframe>"),
        ("</main>", "</main><!-- --!><script>alert(1)</script> -->", "<!-- "),
        ("<main>", '<main onload="alert(1)">', 'onload="alert(1)" in <main>'),
        ('href="suite.json"', 'href="javascript:alert(1)"', 'href="javascript:alert(1)" in <a>'),
        ('href="suite.json"', 'href="https://evil.example"', 'href="https://evil.example" in'),
        ("</style>", "@import '//evil.example';</style>", "@import in <style>"),
        ("</style>", "p{background:u\\72l(//e.example)}</style>", "\\ in <style>"),
        ("</main>", '</main><meta http-equiv="refresh" name="x">', "http-equiv"),
        ("</main>", '</main><path fill="url(//evil.example/x.svg#a)"/>', "url( in"[:3]),
        ("</main>", "</main><p a='<b>'>", "<p a='"),
    ],
)
def test_an_active_page_is_refused(copy: Path, old: str, new: str, found: str, capsys: Any) -> None:
    page = (copy / "report.html").read_text("utf-8")
    assert old in page
    line = page[: page.index(old)].count("\n") + 1
    (copy / "report.html").write_text(page.replace(old, new, 1), encoding="utf-8")
    assert main(["check", str(copy)]) == 2
    (output,) = capsys.readouterr().err.strip().splitlines()
    assert f"report.html: line {line}: found" in output and found in output, output


@pytest.mark.parametrize("folder", sorted(p for p in COMMUNITY.glob("*") if p.is_dir()), ids=str)
def test_every_folder_sent_so_far_is_whole(folder: Path) -> None:
    assert check_sent_folder(folder).startswith(str(folder))


UTF_8 = '<meta charset="utf-8">'


@pytest.mark.parametrize(
    ("page", "found"),
    [
        (UTF_8, ""),
        ('<meta charset="iso-2022-jp">', "charset"),
        (f'<meta charset="iso-2022-jp">{UTF_8}', "charset"),
        ("<p>Without an encoding a browser guesses.</p>", "charset"),
        (f"<title>{1024 * 'x'}</title>{UTF_8}", "charset"),
        (f"{UTF_8}<p>\x1b$B</p>", "0x1b"),
        (f"{UTF_8}<p>\x00</p>", "0x00"),
        (f"{UTF_8}<p>\ttab\r\n</p>", ""),
    ],
)
def test_a_page_is_read_in_the_encoding_that_it_was_checked_in(page: str, found: str) -> None:
    """In ISO-2022-JP a quote may be half of a character, and end no attribute."""
    if not found:
        refuse_active_page(page, "page")
        return
    with pytest.raises(ResultsError, match=found):
        refuse_active_page(page, "page")
