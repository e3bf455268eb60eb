"""The recommendation: which configuration to use, why, where that is valid, and what to paste."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite, isnan
from typing import Any

from dpbench.analysis.times.paired_times import (
    MACHINE_DISTURBED,
    compare_paired_times,
    count_common_window_steps,
    find_faster_inconclusive,
)
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.simulated_losses import list_losses
from dpbench.analysis.verdict.thruster_verdicts import copy_with_thruster_times, has_times_of_both
from dpbench.analysis.verdict.time_findings import (
    SlowStep,
    SpeedMargin,
    compute_speed_margins,
    find_largest_stall_ns,
)
from dpbench.analysis.verdict.verdict import (
    SolverChoice,
    Verdict,
    choose_solver,
    find_fastest_configuration,
    find_solver_record_or_none,
    rank_configurations,
)
from dpbench.bench.judge.rules import LEAST_STRETCH
from dpbench.bench.record.cell import DEFAULT_FALLBACK, Configuration
from dpbench.errors import InputError, format_allowed_names
from dpbench.report.commands_text import describe_machine, describe_turns
from dpbench.report.embedded_text import list_embedded_cost_sentences
from dpbench.report.formats import (
    format_count,
    format_error,
    format_rounded_down,
    format_time,
    join_with_and,
    plural,
)
from dpbench.report.page.data import PageData
from dpbench.report.ship.capability_text import describe_consequence_solver, describe_unanswered_qps
from dpbench.report.ship.ship_text import ShipSummary, summarise_ships
from dpbench.report.verdict.findings_text import describe_findings, name_experiment
from dpbench.report.verdict.verdict_text import (
    NOBODY,
    describe_deployment,
    describe_hardest_wait,
    describe_judged_runs,
    describe_limiting_time,
    describe_longest_wait,
    describe_requirements,
    describe_short_times,
    describe_stopped_runs,
    describe_times_compared_with,
    describe_tolerances_left,
    explain_no_recommendation,
)
from dpbench.solvers.own_settings import decode_options_from_json, format_options_as_toml
from dpbench.solvers.settings import (
    format_library_call,
    has_distinct_tolerance_presets,
    has_preset_or_tolerance,
    resolve_settings_with_fixed_options,
)
from dpbench.solvers.table import CONTROLLER_SOLVERS

MOST_CHIPS = 16
"""More experiments are counted by state, and named only where they are at most `FEW`."""
FEW = 5
UNEQUAL_ERRORS, SMALL_ERROR = 1e3, 1e-6
"""Ratio of two errors of the first move, and least larger one, from which both are given."""
NOTE_TITLES = {
    "deployment": "Deployment",
    "margin": "Slower computer",
    "counted": "Embedded core",
}
"""Titles of notes that do not name their topic themselves, by keyword."""
WITH_THRUSTERS = "With commanded thrusters, "
NEXT = "The next fastest solver that passes is "
"""First words of a note, which the terminal replaces by a label."""
MOST_INCONCLUSIVE = 2
"""Number of faster but inconclusive configurations with a note."""


@dataclass(frozen=True)
class Badge:
    """Badge on the report page: verdict on the recommended solver in a scenario or replay."""

    state_text: str
    mark: str
    name: str = ""
    experiment: int | None = None

    @property
    def text(self) -> str:
        """Text of the badge for output other than the page: scenario and verdict."""
        return f"{self.name}: {self.state_text}" if self.name else self.state_text


@dataclass(frozen=True, eq=False)
class Recommendation:
    """Headline of the report page: ship, solver to use, notes, verdicts by scenario, code to paste.

    ship : what the controller does to it whatever the solver; comes before `sentence` everywhere.
    verdict : which solver to use, or why none. Of this solver, "" without one: evidence : where it
    was correct, and its step time; accuracy : its largest error and its answers to QPs without a
    solution; margin : how much slower the computer may be.
    """

    ship: ShipSummary
    verdict: str
    evidence: str
    accuracy: str
    margin: str
    notes: tuple[tuple[str, str], ...]
    chips: tuple[Badge, ...]
    snippets: tuple[tuple[str, str], ...]
    requirements: str
    machine: str
    first: Configuration | None
    second: Configuration | None

    @property
    def sentence(self) -> str:
        """Verdict, evidence and accuracy as one text."""
        return " ".join(filter(None, (self.verdict, self.evidence, self.accuracy)))

    @property
    def details(self) -> Iterator[tuple[str, str]]:
        """Title and text of each paragraph that the page folds."""
        ship = self.ship
        yield from (("Ship", ship.details), ("", ship.conditions), ("", ship.wash))
        yield from (("Accuracy", self.accuracy), ("", self.requirements))
        for about, text in self.notes:
            if about == "checked":
                # Section "Two solvers" and the note on the figure of times have this caution.
                continue
            yield NOTE_TITLES.get(about, ""), text.removeprefix(self.margin).lstrip()

    @staticmethod
    def why(verdict: Verdict) -> str:
        """Return a text on why a configuration does not pass; "" where it passes."""
        if verdict.refusal:
            return verdict.refusal
        if verdict.state == "pass":
            return ""
        reasons = describe_findings(verdict.causes or verdict.findings_that_bar_pass)
        is_inaccurate = any(finding.kind == "inaccurate" for finding in verdict.causes)
        left = describe_tolerances_left(verdict) if is_inaccurate else ""
        return "; ".join(filter(None, (reasons, left)))


def build_recommendation(
    data: PageData, machine: Mapping[str, Any], baseline: str | None = None
) -> Recommendation:
    """Return the report's headline: solver to use, one to compare, notes and code to paste.

    baseline : solver to compare with; by default a faster one that is not deployable or, if there
        is none, the next fastest deployable one.

    Raises InputError for a baseline that was not run.
    """
    found = choose_solver(data.verdicts)
    chosen = found.chosen
    known = [v.configuration for v in data.verdicts.all_verdicts if v.state != "not run"]
    first = chosen.configuration if chosen else known[0] if known else None
    other = found.faster or found.runner_up
    second = other.configuration if other else next((c for c in known if c != first), None)
    if baseline is not None:
        own = [c for c in known if c.solver == baseline]
        if not own:
            solvers = format_allowed_names(baseline, list(dict.fromkeys(c.solver for c in known)))
            raise InputError("`baseline`", "", repr(baseline), f"a solver that was run: {solvers}")
        fastest = find_fastest_configuration(data.verdicts, baseline)
        second = fastest.configuration if fastest else own[0]
    ship = summarise_ships(data.ships)
    alone = _describe_lone_solver(known)
    verdict, evidence, accuracy = _describe_choice(
        data, found, is_lost=bool(ship.warning), is_alone=len(known) == 1
    )
    margin = list_speed_margin_sentences(data, chosen) if chosen else []
    return Recommendation(
        ship=ship,
        verdict=" ".join(filter(None, (alone, verdict))),
        evidence=evidence,
        accuracy=accuracy,
        margin=margin[0] if margin else "",
        notes=(
            *_yield_deployment_notes(chosen),
            *([("margin", " ".join(margin))] if margin else ()),
            *_yield_embedded_notes(data, chosen),
            *_yield_notes_on_choice(data, found),
            *_yield_notes_on_runs(data),
        ),
        chips=tuple(_make_badges(data, first)),
        snippets=tuple(_make_snippets(chosen.configuration)) if chosen else (),
        requirements=describe_requirements(data.requirements) if data.verdicts.of else "",
        machine=describe_machine(data.records, machine),
        first=first,
        second=second,
    )


def _describe_lone_solver(known: Sequence[Configuration]) -> str:
    """Return a sentence where one solver alone was run; "" where there are others."""
    if len(known) == 1:
        return f"Nothing was compared, as only {known[0].marked_label} was run."
    if len({configuration.solver for configuration in known}) != 1:
        return ""
    modes = f"{len(known)} configurations"
    return f"Only `{known[0].solver}` was run, in {modes}: no other solver is compared."


def _describe_choice(
    data: PageData, found: SolverChoice, *, is_lost: bool, is_alone: bool
) -> tuple[str, str, str]:
    """Return texts on the solver to use, or why there is none, its runs and its accuracy.

    is_lost : the controller does not hold a ship, so that the sentence speaks of the QPs alone.
    is_alone : only one configuration was run, so that none is the fastest.
    """
    chosen = found.chosen
    if chosen is None:
        return _explain_no_choice(data, found), "", ""
    c = chosen.configuration
    is_recommended = chosen.state == "pass" and not is_lost
    is_first = is_recommended and _is_fastest(data, chosen)
    opening = _describe_verdict_on_choice(chosen, is_lost=is_lost)
    opening += ", the fastest deployable configuration that passes" * (is_first and not is_alone)
    record = find_solver_record_or_none(c.solver)
    own = is_recommended and record is not None and record.extra == "own"
    both = describe_consequence_solver(data.records, c.solver)
    timed = copy_with_thruster_times(data.records, data.requirements, chosen)
    every = "with a feasible QP in" if data.list_runs_with_infeasible_steps(c) else "of"
    unranked = (
        " Several settings of this solver pass and are equally fast within the noise; these are "
        "the most usual ones."
    ) * (is_recommended and not is_first)
    return (
        f"{both + ' ' if both else ''}{opening}.{' It is part of dpbench itself.' * own}",
        f"It was accurate on every step {every} {describe_judged_runs(chosen)}. "
        f"{_open_time_sentence(chosen, timed)} {describe_limiting_time(timed)}.",
        f"The largest error of the first move is {format_error(chosen.error_move)} times the "
        f"maximum increment.{_describe_unverified_steps(data, c)}"
        f"{_describe_infeasible_steps(data, c)}{unranked}",
    )


def _open_time_sentence(verdict: Verdict, timed: Verdict) -> str:
    """Return the first words on the times of a verdict; `timed` may be of thruster QPs alone."""
    return "Its" if timed is verdict else f"{WITH_THRUSTERS}its"


def _describe_verdict_on_choice(chosen: Verdict, *, is_lost: bool) -> str:
    """Return a text that recommends a configuration, or states why it does not pass."""
    c = chosen.configuration
    call = f"`{c.solver}` ({c.route} {c.policy}, {c.settings})"
    if is_lost:
        verdicts = {"pass": f"{call} passes", "borderline": f"{call} is borderline"}
        lead = "As a solver of these QPs alone, "
    else:
        verdicts = {"pass": f"Use {call}", "borderline": f"Borderline: {call}"}
        lead = ""
    why = "" if chosen.state == "pass" else f": {Recommendation.why(chosen)}"
    return f"{lead}{verdicts.get(chosen.state, f'{call} is inconclusive')}{why}"


def _is_fastest(data: PageData, chosen: Verdict) -> bool:
    """Return whether a configuration ranks first of those of its solver."""
    solver = chosen.configuration.solver
    of_solver = (v for v in rank_configurations(data.verdicts) if v.configuration.solver == solver)
    return next(of_solver, chosen) is chosen


def _describe_unverified_steps(data: PageData, c: Configuration) -> str:
    """Return in how many steps of its worst run no solution is verified; "" for none."""
    own = [run for run in data.records.runs if run.configuration.moved_to_common_formulation == c]
    worst = max(own, key=lambda run: run.unverified_steps, default=None)
    if worst is None or not worst.unverified_steps:
        return ""
    where = f"{plural(worst.steps_done, 'step')} of {name_experiment(worst)}"
    return f" In {format_count(worst.unverified_steps)} of {where} the solution is not verified."


def _describe_infeasible_steps(data: PageData, c: Configuration) -> str:
    """Return which QPs have no solution, if the solver reported it, and the fallback; "" for none.

    The steps are named where there is one run and the folder has its steps.
    """
    known = data.list_runs_with_infeasible_steps(c)
    if not known:
        return ""
    # A replay counts a step in each of its rounds.
    steps = sum(round(run.infeasible_steps / max(1.0, run.rounds)) for run in known)
    names = dict.fromkeys(run.scenario or run.sequence for run in known)
    where = join_with_and([f"`{name}`" for name in names])
    table = data.records.read_step_table(known[0], ("k", "certificate"))
    at = table["k"][table["certificate"] == "infeasible"].unique() if len(known) == 1 else ()
    named = f" ({join_with_and([f'{k}' for k in at])})" * (0 < len(at) <= FEW)
    reported = ", which the solver reported correctly"
    reported *= all(run.true_share == 1.0 for run in known)
    acting = {run.fallback or DEFAULT_FALLBACK for run in known if run.fallbacks > 0}
    acted = f"; the fallback `{'`, `'.join(sorted(acting))}` acted" * bool(acting)
    has = "has" if steps == 1 else "have"
    return (
        f" {plural(steps, 'step')} of {where}{named} {has} no feasible solution{reported}{acted}."
    )


def _explain_no_choice(data: PageData, found: SolverChoice) -> str:
    """Return a text on why no solver is recommended; "" if no choice is meant."""
    records = data.records
    if any(not run.is_baseline_law for run in records.runs):
        return explain_no_recommendation(records, data.verdicts, found)
    topics = records.random or records.consequence or records.at_edge or records.study
    other = topics or records.delayed or records.calibration
    return "" if other else NOBODY


def _yield_embedded_notes(data: PageData, chosen: Verdict | None) -> Iterator[tuple[str, str]]:
    """Yield the note on the cost of the recommended solver on an embedded core, if counted."""
    solver = chosen.configuration.solver if chosen else ""
    if counted := list_embedded_cost_sentences(data.counts, data.requirements, solver):
        yield "counted", " ".join(counted)


def _yield_deployment_notes(chosen: Verdict | None) -> Iterator[tuple[str, str]]:
    """Yield the note on the deployment of the recommended solver, if there is one."""
    if chosen is not None:
        yield "deployment", describe_deployment(chosen.configuration.solver)


def _yield_notes_on_choice(data: PageData, found: SolverChoice) -> Iterator[tuple[str, str]]:
    """Yield notes on the recommended solver beside others, as keyword and text."""
    chosen = found.chosen
    if chosen is None:
        return
    if found.faster is not None:
        label = found.faster.configuration.marked_label
        compared = compare_paired_times(data.records, chosen, found.faster)
        apart = bool(compared) and all(one.separate for one in compared)
        lead = f"has a smaller p99, {compared[0].separate}" if apart else "is faster"
        if any(one.finding_text == MACHINE_DISTURBED for one in compared):
            lead = "has a smaller p99, measured on a disturbed machine,"
        yield "faster", f"{label} {lead} but is not recommended: {found.because}."
    yield from _yield_inconclusive_notes(data, found)
    if found.runner_up is not None:
        pair = data.records, chosen, found.runner_up
        timed = copy_with_thruster_times(data.records, data.requirements, found.runner_up)
        label = found.runner_up.configuration.marked_label
        first = chosen.configuration.marked_label
        beside = describe_times_compared_with(
            first, compare_paired_times(*pair), count_common_window_steps(*pair)
        )
        error = _describe_larger_error(chosen, found.runner_up)
        its = _open_time_sentence(found.runner_up, timed)
        time = describe_limiting_time(timed)
        state = found.runner_up.state
        lead = NEXT if state == "pass" else NEXT.replace(" that passes", f", which is {state},")
        text = f"{lead}{label}. {its} {time}. {beside}{error}"
        yield "next", text
    named = [*filter(None, (chosen, found.faster, found.runner_up))]
    if short := describe_short_times(data.records, named):
        yield "checked", short
    for verdict in filter(None, (chosen, found.runner_up)):
        if silent := describe_unanswered_qps(data.records, verdict.configuration.solver):
            yield "unanswered", f"{silent}."


def _describe_larger_error(first: Verdict, second: Verdict) -> str:
    """Return a sentence on both errors if the second is far larger, as times depend on it."""
    if not second.error_move > max(UNEQUAL_ERRORS * first.error_move, SMALL_ERROR):
        return ""
    return (
        f" Its largest error of the first move is {format_error(second.error_move)} times the "
        f"maximum increment, against {format_error(first.error_move)}: the times "
        "are not at equal accuracy."
    )


def _yield_notes_on_runs(data: PageData) -> Iterator[tuple[str, str]]:
    """Yield notes on replays that were not interleaved, and on runs stopped by their time limit."""
    if turns := describe_turns(data.records):
        yield "commands", turns
    if stopped := describe_stopped_runs(data.records.all_runs):
        yield "stopped", stopped


def _yield_inconclusive_notes(data: PageData, found: SolverChoice) -> Iterator[tuple[str, str]]:
    """Yield notes on faster configurations whose verdict is inconclusive."""
    if found.chosen is None or found.chosen.state != "pass":
        return
    known = None if found.faster is None else found.faster.configuration.solver
    others = [
        verdict
        for verdict in find_faster_inconclusive(data.records, data.verdicts, found.chosen)
        if verdict.configuration.solver != known
    ]
    for verdict in others[:MOST_INCONCLUSIVE]:
        why = Recommendation.why(verdict) if verdict.loops else "not run in closed loop"
        yield (
            "inconclusive",
            f"{verdict.configuration.marked_label} is faster on average, but inconclusive: {why}.",
        )


def list_speed_margin_sentences(data: PageData, chosen: Verdict) -> list[str]:
    """Return sentences: how much slower a computer may be for a solver, and its limiting steps.

    Those of thruster QPs in a folder about thrusters; the margin over all replays is named too.
    """
    of_all, requirements = data.get_speed_margin(chosen.configuration), data.requirements
    if of_all is None:
        return []
    margin, controller, also = of_all, "", ""
    if has_times_of_both(data.records):
        of_thrusters = compute_speed_margins(data.records, requirements, of_thrusters=True)
        margin = of_thrusters.get(chosen.configuration, of_all)
    if margin is not of_all:
        chosen = copy_with_thruster_times(data.records, requirements, chosen)
        least = format_rounded_down(of_all.allowed_slowness_factor)
        controller, also = WITH_THRUSTERS, f" (× {least} over all replays)"
        also *= least != format_rounded_down(margin.allowed_slowness_factor)
    is_short = 0 < margin.p99.run.steps_searched_for_hardest < LEAST_STRETCH
    has_p99 = isfinite(chosen.p99_ns) and not is_short
    is_of_own_plant = any(run.is_of_own_plant for run in data.records.runs)
    computer = "the computer" if is_of_own_plant else "the ship's computer"
    opening = f"{controller}{computer}"
    untimed = [*_yield_untimed_loops_sentences(data)]
    replayed = " for the replayed QPs" * bool(untimed)
    return [
        f"{opening[0].upper()}{opening[1:]} may be up to "
        f"{format_rounded_down(margin.allowed_slowness_factor)} times slower than this machine"
        f"{replayed}{also}; {_describe_margin_limit(margin, requirements, has_p99=has_p99)}.",
        *_list_limiting_steps(data, margin, has_p99=has_p99),
        *_yield_longest_timing(data, chosen.configuration),
        *untimed,
    ]


def _describe_margin_limit(
    margin: SpeedMargin, requirements: Requirements, *, has_p99: bool
) -> str:
    """Return a clause on the time of a solver that first reaches its limit as it slows down."""
    longest = f"the longest step ({format_time(margin.longest_ns)} on this machine) then reaches"
    if margin.deadline < margin.p99_limit:
        return f"{longest} the deadline of {requirements.deadline_ms:g} ms"
    if has_p99:
        return f"the limiting p99 then reaches the p99 limit of {requirements.p99_ms:g} ms"
    limit = f"the p99 limit of {requirements.p99_ms:g} ms"
    return f"{longest} {limit}, as there are too few steps for a p99"


def _list_limiting_steps(data: PageData, margin: SpeedMargin, *, has_p99: bool) -> list[str]:
    """Return sentences on the steps that limit a speed margin, and each one's largest slowdown."""
    requirements, hardest = data.requirements, margin.hardest
    texts = [_describe_limiting_p99(margin)] if has_p99 else []
    if margin.deadline < margin.p99_limit and has_p99:
        texts.append(
            f"It reaches its limit of {requirements.p99_ms:g} ms at a slowdown of "
            f"× {format_rounded_down(margin.p99_limit)}."
        )
    reaches = (
        f"reaches the deadline of {requirements.deadline_ms:g} ms at a slowdown of "
        f"× {format_rounded_down(margin.deadline)}."
    )
    if hardest.run.untimed_iterations_max > 1.0:
        longest = "The longest step, scaled up to the iterations of the closed loop,"
    else:
        wait = describe_hardest_wait(data.records, hardest.run, is_scaled=False)
        named = f"{_name_slow_step(hardest)} ({_describe_work(hardest)})"
        took = f"{format_time(hardest.time_ns)}{wait}"
        longest = f"The longest step is {named}. It took {took}, and"
    return [*texts, f"{longest} {reaches}"]


