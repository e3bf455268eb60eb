"""The tables beside the page hold the numbers of the records."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import dpbench
from dpbench.analysis.records.run_steps import extract_counting_rows, yield_merged_steps_by_run
from dpbench.cli.main import main
from dpbench.files.regular_files import write_file_set_into_folder
from dpbench.report.formats import Table
from dpbench.report.page.recommendation import Recommendation
from dpbench.report.page.section import Topic
from dpbench.report.report import TABLES, Report, build_tables, describe_table, read_tables
from dpbench.report.write import write_report
from tests.result_folder import write_results


def _table(folder: Path, name: str) -> pd.DataFrame:
    return pd.read_csv(folder / "tables" / f"{name}.csv", keep_default_na=False, na_values=[""])


def test_runs_are_those_of_the_parquet_file(written: Any) -> None:
    runs = pd.read_parquet(written.folder / "runs.parquet").drop(columns="cell")
    table = _table(written.folder, "runs")
    assert list(table.columns) == list(runs.columns)
    assert len(table) == len(runs)
    for name in runs.columns:
        if pd.api.types.is_numeric_dtype(runs[name].dtype):
            expected = runs[name].to_numpy(dtype=np.float64, na_value=np.nan)
            found = table[name].to_numpy(dtype=np.float64, na_value=np.nan)
            np.testing.assert_array_equal(found, expected, err_msg=name)
        else:
            found = table[name].astype(object).where(table[name].notna(), "")
            expected = ["" if pd.isna(x) else str(x) for x in runs[name]]
            assert [str(x) for x in found] == expected, name


def test_the_first_failed_step_is_that_of_the_run_with_most(records: Any) -> None:
    records.loop("daqp", failed=0)
    records.replay("daqp", steps=20, failed=4, lost=(3, 5))
    records.replay("daqp", "turn", steps=20, failed=2, lost=(1,))
    records.loop("osqp")
    table = Report.from_results(records.results()).tables["verdicts"].set_index("solver")
    assert table["first_failed_step"].to_dict() == {"daqp": "paper, k 3", "osqp": ""}


def test_verdicts_are_those_of_the_analysis(written: Any) -> None:
    verdicts = written.report.data.verdicts.all_verdicts
    table = _table(written.folder, "verdicts")
    assert len(table) == len(verdicts)
    for row, verdict in zip(table.to_dict("records"), verdicts, strict=True):
        who = verdict.configuration
        named = row["solver"], row["route"], row["policy"], row["settings"], row["verdict"]
        assert named == (who.solver, who.route, who.policy, who.settings, verdict.state)
        for name in ("error_move", "failed_steps", "steps", "closed_loops", "replays"):
            attribute = {"closed_loops": "loops"}.get(name, name)
            np.testing.assert_equal(float(row[name]), float(getattr(verdict, attribute)))
        times = {"p50": "p50", "limiting_p99": "p99", "max": "longest", "raw_max": "raw_max"}
        for name, attribute in times.items():
            ns = float(getattr(verdict, f"{attribute}_ns"))
            np.testing.assert_allclose(1e3 * float(row[f"{name}_us"]), ns, rtol=1e-12)
        why = Recommendation.why(verdict).replace("`", "")  # names without the marks of Markdown
        assert (row["why"] if isinstance(row["why"], str) else "") == why


def test_hard_steps_are_the_largest_of_each_run(written: Any) -> None:
    hard = _table(written.folder, "hard_steps")
    steps = dict(yield_merged_steps_by_run(extract_counting_rows(written.results.steps)))
    assert set(hard["by"]) == {"time", "iterations", "error"}
    assert set(hard["experiment"]) <= {one.label for one in written.report.data.experiments}
    assert any("in SI units" in label for label in hard["experiment"])
    assert hard.groupby(["run_id", "by"]).size().max() == 5
    first = hard.drop_duplicates(["run_id", "by"]).set_index(["run_id", "by"])
    for (run_id, measure), row in first.iterrows():
        own = steps[str(run_id)]
        values = {"time": own.time_ns, "iterations": own.iterations, "error": own.error}[measure]
        value = row["value"] * (1e3 if measure == "time" else 1.0)
        assert value == pytest.approx(np.nanmax(values), rel=1e-12)
        assert values[list(own.k).index(row["k"])] == pytest.approx(value, rel=1e-12)


def test_windows_are_no_runs_of_the_hard_steps(records: Any) -> None:
    """The README excludes them."""
    cell = json.dumps({"source": {"kind": "hardest", "name": "turn hardest 30", "of": 450}})
    records.replay("daqp", steps=20)
    records.replay("daqp", "turn hardest 30", steps=30, cell=cell)
    tables = Report.from_results(records.results()).tables
    assert len(tables["runs"]) == 2
    assert tables["hard_steps"]["run_id"].nunique() == 1
    assert "without studies and windows;" in TABLES["hard_steps"]


def test_a_table_that_the_page_cuts_is_whole_in_its_file(records: Any, tmp_path: Path) -> None:
    rows = tuple((str(i),) for i in range(9))
    topic = Topic("some", "Some", tables=(Table(("i",), rows, shown=4),))
    records.loop("daqp", steps=20)
    report = Report.from_results(records.results())
    tables = build_tables(report.results, report.data, report.recommendation, [topic])
    assert tables["some"]["i"].tolist() == [row[0] for row in rows]
    assert "some_2" not in tables
    assert topic.tables[0].page_rows == [list(row) for row in rows[:4]]


@pytest.mark.slow
def test_what_ended_early_stands_with_its_reason(records: Any, tmp_path: Path) -> None:
    records.loop("daqp", steps=20)
    records.refused("ecos", "it keeps no workspace", policy="reuse")
    records.loop("highs", outcome="crashed", outcome_detail="signal 11", done=0)
    out = records.write(tmp_path / "out")
    write_file_set_into_folder(out / "tables", {"old.csv": lambda: b"x\n1\n"})
    write_report(out)
    table = _table(out, "runs").set_index("solver")
    assert table["outcome"].to_dict() == {"daqp": "finished", "ecos": "refused", "highs": "crashed"}
    assert table.loc["ecos", "outcome_detail"] == "it keeps no workspace"
    assert _table(out, "verdicts").set_index("solver")["why"]["highs"] == (
        "its process ended in paper: signal 11"
    )
    assert not (out / "tables" / "old.csv").exists()


def test_the_command_names_every_table_and_prints_one_in_latex(
    records: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Those that have rows, with their meaning; LaTeX by the same name, and no other."""
    records.loop("daqp")
    records.replay("daqp")
    write_results(tmp_path, records.results())
    tables = Report.from_results(records.results()).tables
    assert main(["report", str(tmp_path), "--tables"]) == 0
    text = capsys.readouterr().out
    named = re.findall(r"^(\w+) \(\d+ rows?\): \S", text, flags=re.MULTILINE)
    assert named == [name for name, table in tables.items() if len(table)]
    assert f"dpbench report {tmp_path} --latex NAME" in " ".join(text.split())
    csv = f"CSV: `dpbench report {tmp_path}` writes the tables to {tmp_path / 'tables'} LaTeX:"
    assert csv in " ".join(text.split())
    assert main(["report", str(tmp_path), "--latex", "verdicts"]) == 0
    assert capsys.readouterr().out.startswith("\\begin{tabular}")
    words = ["report", str(tmp_path), "--latex", "verdicts", "--columns", "solver, p50_us"]
    assert main(words) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[2] == r"solver & p50 [$\mu$s] \\" and printed[-1].startswith("% Caption: ")
    assert re.search(r"each step's fastest of \d+ rounds\.$", printed[-1])
    assert main([*words[:-1], "solvr"]) == 2
    assert "solver" in capsys.readouterr().err
    assert main(["report", str(tmp_path), "--columns", "solver"]) == 2
    assert "--latex" in capsys.readouterr().err
    assert main(["report", str(tmp_path), "--latex", "verdict"]) == 2
    error = capsys.readouterr().err
    allowed = error.partition("allowed: ")[2].partition(":")[0].partition("…")[0]
    assert "found 'verdict'" in error and "verdicts" in allowed
    with_rows = {name for name, table in tables.items() if len(table)}
    assert set(re.findall(r"\w{3,}", allowed)) - {"one"} <= with_rows


