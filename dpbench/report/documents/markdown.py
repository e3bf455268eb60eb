"""The report as Markdown text: `report.md`, and its table of solvers."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import compress

from dpbench.analysis.records.run_record import RunRecord, group_by_key
from dpbench.analysis.verdict.requirements import OWN_DOING
from dpbench.analysis.verdict.verdict import (
    Verdict,
    Verdicts,
    list_best_verdict_of_each_solver,
    list_main_verdicts,
    sort_best_first,
)
from dpbench.report.commands_text import describe_how_results_were_made, describe_subject
from dpbench.report.embedded_text import yield_uncounted_sentences
from dpbench.report.formats import (
    MISSING,
    describe_range_of_steps,
    describe_wait,
    escape_markdown,
    escape_markdown_paragraph,
    explain_range_of_steps,
    format_error,
    format_rounded_down,
    format_time,
    join_with_and,
    make_markdown_table,
)
from dpbench.report.own_settings_text import describe_failing_settings_and_grids
from dpbench.report.page.data import PageData
from dpbench.report.page.live import describe_failures_in_si
from dpbench.report.page.recommendation import Recommendation
from dpbench.report.page.section import Topic
from dpbench.report.report import Report
from dpbench.report.ship.ship_text import ShipSummary
from dpbench.report.topics.study import (
    yield_disturbance_sentences,
    yield_excluded_points_sentences,
    yield_tolerance_sentences,
)
from dpbench.report.verdict.findings_text import describe_findings, name_experiment
from dpbench.report.verdict.verdict_text import (
    describe_hardest_wait,
    describe_which_solvers_pass,
    format_p99_interval,
)

MOST_BYTES = 9000
"""Largest size of the report [B], about two screens; its head is never cut."""
MOST_ROWS = 24
"""Configurations up to which the report lists all of them, not only the best of each solver."""
MOST_LISTED = 48
"""Largest number of configurations in the table of solvers."""
MOST_EXCEPTIONS = 3
"""Configurations that a remark names; more are counted."""
MOST_STUDY_ROWS = 8
"""Rows of each table of a study in the report."""
HOW_MADE = "How these results were made"
"""Heading of the last paragraph, which a paper can copy."""
MARGIN = "speed margin"
"""Column that is left out where lateness is not judged."""
HEAD: tuple[str, ...] = (
    *("solver", "call mode, settings", "verdict", "p50", "limiting p99", "longest step", MARGIN),
    *("largest error [maximum increments]", "failed steps"),
)
CALL_MODES = (
    "A call mode is a route and a policy. Route `native` is the solver's own interface, "
    "`qpsolvers` the Python package. Policy `fresh` sets up the solver at every step, `reuse` "
    "keeps its workspace, and `warm` also starts from its last solution. Settings are `default` "
    "unless named; `low`, `mid` and `high` are tolerance presets."
)
FAILED_STEPS = (
    "The failed steps of all closed loops, replays and windows are added up: a step counts once "
    "in each run in which it fails. In a replay or window, a step counts if it fails in any round "
    "or in the warm-up."
)
FILES = (
    "All figures are in `report.html` and all steps in `steps.parquet`. The section “Files” of "
    "`report.html` describes the other files."
)
TERMS = "Terms: `docs/glossary.md` of dpbench."


def make_report_markdown(report: Report) -> str:
    """Return the report as Markdown text of limited length: recommendation, table of solvers."""
    data, results, recommendation = report.data, report.results, report.recommendation
    made = describe_how_results_were_made(data.records, results.suite, results.machine)
    ending = f"\n\n{FILES}\n\n## {HOW_MADE}\n\n{escape_markdown_paragraph(made)}\n"
    most_bytes = MOST_BYTES - len(ending.encode())
    counts = "\n\n".join(_make_counts_tables(report.topics))
    head = "\n\n".join(filter(None, _yield_head(report)))
    sections = [head, counts, *_yield_remarks(report), *_yield_study_tables(report.topics)]
    sections = _shorten(sections, most_bytes, recommendation, counts)
    return join_sections(sections, most_bytes, "report.html") + ending


def _yield_head(report: Report) -> Iterator[str]:
    """Yield the paragraphs down to the table of solvers and its notes."""
    data, recommendation = report.data, report.recommendation
    lead = [topic.lines[0] for topic in report.topics if topic.leads]
    wording = [note for about, note in recommendation.notes if about == "stopped"]
    if data.verdicts.of or not lead:
        wording = [recommendation.sentence, *(note for _, note in recommendation.notes)]
    suite = report.results.suite
    yield f"# dpbench: suite `{escape_markdown(str(suite.get('name', 'results')))}`"
    yield escape_markdown_paragraph(f"{describe_subject(data.records, suite)}.")
    yield from make_ship_lines(recommendation.ship)
    texts = [*lead, *wording, recommendation.machine, recommendation.requirements]
    yield from map(escape_markdown_paragraph, texts)
    listed = _list_verdicts(data.verdicts)[:MOST_LISTED]
    yield make_solver_table(data, listed)
    yield _explain_columns(data, listed)
    yield _unlisted_text(data.verdicts, len(listed))
    if data.verdicts.of:
        yield escape_markdown_paragraph(describe_which_solvers_pass(data.verdicts))


def _yield_remarks(report: Report) -> Iterator[str]:
    """Yield the paragraphs between the notes on the table of solvers and the tables of studies."""
    data, topics = report.data, report.topics
    remarks = [*describe_failing_settings_and_grids(data.records, data.verdicts)]
    remarks.append(describe_failures_in_si(data, beyond_verdicts=True))
    remarks += _yield_verdicts_by_scenario(data, report.recommendation)
    remarks += yield_disturbance_sentences(data.studies)
    remarks += yield_tolerance_sentences(data.studies)
    remarks += [f"{topic.title}: {topic.lines[0]}" for topic in topics if not topic.leads]
    remarks += yield_excluded_points_sentences(data.studies)
    if data.counts.sequences:
        remarks += yield_uncounted_sentences(data.counts.not_counted)
    yield from map(escape_markdown_paragraph, remarks)


def _shorten(
    sections: Sequence[str], most_bytes: int, recommendation: Recommendation, counts: str
) -> list[str]:
    """Return the sections of a report without as many dispensable parts as it takes to fit.

    counts : section of instruction counts. The legend of the table and the verdicts stay.
    """
    ship = recommendation.ship
    dispensable = {
        counts: "Instruction counts: `tables/embedded.csv`.",
        f"{escape_markdown_paragraph(ship.conditions)}\n\n": "",
        f" {escape_markdown_paragraph(ship.details)}": "",
        f" {escape_markdown_paragraph(_find_margin_details(recommendation))}": "",
    }
    shortened = list(filter(None, sections))
    for part, shorter in dispensable.items():
        if part.strip() and len("\n\n".join(shortened).encode()) > most_bytes:
            shortened = [section.replace(part, shorter, 1) for section in shortened]
    return shortened


def _find_margin_details(recommendation: Recommendation) -> str:
    """Return the note on the speed margin without its first sentence; "" for none."""
    note = dict(recommendation.notes).get("margin", "")
    return note.removeprefix(recommendation.margin).strip()


def _yield_verdicts_by_scenario(data: PageData, recommendation: Recommendation) -> Iterator[str]:
    """Yield a sentence on the first configuration's verdict in each scenario, if there is any."""
    if not recommendation.chips or recommendation.first is None:
        return
    by_state = group_by_key(recommendation.chips, lambda badge: badge.state_text)
    parts = []
    for state, badges in by_state.items():
        units = [data.experiments[b.experiment].units for b in badges if b.experiment is not None]
        names = join_with_and([f"`{badge.name}`" for badge in badges if badge.name])
        text = f"{names} (not counted): {state}" if units == ["si"] else f"{state} in {names}"
        parts.append(text if names else state)
    notation = explain_range_of_steps(run.sequence for run in data.runs.values())
    label = recommendation.first.marked_label
    yield f"Verdicts on {label}: {'; '.join(parts)}. {notation}".rstrip()