def _describe_limiting_p99(margin: SpeedMargin) -> str:
    """Return a sentence on the steps that the limiting p99 comes from; times are in the tables."""
    run, steps = margin.p99.run, margin.p99.run.steps_searched_for_hardest
    if not steps:
        is_scaled = run.untimed_iterations > 1.0
        scaled = ", scaled up to the iterations of the closed loop" * is_scaled
        return f"The limiting p99 is that of {name_experiment(run)}{scaled}."
    return (
        f"In `{run.scenario}`, only a window of {format_count(run.steps_planned)} of the "
        f"{format_count(steps)} steps was replayed, so the p99 is an estimate without a "
        "confidence interval."
    )


def _yield_longest_timing(data: PageData, c: Configuration) -> Iterator[str]:
    """Yield a sentence on a configuration's largest single timing beside the machine's stalls."""
    run, stall_ns = data.find_longest_timing(c), find_largest_stall_ns(data.records)
    if run is None:
        return
    stall = (
        " It may contain a stall: calibration runs, which run no solver, have stalls of up to "
        f"{format_time(stall_ns)}."
    ) * (stall_ns > 0.0)
    wait = describe_longest_wait(data.records, run)
    yield (
        "Stalls do not scale with the speed of the computer. The largest single timing is "
        f"{format_time(run.raw_max_ns)}{wait} in {name_experiment(run)}.{stall}"
    )


