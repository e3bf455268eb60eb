"""Counts of solvers' C in words, and as times at a clock and cycles per instruction."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from dpbench.analysis.suites.embedded import APART, CountedSequence, EmbeddedResults
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.bench.record.result_folder import UncountedSolver
from dpbench.embedded.toolchain import TARGETS
from dpbench.report.formats import (
    MISSING,
    describe_range_of_steps,
    format_count,
    format_sample_share,
    format_time,
    join_with_and,
)
from dpbench.solvers.contract import DEFAULT
from dpbench.solvers.settings import find_options_of_preset

CYCLES = 1.0
"""Cycles per instruction where the reader gives none: an assumption."""
CLOCK_MHZ = 100.0
CAVEAT = (
    "The counts do not include effects of caches, pipeline and bus, and do not bound the "
    "worst-case execution time."
)
MOST_SCENARIOS = 6
"""Number of scenarios without counts that are named."""
MOST_PAIRS = 2
"""Number of disagreements between desk and counts that are named for a sequence."""


def name_core_and_precision(target: str, *, single: bool) -> str:
    """Return the name of a core and of its code's precision; double precision is not named."""
    title = TARGETS[target].title if target in TARGETS else target
    return f"{title}, float" if single else title


NOTE = (
    "p50, p99 and maximum: instructions per step. Iterations and active limits are those of the "
    "step with the maximum. Code includes constants; static memory includes the heap. Error: "
    "largest error of the first move, in maximum increments. The times on this machine are those "
    "of the same steps through the native interface at default settings, with a warm start where "
    "supported. Solvers whose C code runs at other settings have no rank. Where ranks by "
    "instructions and by time on this machine are compared, p99 values within "
    f"{100 * (APART - 1):.0f} % of each other count as equal."
)
"""Meaning of the columns of the table of counts."""


def name_sequence_and_core(sequence: CountedSequence) -> str:
    """Return the text "SEQUENCE on CORE" that names a group of instruction counts."""
    return (
        f"{sequence.sequence} on {name_core_and_precision(sequence.target, single=sequence.single)}"
    )


def _mark_sequence_and_core(sequence: CountedSequence) -> str:
    """Return the text "`SEQUENCE` on CORE", the sequence as code, a range of steps in words."""
    core = _name_core_with_article(sequence.target, single=sequence.single)
    return f"{describe_range_of_steps(sequence.sequence)} on {core}"


def _name_core_with_article(target: str, *, single: bool) -> str:
    """Return the name of a core and of its code's precision after "a" or "an"."""
    core = name_core_and_precision(target, single=single)
    return f"{'an' if core.startswith('x86') else 'a'} {core}"


def convert_instructions_to_ns(instructions: int) -> float:
    """Return the time of instructions at `CYCLES` each and `CLOCK_MHZ` [ns]."""
    return 1e3 * instructions * CYCLES / CLOCK_MHZ


@dataclass(frozen=True)
class CoreTimes:
    """One row of the calculator: a solver on a core, its p99 and maximum in instructions."""

    solver: str
    where: str
    p99: int
    worst: int
    deadline_ns: float

    @property
    def cells(self) -> tuple[str, ...]:
        """Texts of a row: solver, sequence, core; p99, maximum, and its share of the deadline."""
        worst_ns = convert_instructions_to_ns(self.worst)
        known = math.isfinite(self.deadline_ns)
        share = format_sample_share(worst_ns / self.deadline_ns) if known else MISSING
        return (
            self.solver,
            self.where,
            format_time(convert_instructions_to_ns(self.p99)),
            format_time(worst_ns),
            share,
        )


def describe_deadline(requirements: Requirements) -> str:
    """Return a text on the deadline of a step."""
    if not requirements.judges_step_times:
        return "no deadline is known"
    return f"deadline of {requirements.deadline_ms:g} ms"


def make_calculator_rows(results: EmbeddedResults, requirements: Requirements) -> list[CoreTimes]:
    """Return rows with solvers' times on embedded cores, in the order of the table of counts."""
    return [
        CoreTimes(
            one.solver, name_sequence_and_core(group), one.p99, one.worst, requirements.deadline_ns
        )
        for group in results.sequences
        for one in group.solvers
    ]


def list_embedded_cost_sentences(
    results: EmbeddedResults, requirements: Requirements, solver: str
) -> list[str]:
    """Return sentences on the cost of a solver on an embedded core; none where not counted."""
    largest = results.find_largest_count_of_solver(solver)
    if largest is None or largest[1].error_move > requirements.error_move:
        return []
    sequence, one = largest
    worst_ns = convert_instructions_to_ns(one.worst)
    core = _name_core_with_article(sequence.target, single=sequence.single)
    share = format_sample_share(worst_ns / requirements.deadline_ns)
    of_deadline = f", {share} of the {describe_deadline(requirements)}"
    return [
        f"Compiled for {core} and run in an emulator, `{solver}` executes at most "
        f"{format_count(one.worst)} instructions per step "
        f"({describe_range_of_steps(sequence.sequence)}). They take {format_time(worst_ns)} at "
        f"an assumed {CYCLES:g} cycle per instruction and {CLOCK_MHZ:g} MHz"
        f"{of_deadline * requirements.judges_step_times}.",
        *yield_uncounted_loops_sentences(results),
        CAVEAT,
    ]


