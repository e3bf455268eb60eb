"""Comparison of one solver with others in Markdown, as the comment on a pull request."""

import math
from collections.abc import Sequence

from dpbench.analysis.records.run_record import group_by_key
from dpbench.analysis.records.run_steps import Measure
from dpbench.analysis.records.thinned_runs import (
    WorstStep,
    find_value_at_worst_step,
    find_worst_steps,
)
from dpbench.analysis.times.paired_times import compare_paired_times, count_common_window_steps
from dpbench.analysis.verdict.verdict import (
    Verdict,
    list_best_verdict_of_each_solver,
    sort_best_first,
    sort_fastest_first,
)
from dpbench.errors import UnknownNameError, format_allowed_names
from dpbench.report.commands_text import describe_versions
from dpbench.report.documents.markdown import join_sections, make_ship_lines, make_solver_table
from dpbench.report.formats import (
    describe_wait,
    escape_markdown,
    escape_markdown_paragraph,
    format_count,
    format_error,
    format_time,
    join_with_and,
    make_markdown_table,
    one_line,
)
from dpbench.report.page.data import PageData
from dpbench.report.report import Report
from dpbench.report.verdict.findings_text import describe_findings
from dpbench.report.verdict.verdict_text import (
    describe_answer,
    describe_paired_times,
    describe_requirements,
    describe_short_times,
)
from dpbench.solvers.own_settings import split_into_solver_and_options_text

USUAL = ("osqp", "daqp")
"""Solvers to compare with by default."""
COMMENT_BYTES = 4000
"""Largest size of a comment [B], about one screen; its table of solvers is never cut."""
MOST_CONFIGURATIONS = 3
"""Rows of the solver itself, or one for each of its settings where these are more."""


def compare_solver(
    report: Report, solver: str, others: Sequence[str] = ()
) -> tuple[str, list[WorstStep]]:
    """Return a Markdown text that compares a solver with others, and the list of its worst steps.

    others : solvers to compare with; by default those of `USUAL` that ran.

    Raises InputError for a solver that was not run.
    """
    data, machine = report.data, report.recommendation.machine
    best = {v.configuration.solver: v for v in list_best_verdict_of_each_solver(data.verdicts)}
    for option, name in (("--for", solver), *(("--against", other) for other in others)):
        if name not in best:
            bare = split_into_solver_and_options_text(name)[0].partition(" ")[0]
            allowed = format_allowed_names(bare, sorted(best))
            if bare != name:
                allowed += ", without settings; `dpbench compare DIR --solver` accepts settings"
            raise UnknownNameError(option, "", repr(name), allowed)
    named = others or [name for name in USUAL if name in best]
    chosen = [best[name] for name in dict.fromkeys(named) if name != solver]
    own = [v for v in data.verdicts.of[solver] if v.state != "not run"]
    rows = _choose_rows_of_solver(best[solver], own)
    worst = find_worst_steps(data.records, rows[0].configuration)
    names = join_with_and([v.configuration.solver for v in chosen]) or "no other solver"
    solvers = [v.configuration.solver for v in (rows[0], *chosen)]
    versions = describe_versions(data.records, report.results.suite, solvers)
    ending = "".join(f"\n\n{escape_markdown_paragraph(text)}" for text in (machine, versions))
    head = [
        f"# {escape_markdown(solver)} compared with {escape_markdown(names)}",
        *make_ship_lines(report.recommendation.ship),
        escape_markdown_paragraph(_describe_verdict(rows[0], data.verdicts.of[solver][0], own)),
        make_solver_table(data, [*rows, *chosen]),
    ]
    sections = [
        "\n\n".join(filter(None, head)),
        "\n".join(f"- {escape_markdown(_compare_step_times(data, rows[0], v))}" for v in chosen),
        _make_worst_table(data, worst, chosen),
        "\n".join(f"    {one_line(s.export_command)}" for s in worst if s.export_command),
        COLD if any(s.export_command and s.run.policy == "warm" for s in worst) else "",
        escape_markdown_paragraph(describe_requirements(data.requirements)),
    ]
    kept = join_sections(sections, COMMENT_BYTES - len(ending.encode()) - 1, "report.md")
    return f"{kept}{ending}\n", worst


COLD = (
    "An exported step has no history. To repeat a warm start, export the steps 0 to K with "
    "`--steps K+1` and replay the file with `dpbench run --sequence FILE`."
)


