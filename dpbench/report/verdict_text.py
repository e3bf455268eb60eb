"""Verdicts in plain words; every number in them comes from rows."""

import math
from collections.abc import Sequence

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.records.run_steps import RunSteps
from dpbench.analysis.statistics import LEAST_STEPS
from dpbench.analysis.times.contrasts import PairedComparison
from dpbench.analysis.verdict.fastest import (
    SolverChoice,
    best_verdict_by_solver,
    find_solver_record,
)
from dpbench.analysis.verdict.findings import Finding, State
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.verdict import Verdict, Verdicts, outcome_cause
from dpbench.report.formats import (
    and_list,
    count_text,
    error_text,
    plural,
    share_text,
    significant,
    strip_markdown,
    time_text,
)
from dpbench.report.words import read_words

NOBODY = "No solver was run, so there is nothing to judge."


def requirements_text(requirements: Requirements) -> str:
    """State the limits on a solver's error, failed steps and time in one sentence."""
    share = f"{100.0 * requirements.p99_ms / requirements.deadline_ms:.2g}"
    failed = (
        "no failed step"
        if requirements.failed_steps == 0
        else (f"at most {plural(requirements.failed_steps, 'failed step')} a run")
    )
    return (
        f"The requirements: on every step the first move within {requirements.error_move:g} of "
        f"a rate-limit step of the certified optimum, {failed}, a p99 of the algorithmic step time "
        f"of at most {requirements.p99_ms:g} ms ({share} % of the deadline), and every step within "
        f"the deadline of {requirements.deadline_ms:g} ms."
    )


_OTHERS: tuple[State, ...] = ("borderline", "late", "fail", "inconclusive", "not run")


def count_solvers(verdicts: Verdicts) -> str:
    """State how many solvers pass, and name those that are late, fail or are inconclusive."""
    if not verdicts.references:
        return NOBODY
    best = {verdict.configuration.solver: verdict for verdict in best_verdict_by_solver(verdicts)}
    groups: dict[State, list[str]] = {name: [] for name in ("pass", *_OTHERS)}
    otherwise = []
    for reference in verdicts.references:
        solver = reference.configuration.solver
        groups[best[solver].state].append(solver)
        if best[solver].state == "pass" and reference.state != "pass":
            otherwise.append(best[solver].configuration.label)
    run, good = len(best) - len(groups["not run"]), len(groups["pass"])
    wording = [f"{good} of {run} pass"] if good or not groups["inconclusive"] else []
    if otherwise:
        wording[0] += f", {len(otherwise)} of them not by default: {', '.join(otherwise)}"
    wording += [f"{name}: {', '.join(groups[name])}" for name in _OTHERS if groups[name]]
    return "; ".join(wording)


def stopped_runs_text(runs: Sequence[RunRecord]) -> str:
    """State how many runs their time limit stopped; "" for none."""
    ran = [run for run in runs if run.outcome != "refused"]
    stopped = sum(run.outcome == "timed_out" for run in ran)
    if not stopped:
        return ""
    return f"{stopped} of {plural(len(ran), 'run')} stopped at the time limit (cell_limit_s)."


def deployment_facts(solver: str) -> str:
    """State a solver's licence, its language, and whether it generates C code."""
    known = find_solver_record(solver)
    if known is None:
        return "Its licence and language are not known here."
    project = known.project
    return (
        f"Licence: {project.licence.value}; language: {project.language.value}; C code: "
        f"{project.c_code.value}."
    )


def explain_no_recommendation(
    view: Records, verdicts: Verdicts, recommendation: SolverChoice
) -> str:
    """Explain why no solver is recommended: none deployable, none timed, or none passes."""
    if recommendation.faster is not None:
        return (
            "Nothing that can go aboard passes; "
            f"{recommendation.faster.configuration.label} does: {recommendation.because}."
        )
    if not any(row.has_steps for row in view.select(mode="replay", units="scaled")):
        return "Nothing is recommended, as no replay left a step, so nothing is timed."
    states = {verdict.state for verdict in verdicts.all}
    if "inconclusive" in states:
        return "Nothing is recommended while the verdict on a solver is inconclusive."
    return "Nothing is recommended: no solver passes in any configuration that was run."


