"""The answer: which configuration to use, why, where that is valid, and what to paste."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import isnan
from typing import Any

from dpbench.analysis.times.machine import shortest_wait_ns
from dpbench.analysis.times.pairs import faster_but_open, paired_comparison
from dpbench.analysis.verdict.fastest import Recommendation, fastest_of, known_record, recommend
from dpbench.analysis.verdict.speed_margin import SlowStep, largest_stall_ns
from dpbench.analysis.verdict.verdict import Verdict
from dpbench.bench.record.configuration import Configuration
from dpbench.errors import InputError
from dpbench.report.formats import (
    and_list,
    error_text,
    plural,
    rounded_down,
    time_text,
    unmarked,
)
from dpbench.report.page.facts import Facts
from dpbench.report.verdict_text import (
    NOBODY,
    aboard,
    clauses,
    demand_text,
    judged_on,
    paired_text,
    usual_time,
    why_nothing,
)
from dpbench.solvers.settings import has_setting, level_options

MOST_CHIPS = 16
"""More places than these are counted by state, and named only where they are at most `FEW`."""
FEW = 5
MOST_OPEN = 2
"""So many faster configurations are named that are open."""


@dataclass(frozen=True)
class Chip:
    """Whether the answer holds in a place, of number `place`; or in how many, without one."""

    said: str
    mark: str
    name: str = ""
    place: int | None = None

    @property
    def text(self) -> str:
        """As it is written where there is no page."""
        return f"{self.name}: {self.said}" if self.name else self.said


@dataclass(frozen=True, eq=False)
class Answer:
    """What stands first on the page."""

    sentence: str
    notes: tuple[tuple[str, str], ...]
    chips: tuple[Chip, ...]
    snippets: tuple[tuple[str, str], ...]
    demand: str
    machine: str
    first: Configuration | None
    second: Configuration | None

    @staticmethod
    def why(verdict: Verdict) -> str:
        """What is said against a configuration, or left open."""
        if verdict.refusal:
            return verdict.refusal
        if verdict.outcome == "meets":
            return ""
        return unmarked(clauses(verdict.causes or verdict.missing))


def answer_of(facts: Facts, machine: Mapping[str, Any], baseline: str | None = None) -> Answer:
    """The answer of some facts.

    Parameters
    ----------
    baseline : the solver to set beside it; by default a faster one, or the next.

    Raises
    ------
    InputError : for a baseline that was not run.
    """
    found = recommend(facts.verdicts)
    chosen = found.chosen
    known = [v.configuration for v in facts.verdicts.all if v.outcome != "not run"]
    first = chosen.configuration if chosen else known[0] if known else None
    other = found.faster or found.runner_up
    second = other.configuration if other else next((c for c in known if c != first), None)
    if baseline is not None:
        own = [c for c in known if c.solver == baseline]
        if not own:
            solvers = ", ".join(dict.fromkeys(c.solver for c in known))
            raise InputError("--baseline", "", repr(baseline), f"a solver that was run: {solvers}")
        fastest = fastest_of(facts.verdicts, baseline)
        second = fastest.configuration if fastest else own[0]
    return Answer(
        sentence=_sentence(facts, found),
        notes=tuple(_notes(facts, found)),
        chips=tuple(_chips(facts, first)),
        snippets=tuple(_snippets(chosen.configuration)) if chosen else (),
        demand=demand_text(facts.demand) if facts.verdicts.of else "",
        machine=_machine(machine),
        first=first,
        second=second,
    )


def _sentence(facts: Facts, found: Recommendation) -> str:
    chosen = found.chosen
    if chosen is None:
        return _nothing(facts, found)
    c = chosen.configuration
    heads = {"meets": "Use", "borderline": "Borderline:"}
    head = heads.get(chosen.outcome, "Nothing contradicts")
    left_open = "" if chosen.outcome == "meets" else f"; {unmarked(clauses(chosen.missing))}"
    return (
        f"{head} {c.solver} ({c.route}, {c.policy}, {c.settings}): right on every step of "
        f"{judged_on(chosen)}{_no_solution(facts, c)}, {usual_time(chosen)}, largest error of the "
        f"first move "
        f"{error_text(chosen.error_move)}{left_open}."
    )


def _no_solution(facts: Facts, c: Configuration) -> str:
    """Steps on which right means to say that there is no answer."""
    steps, told = facts.without_solution(c)
    said = ", and it said so" if told else ""
    return f" ({plural(steps, 'step')} had no solution{said})" if steps else ""


def _nothing(facts: Facts, found: Recommendation) -> str:
    """Why nothing is recommended; empty where nobody asked for a recommendation."""
    records = facts.records
    if any(not run.is_baseline_law for run in records.runs):
        return unmarked(why_nothing(records, facts.verdicts, found))
    topics = records.random or records.consequence or records.at_edge or records.study
    other = topics or records.delayed or records.calibration
    return "" if other else NOBODY


def _notes(facts: Facts, found: Recommendation) -> Iterator[tuple[str, str]]:
    """What belongs to the answer, each with a word for what it is about."""
    chosen = found.chosen
    if chosen is None:
        return
    yield "aboard", aboard(chosen.configuration.solver)
    if slower := slower_text(facts, chosen):
        yield "slower", slower
    shortest_ns = shortest_wait_ns(facts.records.calibration)
    if chosen.p50_ns < shortest_ns:
        p50, shortest = time_text(chosen.p50_ns), time_text(shortest_ns)
        yield "checked", f"Its p50, {p50}, lies below the shortest wait checked, {shortest}."
    if found.faster is not None:
        label = found.faster.configuration.label
        yield "faster", f"{label} is faster, and is not the answer: {found.because}."
    yield from _open_notes(facts, found)
    if found.runner_up is not None:
        beside = paired_text(paired_comparison(facts.records, chosen, found.runner_up))
        label, time = found.runner_up.configuration.label, usual_time(found.runner_up)
        yield "next", f"Next: {label}, {time}, {beside}."


def _open_notes(facts: Facts, found: Recommendation) -> Iterator[tuple[str, str]]:
    """What would be faster than the answer, were it not open; of who is no answer anyway nothing
    more."""
    if found.chosen is None or found.chosen.outcome != "meets":
        return
    known = None if found.faster is None else found.faster.configuration.solver
    others = [
        verdict
        for verdict in faster_but_open(facts.records, facts.verdicts, found.chosen)
        if verdict.configuration.solver != known
    ]
    for verdict in others[:MOST_OPEN]:
        why = "not run in closed loop" if not verdict.loops else unmarked(clauses(verdict.missing))
        yield "open", f"{verdict.configuration.label} is faster on average, and open: {why}."


def slower_text(facts: Facts, chosen: Verdict) -> str:
    """State how much slower a computer may be, by the steps that bound it, and the stalls apart."""
    margin, demand = facts.margin(chosen.configuration), facts.demand
    if margin is None:
        return ""
    parts = [
        f"The computer may be up to × {rounded_down(margin.factor)} slower.",
        f"The p99 reaches {demand.p99_ms:g} ms at × {rounded_down(margin.p99_limit)}: it is "
        f"{_slow_step_text(margin.p99)}.",
        f"The hardest step takes the deadline of {demand.deadline_ms:g} ms at × "
        f"{rounded_down(margin.deadline)}: it is {_slow_step_text(margin.hardest)}.",
    ]
    longest, arms_ns = facts.longest_timing(chosen.configuration), largest_stall_ns(facts.records)
    if longest is not None:
        place, run = longest
        arms = f", the largest stall of a calibration run {time_text(arms_ns)}" * (arms_ns > 0.0)
        largest = f"{time_text(run.raw_max_ns)} in {place.label}{arms}"
        parts.append(f"Stalls do not scale with the computer: the largest timing is {largest}.")
    return " ".join(parts)


def _slow_step_text(step: SlowStep) -> str:
    """The time of a step, where it is, and how much work that is."""
    iterations = "" if isnan(step.iterations) else f"{plural(step.iterations, 'iteration')}, "
    work = f"{iterations}{plural(step.n_active, 'active limit')}"
    where = step.run.scenario or step.run.sequence
    return f"{time_text(step.time_ns)} in {where}, k {step.k} ({work})"


def _chips(facts: Facts, first: Configuration | None) -> list[Chip]:
    if first is None:
        return []
    c = facts.index(first)
    places = facts.judged_experiments
    states = [facts.state(c, p) for p in places]
    counts = Counter(states)
    counted = {s for s in counts if len(states) > MOST_CHIPS and counts[s] > FEW}
    marks = {state: "none" if state == "not run" else state for state in states}
    named = [
        Chip(
            f"{_said(state)}{_otherwise(facts, first, p)}",
            marks[state],
            facts.experiments[p].label,
            p,
        )
        for p, state in zip(places, states, strict=True)
        if state not in counted
    ]
    sums = [
        Chip(f"{_said(state)} in {counts[state]} of {len(states)}", marks[state])
        for state in counts
        if state in counted
    ]
    return [*sums, *named]


_STATES = {"meets": "held"}
"""Of the states, those that a chip has another word for."""


def _said(state: str) -> str:
    return _STATES.get(state, state)


def _otherwise(facts: Facts, chosen: Configuration, p: int) -> str:
    """How the solver did in a place where it was run in other ways than the chosen one alone."""
    if (facts.index(chosen), p) in facts.runs:
        return ""
    ways: dict[str, list[str]] = {}
    for c, other in enumerate(facts.configurations):
        if (other.solver, other.settings) == (chosen.solver, chosen.settings):
            ways.setdefault(facts.state(c, p), []).append(f"{other.route} {other.policy}")
    others = [
        f"{and_list(names)} {_said(state)}" for state, names in ways.items() if state != "not run"
    ]
    return f" this way ({'; '.join(others)})" if others else ""


def call_text(c: Configuration) -> str:
    """The call that opens a configuration, and its settings in numbers; of a solver or settings
    that this installation does not know the call alone."""
    call = (
        "import dpbench\n"
        f'solver = dpbench.open_workspace("{c.solver}", route="{c.route}", policy="{c.policy}", '
        f'settings="{c.settings}")'
    )
    if known_record(c.solver) is None or not has_setting(c.solver, c.settings):
        return call
    options = level_options(c.settings, c.solver)
    keys = ", ".join(f"{key}={value!r}" for key, value in options.items())
    return f"{call}\n# that is, {keys or 'as the library has them'}"


def _snippets(c: Configuration) -> Iterator[tuple[str, str]]:
    """What to paste: each language with its text; C where the solver's record says how."""
    yield "Python", call_text(c)
    options = level_options(c.settings, c.solver)
    known = known_record(c.solver)
    names = known.project.c_settings if known else None
    if names is None:
        return
    # C has no True.
    numbers = {key: int(x) if isinstance(x, bool) else x for key, x in options.items()}
    lines = [f"settings.{key} = {value!r};" for key, value in numbers.items()]
    start = f"{names.struct} settings;\n{names.defaults}(&settings);"
    yield "C", "\n".join([start, *lines])


def _machine(machine: Mapping[str, Any]) -> str:
    return (
        f"Machine: {machine.get('cpu_model', 'not known')}, {machine.get('cores', '?')} cores, "
        f"{machine.get('python', '')}. Times hold for it alone."
    )
