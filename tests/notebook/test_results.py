"""A result folder in a notebook: the tables of the report as data frames."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench import InputError, compare, load_results
from dpbench.analysis.verdict.requirements import MISSED, STATES
from dpbench.errors import ResultsError
from dpbench.notebook.results import RatioTable, Results
from dpbench.report.ship.ship_text import BANNER
from dpbench.report.write import write_report


@pytest.fixture(scope="module")
def results(campaign: Path) -> Results:
    return load_results(campaign)


def test_the_verdict_has_a_row_for_each_configuration(results: Results) -> None:
    verdict = results.verdict().set_index(["solver", "route", "policy", "settings"])
    assert verdict.index.is_unique
    assert set(verdict["verdict"]) <= {*STATES}
    missed = verdict[verdict["verdict"].isin(MISSED)]
    assert len(missed) and (missed["why"] != "").all()
    assert (verdict[verdict["verdict"] == "pass"]["why"] == "").all()


@pytest.mark.parametrize("figure", ["times", "accuracy"])
def test_figures_have_each_timed_solver_by_either_backend(results: Results, figure: str) -> None:
    pytest.importorskip("matplotlib", reason="an extra")
    draw = getattr(results.plot, figure)
    assert "$schema" in draw().to_dict()
    (axes,) = draw(backend="matplotlib").axes
    texts = axes.get_yticklabels() if figure == "times" else axes.texts
    named = {text.get_text().split(" ")[0] for text in texts}
    timed = set(results.ladder()["solver"])
    # Without any answer a solver has a time and no error.
    assert named == timed if figure == "times" else {"daqp", "osqp"} <= named <= timed
    if figure == "accuracy":
        words = [layer.get("encoding", {}).get("text") for layer in draw().to_dict()["layer"]]
        assert {"field": "solver", "type": "nominal"} in words
        title = "largest error of the first move in the replays"
        assert axes.get_ylabel() == f"{title}\n[maximum increments]"
        assert title in json.dumps(draw().to_dict())
    with pytest.raises(InputError, match="one of altair, matplotlib"):
        draw(backend="pdf")


def test_tables_are_those_beside_the_page(results: Results, tmp_path: Path) -> None:
    """One source: what is written by a report is what a notebook gets, table by table."""
    results.to_csv(tmp_path)
    written = {path.stem for path in tmp_path.glob("*.csv")}
    assert written == {name for name, table in results.tables.items() if len(table)}
    assert {"verdicts", "hard_steps", "ladder", "paired_ratios", "experiments", "runs"} <= written
    for name in ("ladder", "paired_ratios"):
        again = pd.read_csv(tmp_path / f"{name}.csv")
        assert list(again.columns) == list(results.tables[name].columns)


def test_a_table_in_latex_has_a_line_for_each_row(results: Results) -> None:
    """Numbers have three digits, and characters with a meaning in LaTeX are escaped."""
    lines = results.to_latex("verdicts", columns=["solver", "error_move", "p50_us"]).splitlines()
    rows = [line for line in lines if line.endswith(r"\\")]
    assert len(rows) == 1 + len(results.verdict())
    assert rows[0] == r"solver & first-move error [max. increments] & p50 [$\mu$s] \\"
    cells = rows[1].split("&")[1:]
    assert all(len(re.findall(r"[1-9]", cell.split("\\cdot")[0])) <= 3 for cell in cells)
    (head,) = (line for line in results.to_latex().splitlines() if line.startswith("solver &"))
    assert head.count("&") < 8 and "first-move error" in head
    assert r"in its columns timed\_on and p99\_on" in results.to_latex()
    # Of one that was not run alone, its errors and times are empty columns.
    timed = results.verdict().groupby("solver")["p50_us"].transform("count")
    never = results.to_latex(solvers=[*results.verdict()[timed == 0]["solver"].unique()])
    assert "p99" not in never and "& verdict " in never
    assert r"p99\_on" not in results.to_latex(columns=["solver", "p50_us"])
    with pytest.raises(InputError, match="verdicts"):
        results.to_latex("verdict")
    with pytest.raises(InputError, match="p50_us"):
        results.to_latex("verdicts", columns=["p50"])


def test_rows_of_a_table_in_latex_can_be_chosen(results: Results) -> None:
    verdict = results.verdict()
    assert {"not run", "pass"} < set(verdict["verdict"]) and verdict["solver"].nunique() > 2
    known = results.to_latex(solvers=["daqp", "osqp"], only_run=True)
    chosen = verdict[verdict["solver"].isin(["daqp", "osqp"]) & (verdict["verdict"] != "not run")]
    assert 0 < len(chosen) < len(verdict[verdict["verdict"] != "not run"])
    solvers = [line.split(" & ")[0] for line in known.splitlines() if line.endswith(r"\\")]
    assert solvers == ["solver", *chosen["solver"]]
    assert "not run" in results.to_latex() and "not run" not in known
    assert results.to_latex(chosen, ["solver"]).count(r"\\") == 1 + len(chosen)
    with pytest.raises(InputError, match=r"found 'dapq'; allowed: one of daqp"):
        results.to_latex(solvers=["dapq"])
    with pytest.raises(InputError, match="found 'solver'"):
        results.to_latex("paired_ratios", solvers=["daqp"])


def test_every_table_in_latex_is_complete_ascii(results: Results) -> None:
    """Braces and dollars are balanced, and every row has the cells of the head."""
    for name, table in results.tables.items():
        text = results.to_latex(name)
        assert text.isascii(), name
        bare = re.sub(r"\\[\\{}$]", "", text)
        assert bare.count("{") == bare.count("}") and bare.count("$") % 2 == 0, name
        rows = [line for line in text.splitlines() if line.endswith(r"\\")]
        usual = 8 if name == "verdicts" else len(table.columns)
        assert all(len(re.findall(r"(?<!\\)&", row)) == usual - 1 for row in rows), name


def test_an_unknown_table_is_named_with_the_nearest(results: Results) -> None:
    with pytest.raises(KeyError, match="no table 'verdict'; allowed: one of verdicts"):
        results.tables["verdict"]
    with pytest.raises(KeyError, match="no table 3; allowed: one of "):
        results.tables[3]


def test_a_ratio_of_one_run_to_itself_is_empty_in_latex(results: Results) -> None:
    rows = results.paired_ratios()[["ratio", "low", "high", "finding"]][:2]
    rows = rows.assign(ratio=[1.0, 2.04], low=[0.0, 1.9], high=[np.inf, 2.1])
    text = results.to_latex(rows.assign(finding=["one run", "slower"]))
    assert "An empty ratio: both names are of one run." in text
    assert "of one run" not in results.to_latex(rows.assign(finding="slower"))
    assert "\n &  &  & one run" in text and "\n2.04 & 1.90 & 2.10 & slower" in text


def test_rows_of_a_table_keep_its_caption_in_latex(results: Results) -> None:
    """The contents, steps and rounds; a frame that is no table of the report has none."""
    caption = results.to_latex("ladder").splitlines()[-1]
    ladder = results.ladder()
    some = ladder[ladder["p50_us"] > 0.0].copy()
    assert results.to_latex(some).splitlines()[-1] == caption
    assert caption.startswith("% Caption: ") and " rounds." in caption
    assert "Caption" not in results.to_latex(pd.DataFrame({"a": [1.0]}))


@pytest.mark.parametrize("name", ["verdicts", "experiments", "hard_steps", "paired_ratios"])
def test_tables_of_a_study_alone_have_columns_without_rows(
    name: str, results: Results, records: Any, tmp_path: Path
) -> None:
    records.sea("daqp", 0, 1, {"N_p": 20.0})
    study = load_results(records.write(tmp_path / "study"))
    assert study.tables[name].empty
    assert list(study.tables[name].columns) == list(results.tables[name].columns)
    assert study.verdict().query("solver == 'daqp' and p50_us > 0").empty


def test_a_table_without_ratios_names_the_study() -> None:
    assert "vary the horizon in a study" in repr(RatioTable())
    assert "vary the horizon" not in repr(RatioTable({"ratio": [1.0]}))


def test_ratios_are_shown_with_their_definition_and_reach(results: Results) -> None:
    """In text, in a notebook, and in the caption of LaTeX, of a frame of some columns too."""
    ratios = results.paired_ratios()
    frame = results.to_latex(ratios, ["first", "second", "ratio", "low", "high"])
    stored = results.to_latex("paired_ratios")
    for text in (
        repr(ratios),
        ratios._repr_html_(),
        frame.replace("\\%", "%"),
        stored.replace("\\%", "%"),
    ):
        assert "geometric mean of the step times of the second over those of the first" in text
        assert "95 % interval, for these measurements only" in text
    assert type(ratios[["ratio"]]) is pd.DataFrame


def test_ladder_and_ratios_are_of_the_same_solvers(results: Results) -> None:
    ladder, ratios = results.ladder(), results.paired_ratios()
    assert ladder["solver"].is_unique
    fastest_first = ratios["first"] == ratios["first"][0]
    assert ratios.loc[fastest_first, "second"].isin(ladder["label"]).sum() == len(ladder) - 1
    fastest = ladder.set_index("label").loc[ratios["first"][0]]
    known = ladder["limiting_p99_us"].notna()
    assert fastest["limiting_p99_us"] == ladder[known]["limiting_p99_us"].min()
    assert ((ratios["low"] <= ratios["ratio"]) & (ratios["ratio"] <= ratios["high"])).all()
    tied = (ratios["low"] <= 1.0) & (ratios["high"] >= 1.0) & np.isfinite(ratios["high"])
    np.testing.assert_array_equal(ratios["finding"] == "tied", tied)


def test_hard_steps_lie_in_their_runs(results: Results) -> None:
    hard = results.hard_steps()
    known = set(zip(results.steps["run_id"], results.steps["k"], strict=True))
    assert set(zip(hard["run_id"], hard["k"], strict=True)) <= known


def test_results_say_what_they_are(results: Results) -> None:
    solvers = results.runs["solver"].nunique()
    name = f"<Results synthetic: {len(results.runs)} runs of {solvers} solvers"
    assert repr(results).startswith(name)
    finished = results.runs.assign(outcome="finished")
    stopped = finished.assign(outcome=finished["outcome"].where(finished.index > 1, "timed_out"))
    assert repr(replace(results, runs=finished)).startswith(f"{name}>")
    assert repr(replace(results, runs=stopped)).startswith(f"{name}, 2 timed_out>")
    html = results._repr_html_()
    assert "<script" not in html and "style" not in html
    assert all(f"<td>{solver}</td>" in html for solver in results.ladder()["solver"])
    assert results.answer.split(":")[0] in html


@pytest.mark.parametrize("switches", [0, 67])
def test_results_name_what_disturbed_their_times(results: Results, switches: int) -> None:
    """As `report.md`, in text and in HTML; a quiet machine is not mentioned."""
    quiet = dict.fromkeys(
        ["disturbed_rounds", "counting_disturbed", "steal_s", "throttle_events"], 0
    )
    runs = results.runs.assign(**quiet, replay_s=1.0, involuntary_switches=switches)
    shown = replace(results, runs=runs)
    cause = "67 involuntary context switches per second"
    warning = f"the machine was affected by other load: {cause}. Times under such load do not"
    for text in (repr(shown), shown._repr_html_()):
        assert (warning in text.replace("The machine", "the machine")) == (switches > 0)
        assert ("affected by other load" in text) == (switches > 0)


def test_results_name_a_lost_ship_before_their_verdicts(results: Results) -> None:
    """In text, and in HTML before the table; a ship on station has no warning."""
    left = {"exact_steps": 40.0, "exact_left_s": 3.0, "exact_offset_max_m": 9.0}
    lost = replace(results, runs=results.runs.assign(**left))
    html = str(lost._repr_html_())
    assert f"; {BANNER}" in repr(lost)
    assert html.startswith(f"<p>{BANNER}") and html.count(BANNER) == 1
    assert html.index("</p><table>") < html.index("<tbody>")
    kept = replace(lost, runs=lost.runs.assign(exact_left_s=np.nan))
    assert BANNER not in repr(kept) and str(kept._repr_html_()).startswith("<table>")


@pytest.mark.slow
def test_a_comparison_says_what_it_found(campaign: Path) -> None:
    found = compare(campaign, campaign)
    assert "no regression" in repr(found) and len(repr(found)) < 100
    html = found._repr_html_()
    assert "<script" not in html
    assert all(table.title in html for table in found.tables)


def test_a_folder_without_steps_has_the_tables_of_its_report(
    results: Results, campaign: Path, tmp_path: Path
) -> None:
    """As `results/reference`: runs and written tables are there, and what needs steps is named."""
    part = tmp_path / "part"
    part.mkdir()
    for name in ("runs.parquet", "suite.json", "machine.json"):
        shutil.copy(campaign / name, part / name)
    with pytest.raises(InputError, match=r"found 'x'; allowed: none, as there are no tables"):
        load_results(part).to_latex("x")
    results.to_csv(part / "tables")
    stored = load_results(part)
    assert repr(stored) == repr(results)
    identity = ["solver", "route", "policy", "settings", "options"]
    assert "no steps.parquet. Required: a new run of the suite" in stored._repr_html_()
    stored.to_csv(tmp_path / "copied")
    for file in sorted((part / "tables").iterdir()):
        assert (tmp_path / "copied" / file.name).read_bytes() == file.read_bytes()
    for name in ("verdict", "ladder", "ships"):
        table, original = getattr(stored, name)(), getattr(results, name)()
        assert list(table.columns) == list(original.columns) and len(table) == len(original)
    assert stored.verdict()[identity].equals(results.verdict()[identity].astype("str"))
    assert len(stored.runs.merge(stored.verdict()[identity])) > 0
    with pytest.raises(ResultsError, match=r"steps\.parquet"):
        stored.steps  # noqa: B018 - reading it is the test
    with pytest.raises(ResultsError, match=r"steps\.parquet"):
        stored.plot.times()
    with pytest.raises(ResultsError, match=r"steps\.parquet: no such file; required: a new run"):
        stored.paired_ratios("daqp", "osqp")
    with pytest.raises(ResultsError, match=r"study\.csv.*required: .*verdicts"):
        stored.tables["study"]
    required = r"This one was published without them: open its report\.html, .* `dpbench run SUITE`"
    with pytest.raises(ResultsError, match=rf"steps\.parquet: no such file; .*{required}"):
        write_report(part)


@pytest.mark.slow
def test_the_reference_results_can_be_loaded() -> None:
    reference = load_results(Path(__file__).parents[2] / "results" / "reference")
    with pytest.raises(ResultsError, match=r"steps\.parquet: no such file"):
        reference.recorded.read_run(reference.runs["run_id"].iloc[0])
    verdict = reference.verdict()
    assert set(verdict["verdict"]) <= {*STATES}
    assert set(verdict["solver"]) <= set(reference.runs["solver"])