def _yield_untimed_loops_sentences(data: PageData) -> Iterator[str]:
    """Yield a sentence that names judged closed loops whose QPs no replay timed, if any."""
    judged = [run for run in data.records.runs if run.units == "scaled"]
    # A sequence from a file has no scenario; that of a `LinearMPC` has the problem's name.
    replays = {run.scenario or run.sequence: run for run in judged if run.mode == "replay"}
    loops = {run.scenario: run for run in judged if run.mode == "closed_loop"}
    if untimed := [
        f"`{name}`"
        for name, loop in loops.items()
        if name not in replays and not any(map(loop.has_problem_of, replays.values()))
    ]:
        yield f"Not timed, as no replay has their QPs: {join_with_and(untimed)}."


def _name_slow_step(step: SlowStep) -> str:
    """Return the name of a slow step: its index and its scenario or sequence."""
    return f"step {step.k} of `{step.run.scenario or step.run.sequence}`"


def _describe_work(step: SlowStep) -> str:
    """Return the iterations of a slow step, where known, and its active limits as text."""
    iterations = "" if isnan(step.iterations) else f"{plural(step.iterations, 'iteration')}, "
    lost_k = min((at_s for at_s, _ in list_losses(step.run)), default=inf) / step.run.sample_s
    lost = ", with those of lost thrusters" * (step.n_active > 0 and step.k >= lost_k)
    return f"{iterations}{plural(step.n_active, 'active limit')}{lost}"


