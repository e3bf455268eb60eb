"""Counts of solvers' C in words, and as times at a clock and cycles per instruction."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from dpbench.analysis.suites.embedded import APART, CountedSequence, EmbeddedResults
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.bench.record.result_folder import UncountedSolver
from dpbench.embedded.targets import TARGETS
from dpbench.report.formats import and_list, count_text, sample_share_text, time_text

CYCLES = 1.0
"""Cycles per instruction where the reader gives none: an assumption."""
CLOCK_MHZ = 100.0
CAVEAT = (
    "Counts have no caches, no pipeline and no bus in them, and are no bound of the worst-case "
    "execution time."
)
MOST_PAIRS = 2
"""Number of disagreements between desk and counts that are named for a sequence."""


def core_text(target: str, *, single: bool) -> str:
    """Return a core and the precision of the code on it; double precision is not named."""
    title = TARGETS[target].title if target in TARGETS else target
    return f"{title}, float" if single else title


NOTE = (
    "k, iterations and active rows are those of the worst step. code: with constants; static: with "
    "heap [bytes]. error: largest of the first move, in rate-limit steps. desk: native call at "
    "default settings, warm start where the solver has one; p99 of the same steps."
)
"""Meaning of the columns of the table of counts."""


def setting_text(sequence: CountedSequence) -> str:
    """Return sequence and core of a group of counts."""
    return f"{sequence.sequence} on {core_text(sequence.target, single=sequence.single)}"


def core_time_ns(instructions: int) -> float:
    """Return the time of instructions at `CYCLES` each and `CLOCK_MHZ` [ns]."""
    return 1e3 * instructions * CYCLES / CLOCK_MHZ


@dataclass(frozen=True)
class CoreTimes:
    """One row of the calculator: a solver on a core, its p99 and worst step in instructions."""

    solver: str
    where: str
    p99: int
    worst: int
    deadline_ns: float

    @property
    def cells(self) -> tuple[str, ...]:
        """Solver, sequence and core; p99, worst step, and the share of the deadline it takes."""
        worst_ns = core_time_ns(self.worst)
        share = sample_share_text(worst_ns / self.deadline_ns)
        return (
            self.solver,
            self.where,
            time_text(core_time_ns(self.p99)),
            time_text(worst_ns),
            share,
        )


def calculator_rows(results: EmbeddedResults, requirements: Requirements) -> list[CoreTimes]:
    """Return the rows of the calculator, in the order of the table of counts."""
    return [
        CoreTimes(one.solver, setting_text(group), one.p99, one.worst, requirements.deadline_ns)
        for group in results.sequences
        for one in group.solvers
    ]


def counted_text(results: EmbeddedResults, requirements: Requirements, solver: str) -> str:
    """State what a solver costs on an embedded core; "" where that was not counted."""
    largest = results.find_largest(solver)
    if largest is None or largest[1].error_move > requirements.error_move:
        return ""
    sequence, one = largest
    worst_ns = core_time_ns(one.worst)
    return (
        f"As C on a {core_text(sequence.target, single=sequence.single)} {solver} executes "
        f"{count_text(one.p99)} instructions a step at p99 and at most {count_text(one.worst)} "
        f"in {sequence.sequence}. At {CYCLES:g} cycle per instruction (an assumption) and "
        f"{CLOCK_MHZ:g} MHz the worst takes {time_text(worst_ns)}, "
        f"{sample_share_text(worst_ns / requirements.deadline_ns)} of the deadline of "
        f"{requirements.deadline_ms:g} ms. {CAVEAT}"
    )


def cheapest_text(sequence: CountedSequence, requirements: Requirements) -> str:
    """State which solver executes the fewest instructions within the required error."""
    right = [one for one in sequence.solvers if one.error_move <= requirements.error_move]
    where = setting_text(sequence)
    if not right:
        return f"No solver counted along {where} stays within the required error."
    first, *others = right
    following = ""
    if others:
        p99, worst = count_text(others[0].p99), count_text(others[0].worst)
        following = f" Next: {others[0].solver}, {p99} and {worst}."
    return (
        f"Along {where} {first.solver} executes the fewest instructions: "
        f"{count_text(first.p99)} a step at p99, {count_text(first.worst)} at most.{following}"
    )


def ranking_texts(
    sequences: Sequence[CountedSequence], requirements: Requirements
) -> Iterator[str]:
    """Yield where instructions and the desk's times rank solvers alike, and where otherwise."""
    apart = f"where both p99 differ by more than {100 * (APART - 1):.0f} %"
    alike = []
    for sequence in sequences:
        if len(sequence.desk_ranks) < 2:
            continue
        pairs = sequence.find_disagreements(requirements.error_move)
        if not pairs:
            alike.append(setting_text(sequence))
            continue
        # The widest first.
        pairs.sort(key=lambda pair: -pair[1].p99 * pair[0].desk_p99_ns / pair[0].p99)
        named = [
            f"{few.solver} executes fewer instructions than {many.solver} "
            f"({count_text(few.p99)} against {count_text(many.p99)}) and is slower on the desk "
            f"({time_text(few.desk_p99_ns)} against {time_text(many.desk_p99_ns)})"
            for few, many in pairs[:MOST_PAIRS]
        ]
        more = f", and {len(pairs) - MOST_PAIRS} more" if len(pairs) > MOST_PAIRS else ""
        where = setting_text(sequence)
        yield f"Desk and counts disagree along {where}: {and_list(named)}{more}, {apart}."
    if alike:
        yield f"Desk and counts rank the solvers alike along {and_list(alike)}, {apart}."


def not_counted_texts(missing: Sequence[UncountedSolver]) -> Iterator[str]:
    """Yield a line for each reason why solvers were not counted."""
    for reason in dict.fromkeys(one["reason"] for one in missing):
        own = [one for one in missing if one["reason"] == reason]
        solvers = and_list(list(dict.fromkeys(one["solver"] for one in own)))
        where = [f"{one['sequence']} on {core_text(one['target'], single=False)}" for one in own]
        yield f"Not counted: {solvers}, {and_list(list(dict.fromkeys(where)))}: {reason}."