def _make_counts_tables(topics: Sequence[Topic]) -> list[str]:
    """Return the table of counts on embedded cores with its title and note, if there is one."""
    return [
        "\n\n".join(
            [
                f"{topic.title}: instructions per step, memory, error, and p99 on this machine.",
                make_markdown_table(table.printed_heads, table.rows, table.text_columns),
                table.note,
            ]
        )
        for topic in topics
        if topic.id == "embedded"
        for table in topic.tables
    ]


def _yield_study_tables(topics: Sequence[Topic]) -> Iterator[str]:
    """Yield a section for each table of a study with intervals: title, first rows, note."""
    tables = [table for topic in topics if topic.id == "study" for table in topic.tables]
    for table in tables:
        if table.note:
            more = len(table.rows) - MOST_STUDY_ROWS
            rows = table.rows[:MOST_STUDY_ROWS]
            parts = [
                f"{escape_markdown(table.title)}:",
                make_markdown_table(table.printed_heads, rows, table.text_columns),
                f"{more} more rows: `tables/study_*.csv`." if more > 0 else "",
                escape_markdown_paragraph(table.note),
            ]
            yield "\n\n".join(filter(None, parts))


def _list_verdicts(verdicts: Verdicts) -> list[Verdict]:
    """Return the verdicts of the page's ladder, or all by solver where there are few."""
    main, ran = list_main_verdicts(verdicts), _count_configurations(verdicts)
    if ran == len(main) or ran > MOST_ROWS:
        return main
    listed = {
        verdict.configuration: verdict
        for best in list_best_verdict_of_each_solver(verdicts)
        for verdict in (best, *sort_best_first(verdicts.of[best.configuration.solver]))
    }
    return [verdict for verdict in listed.values() if verdict.state != "not run"]


