"""Verdicts on custom settings in plain words, and the best of each grid of them."""

import math
from collections.abc import Sequence

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import group_by_key
from dpbench.analysis.times.paired_times import MACHINE_DISTURBED, compare_configurations
from dpbench.analysis.verdict.requirements import STATES
from dpbench.analysis.verdict.verdict import (
    ACCURATE,
    LEAST_POINTS,
    MOST_OWN,
    BestSettings,
    Verdict,
    Verdicts,
    choose_best_settings,
    find_ranking_time_ns,
    find_solver_record_or_none,
    group_own_settings,
    list_best_verdict_of_own_settings,
    list_equally_fast,
    sort_points_of_grids_last,
)
from dpbench.report.formats import (
    as_float,
    format_error,
    format_time,
    join_with_and,
    plural,
    significant,
    strip_markdown,
)
from dpbench.report.page.data import PageData
from dpbench.report.verdict.findings_text import describe_finding
from dpbench.report.verdict.verdict_text import (
    describe_kinds_of_reasons,
    describe_limiting_time,
    describe_paired_times,
    describe_tolerances_left,
)
from dpbench.solvers.own_settings import decode_options_from_json, format_each_option_as_toml
from dpbench.solvers.settings import resolve_settings_with_fixed_options

SIMILAR = 2.0
"""Factor below which largest errors differ little, so that a wider grid would hardly help."""
NOT_RANKED = "times are not ranked, as the machine was disturbed"
EQUALS = {"time": "equally fast within the noise", "iterations": "with the same p50"}
"""Words on settings that are as good as the best, by the figure that it is best by."""
MOST_EQUAL = 2
"""Settings that are named as equally fast; of the others their number is."""


def describe_own_settings(records: Records, verdicts: Verdicts) -> list[str]:
    """Return lines on the verdict on each custom settings, and the best of each grid."""
    own = _leave_out_failing_grids(verdicts)
    lines = describe_verdicts_on_settings(verdicts, own)
    others = len(own) - MOST_OWN
    more = [f"{others} more settings: tables/verdicts.csv."] if others > 0 else []
    return [*lines, *more, *describe_best_of_grids(records, verdicts)]


def describe_failing_settings_and_grids(records: Records, verdicts: Verdicts) -> list[str]:
    """Return lines on the custom settings that fail, and why, and the best of each grid."""
    failing = [v for v in _leave_out_failing_grids(verdicts) if v.state == "fail"]
    best = describe_best_of_grids(records, verdicts)
    return [*describe_verdicts_on_settings(verdicts, failing), *best]


def _leave_out_failing_grids(verdicts: Verdicts) -> list[Verdict]:
    """Return the best verdicts on custom settings, without grids of which every point fails."""
    failing = [v for points in list_grids(verdicts) if _do_all_fail(points) for v in points]
    return [v for v in list_best_verdict_of_own_settings(verdicts) if v not in failing]


def _do_all_fail(points: Sequence[Verdict]) -> bool:
    """Return whether every point of a grid fails."""
    return all(verdict.state == "fail" for verdict in points)


def describe_verdicts_on_settings(verdicts: Verdicts, own: Sequence[Verdict]) -> list[str]:
    """Return lines on verdicts on custom settings, grids last, else passes first.

    At most `MOST_OWN` lines.
    """
    modes = group_own_settings(verdicts)
    passes_first = sorted(own, key=lambda v: STATES.index(v.state))
    shown = sort_points_of_grids_last(passes_first)[:MOST_OWN]
    return [
        _describe_verdict_on_settings(v, modes[v.configuration.solver, v.configuration.options])
        for v in shown
    ]


def describe_own_settings_in_si(data: PageData) -> list[str]:
    """Return a line on custom settings that fail in SI units; these runs enter no verdict."""
    unscaled = [p for p in data.judged_experiment_indices if data.experiments[p].units == "si"]
    own = [c for c, configuration in enumerate(data.configurations) if configuration.options]
    states = {c: {data.get_state_in_experiment(c, p) for p in unscaled} - {"not run"} for c in own}
    ran = [c for c, known in states.items() if known]
    failing = [c for c in ran if "fail" in states[c]]
    if not failing:
        return []
    verb = "fails" if 1 in (len(ran), len(failing)) else "fail"
    return [
        f"In SI units (N, N·m), {len(failing)} of {len(ran)} custom settings {verb}: scale the QP. "
        "These runs do not count towards the verdicts."
    ]


def _name_own_settings(verdict: Verdict) -> str:
    """Return the name of a solver with one's own settings, as `osqp[rho=1.6]` or `osqp mine`."""
    c = verdict.configuration
    return f"{c.solver} {c.settings}" if c.options_text else f"{c.solver}[{c.settings}]"


