"""The part of the report on the ship's computer."""

from pathlib import Path

import pandas as pd
import pytest

from dpbench.embedded.table import EMBEDDED_FILE, write_counted_steps_atomically
from dpbench.report.documents.markdown import make_report_markdown
from dpbench.report.report import Report
from dpbench.report.write import write_report_with_summary
from tests.conftest import MadeRecords
from tests.embedded.made_counts import make_counts

NATIVE = {"route": "native", "policy": "warm"}


def counts() -> pd.DataFrame:
    return pd.concat(
        [make_counts("daqp", [2_000_000] * 200), make_counts("quadprog", [4_500_000] * 200)]
    )


@pytest.fixture
def judged(records: MadeRecords) -> MadeRecords:
    """Two solvers that pass; the one with fewer instructions is the slower one on the desk."""
    for solver, median_us in (("daqp", 40.0), ("quadprog", 20.0)):
        records.loop(solver, steps=1000, **NATIVE)
        records.replay(solver, median_us=median_us, **NATIVE)
    return records


def notes(report: Report) -> dict[str, str]:
    return dict(report.recommendation.notes)


def test_counts_are_named_beside_the_speed_margin(judged: MadeRecords) -> None:
    without = notes(Report.from_results(judged.results()))
    assert "counted" not in without
    found = notes(Report.from_results(judged.results(), counted=counts()))
    assert "may be up to" in found["margin"]
    # 4.5 million instructions at one cycle each and 100 MHz: 45 ms of 300 ms.
    assert (
        "executes at most 4\u202f500\u202f000 instructions per step (steps 0 to 199 of `paper`). "
        in found["counted"]
    )
    assert (
        "take 45.0 ms at an assumed 1 cycle per instruction and 100 MHz, 15 % of the deadline"
        in found["counted"]
    )
    assert "do not bound the worst-case execution time" in found["counted"]


def test_counts_beyond_the_required_error_replace_nothing(judged: MadeRecords) -> None:
    loose = make_counts("quadprog", [1000] * 200, error=0.5)
    assert "margin" in notes(Report.from_results(judged.results(), counted=loose))


def test_the_topic_names_the_disagreement(judged: MadeRecords) -> None:
    report = Report.from_results(judged.results(), counted=counts())
    (topic,) = (topic for topic in report.topics if topic.id == "embedded")
    assert topic.lines[0].startswith(
        "The solvers' C code was compiled for a Cortex-M7 and run in an emulator. In steps 0 to "
        "199 of `paper` on a Cortex-M7, `daqp` has the smallest p99 of the 2 accurate solvers: "
    )
    (line,) = (line for line in topic.lines if "rank solvers differently" in line)
    assert "`daqp` executes fewer instructions than `quadprog`" in line
    assert "but is slower here" in line
    (table,) = topic.tables
    first = dict(zip(table.heads, table.rows[0], strict=True))
    assert (first["solver"], first["desk rank"]) == ("daqp", "2")
    # With constants, and with heap.
    assert (first["code"], first["static"]) == ("20\u202f500", "3\u202f064")


def test_unequal_settings_and_loops_without_counts_are_named(judged: MadeRecords) -> None:
    judged.loop("daqp", "turn", **NATIVE)
    judged.replay("osqp", median_us=30.0, **NATIVE)
    tight = make_counts("osqp", [3_000_000] * 200, settings='{"eps_abs": 1e-06, "rho": 0.25}')
    report = Report.from_results(judged.results(), counted=pd.concat([counts(), tight]))
    (topic,) = (topic for topic in report.topics if topic.id == "embedded")
    assert (
        "`osqp` is not ranked, because its settings differ. Its C code runs with eps_abs = 1e-06 "
        "and rho = 0.25. On this machine, the solver runs with the default settings (adaptive_rho "
        "= 1, adaptive_rho_interval = 50)."
    ) in topic.tables[0].note
    uncounted = "Instructions were not counted for the QPs of `turn`, which may take more."
    assert uncounted in topic.tables[0].note and uncounted in notes(report)["counted"]


def test_what_was_not_counted_is_stated_once_a_reason(judged: MadeRecords) -> None:
    judged.suite["not_counted"] = [
        {"solver": solver, "target": "m7", "sequence": "paper[0:200]", "reason": "no compiler"}
        for solver in ("daqp", "osqp")
    ]
    report = Report.from_results(judged.results())
    (topic,) = (topic for topic in report.topics if topic.id == "embedded")
    line = (
        "Not counted: `daqp` and `osqp` in steps 0 to 199 of `paper` on a Cortex-M7: no compiler."
    )
    plain = line.replace("`", "")
    assert topic.lines == (line,)
    assert dict(report.summary_rows())["embedded"] == plain
    some = Report.from_results(judged.results(), counted=counts())
    ended = dict(some.summary_rows())
    assert plain == f"Not counted: {ended['not counted']}" != ended["embedded"]
    assert line in make_report_markdown(some)


def test_a_report_without_counts_has_no_such_part(judged: MadeRecords) -> None:
    assert "embedded" not in {topic.id for topic in Report.from_results(judged.results()).topics}


@pytest.mark.slow
def test_a_folder_with_counts_has_them_in_all_documents(
    judged: MadeRecords, tmp_path: Path
) -> None:
    out = judged.write(tmp_path / "out")
    write_counted_steps_atomically(counts(), out / EMBEDDED_FILE)
    page, ended = write_report_with_summary(out)
    assert "15 %" in dict(ended)["counted"]
    html, markdown = page.read_text(), (out / "report.md").read_text()
    assert 'id="core-times"' in html and "45.0 ms" in html and 'href="embedded.parquet"' in html
    assert "| daqp | paper[0:200] | Cortex-M7 | 2\u202f000\u202f000 |" in markdown
    assert (out / "figures" / "embedded.svg").is_file()
    table = pd.read_csv(out / "tables" / "embedded.csv").set_index("solver")
    assert table.loc["daqp", ["median", "code", "static", "desk_rank"]].tolist() == [
        *(2_000_000, 20_500, 3_064, 2)
    ]