def _count_configurations(verdicts: Verdicts) -> int:
    """Return how many configurations were run."""
    return sum(verdict.state != "not run" for verdict in verdicts.all_verdicts)


def _explain_columns(data: PageData, listed: Sequence[Verdict]) -> str:
    """Return a note on the call modes and columns of the table of solvers; "" without rows."""
    if not listed:
        return ""
    notes = [CALL_MODES, _explain_speed_margin(data, listed), FAILED_STEPS, TERMS]
    return " ".join(filter(None, notes))


def _explain_speed_margin(data: PageData, listed: Sequence[Verdict]) -> str:
    """Return how the columns of the table give the speed margin; "" without one."""
    timed = [(v, m) for v in listed if (m := data.get_speed_margin(v.configuration))]
    if not timed:
        return ""
    requirements = data.requirements
    is_scaled = any(
        max(m.p99.run.untimed_iterations, m.hardest.run.untimed_iterations_max) > 1.0
        for _, m in timed
    )
    scaled = (
        " The p99 is scaled up if the p99 of iterations is larger in the closed loop. The longest "
        "step is scaled up if the largest number of iterations is larger there." * is_scaled
    )
    without = " (without a p99: longest step)" * any(math.isnan(v.p99_ns) for v, _ in timed)
    return (
        "The limiting p99 is the largest p99 of all replays and windows, and the longest step is "
        "their largest step time."
        f"{scaled} The speed margin is the factor by which the ship's computer may be slower than "
        "this machine, rounded down; if it is below 1, the computer must be faster. The margin is "
        "the smaller of two ratios: "
        f"{requirements.p99_ms:g} ms / limiting p99{without} and {requirements.deadline_ms:g} ms / "
        "longest step."
    )


def _unlisted_text(verdicts: Verdicts, listed: int) -> str:
    """Return a note that names the file with the verdicts not listed; "" where all are listed."""
    more = _count_configurations(verdicts) - listed
    if more == 1:
        return "The verdict on one more configuration is in `tables/verdicts.csv`."
    return f"The verdicts on {more} more configurations are in `tables/verdicts.csv`." * (more > 0)


def make_ship_lines(ship: ShipSummary) -> list[str]:
    """Return the first lines of a Markdown document: what the controller does to the ship."""
    bold = (
        f"**{text}**" if text else ""
        for text in map(escape_markdown_paragraph, (ship.warning, ship.caution))
    )
    warning, caution = bold
    others = map(escape_markdown_paragraph, (ship.text, ship.conditions, ship.wash))
    text, conditions, wash = others
    return [line for line in (warning, text, caution, conditions, wash) if line]


def make_solver_table(data: PageData, verdicts: Iterable[Verdict]) -> str:
    """Return a Markdown table of verdict, times and errors by configuration; "" without one."""
    listed = list(verdicts)
    rows = make_solver_rows(data, listed)
    if not rows:
        return ""
    shown = [
        head != MARGIN or set(cells) != {MISSING} for head, *cells in zip(HEAD, *rows, strict=True)
    ]
    heads, *kept = ([*compress(cells, shown)] for cells in (HEAD, *rows))
    return "\n\n".join(
        [
            make_markdown_table(heads, kept, 3),
            *map(escape_markdown_paragraph, yield_table_remarks(listed)),
        ]
    )


