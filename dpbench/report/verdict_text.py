"""Say verdicts and recommendation in plain sentences; every number in them comes from rows."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dpbench.analysis.demand import Demand
from dpbench.analysis.records import Records
from dpbench.analysis.run_record import RunRecord
from dpbench.analysis.times.fastest import (
    Recommendation,
    fastest_first,
    known_record,
    recommend,
)
from dpbench.analysis.times.pairs import PairedComparison, paired_comparison
from dpbench.analysis.verdict import Finding, Outcome, Verdict, Verdicts, detail
from dpbench.report.formats import (
    and_list,
    count_text,
    error_text,
    interval_text,
    plural,
    rounded_down,
    significant,
    time_text,
)


def demand_text(demand: Demand) -> str:
    """The demand in one sentence."""
    share = f"{100.0 * demand.p99_ms / demand.deadline_ms:.2g}"
    failed = (
        "no failed step"
        if demand.failed_steps == 0
        else (f"at most {plural(demand.failed_steps, 'failed step')} a run")
    )
    return (
        f"The demand: on every step the first move within {demand.error_move:g} of "
        f"a rate-limit step of the certified optimum, {failed}, and a p99 of the algorithmic "
        f"step time of at most {demand.p99_ms:g} ms ({share} % of the "
        f"{demand.deadline_ms / 1e3:g} s sample)."
    )


def summary(verdicts: Verdicts) -> list[str]:
    """How many solvers meet the demand in their default configuration, who does so only in
    another one, who misses it, who is open; every solver once."""
    references = verdicts.references
    if not references:
        return ["No solver was run, so there is nothing to judge."]
    run = [v for v in references if v.outcome != "not run"]
    good = fastest_first(_with(references, "meets"))
    rescued = [_only(verdicts, v) for v in run if v.outcome != "meets"]
    only = [v for v in rescued if v is not None]
    rest = [
        v
        for v in run
        if v.outcome != "meets"
        and v.configuration.solver not in {o.configuration.solver for o in only}
    ]
    lines = [_count_line(run, good)]
    if only:
        lines.append(f"Only in another configuration: {_labels(only)}.")
    lines += _no_longer(verdicts, good)
    missing = _with(rest, "misses")
    if missing:
        lines.append(f"{_names(missing)} {_verb(missing, 'miss')} it.")
    unsure = _with(rest, "open")
    if unsure:
        lines.append(f"{_names(unsure)} cannot be judged on these records.")
    absent = _with(references, "not run")
    if absent:
        lines.append(f"Not run: {_names(absent)}.")
    return lines


def _only(verdicts: Verdicts, reference: Verdict) -> Verdict | None:
    """The fastest configuration that meets the demand where a solver's reference does not."""
    return next(
        iter(fastest_first(_with(verdicts.of[reference.configuration.solver], "meets"))), None
    )


def _no_longer(verdicts: Verdicts, good: Sequence[Verdict]) -> list[str]:
    """Who meets the demand by default and misses it at another level."""
    lines = []
    for level in verdicts.levels:
        lost = [
            v
            for v in _with(verdicts.at(level), "misses")
            if v.configuration.solver in _solvers(good)
        ]
        if lost:
            lines.append(f"With settings `{level}` no longer: {_names(lost)}.")
    return lines


def _count_line(run: Sequence[Verdict], good: Sequence[Verdict]) -> str:
    """How many meet the demand; that this is open where nobody can be said to."""
    if not run:
        return "No solver ran."
    if not good and all(_lacks(v, "no replay") for v in run):
        return "Nothing can be judged on time: no replay was run."
    unsure = _with(run, "open")
    if not good and unsure:
        loops = not all(_lacks(v, "no closed loop") for v in unsure)
        why = "" if loops else f", as {_WORDS['no closed loop']}"
        return (
            "Whether a solver meets the demand in its default configuration is open: "
            f"{len(unsure)} of {plural(len(run), 'solver')} that ran cannot be judged{why}."
        )
    names = f": {_names(good)}" if good else ""
    return (
        f"{len(good)} of {plural(len(run), 'solver')} that ran {_verb(good, 'meet')} the demand "
        f"in {'its' if len(good) == 1 else 'their'} default configuration{names}."
    )


def _lacks(verdict: Verdict, kind: str) -> bool:
    """Whether a kind of run is missing from a verdict."""
    return any(finding.kind == kind for finding in verdict.missing)