def _make_badges(data: PageData, first: Configuration | None) -> list[Badge]:
    """Return the badges of a solver's verdicts, one per scenario or replay, or counted."""
    if first is None:
        return []
    c = data.find_index(first)
    experiments = data.judged_experiment_indices
    states = [data.get_state_in_experiment(c, p) for p in experiments]
    counts = Counter(states)
    counted = {s for s in counts if len(states) > MOST_CHIPS and counts[s] > FEW}
    marks = {state: "none" if state == "not run" else state for state in states}
    named = [
        Badge(
            f"{state}{_describe_other_call_modes(data, first, p)}",
            marks[state],
            data.experiments[p].label,
            p,
        )
        for p, state in zip(experiments, states, strict=True)
        if state not in counted
    ]
    sums = [
        Badge(f"{state} in {counts[state]} of {len(states)}", marks[state])
        for state in counts
        if state in counted
    ]
    return [*sums, *named]


def _describe_other_call_modes(data: PageData, chosen: Configuration, p: int) -> str:
    """Return a text on a solver's verdicts in other call modes if not run in this one; or ""."""
    if (data.find_index(chosen), p) in data.runs:
        return ""
    modes: dict[str, list[str]] = {}
    for c, other in enumerate(data.configurations):
        if (other.solver, other.settings) == (chosen.solver, chosen.settings):
            modes.setdefault(data.get_state_in_experiment(c, p), []).append(
                f"{other.route} {other.policy}"
            )
    others = [
        f"{join_with_and(names)}: {state}" for state, names in modes.items() if state != "not run"
    ]
    return f" in this call mode ({'; '.join(others)})" if others else ""