def yield_table_remarks(verdicts: Sequence[Verdict]) -> Iterator[str]:
    """Yield remarks: the replay of each time where they differ, the user's settings' options."""
    timed = [verdict for verdict in verdicts if verdict.timed_on]
    usual = {
        v.configuration.marked_label: f"the replay of {describe_range_of_steps(v.timed_on)}"
        for v in timed
    }
    placed = [v for v in verdicts if v.longest_run is not None]
    worst = {
        v.configuration.marked_label: _where(v.p99_run) for v in placed if not math.isnan(v.p99_ns)
    }
    hardest = {v.configuration.marked_label: _where(v.longest_run) for v in placed}
    if len({*usual.values()}) > 1 or any(verdict.replays > 1 for verdict in timed):
        yield _locate_times("p50", usual, "from")
    if any(_is_window(v.p99_run) for v in placed):
        yield (
            "A window is a replay of a few steps around the hardest step of a scenario; its p99 "
            "has no confidence interval."
        )
    for name, found in (("limiting p99", worst), ("longest step", hardest)):
        if any(found[label] != usual.get(label, "") for label in found):
            yield _locate_times(name, found, "in")
    ended = [
        f"{v.configuration.marked_label}: {describe_findings(causes)}"
        for v in verdicts
        if (causes := [finding for finding in v.causes if finding.kind in OWN_DOING])
    ]
    if ended:
        more = f"; and {len(ended) - MOST_EXCEPTIONS} more" * (len(ended) > MOST_EXCEPTIONS)
        yield f"Runs that crashed or hung: {'; '.join(ended[:MOST_EXCEPTIONS])}{more}."
    own = {
        f"`{v.configuration.solver}` {v.configuration.settings}: {v.configuration.options_text}"
        for v in verdicts
        if v.configuration.options_text
    }
    if own:
        yield f"Custom settings: {'; '.join(sorted(own))}."


def _is_window(run: RunRecord | None) -> bool:
    """Return whether a time is from a window."""
    return run is not None and run.steps_searched_for_hardest > 0


def _where(run: RunRecord | None) -> str:
    """Return the name of the replay or window of a time; "" for none."""
    return "" if run is None else name_experiment(run)


def _locate_times(time: str, names: Mapping[str, str], preposition: str) -> str:
    """Return a sentence on the replays or windows of a time, named by configuration.

    Few exceptions are named, more are counted.

    Examples
    --------
    >>> _locate_times("longest step", {"daqp": "turn", "osqp": "turn", "piqp": "rough"}, "in")
    'The longest step is in turn, with one exception: for piqp, it is in rough.'
    """
    of_name = group_by_key(names, lambda label: names[label])
    most, *others = sorted(of_name, key=lambda name: -len(of_name[name]))
    lead = f"The {time} is {preposition} {most}"
    if not others:
        return f"{lead}."
    if sum(len(of_name[name]) for name in others) > MOST_EXCEPTIONS:
        counts = [f"{preposition} {name} for {len(of_name[name])}" for name in others]
        first = f"{lead} for {len(of_name[most])} of the {len(names)} configurations"
        return f"{join_with_and([first, *counts])}."
    clauses = [f"for {join_with_and(of_name[name])}, it is {preposition} {name}" for name in others]
    exceptions = "one exception" if len(others) == 1 else f"{len(others)} exceptions"
    return f"{lead}, with {exceptions}: {'; '.join(clauses)}."


def make_solver_rows(data: PageData, verdicts: Iterable[Verdict]) -> list[tuple[str, ...]]:
    """Return rows of text cells with each configuration's verdict, times and errors."""
    return [
        (
            verdict.configuration.solver,
            verdict.configuration.call_text,
            verdict.state,
            format_time(verdict.p50_ns),
            format_time(verdict.p99_ns)
            + format_p99_interval(verdict.p99_interval)
            + describe_wait(verdict.p99_ns, verdict.p99_wait_ns),
            format_time(verdict.longest_ns)
            + describe_hardest_wait(data.records, verdict.longest_run),
            MISSING
            if margin is None
            else f"× {format_rounded_down(margin.allowed_slowness_factor)}",
            format_error(verdict.error_move),
            str(verdict.failed_steps),
        )
        for verdict in verdicts
        for margin in [data.get_speed_margin(verdict.configuration)]
    ]


def join_sections(sections: Iterable[str], most_bytes: int, elsewhere: str) -> str:
    """Return as many sections as fit into a number of bytes, each whole, but at least the first.

    If some are left out, the text names the file with more.
    """
    kept = [section for section in sections if section]
    text = "\n\n".join(kept)
    notice = f"Further results are left out here; they are in `{elsewhere}`."
    while len(text.encode()) > most_bytes and len(kept) > 1:
        kept.pop()
        text = "\n\n".join([*kept, notice])
    return text
