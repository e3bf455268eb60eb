"""A report on a folder that a stranger made writes nowhere else, and shows his words as words."""

import csv
import json
import os
from pathlib import Path
from typing import Any

import pytest
from markdown_it import MarkdownIt

from dpbench.bench.record.result_folder import write_json
from dpbench.cli.main import main

pytestmark = pytest.mark.slow
HOSTILE = "x<img src=x onerror=a()>|[y](http://z)\n# b"
FORMULA = '=HYPERLINK("http://z")'


def _folder(records: Any, out: Path, *solvers: str) -> Path:
    for solver in solvers or ("daqp", "osqp"):
        records.loop(solver, steps=20)
        records.replay(solver)
    return Path(records.write(out))


@pytest.mark.parametrize("name", ["figures", "tables"])
def test_a_linked_folder_is_refused(records: Any, tmp_path: Path, capsys: Any, name: str) -> None:
    """One line, exit code 2; nothing is written, there or here."""
    out, thesis = _folder(records, tmp_path / "out"), tmp_path / "thesis"
    thesis.mkdir()
    for kind in ("svg", "pdf", "png", "csv"):
        (thesis / f"mine.{kind}").write_text("mine", encoding="utf-8")
    (out / name).symlink_to(thesis)
    assert main(["report", str(out)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{name}: found a link" in line
    assert len(list(thesis.iterdir())) == 4 and not (out / "report.html").exists()


@pytest.mark.parametrize("link", [os.symlink, os.link], ids=["soft", "hard"])
def test_linked_files_are_replaced(records: Any, tmp_path: Path, link: Any) -> None:
    out, send = _folder(records, tmp_path / "out"), tmp_path / "send"
    names = [
        *("report.html", "report.md", "daqp.md", "tables/runs.csv", "tables/README.md"),
        *("figures/ladder.svg", "figures/ladder.svg.part", "report.html.part"),
    ]
    places = [*(out / name for name in names), send / "report.html", send / "sender.toml"]
    mine = tmp_path / "thesis.txt"
    mine.write_text("who = 'me'", encoding="utf-8")
    for place in places[:-1] if link is os.link else places:
        place.parent.mkdir(exist_ok=True)
        link(mine, place)
    assert main(["report", str(out), "--for", "daqp", "--send", str(send), "--quiet"]) == 0
    assert mine.read_text("utf-8") == "who = 'me'" and mine.stat().st_nlink == 1
    assert not any(place.is_symlink() for place in places[:-1])
    assert "<html" in (out / "report.html").read_text("utf-8")


def test_batches_of_an_interrupted_run_are_named(
    records: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A report of the tables before it says so; a statement, which is signed, is refused."""
    out, statement = _folder(records, tmp_path / "out"), tmp_path / "statement.svg"
    (out / "cells").mkdir()
    (out / "cells" / "part-00001-0a1b2c3d.parquet").write_bytes(b"")
    assert main(["report", str(out)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "a later run was interrupted, and its results (batches: 1) are in no table" in said
    assert main(["report", str(out), "--statement", str(statement)]) == 2
    assert "a later run was interrupted" in capsys.readouterr().err and not statement.exists()
    (out / "cells" / "part-00001-0a1b2c3d.parquet").unlink()
    assert main(["report", str(out), "--statement", str(statement)]) == 0
    assert "run was interrupted" not in capsys.readouterr().out


def test_files_of_others_beside_figures_and_tables_stay(records: Any, tmp_path: Path) -> None:
    out = _folder(records, tmp_path / "out")
    for name in ("figures/mine.svg", "tables/mine.csv"):
        (out / name).parent.mkdir()
        (out / name).write_text("mine", encoding="utf-8")
    assert main(["report", str(out), "--figures", "pdf", "--quiet"]) == 0
    assert (out / "figures" / "ladder.pdf").exists()
    assert main(["report", str(out), "--quiet"]) == 0
    assert not (out / "figures" / "ladder.pdf").exists()
    assert (out / "figures" / "ladder.svg").exists()
    assert (out / "figures" / "mine.svg").exists() and (out / "tables" / "mine.csv").exists()


@pytest.mark.parametrize("name", ["../../x", "/tmp/x", "a\x1b[2J", ""])
def test_a_solver_named_like_no_file(records: Any, tmp_path: Path, capsys: Any, name: str) -> None:
    out = _folder(records, tmp_path / "a" / "b", "daqp", name)
    there = sorted(tmp_path.rglob("*"))
    assert main(["report", str(out), "--for", name]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "runs.parquet: solver: found" in line and line.isprintable()
    assert sorted(tmp_path.rglob("*")) == there


def _spoilt(records: Any, out: Path) -> Path:
    """A folder in which every name says something to Markdown, HTML or a spreadsheet."""
    words = HOSTILE.replace("/", "\N{FRACTION SLASH}").replace("\n", " ")
    folder = _folder(records, out, words, FORMULA.replace("/", ""), "-1+cmd|calc")
    for name, key in (("machine.json", "cpu_model"), ("suite.json", "name")):
        document = json.loads((folder / name).read_text("utf-8"))
        write_json(folder / name, document | {key: HOSTILE})
    return folder


def test_markdown_has_no_html_or_links_of_the_folder(records: Any, tmp_path: Path) -> None:
    records.refused("ecos", HOSTILE)
    out = _spoilt(records, tmp_path / "out")
    assert main(["report", str(out), "--for", FORMULA.replace("/", ""), "--quiet"]) == 0
    files = [out / "report.md", out / f"{FORMULA.replace('/', '')}.md"]
    for path in files:
        tokens = MarkdownIt("commonmark").enable("table").parse(path.read_text("utf-8"))
        inline = [child for token in tokens for child in token.children or []]
        kinds = {token.type for token in [*tokens, *inline]}
        assert not kinds & {"html_inline", "html_block", "link_open", "image"}, path
        assert "b" not in [t.content for t in tokens if t.type == "inline"], path
    tables = (out / "report.md").read_text("utf-8").splitlines()
    rows = [line for line in tables if line.startswith("|")]
    parsed = MarkdownIt("commonmark").enable("table").parse("\n".join(rows))
    assert sum(token.type == "tr_open" for token in parsed) == len(rows) - 1


def test_no_cell_of_a_table_is_a_formula(records: Any, tmp_path: Path) -> None:
    records.refused("ecos", "@SUM(A1)", dev_position_max_m=-0.5)
    out = _spoilt(records, tmp_path / "out")
    assert main(["report", str(out), "--quiet"]) == 0
    for path in (out / "tables").glob("*.csv"):
        with path.open(newline="", encoding="utf-8") as file:
            cells = [cell for row in csv.reader(file) for cell in row]
        formulas = [cell for cell in cells if cell[:1] in set("=+-@\t\r") and not _number(cell)]
        assert formulas == [""] * len(formulas), path
    with (out / "tables" / "runs.csv").open(newline="", encoding="utf-8") as file:
        (row,) = [row for row in csv.DictReader(file) if row["solver"] == "ecos"]
    assert (row["outcome_detail"], row["dev_position_max_m"]) == ("'@SUM(A1)", "-0.5")


def _number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