def _choose_rows_of_solver(best: Verdict, own: Sequence[Verdict]) -> list[Verdict]:
    """Return the best verdict on each of a solver's settings, and others up to a least number.

    Those judged in closed loops and replays come first, sorted by `sort_best_first`. `best` is the
    first of them unless it fails.
    """
    ordered = sort_best_first(own)
    ordered.sort(key=lambda v: not _is_judged_in_both(v))
    if best.state != "fail":
        ordered.sort(key=lambda v: v is not best)
    by_settings = group_by_key(ordered, lambda v: v.configuration.settings).values()
    chosen = [alike[0] for alike in by_settings]
    others = [v for v in ordered if v not in chosen][: max(0, MOST_CONFIGURATIONS - len(chosen))]
    return [v for v in ordered if v in chosen or v in others] or [best]


def _is_judged_in_both(verdict: Verdict) -> bool:
    """Return whether a configuration was run in closed loop and timed in a replay."""
    return verdict.loops > 0 and verdict.replays > 0


def _describe_verdict(verdict: Verdict, reference: Verdict, own: Sequence[Verdict]) -> str:
    """Return a text on whether a solver's best configuration passes, and of how many it is best.

    reference : verdict on its usual call mode and settings; own : on all that were run.
    """
    label, findings = verdict.configuration.label, verdict.causes or verdict.findings_that_bar_pass
    verbs = {"pass": "passes everywhere it was run", "late": "is late", "fail": "fails"}
    why = "" if verdict.state == "pass" else f": {describe_findings(findings)}"
    sentence = f"`{label}` {verbs.get(verdict.state, f'is {verdict.state}')}{why}."
    both = [v for v in own if _is_judged_in_both(v)]
    count = len(both or own)
    if count > 1:
        run = " with a closed loop and a replay" if 0 < len(both) < len(own) else ""
        sentence += f" It is the best of {count} call modes and settings{run}"
        usual = f"; usually called, `{reference.configuration.label}`: {reference.state}"
        sentence += "." if reference is verdict else f"{usual}."
    return sentence


def _compare_step_times(data: PageData, own: Verdict, other: Verdict) -> str:
    """Return a sentence that compares the step times of two verdicts' configurations."""
    faster, slower = sort_fastest_first([own, other])
    pair = data.records, faster, slower
    wording = describe_paired_times(compare_paired_times(*pair), count_common_window_steps(*pair))
    names = f"`{slower.configuration.label}` against `{faster.configuration.label}`"
    return f"{names}: {wording}. {describe_short_times(data.records, [faster, slower])}".rstrip()


def _make_worst_table(data: PageData, worst: Sequence[WorstStep], others: Sequence[Verdict]) -> str:
    """Return a Markdown table of a solver's worst steps, beside other solvers' values there."""
    if not worst:
        return ""
    names = [verdict.configuration.solver for verdict in others]
    heads = ("worst by", "step", "call mode", "figure", "its median", "answer", *names)
    rows = [
        (
            step.measure,
            _name_worst_step(step),
            step.run.configuration.call_text,
            _format_measure(step.measure, step.value) + describe_wait(step.value, step.wait_ns),
            _format_measure(step.measure, step.median),
            describe_answer(step.step, 0),
            *(
                _format_measure(
                    step.measure, find_value_at_worst_step(data.records, step, v.configuration)
                )
                for v in others
            ),
        )
        for step in worst
    ]
    return make_markdown_table(heads, rows, 3)


def _name_worst_step(step: WorstStep) -> str:
    """Return the number in the scenario and the run of a worst step in words."""
    loop = ", a closed loop" if step.run.mode == "closed_loop" else ""
    return f"{step.scenario_step} of {step.run.problem}{loop}"


def _format_measure(measure: Measure, value: float) -> str:
    """Return a time [ns], an error or a number of iterations as text, depending on `measure`."""
    if measure == "time":
        return format_time(value)
    return format_error(value) if measure == "error" else format_count(value)


def format_worst_steps(worst: Sequence[WorstStep]) -> list[tuple[str, str]]:
    """Return label and text of each worst step; that of a replay ends in its export command."""
    return [
        (
            f"worst {step.measure}",
            f"step {_name_worst_step(step)} ({step.run.configuration.call_text}): "
            f"{_format_measure(step.measure, step.value)}"
            f"{describe_wait(step.value, step.wait_ns)}, median "
            f"{_format_measure(step.measure, step.median)}"
            f"{f'; {step.export_command}' if step.export_command else ''}",
        )
        for step in worst
        if not math.isnan(step.value)
    ]