def test_the_legend_of_ships_sends_a_point_to_the_table_that_has_its_values(written: Any) -> None:
    """And says which limits count where."""
    legend = (written.folder / "tables" / "README.md").read_text(encoding="utf-8")
    ships = legend.split("\n## ships.csv")[1].split("\n## ")[0]
    assert "`study_point`: number of the point in its study; its values are the columns" in ships
    assert "x_<key> of study_points.csv" in ships
    assert "limits that keep a lost thruster at zero do not count, unlike in n_active" in ships


def test_the_files_to_publish_are_those_that_a_result_is_read_from(
    records: Any, tmp_path: Path
) -> None:
    """The guide lists them; without the steps, the tables are read."""
    records.loop("daqp")
    records.replay("daqp")
    out = records.write(tmp_path / "out")
    write_report(out)
    guide = Path(__file__).parents[2] / "docs" / "guide" / "report.md"
    part = guide.read_text("utf-8").split("## Publish a result")[1].split("\n## ")[0]
    items = part.partition("The folder `cells/`")[0]
    listed = {*re.findall(r"`([\w.]+(?:\.\w+|/))`", items)}
    made = {f"{path.name}{'/' * path.is_dir()}" for path in out.iterdir()}
    own = {"suite.toml", "design.json", "capability.parquet", "embedded.parquet"}
    assert listed == own | {name for name in made if not name.startswith((".", "figures"))}
    for name in listed & made - {"steps.parquet"}:
        (tmp_path / "published").mkdir(exist_ok=True)
        copy = shutil.copytree if name.endswith("/") else shutil.copy
        copy(out / name, tmp_path / "published" / name)
    published = dpbench.load_results(tmp_path / "published")
    assert len(published.runs) == 2
    pd.testing.assert_series_equal(published.verdict()["p50_us"], _table(out, "verdicts")["p50_us"])


