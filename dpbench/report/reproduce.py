"""The paper from nothing: its loops, Figures 4-7, the data behind each, the table of its claims."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.paper import (
    PAPER,
    Law,
    read_laws_in_paper_scenario,
    tabulate_paper_figure,
)
from dpbench.bench.campaign import run_campaign
from dpbench.bench.design import Designs, compute_linear_record
from dpbench.bench.progress import Progress
from dpbench.bench.record.machine import describe_version
from dpbench.bench.record.result_folder import Results, load_results, read_lost_count_and_remarks
from dpbench.files.regular_files import write_bytes_atomically, write_text_atomically
from dpbench.report.charts.render import encode_figure
from dpbench.report.formats import make_markdown_table, plural, strip_markdown
from dpbench.report.page.citations import format_citations
from dpbench.report.page.section import Topic
from dpbench.report.report import convert_to_frame, encode_csv
from dpbench.report.topics.paper import (
    Claim,
    build_paper_topic,
    describe_count_reproduced,
    judge_claims,
)
from dpbench.report.words import render_document
from dpbench.scenario.scenario import Scenario

SUITE = "claims"
RUNS = "runs"
"""Result folder within that of the reproduction."""
FORMATS = ("pdf", "svg")
MOST_NAMED = 4
"""Number of claims named on the terminal that are not reproduced."""


@dataclass(frozen=True)
class Reproduction:
    """Outcome of reproducing the paper: summary lines, faults of runs, whether complete.

    lines : its description, at most ten; remarks : faults of the runs.
    complete : whether the benchmark lost none of them.
    """

    lines: tuple[str, ...]
    remarks: tuple[str, ...]
    complete: bool


def reproduce_paper(
    out: str | Path | None = None, *, progress: Progress | None = None
) -> Reproduction:
    """Run the paper's case with exact MPC and the baseline law; write and return figures, claims.

    Files as of `write_reproduction`; the runs are in the folder `runs` beside them. Finished
    loops are not run again.

    Parameters
    ----------
    out : the folder; by default `results/paper`.

    Raises
    ------
    InputError : when the folder cannot be written, or holds other runs.
    """
    folder = Path(out) if out is not None else Path("results") / PAPER
    return write_reproduction(run_campaign(SUITE, folder / RUNS, progress=progress), folder)


def write_reproduction(runs: Path, folder: Path) -> Reproduction:
    """Write figures, data and claims of the paper from a result folder's runs; return them.

    `figure4_path` to `figure7_increments` as PDF, SVG and CSV; `claims.md` and `claims.csv`.
    """
    results = load_results(runs)
    records = Records(results)
    scenario = records.build_scenario(PAPER)
    # How far off the ship is brought back from takes a quarter of a minute more: suite `standard`.
    designs = Designs((compute_linear_record(scenario),)) if scenario is not None else None
    topic = build_paper_topic(records, designs)
    lost, remarks = read_lost_count_and_remarks(runs)
    if topic is None or scenario is None:
        nothing = f"nothing is reproduced: no loop of the paper's case was finished; see {runs}"
        return Reproduction((nothing,), tuple(remarks), complete=False)
    _write_paper_figures(folder, topic, read_laws_in_paper_scenario(records), scenario)
    write_bytes_atomically(folder / "claims.csv", encode_csv(convert_to_frame(topic.tables[0])))
    write_text_atomically(folder / "claims.md", _make_claims_document(topic, results))
    judged = judge_claims(records)
    radius = compute_linear_record(scenario).spectral_radius
    stable = (
        f"stability: largest |λ| {radius:.4f} (eq. 35); largest sway offset: "
        f"`dpbench check {PAPER}`"
    )
    places = (
        f"figures 4-7: {folder / 'figure*.pdf'}, .svg and .csv",
        f"claims: {folder / 'claims.md'} and .csv",
        f"runs: {folder / RUNS}; `dpbench report` writes their report",
    )
    wording = (
        f"{describe_count_reproduced(judged)}.",
        *_list_contradicted(judged),
        stable,
        *places,
    )
    return Reproduction(wording, tuple(remarks), complete=lost == 0)


def _write_paper_figures(
    folder: Path, topic: Topic, laws: Sequence[Law], scenario: Scenario
) -> None:
    """Write the figures of the paper in all formats, with their data as CSV."""
    for number, figure in enumerate(topic.figures, 4):
        short = figure.name.removeprefix(f"{topic.id}-")
        name = f"figure{number}_{short}"
        for kind in FORMATS:
            write_bytes_atomically(folder / f"{name}.{kind}", encode_figure(figure.chart, kind))
        data = pd.concat([tabulate_paper_figure(short, law, scenario) for law in laws])
        write_bytes_atomically(folder / f"{name}.csv", encode_csv(data))


def _make_claims_document(topic: Topic, results: Results) -> str:
    """Return the text on the paper's claims and how far the runs confirm them."""
    versions = results.runs.drop_duplicates("solver")[["solver", "solver_version", "build"]]
    ran = [" ".join(filter(None, row)) for row in versions.itertuples(index=False)]
    tables = [
        (table.title, make_markdown_table(table.heads, table.rows, len(table.heads)), table.note)
        for table in topic.tables
    ]
    made = describe_version(results.suite)
    return render_document(
        "claims.md",
        topic=topic,
        tables=tables,
        ran=ran,
        made_by=made,
        runs=RUNS,
        cite=format_citations(results),
    )


def _list_contradicted(judged: Sequence[Claim]) -> list[str]:
    """Return the claims that the runs contradict or do not cover, at most `MOST_NAMED`."""
    named = [f"{claim.state}: “{claim.claim}”" for claim in judged if claim.state != "reproduced"]
    rest = len(named) - MOST_NAMED
    unnamed = [f"and {plural(rest, 'other')}: see claims.md"] if rest > 0 else []
    return [strip_markdown(line) for line in named[:MOST_NAMED]] + unnamed