def _describe_verdict_on_settings(verdict: Verdict, modes: Sequence[Verdict]) -> str:
    """Return verdict, error, failed steps and p99 of a solver at custom settings as text.

    modes : verdicts on all call modes of these settings, of which the verdict is the best.
    """
    c = verdict.configuration
    best = f", best of {len(modes)} call modes" if len(modes) > 1 else ""
    name = f"{_name_own_settings(verdict)} ({c.route} {c.policy}{best})"
    if verdict.refusal:
        return f"{name}: {verdict.state}: {verdict.refusal}."
    time = f"; {describe_limiting_time(verdict)}" if verdict.timed_on else ""
    why = f": {reasons}" if (reasons := describe_kinds_of_reasons(verdict)) else ""
    notes = f"; {options}" if (options := _describe_options(verdict)) else ""
    return (
        f"{name}: {verdict.state}, largest error {format_error(verdict.error_move)}, "
        f"{plural(verdict.failed_steps, 'failed step')}{time}{why}{notes}."
        f"{_describe_failing_modes(verdict, modes)}"
    )


def _describe_reasons(verdict: Verdict) -> str:
    """Return in words why custom settings do not pass, with the notes on their options."""
    parts = describe_kinds_of_reasons(verdict), _describe_options(verdict)
    return "; ".join(filter(None, parts))


def _describe_options(verdict: Verdict) -> str:
    """Return in words options that the solver adapts, and tolerances that are not set; or ""."""
    left = strip_markdown(describe_tolerances_left(verdict))
    return "; ".join(filter(None, (_describe_adapted_options(verdict), left)))


def _describe_failing_modes(verdict: Verdict, modes: Sequence[Verdict]) -> str:
    """Return in words the other call modes of the same settings that fail, with the reasons."""
    return "".join(
        f" {v.configuration.route} {v.configuration.policy} fails: "
        f"{strip_markdown(describe_finding(v.causes[0]))}."
        for v in modes
        if v.state == "fail" and v is not verdict
    )


def describe_best_of_grids(records: Records, verdicts: Verdicts) -> list[str]:
    """Return lines on the best of three or more settings of a solver that set the same options.

    Also the options of which it has the least or largest value that was tried. Limits of iterations
    or time alone have a topic of their own.
    """
    grids = list_grids(verdicts)
    best = [_describe_best_of_grid(records, p, choose_best_settings(verdicts, p)) for p in grids]
    # The line on a grid that fails everywhere has this note already.
    adapted = [_describe_adapted_options(p[0]) for p in grids if not _do_all_fail(p)]
    return [*best, *(f"{text}." for text in dict.fromkeys(filter(None, adapted)))]


def _group_by_names_of_options(verdicts: Verdicts) -> list[list[Verdict]]:
    """Return the best verdicts on custom settings, grouped by solver and the options they set."""
    own = list_best_verdict_of_own_settings(verdicts)
    alike = group_by_key(own, lambda v: (v.configuration.solver, tuple(format_options_by_name(v))))
    return [*alike.values()]


def list_grids(verdicts: Verdicts) -> list[list[Verdict]]:
    """Return the best verdict on each point of each grid: of settings that set the same options.

    Limits of iterations or time alone are no grid.
    """
    return [
        points
        for points in _group_by_names_of_options(verdicts)
        if len(points) >= LEAST_POINTS and not _differ_in_limit_alone(points)
    ]


def list_varied_options(points: Sequence[Verdict]) -> set[str]:
    """Return the names of the options in which settings differ that set the same options."""
    options = [format_options_by_name(verdict) for verdict in points]
    return {name for name in options[0] if len({own[name] for own in options}) > 1}


def _describe_adapted_options(verdict: Verdict) -> str:
    """Return a clause on options set that the solver adapts from a first value; or ""."""
    c = verdict.configuration
    record = find_solver_record_or_none(c.solver)
    adapted = {} if record is None else record.adapted
    set_to = resolve_settings_with_fixed_options(c.solver_settings, c.solver) if adapted else {}
    texts = [
        f"{name} is only an initial value in {c.solver}, as {switch} is on (fix it with "
        f"{switch}=false)"
        for name, switch in adapted.items()
        if name in format_options_by_name(verdict) and set_to.get(switch)
    ]
    return "; ".join(texts)


def _differ_in_limit_alone(points: Sequence[Verdict]) -> bool:
    """Return whether settings of a solver are the same but for its limit of iterations or time."""
    record = find_solver_record_or_none(points[0].configuration.solver)
    limits = () if record is None else (record.iteration_limit, record.time_limit)
    varied = list_varied_options(points)
    return any(varied == {limit} for limit in limits)


def _list_differing_options(one: Verdict, other: Verdict) -> set[str]:
    """Return the names of the options in which two settings differ that set the same options."""
    own = format_options_by_name(one)
    return {name for name, value in format_options_by_name(other).items() if value != own[name]}


def format_options_by_name(verdict: Verdict) -> dict[str, str]:
    """Return the options of a verdict's configuration as text, by name."""
    return format_each_option_as_toml(decode_options_from_json(verdict.configuration.options))