def usual_time_text(verdict: Verdict) -> str:
    """Format a configuration's p99 step time, or its p50 if there are too few steps."""
    if verdict.p99_run is None or math.isnan(verdict.p99_ns):
        return f"p50 {time_text(verdict.p50_ns)} in the replay of {verdict.timed_on}"
    return f"p99 {time_text(verdict.p99_ns)} in {strip_markdown(experiment_text(verdict.p99_run))}"


def paired_text(compared: PairedComparison) -> str:
    """State the ratio of two configurations' step times, with its interval or why it has none."""
    if compared.steps == 0:
        return "no step was replayed by both"
    wording = f"{significant(compared.ratio.value)} times as long over the same steps"
    if not math.isfinite(compared.ratio.high):
        few = f"; fewer than {LEAST_STEPS} steps" if compared.steps < LEAST_STEPS else ""
        wording += f" (geometric mean of {plural(compared.steps, 'step')}{few}, so no interval)"
    else:
        interval = f"{significant(compared.ratio.low)} to {significant(compared.ratio.high)}"
        wording += f" (geometric mean, {interval})"
        if compared.tied:
            return f"{wording}: the two cannot be told apart"
    return f"{wording}; which is faster depends on the yardstick" if compared.unstable else wording


def describe_findings(findings: Sequence[Finding]) -> str:
    """Describe the reasons for a verdict in clauses joined by semicolons."""
    return "; ".join(map(describe_finding, findings))


_WORDS: dict[str, str] = read_words(__file__)["findings"]


def describe_finding(finding: Finding) -> str:
    """Describe one reason for a verdict, as a late or wrong step, in a clause."""
    words = {"value": finding.value, "steps": plural(finding.steps, "step")}
    if not finding.runs:
        return _WORDS[finding.kind].format(**words)
    first, *others = finding.runs
    also = _experiments_text(others)
    # Failures in replays are counted in the warm-up, too: their number may exceed that of steps.
    in_rounds = finding.kind == "failed" and first.mode == "replay"
    return _WORDS["failed answers" if in_rounds else finding.kind].format(
        **words,
        where=experiment_text(first),
        experiments=_experiments_text(finding.runs),
        detail=outcome_cause(first),
        outcome=first.outcome,
        planned=count_text(first.steps_planned),
        done=plural(first.steps_done, "step"),
        counted=plural(finding.value, "step"),
        error=error_text(finding.value),
        time=time_text(finding.value),
        share=share_text(finding.value),
        timings=plural(finding.steps, "timing"),
        machine=share_text(finding.machine),
        also=f" (also in {also})" if also else "",
        some_also=f" (some also in {also})" if also else "",
        also_over=f" (over the requirements also in {also})" if also else "",
    )


def answer_text(steps: RunSteps, at: int) -> str:
    """Describe a solver's answer at one step: claimed solved or not, true or not."""
    claimed = "claimed" if steps.claimed[at] else "not claimed"
    return f"{claimed}, {'true' if steps.true[at] else 'not true'}"


def experiment_text(row: RunRecord) -> str:
    """Name the scenario, replay or hardest steps that a run solved."""
    if row.window_of:
        return f"the hardest steps of `{row.scenario}`"
    if row.mode == "replay":
        return f"the replay of `{row.sequence}`"
    return f"`{row.scenario}`"


def _experiments_text(rows: Sequence[RunRecord]) -> str:
    loops = [f"`{row.scenario}`" for row in rows if row.mode != "replay"]
    windows = [f"`{row.scenario}`" for row in rows if row.window_of]
    replays = [f"`{row.sequence}`" for row in rows if row.mode == "replay" and not row.window_of]
    if replays:
        word = "replay" if len(replays) == 1 else "replays"
        loops.append(f"the {word} of {' and '.join(replays)}")
    if windows:
        loops.append(f"the hardest steps of {' and '.join(windows)}")
    return and_list(loops)


def judged_runs_text(verdict: Verdict) -> str:
    """State on how many closed loops and replays a configuration was judged."""
    kinds = {"closed loop": verdict.loops, "replay": verdict.replays, "window": verdict.windows}
    return and_list([plural(count, kind) for kind, count in kinds.items() if count])