def _verb(subjects: Sequence[Verdict], verb: str) -> str:
    return verb if len(subjects) != 1 else f"{verb}es" if verb.endswith("ss") else f"{verb}s"


def _with(verdicts: Sequence[Verdict], outcome: Outcome) -> list[Verdict]:
    return [v for v in verdicts if v.outcome == outcome]


def _solvers(verdicts: Sequence[Verdict]) -> set[str]:
    return {v.configuration.solver for v in verdicts}


def _names(verdicts: Sequence[Verdict]) -> str:
    return and_list([v.configuration.solver for v in verdicts])


def _labels(verdicts: Sequence[Verdict]) -> str:
    return and_list([v.configuration.label for v in verdicts])


def recommendation(view: Records, verdicts: Verdicts) -> list[str]:
    """What to use, what is faster and cannot go aboard, and how clear the lead is."""
    found = recommend(verdicts)
    if found.chosen is None:
        return [_nobody(view, verdicts, found)]
    lines = [_use(found.chosen, verdicts.demand)]
    if found.faster is not None:
        faster = found.faster.configuration
        lines.append(
            f"Faster: **{faster.solver}** ({faster.options}, "
            f"{figures(found.faster)}), which cannot go aboard as it is: {found.because}."
        )
    if found.runner_up is not None:
        lines.append(paired_text(paired_comparison(view, found.chosen, found.runner_up)))
    return lines


def _use(chosen: Verdict, demand: Demand) -> str:
    if chosen.outcome == "meets":
        head = f"Use **{chosen.configuration.solver}**"
        right = f"right on every step of {judged_on(chosen)}"
    else:
        head = f"Nothing contradicts **{chosen.configuration.solver}**"
        right = f"right on every step of {judged_on(chosen)}, {clauses(chosen.missing)}"
    who = chosen.configuration
    return (
        f"{head} (route {who.route}, policy {who.policy}, settings `{who.settings}`), the "
        f"fastest by {yardstick(chosen)} that can go aboard: {right}; {figures(chosen)}; "
        f"{slack_text(chosen, demand)}. {aboard(who.solver)}"
    )


def aboard(solver: str) -> str:
    """Licence, language and C code of a solver, in a sentence."""
    known = known_record(solver)
    if known is None:
        return "Its licence and language are not known here."
    project = known.project
    return (
        f"Licence: {project.licence.value}; language: {project.language.value}; C code: "
        f"{project.c_code.value}."
    )


def _nobody(view: Records, verdicts: Verdicts, found: Recommendation) -> str:
    """Why nothing is recommended."""
    if found.faster is not None:
        return (
            "Nothing that can go aboard meets the demand; "
            f"{found.faster.configuration.label} does, {figures(found.faster)}: {found.because}."
        )
    if not any(row.has_steps for row in view.select(mode="replay", units="scaled")):
        return "Nothing is recommended, as no replay left a step, so nothing is timed."
    outcomes = {verdict.outcome for verdict in verdicts.all}
    if "open" in outcomes:
        return "Nothing is recommended while it is open whether a solver meets the demand."
    return "Nothing is recommended: no solver meets the demand in any configuration that was run."


def yardstick(configuration: Verdict) -> str:
    """What a configuration is ranked by: its p99, or its largest step where there is no p99."""
    return "p99" if math.isfinite(configuration.p99_ns) else "largest step"


def figures(verdict: Verdict) -> str:
    """Error and step times of a configuration."""
    p99 = (
        f"p99 {time_text(verdict.p99_ns)}"
        if math.isfinite(verdict.p99_ns)
        else "too few steps for a p99"
    )
    return (
        f"error_move at most {error_text(verdict.error_move)}, p50 {time_text(verdict.p50_ns)} and "
        f"{p99} on `{verdict.timed_on}`, largest step {time_text(verdict.algo_max_ns)}"
    )


def slack_text(verdict: Verdict, demand: Demand) -> str:
    """How much slower a computer may be, by the largest algorithmic step and by the largest sample,
    as a clause."""
    deadline = f"{demand.deadline_ms / 1e3:g} s"
    by_step, by_sample = verdict.slowdown(demand), verdict.raw_slowdown(demand)
    if by_step < 1.0:
        return f"its largest step, {time_text(verdict.algo_max_ns)}, misses the {deadline}"
    return (
        f"a computer {rounded_down(by_step)} times slower would still make the {deadline} deadline "
        f"by its largest algorithmic step, {rounded_down(by_sample)} times by its largest sample "
        f"({time_text(verdict.raw_max_ns)}, jitter of this machine included)"
    )