def describe_emulation(sequences: Sequence[CountedSequence]) -> str:
    """Return for which cores solvers' C code was compiled to be run in an emulator, as text."""
    cores = [_name_core_with_article(one.target, single=one.single) for one in sequences]
    return f"compiled for {join_with_and(list(dict.fromkeys(cores)))} and run in an emulator"


def yield_uncounted_loops_sentences(results: EmbeddedResults) -> Iterator[str]:
    """Yield a sentence on the scenarios whose QPs were not counted, if there are any."""
    names = [f"`{name}`" for name in results.uncounted_loops]
    if results.sequences and names:
        more = len(names) - MOST_SCENARIOS
        listed = [*names[:MOST_SCENARIOS], *[f"{more} more scenarios"] * (more > 0)]
        yield (
            f"Instructions were not counted for the QPs of {join_with_and(listed)}, which may "
            "take more."
        )


def describe_cheapest_solver(sequence: CountedSequence, requirements: Requirements) -> str:
    """Return a sentence on the solver of fewest instructions within the required error."""
    right = [one for one in sequence.solvers if one.error_move <= requirements.error_move]
    where = _mark_sequence_and_core(sequence)
    if not right:
        return f"No solver whose instructions were counted is within the error limit in {where}."
    first, *others = right
    following = of_ranked = ""
    if others:
        of_ranked = f" of the {len(right)} accurate solvers"
        p99, worst = format_count(others[0].p99), format_count(others[0].worst)
        following = f" `{others[0].solver}` follows (p99 {p99}, maximum {worst})."
    return (
        f"In {where}, `{first.solver}` has the smallest p99{of_ranked}: {format_count(first.p99)} "
        f"instructions per step (maximum {format_count(first.worst)}).{following}"
    )


def yield_ranking_sentences(
    sequences: Sequence[CountedSequence], requirements: Requirements
) -> Iterator[str]:
    """Yield sentences: where instructions and desk times rank solvers alike, where otherwise."""
    alike = []
    for sequence in sequences:
        if len(sequence.desk_rank_by_solver) < 2:
            continue
        pairs = sequence.find_pairs_ranked_otherwise(requirements.error_move)
        if not pairs:
            alike.append(_mark_sequence_and_core(sequence))
            continue
        # The widest first.
        pairs.sort(key=lambda pair: -pair[1].p99 * pair[0].desk_p99_ns / pair[0].p99)
        named = [
            f"`{few.solver}` executes fewer instructions than `{many.solver}` "
            f"({format_count(few.p99)} against {format_count(many.p99)}) but is slower here "
            f"({format_time(few.desk_p99_ns)} against {format_time(many.desk_p99_ns)})"
            for few, many in pairs[:MOST_PAIRS]
        ]
        more = f", and {len(pairs) - MOST_PAIRS} more" if len(pairs) > MOST_PAIRS else ""
        where = _mark_sequence_and_core(sequence)
        yield (
            f"In {where}, instruction counts rank solvers differently from times on this machine: "
            f"{join_with_and(named)}{more}."
        )
    if alike:
        ranked = dict.fromkeys(name for s in sequences for name in s.desk_rank_by_solver)
        is_whole = not _list_unranked_settings(sequences)
        solvers = "the solvers" if is_whole else join_with_and([f"`{name}`" for name in ranked])
        where = "" if len(alike) == len(sequences) else f" in {join_with_and(alike)}"
        yield (
            f"Instruction counts rank {solvers} in the same order as times on this machine{where}."
        )


def yield_unranked_sentences(sequences: Sequence[CountedSequence]) -> Iterator[str]:
    """Yield a sentence on each solver whose C code does not run at the settings of the desk."""
    for name, own in _list_unranked_settings(sequences).items():
        counted = join_with_and([f"{key} = {value:g}" for key, value in own.items()])
        default = find_options_of_preset(DEFAULT, name)
        options = ", ".join(f"{key} = {value}" for key, value in default.items())
        desk = f"with the default settings ({options or 'those of the library'})"
        yield (
            f"`{name}` is not ranked, because its settings differ. Its C code runs with {counted}. "
            f"On this machine, the solver runs {desk}."
        )


def _list_unranked_settings(
    sequences: Sequence[CountedSequence],
) -> dict[str, Mapping[str, bool | int | float]]:
    """Return the settings of the C code by solver, of those timed here at other settings."""
    return {
        one.solver: one.settings
        for sequence in sequences
        for one in sequence.solvers
        if one.settings and not math.isnan(one.desk_p99_ns)
    }


def yield_uncounted_sentences(missing: Sequence[UncountedSolver]) -> Iterator[str]:
    """Yield a line for each reason why solvers were not counted."""
    for reason in dict.fromkeys(one["reason"] for one in missing):
        own = [one for one in missing if one["reason"] == reason]
        solvers = join_with_and(list(dict.fromkeys(f"`{one['solver']}`" for one in own)))
        where = [
            f"{describe_range_of_steps(one['sequence'])} on "
            f"{_name_core_with_article(one['target'], single=False)}"
            for one in own
        ]
        yield f"Not counted: {solvers} in {join_with_and(list(dict.fromkeys(where)))}: {reason}."
