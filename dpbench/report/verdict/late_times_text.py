"""Times above one limit in several replays and windows, as one clause of a verdict."""

from collections.abc import Iterator, Sequence

from dpbench.analysis.records.run_record import group_by_key
from dpbench.analysis.verdict.requirements import Finding
from dpbench.report.formats import describe_range_of_steps, format_time, join_with_and
from dpbench.report.words import read_words

_WORDS: dict[str, str] = read_words(__file__)
_SAME_LIMIT = {"window late": "p99 late"}
"""Kinds of findings that share the clause of another kind."""


def group_late_times(findings: Sequence[Finding]) -> Iterator[list[Finding]]:
    """Yield lists of findings in order: those of times above one limit together, others alone."""

    def kind_or_number(numbered: tuple[int, Finding]) -> str | int:
        i, finding = numbered
        kind = _SAME_LIMIT.get(finding.kind, finding.kind)
        return kind if kind in _WORDS else i

    for alike in group_by_key([*enumerate(findings)], kind_or_number).values():
        yield [finding for _, finding in alike]


def describe_late_times(alike: Sequence[Finding]) -> str:
    """Return the clause of several times above one limit, each behind its replay or window."""
    replays, windows = list[str](), list[str]()
    for finding in alike:
        run, time = finding.runs[0], format_time(finding.value)
        if run.steps_searched_for_hardest:
            windows.append(f"`{run.scenario}` ({time})")
        else:
            replays.append(f"{describe_range_of_steps(run.sequence)} ({time})")
    where = []
    if replays:
        where.append(f"the replay{'s' * (len(replays) > 1)} of {join_with_and(replays)}")
    if windows:
        where.append(f"the hardest steps of {join_with_and(windows)}")
    kind = _SAME_LIMIT.get(alike[0].kind, alike[0].kind)
    return _WORDS[kind].format(limit=format_time(alike[0].limit), where=join_with_and(where))