def paired_text(found: PairedComparison) -> str:
    """How the top two compare, with caution where they cannot be told apart."""
    if found.steps == 0:
        return f"{found.second} is second; no step was replayed by both, so they are not compared."
    ratio = significant(found.ratio.value)
    bounded = math.isfinite(found.ratio.high)
    span = interval_text(found.ratio.low, found.ratio.high)
    known = f"95 % interval {span}" if bounded else "too few for an interval"
    pair = (
        f"{found.second} takes {ratio} times as long as {found.first} per step "
        f"(geometric mean of the paired ratios of {plural(found.steps, 'step')}, each sequence of "
        "equal weight, "
        f"{known})"
    )
    if found.tied:
        why = "the interval holds 1, so" if bounded else "without one"
        return f"Caution: {pair}; {why} the two cannot be told apart."
    if found.unstable:
        by = {name: f"{found.leaders[name]} by {name}" for name in found.leaders}
        return (
            f"Caution: {pair}; the order depends on the yardstick: {and_list(list(by.values()))}."
        )
    return f"Second: {pair}."


def clauses(findings: Sequence[Finding]) -> str:
    """What was found, in plain clauses."""
    return "; ".join(map(clause, findings))


_WORDS = {
    "no answer": "it leaves steps without an answer in {places}",
    "inaccurate": "its first move is up to {error} of a rate-limit step off the optimum in {where}"
    "{also_over}",
    "failed": "{value:.0f} of {of} fail in {where}{some_also}",
    "crashed": "its process ended in {where}: {detail}{also}",
    "hung": "it did not return in {where}: {detail}{also}",
    "p99 late": "its p99 is {time} in {where}",
    "p95 late": "its p95 is already {time} in {where}",
    "stopped": "{where} was stopped at its time limit ({value:.0f} of {steps})",
    "lost": "the harness lost {where}: {detail}",
    "ended": "{where} {outcome}: {detail}",
    "uncertified": "{counted} of {where} have no certified optimum",
    "remembered": "in {where} it answers a step that it has seen before faster than warming "
    "explains, so its times there are of remembered answers",
    "no step": "{where} left no counting step",
    "no p99": "{steps} of {where} do not support a p99, and the slowest takes {time}",
    "no closed loop": "no closed loop was run",
    "no replay": "no replay was run, so its time is not judged",
    "absent": "not run in {places}",
    "refused": "not run in {where} ({detail})",
    "short": "not run whole in {where} ({planned} of {steps})",
}


def clause(finding: Finding) -> str:
    """One finding as a plain clause."""
    words = {"value": finding.value, "steps": plural(finding.steps, "step")}
    if not finding.runs:
        return _WORDS[finding.kind].format(**words)
    first, *others = finding.runs
    also = _places(others)
    rounds = first.rounds
    done = first.steps_done * (rounds if rounds > 1.0 else 1.0)
    return _WORDS[finding.kind].format(
        **words,
        where=where(first),
        places=_places(finding.runs),
        detail=detail(first),
        outcome=first.outcome,
        planned=count_text(first.steps_planned),
        of=plural(done, "step"),
        counted=plural(finding.value, "step"),
        error=error_text(finding.value),
        time=time_text(finding.value),
        also=f" (also in {also})" if also else "",
        some_also=f" (some also in {also})" if also else "",
        also_over=f" (over the demand also in {also})" if also else "",
    )


def where(row: RunRecord) -> str:
    """The place of a run in words."""
    if row.mode == "replay":
        return f"the replay of `{row.sequence}`"
    return f"`{row.scenario}`"


def _places(rows: Sequence[RunRecord]) -> str:
    loops = [f"`{row.scenario}`" for row in rows if row.mode != "replay"]
    replays = [f"`{row.sequence}`" for row in rows if row.mode == "replay"]
    if replays:
        word = "replay" if len(replays) == 1 else "replays"
        loops.append(f"the {word} of {' and '.join(replays)}")
    return and_list(loops)


def judged_on(verdict: Verdict) -> str:
    """What the answers of a configuration were judged on."""
    replays = plural(verdict.replays, "replay")
    return f"{plural(verdict.loops, 'closed loop')} and {replays}" if verdict.loops else replays