def format_python_call(c: Configuration) -> str:
    """Return Python code to paste that opens a solver with its interface and settings.

    Also the call of its library without dpbench, where the adapter can write it.
    """
    settings = repr(c.solver_settings) if c.options else f'"{c.settings}"'
    call = (
        "from dpbench import open_workspace\n"
        f'solver = open_workspace(\n    "{c.solver}",\n    route="{c.route}",\n'
        f'    policy="{c.policy}",\n    settings={settings},\n)'
    )
    record = find_solver_record_or_none(c.solver)
    if c.solver in CONTROLLER_SOLVERS:
        named = c.solver
        if c.options:
            named = f"'{c.solver}[{format_options_as_toml(decode_options_from_json(c.options))}]'"
        elif has_distinct_tolerance_presets(c.solver):
            named = f"{c.solver} --settings {c.settings}"
        call += f"\n# C code:\n# dpbench codegen SCENARIO --out DIR\n#   --solver {named}"
        if (c.route, c.policy) != ("native", "warm"):
            call += "\n# It starts warm: judge it with --route native --policy warm."
    elif record is not None and record.project.c_code.value.startswith("yes"):
        call += f"\n# C code: {record.project.c_code.source}"
    if record is None or not (c.options or has_preset_or_tolerance(c.solver, c.settings)):
        return call
    options = resolve_settings_with_fixed_options(c.solver_settings, c.solver)
    keys = ", ".join(f"{key}={value!r}" for key, value in options.items())
    for name, switch in record.adapted.items() if c.solver in CONTROLLER_SOLVERS else ():
        if options.get(switch):
            call += f"\n# C code has a constant {name}, as with {switch} = false."
    call += f"\n# settings: {keys or 'library defaults'}"
    own = format_library_call(c.solver, c.route, c.policy, c.solver_settings)
    return f"{call}\n\n# Without dpbench:\n{own}" if own else call


def _make_snippets(c: Configuration) -> Iterator[tuple[str, str]]:
    """Yield language and code to paste that opens a solver: Python, and C if known."""
    yield "Python", format_python_call(c)
    options = resolve_settings_with_fixed_options(c.solver_settings, c.solver)
    known = find_solver_record_or_none(c.solver)
    names = known.project.c_settings if known else None
    if names is None:
        return
    is_native = c.route == "native"
    if is_native:
        options = {**options, **names.list_policy_options(c.policy)}
    # C has no True.
    numbers = {key: int(x) if isinstance(x, bool) else x for key, x in options.items()}
    lines = [f"settings.{key} = {value!r};" for key, value in numbers.items()]
    start = f"{names.struct} settings;\n{names.defaults}(&settings);"
    if is_native and c.policy == "warm" and names.warm_start:
        lines += [
            f"/* Each step: {names.warm_start} with the previous solution and multipliers,",
            "   shifted by one control increment. */",
        ]
    yield "C", "\n".join([start, *lines])