def _list_others_as_good(best: Verdict, by: str, points: Sequence[Verdict]) -> list[Verdict]:
    """Return the other settings of the same state that are as good as the best by its figure."""
    rivals = [verdict for verdict in points if verdict.state == best.state and verdict is not best]
    if by == "time":
        return list_equally_fast(best, rivals)
    if by == "iterations":
        return [verdict for verdict in rivals if verdict.iterations[0] == best.iterations[0]]
    error = format_error(best.error_move)
    return [verdict for verdict in rivals if format_error(verdict.error_move) == error]


def _name_first_of(names: Sequence[str]) -> str:
    """Return names joined in words: the first `MOST_EQUAL`, and the number of the others."""
    more = len(names) - MOST_EQUAL
    return join_with_and([*names[:MOST_EQUAL], *([f"{more} more"] if more > 0 else [])])


def _list_edges(best: Verdict, points: Sequence[Verdict], equals: Sequence[Verdict]) -> list[str]:
    """Return the options of which a wider grid may have a better value than the best has."""
    edges = []
    for option, value in format_options_by_name(best).items():
        numbers = (as_float(format_options_by_name(verdict)[option]) for verdict in points)
        tried = {number for number in numbers if math.isfinite(number)}
        at = as_float(value)
        # No option takes a value below zero: a zero is the least that is allowed.
        ends = {min(tried), max(tried)} if len(tried) >= LEAST_POINTS else set()
        is_bound = at == min(tried, default=at) <= 0.0
        # Another value that is as good shows that nothing is gained towards this end.
        is_flat = any(_list_differing_options(best, other) == {option} for other in equals)
        if at in ends and not is_bound and not is_flat:
            edges.append(option)
    return edges


def _describe_best_of_grid(records: Records, points: Sequence[Verdict], found: BestSettings) -> str:
    """Return a line on the best of a solver's settings, and whether it is at the grid's edge."""
    best, solver = found.verdict, points[0].configuration.solver
    ran = {run.configuration for run in records.runs if run.solver == solver and run.options}
    is_mixed = len({(c.route, c.policy) for c in ran}) > 1
    count = f"{len(points)} settings of {solver}{', each in its best call mode,' * is_mixed}"
    if best is None and found.by == "error":
        return f"None of {count} finished its runs: {_describe_reasons(points[0])}."
    if best is None:
        accurate = sum(verdict.state in ACCURATE for verdict in points)
        return f"{accurate} of {count} are accurate; {NOT_RANKED}."
    equals = _list_others_as_good(best, found.by, points)
    edges = _list_edges(best, points, equals)
    edge = f", at the edge of the grid in {join_with_and(edges)}" if edges else ""
    if _do_all_fail(points):
        errors = [verdict.error_move for verdict in points if verdict.is_finished]
        least, largest = min(errors), max(errors)
        is_similar = largest < SIMILAR * least
        similar = f", with similar errors ({format_error(least)} to {format_error(largest)})"
        edge += ": widen it" * (bool(edges) and not is_similar)
        edge += f"; all fail{similar * is_similar}; the best: {_describe_reasons(best)}"
    elif edges:
        edge += ": widen it"
    if equals and found.by in EQUALS:
        names = [_name_own_settings(verdict) for verdict in equals]
        edge += f"; {EQUALS[found.by]}: {_name_first_of(names)}"
    edge += f"; {NOT_RANKED}" * (found.by == "iterations")
    if found.by == "time":
        edge += _compare_with_runner_up(records, best, points, is_alone=not equals)
    c = best.configuration
    mode = f" ({c.route} {c.policy})" * is_mixed
    return f"Best of {count}{_describe_figure(found.by, best)}: {c.settings}{mode}{edge}."


def _describe_figure(by: str, best: Verdict) -> str:
    """Return the figure that settings are best by in words, with its value; "" if unknown."""
    if by == "error":
        return f" by largest error ({format_error(best.error_move)})"
    if by == "iterations":
        return f" by iterations (p50 {best.iterations[0]:g} in the replay of {best.timed_on})"
    name = "limiting p99" if math.isfinite(best.p99_ns) else "p50"
    time_ns = find_ranking_time_ns(best)
    return f" by {name} ({format_time(time_ns)})" if math.isfinite(time_ns) else ""


def _compare_with_runner_up(
    records: Records, best: Verdict, points: Sequence[Verdict], *, is_alone: bool
) -> str:
    """Return clauses on the runner-up's time ratio to the best settings, and on other load.

    is_alone : whether no settings are equally fast within the noise; otherwise without a ratio.
    """
    options = best.configuration.options
    rivals = [v for v in points if v.state == best.state and v.configuration.options != options]
    if not rivals:
        return ""
    second = min(rivals, key=find_ranking_time_ns)
    pair = best.configuration, second.configuration
    ratios = compare_configurations(records, *pair) if is_alone else []
    words = strip_markdown(describe_paired_times(ratios, than=" as the best"))
    text = f"; the runner-up, {_name_own_settings(second)}, takes {words}" * bool(ratios)
    spread = max(v.disturbed_spread for v in (best, *rivals))
    if spread > 1.0 and all(one.finding_text != MACHINE_DISTURBED for one in ratios):
        factor = significant(spread)
        text += f"; the machine was disturbed: rounds differ by a factor of up to {factor}"
    return text