def test_tables_of_topics_are_files_too(written: Any) -> None:
    (shown,) = (topic for topic in written.report.topics if topic.id == "paper")
    table = _table(written.folder, "paper")
    assert list(table.columns) == list(shown.tables[0].heads)
    assert [tuple(row) for row in table.to_numpy()] == list(shown.tables[0].rows)


def test_a_table_of_a_topic_is_described_by_its_title(
    written: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the list, the legend and the caption; with the legend alone, without the steps too."""
    title = "Assumptions where the paper is incomplete."
    legend = written.folder / "tables" / "README.md"
    assert f"## paper_2.csv\n\n{title}\n" in legend.read_text(encoding="utf-8")
    assert main(["report", str(written.folder), "--tables"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert re.search(rf"paper_2 \(\d+ rows\): {title}", text)
    assert f"CSV: {legend.parent} (columns described in {legend}) LaTeX:" in text
    latex = dpbench.load_results(written.folder).to_latex("paper_2")
    assert latex.endswith(f"\n% Caption: {title}\n")
    stored = dict(read_tables(legend.parent))["paper_2"]
    assert describe_table("paper_2", stored) == title


def test_every_table_has_a_description(written: Any) -> None:
    for name, table in written.report.tables.items():
        assert len(describe_table(name, table)) > 1, name


def test_the_caption_of_verdicts_defines_the_interval_of_the_p99_and_empty_cells(
    records: Any, tmp_path: Path
) -> None:
    """Only where they are printed; daqp has a p99, and osqp was not timed."""
    records.loop("daqp")
    records.replay("daqp", steps=1000)
    write_results(tmp_path, records.results())
    results = dpbench.load_results(tmp_path)
    interval = (
        "p99 low and high: 95 \\% interval of the limiting p99; empty for a window and for a p99 "
        "that is scaled up, infinite if too few steps take longer."
    )
    caption = results.to_latex("verdicts", columns=["solver", "p99_low_us"]).splitlines()[-1]
    assert interval in caption and "An empty cell" not in caption
    assert interval not in results.to_latex("verdicts")
    records.loop("osqp")
    write_results(tmp_path, records.results())
    results = dpbench.load_results(tmp_path)
    empty = "An empty cell: the configuration was not run or not timed, or, for a p99, had neither"
    assert empty in results.to_latex("verdicts")
    assert empty in results.to_latex(results.verdict(), columns=["solver", "p50_us"])
    assert empty not in results.to_latex("verdicts", columns=["solver", "error_move"])


def test_the_caption_of_a_study_defines_it(records: Any, tmp_path: Path) -> None:
    """The reference loop leaves its station at point 1, which is in no mean."""
    for solver in ("daqp", "osqp"):
        for replicate in (1, 2, 3):
            records.sea(solver, 0, replicate, {"scale": 1.0})
            records.sea(solver, 1, replicate, {"scale": 2.0}, exact_left_s=9.0)
    write_results(tmp_path, records.results())
    caption = dpbench.load_results(tmp_path).to_latex("study_excess").splitlines()[-1]
    assert "less that of the reference in the same realisation" in caption
    assert "95 \\% interval of the mean, for each row alone; empty with too few pairs" in caption
    assert caption.endswith(
        "Study seas: 1 point, at most 3 realisations each. seas: 1 point excluded from every "
        "difference to daqp, as the reference loop leaves its station there: 1."
    )


@pytest.mark.parametrize("table", ["study_effects", "study_interactions"])
def test_the_caption_of_effects_defines_the_interval_and_empty_cells(
    records: Any, tmp_path: Path, table: str
) -> None:
    """Three realisations, so too few pairs for an interval."""
    for replicate in (1, 2, 3):
        for point, x in enumerate(({"a": 0, "b": 0}, {"a": 1, "b": 0}, {"a": 0, "b": 1})):
            records.sea("daqp", point, replicate, x)
        records.sea("daqp", 3, replicate, {"a": 1, "b": 1})
    write_results(tmp_path, records.results())
    caption = dpbench.load_results(tmp_path).to_latex(table).splitlines()[-1]
    assert "Low and high: 95 \\% interval of the effect, over realisations" in caption
    assert "No effect: other load can explain that on the step time (disturbed)." in caption
    assert "the same in every realisation, to within 0.0001 of its unit" in caption
    assert caption.endswith("Study seas: 4 points, at most 3 realisations each.")
