"""Verdicts on runs of two revisions: disturbances, pairs of runs, answers, failures."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dpbench.ci import Allowance, parse_allowance
from dpbench.ci.benchmarks import BenchmarkRun, Selection
from dpbench.ci.comparison import compare_runs, describe_end
from dpbench.ci.machine_state import MachineState

QUIET = {
    "wall_s": 1.0,
    "processor_s": 1.0,
    "voluntary_switches": 0.0,
    "involuntary_switches": 3.0,
    "steal_s": 0.0,
    "kernel_before_ns": 4e4,
    "kernel_after_ns": 4.1e4,
}


def entry(name: str = "t", seconds: float = 1e-3, **more: Any) -> dict[str, Any]:
    """An entry of a JSON file, on a quiet machine."""
    info = {"reference_ns": 4e4, "machine": QUIET} | more
    stats = {"min": seconds, "q1": 1.01 * seconds, "rounds": 50}
    return {"fullname": name, "stats": stats, "extra_info": info}


def run_of(*entries: dict[str, Any], **failed: str) -> BenchmarkRun:
    """A run of pytest."""
    return BenchmarkRun.from_json_entries(entries, failed)


def verdicts(base: BenchmarkRun, head: BenchmarkRun, **options: bool) -> tuple[str, bool]:
    """Verdict of a single pair of runs, and whether it is a regression."""
    found = compare_runs([(base, head)], **options)
    return found.verdict, found.worse


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({}, ""),
        ({"involuntary_switches": 30.0}, "30 involuntary context switches per second"),
        ({"processor_s": 0.6}, "a processor for only 60 % of the time"),
        # A solver that sleeps or waits for a device is not put off.
        ({"processor_s": 0.6, "voluntary_switches": 200.0}, ""),
        ({"steal_s": 0.1}, "10.0 % of the time stolen by the host"),
        ({"kernel_after_ns": 8e4}, "a reference kernel 2.00 times as slow at one end"),
        ({"throttle_events": 2.0}, "2 throttle events"),
        # In half a second, 8 switches and one tick of 10 ms are no rates.
        ({"wall_s": 0.5, "processor_s": 0.5, "involuntary_switches": 8.0, "steal_s": 0.01}, ""),
        (
            {"wall_s": 0.5, "processor_s": 0.5, "involuntary_switches": 12.0},
            "12 involuntary context switches per second",
        ),
    ],
)
def test_complaints_of_a_machine(changed: dict[str, float], text: str) -> None:
    """Each limit of a quiet machine has its words; what is hidden is no complaint."""
    assert MachineState.from_stored_state(QUIET | changed).complaints() == ([text] if text else [])


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("factor", [0.06, 1.0, 1.06, 2.06])
def test_a_disturbed_time_has_no_verdict(side: int, factor: float) -> None:
    """Neither slower nor faster, whichever of the two runs it was, and no ratio."""
    loud = QUIET | {"involuntary_switches": 120.0}
    machines = [loud if side == i else QUIET for i in range(2)]
    base, head = (
        run_of(entry(seconds=s, machine=m))
        for s, m in zip((1e-3, factor * 1e-3), machines, strict=True)
    )
    found = compare_runs([(base, head)])
    (row,) = found.rows
    assert (found.verdict, found.worse) == ("disturbed", False)
    assert row.cells["ratio"] == "–"
    assert "120 involuntary context switches" in row.cells["remarks"]
    assert found.headline.startswith("disturbed")
    line = "times not judged (machine disturbed) in 1 of 1 benchmark; failures: no regression"
    _, verdict, *ratio, exact, passes = describe_end(found, "base", "head", option="--option")
    assert found.describe_exit(0) == "exit code 0 (disturbed)"
    assert found.describe_exit(75) == "exit code 75 (disturbed)"
    assert verdict == f"{line} against base"
    not_gross = "; not treated as a gross slowdown (above × 1.5): 1 pair of runs < 2"
    slower = {
        2.06: [f"largest ratio not judged: × 2.06 (t){not_gross}"],
        1.06: ["largest ratio not judged: × 1.06 (t)"],
    }
    assert ratio == slower.get(factor, [])
    assert passes.startswith("times not judged give exit code 0; --option CODE ")
    assert exact.startswith("exact measures are judged on a disturbed machine too: iterations, ")
    assert describe_end(found, "base", "head", 75)[2:] == [*ratio, exact]


def test_a_comparison_counts_times_without_a_verdict_and_bounds_the_others() -> None:
    """One of two times is disturbed; the interval of the other one has an upper end."""
    loud = entry("loud", machine=QUIET | {"involuntary_switches": 120.0})
    found = compare_runs([(run_of(entry("quiet"), entry("loud")), run_of(entry("quiet"), loud))])
    assert found.headline == (
        "disturbed (1 of 2 times not judged, other load disturbed the machine): 1 disturbed, "
        "1 no difference shown"
    )
    (judged,) = (row.ratio for row in found.rows if row.name == "quiet")
    assert judged is not None and judged.high > 1.05
    bound = describe_end(found, "base", "head")[2]
    assert bound == f"largest slowdown not excluded: × {judged.high:.2f} (quiet)"
    assert found.describe_unjudged(0)[0] == bound, "in the lines of `revisions` too"
    slower = compare_runs([(run_of(entry("quiet")), run_of(entry("quiet", 1e-2)))])
    assert not any("not excluded" in line for line in describe_end(slower, "base", "head"))


def test_exact_measures_and_answers_have_a_verdict_on_a_disturbed_machine() -> None:
    """They do not depend on the clock."""
    loud = QUIET | {"involuntary_switches": 120.0}
    base = run_of(entry(machine=loud, exact={"iterations": 10}))
    more = run_of(entry(machine=loud, exact={"iterations": 11}))
    found = compare_runs([(base, more)])
    line = "a regression against base; times not judged (machine disturbed) in 1 of 1 benchmark"
    assert describe_end(found, "base", "head", 75)[1] == line
    assert found.describe_exit(75) == "exit code 1 (worse)"
    assert (found.verdict, found.rows[0].remarks[0]) == ("worse", "iterations 10 → 11")
    line = "times not judged (machine disturbed) in 1 of 1 benchmark; iterations: no regression"
    assert compare_runs([(more, base)]).describe_verdict("b") == f"{line} against b"
    assert verdicts(base, run_of(t="wrong answers: error 3")) == ("wrong answers", True)


def test_a_failed_test_is_not_gone_and_one_that_is_gone_may_be_allowed() -> None:
    """Each has a verdict of its own."""
    base, other = run_of(entry("t")), run_of(entry("u"))
    assert verdicts(base, run_of(t="ZeroDivisionError")) == ("failed, not timed", True)
    for was, remarks in ((base, 1), (run_of(t="ImportError"), 2)):
        (row,) = compare_runs([(was, run_of(t="ImportError"))]).rows
        assert row.remarks == ("ImportError", "the benchmark fails in the base too")[:remarks]
    assert verdicts(base, other) == ("gone", True)
    assert verdicts(base, other, allow_gone=True) == ("new", False)
    assert verdicts(run_of(), base) == ("no baseline", False)
    line = compare_runs([(run_of(), base)]).describe_verdict("base 05cf873")
    assert line == "comparisons start when the base has these benchmarks"
    assert verdicts(run_of(t="TypeError"), base) == ("no baseline", False)
    assert verdicts(run_of(entry("u"), t="TypeError"), run_of(entry("u"), entry("t")))[1] is False


def test_faster_needs_verified_answers() -> None:
    """A solver is not faster by answers that nobody confirmed; slower it may be."""
    base, quick, slow = (run_of(entry(seconds=s, true_share=0.9)) for s in (1e-3, 1e-4, 1e-2))
    assert verdicts(base, quick) == ("faster, not all verified", False)
    assert verdicts(base, slow) == ("slower", True)
    assert verdicts(base, run_of(entry(seconds=1e-4, true_share=1.0))) == ("faster", False)


def test_disturbed_pairs_are_left_out_where_three_others_remain() -> None:
    """Two of five pairs tell nothing; with three disturbed there is no verdict."""
    loud = QUIET | {"steal_s": 0.5}

    def pairs(disturbed: int) -> list[tuple[BenchmarkRun, BenchmarkRun]]:
        machines = [loud] * disturbed + [QUIET] * (5 - disturbed)
        return [
            (run_of(entry()), run_of(entry(seconds=9e-3 if m is loud else 2e-3, machine=m)))
            for m in machines
        ]

    found = compare_runs(pairs(2))
    assert found.verdict == "slower"
    assert found.rows[0].ratio is not None
    assert found.rows[0].ratio.value == pytest.approx(2.0)
    assert compare_runs(pairs(3)).verdict == "disturbed"


@pytest.mark.parametrize(
    ("allow", "verdict"),
    [
        ((), "worse"),
        ((Allowance("iterations", "osqp"),), "no difference shown"),
        ((Allowance("iterations", "osqp", 0.2),), "no difference shown"),
        ((Allowance("iterations", "osqp", 0.1),), "worse"),
        ((Allowance("iterations", "daqp"),), "worse"),
        ((Allowance("errors", "osqp"),), "worse"),
    ],
)
def test_an_increase_may_be_allowed_for_a_solver(allow: Any, verdict: str) -> None:
    """Iterations of one solver alone; an allowance that nothing matches is named."""
    base, head = (
        run_of(
            entry(solver="osqp (native)", exact={"iterations": count}),
            *(entry(name, solver=name) for name in ("piqp", "scs", "qpalm")),
        )
        for count in (10, 12)
    )
    found = compare_runs([(base, head)], allow=allow)
    assert found.verdict == verdict
    (row,) = (row for row in found.rows if row.name == "t")
    allowed = " (allowed)" if verdict == "no difference shown" else ""
    assert row.remarks == (f"iterations 10 → 12{allowed}",)
    lines = describe_end(found, "base", "head")
    is_used = any(one[:2] == ("iterations", "osqp") for one in allow)
    unused = [f"allowed, but measured in no benchmark: {':'.join(one[:2])}" for one in allow]
    bound = ["largest slowdown not excluded: × 1.22 (piqp)"] if allowed else []
    assert lines[2:] == bound + ([] if is_used else unused)
    shown = "no regression shown against base; 1 increase allowed"
    assert lines[1] == (shown if allowed else "a regression against base")


def test_exact_measures_have_one_order_in_the_verdict() -> None:
    """Whichever benchmark is first, and those without a kind of their own last."""
    loud = QUIET | {"involuntary_switches": 120.0}
    exact: list[dict[str, float]] = [{"rows": 3}, {"error_move_max": 1e-6}, {"iterations": 10}]
    run = run_of(*(entry(f"t{i}", machine=loud, exact=one) for i, one in enumerate(exact)))
    more = run_of(*(entry(f"t{i}", machine=loud, exact=one) for i, one in enumerate(exact)))
    more.benchmarks["t2"] = replace(more.benchmarks["t2"], exact={"iterations": 11})
    allow = [Allowance("iterations", "t2")]
    line = compare_runs([(run, more)], allow=allow).describe_verdict("b")
    exact_line = "iterations, errors and rows: no regression against b"
    assert line.endswith(f"; {exact_line}; 1 increase allowed")


@pytest.mark.parametrize("option", ["--allow", "--dpbench-allow"])
@pytest.mark.parametrize(
    ("before", "after", "allowance"),
    [(3799, 3874, "calls:slsqp=2%"), (10, 11, "calls:slsqp=10%"), (0, 4, "calls:slsqp")],
)
def test_a_larger_measure_of_the_user_names_its_allowance(
    before: int, after: int, allowance: str, option: str
) -> None:
    """The growth of 3799 to 3874 is 1.97 %; that of 0 has no percentage. The allowance suffices."""
    base, head = (
        run_of(entry(solver="slsqp (native)", exact={"calls": x})) for x in (before, after)
    )
    (row,) = compare_runs([(base, head)], option=option).rows
    assert row.remarks[0].endswith(f" (to accept: {option} {allowance})")
    assert not compare_runs([(base, head)], allow=[parse_allowance(allowance)]).worse


def test_an_allowance_is_named_as_a_shell_takes_it() -> None:
    """A benchmark without a solver has its own name, whose brackets need quotes."""
    base, head = (run_of(entry("t[1]", exact={"calls": x})) for x in (10, 11))
    (row,) = compare_runs([(base, head)]).rows
    assert row.remarks == ("calls 10 → 11 (to accept: --allow 'calls:t[1]=10%')",)


def test_other_growth_is_no_part_of_an_allowance() -> None:
    """A larger error beside allowed iterations is worse."""
    base = run_of(entry(solver="osqp", exact={"iterations": 10, "error_move_max": 1e-6}))
    head = run_of(entry(solver="osqp", exact={"iterations": 12, "error_move_max": 1e-4}))
    assert compare_runs([(base, head)], allow=[Allowance("iterations", "osqp")]).worse
    both = [Allowance("iterations", "osqp"), Allowance("errors", "osqp")]
    assert not compare_runs([(base, head)], allow=both).worse


def test_a_larger_measure_names_its_step() -> None:
    """A measure of which one step grows names that step; base and head of other steps name none."""
    base, head, others = (
        run_of(
            entry(
                exact={"iterations": sum(counts)},
                sequence="paper-30-5",
                exact_by_step={"k": steps, "iterations": counts},
            )
        )
        for steps, counts in (([0, 3, 6], [5, 5, 5]), ([0, 3, 6], [6, 9, 4]), ([0, 3], [9, 9]))
    )
    (row,) = compare_runs([(base, head)]).rows
    assert row.remarks == ("iterations 15 → 19 (most at step 3 of paper-30-5: 5 → 9)",)
    (row,) = compare_runs([(base, others)]).rows
    assert row.remarks == ("iterations 15 → 18",)


@pytest.mark.parametrize("count", [1, 3])
def test_without_a_quiet_run_there_is_no_ratio(count: int) -> None:
    """Load on both sides shows nothing of the factor between them; a line has it all the same."""
    loud = QUIET | {"steal_s": 0.5}
    pair = run_of(entry(machine=loud)), run_of(entry(seconds=2e-3, machine=loud))
    found = compare_runs([pair] * count)
    (row,) = found.rows
    assert (row.verdict, row.cells["ratio"]) == ("disturbed", "–")
    assert found.describe_unjudged(0)[0].startswith("largest ratio not judged: × 2.00 (t); ")


@pytest.mark.slow
def test_the_interval_of_pairs_covers_what_runs_scatter() -> None:
    """Unchanged code whose runs scatter by 30 %: the truth is in nearly every interval."""
    rng, covered, wide = np.random.default_rng(5), 0, []
    for _ in range(200):
        factors = np.exp(rng.normal(0.0, 0.3, (5, 2)))
        pairs = [(run_of(entry(seconds=a)), run_of(entry(seconds=b))) for a, b in factors]
        (row,) = compare_runs(pairs).rows
        assert row.ratio is not None
        covered += row.ratio.contains(1.0)
        wide.append(row.ratio.high / row.ratio.low)
    assert covered >= 180
    quiet = compare_runs([(run_of(entry()), run_of(entry()))] * 5).rows[0].ratio
    assert quiet is not None
    assert np.median(wide) > 1.5 * quiet.high / quiet.low


def test_the_document_begins_with_the_verdict() -> None:
    """The first line of a comment; names of others are made harmless."""
    found = compare_runs([(run_of(entry("a|b")), run_of(entry("a|b", seconds=1e-2)))])
    first, _, rest = found.markdown(["five runs"]).partition("\n")
    assert first == "**dpbench: slower: 1 benchmark**"
    assert rest.startswith("\nfive runs\n\n|") and "a\\|b" in rest


def test_what_was_compared_is_counted() -> None:
    """Benchmarks of both, and how many each has; what the head was not to run is not gone."""
    base, head = run_of(entry("t"), entry("u"), entry("v")), run_of(entry("t"), new="TypeError")
    found = compare_runs([(base, _without(head, "u", "v"))])
    line = "1 of 4 benchmarks compared (1 failed, 2 not run); 3 in base, 2 in now"
    assert found.describe_scope("base", "now") == line
    assert found.headline.endswith(": 1 failed, 1 no difference shown, 2 not run")
    found = compare_runs([(base, _without(run_of(entry("t"), u="wrong answers: 3"), "v"))])
    counts = "1 with wrong answers, 1 no difference shown, 1 not run"
    assert found.headline.endswith(f" (answers beyond the requirements of the test): {counts}")
    found = compare_runs([(base, _without(run_of(entry("t")), "u", "v"))])
    assert not found.worse and found.verdict == "no difference shown"
    assert compare_runs([(base, _without(run_of(entry("t")), "u"))]).worse


def _without(run: BenchmarkRun, *names: str) -> BenchmarkRun:
    """A run whose session deselected some tests."""
    return replace(run, selection=Selection(deselected=frozenset(names)))


@pytest.mark.parametrize(
    ("given", "name", "is_left_out"),
    [
        (".", "tests/test_a.py::test_x[1]", False),
        ("tests", "tests/test_a.py::test_x[1]", False),
        ("tests/test_a.py", "tests/test_a.py::test_x", False),
        ("tests/test_a.py", "tests/test_b.py::test_x", True),
        ("tests/test_a.py::test_x", "tests/test_a.py::test_x[1]", False),
        ("tests/test_a.py::test_x", "tests/test_a.py::test_xy", True),
        ("tests/test_a.py::Case", "tests/test_a.py::Case::test_x", False),
    ],
)
def test_a_selection_is_of_files_and_node_ids(given: str, name: str, is_left_out: bool) -> None:
    """As pytest reads its arguments: a folder, a file, a class or a test with its parameters."""
    assert Selection((given,)).leaves_out(name) is is_left_out
    assert Selection((given,), frozenset([name])).leaves_out(name)


@pytest.mark.parametrize(
    ("seconds", "switches", "code"), [(1e-3, 0.0, 0), (1e-3, 1e3, 75), (1e-1, 0.0, 1)]
)
def test_the_exit_code_of_a_disturbed_comparison_is_chosen(
    seconds: float, switches: float, code: int
) -> None:
    """It is neither that of a regression nor that of a quiet comparison."""
    machine = QUIET | {"involuntary_switches": switches}
    pair = run_of(entry()), run_of(entry(seconds=seconds, machine=machine))
    assert compare_runs([pair]).exit_code(75) == code


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_change_of_the_solver_measured_most_is_not_the_machines(factor: float) -> None:
    """Three others with a benchmark each outvote four of the one that changed."""
    own = [f"own-{number}" for number in range(4)]

    def entries(seconds: float) -> list[dict[str, Any]]:
        others = [entry(name, solver=name) for name in ("daqp", "osqp", "quadprog")]
        return [*others, *(entry(name, seconds, solver="own") for name in own)]

    found = compare_runs([(run_of(*entries(1e-3)), run_of(*entries(factor * 1e-3)))] * 5)
    for row in found.rows:
        assert row.ratio is not None
        assert row.ratio.value == pytest.approx(factor if row.name in own else 1.0)


@pytest.mark.parametrize("factor", [1.0 / 3.0, 3.0])
def test_a_change_of_a_benchmark_without_a_solver_is_not_the_machines(factor: float) -> None:
    """A replay and a test that notes no solver change together; two other solvers do not."""
    unchanged = [entry(name, solver=name) for name in ("daqp", "quadprog")]
    base, head = (
        run_of(*unchanged, entry("replay", s, solver="slsqp"), entry("calls", s))
        for s in (1e-3, factor * 1e-3)
    )
    ratios = {}
    for row in compare_runs([(base, head)]).rows:
        assert row.ratio is not None
        changed = "slower" if factor > 1.0 else "faster"
        is_same = row.name in ("daqp", "quadprog")
        assert row.verdict == ("no difference shown" if is_same else changed)
        ratios[row.name] = row.ratio.value
    same = {"daqp": 1.0, "quadprog": 1.0}
    assert ratios == pytest.approx(same | {"replay": factor, "calls": factor})


def test_benchmarks_without_a_solver_do_not_widen_the_intervals_of_others() -> None:
    """Their common change may be one of code."""
    known = [entry(f"known-{i}", solver=f"s{i}") for i in range(4)]
    widths = []
    for factor in (1.0, 3.0):
        own = [[entry(f"t{i}", s) for i in range(3)] for s in (1e-3, factor * 1e-3)]
        base, head = (run_of(*known, *one) for one in own)
        ratios = [row.ratio for row in compare_runs([(base, head)]).rows if "known" in row.name]
        widths += [one.high / one.low for one in ratios if one is not None]
    assert widths == pytest.approx([widths[0]] * 8)


def test_an_allowance_of_a_benchmark_without_a_solver_has_its_own_name() -> None:
    """Named as it is suggested; a name with a space and bracket is kept whole."""
    base, head = (run_of(entry("t[a (b)]", exact={"calls": x})) for x in (10, 11))
    assert compare_runs([(base, head)]).worse
    allow = [parse_allowance("calls:t[a (b)]=10%")]
    assert not compare_runs([(base, head)], allow=allow).worse


@pytest.mark.parametrize(
    ("kernel_ns", "text"),
    [
        ((None, None), "machine factor × 2.00, shared by "),
        ((4e4, 4e4), "factor beyond that of the reference kernel: × 2.00, shared by "),
        ((4e4, 8e4), ""),
    ],
)
def test_a_factor_that_all_solvers_share_is_named(kernel_ns: Any, text: str) -> None:
    """It may be of shared code; where the reference kernel has it too, it is the machine's."""
    base, head = (
        run_of(*(entry(x, s, solver=x, reference_ns=kernel) for x in ("a", "b", "c", "d")))
        for s, kernel in zip((1e-3, 2e-3), kernel_ns, strict=True)
    )
    found = compare_runs([(base, head)])
    assert found.verdict == "no difference shown"
    assert [line[: len(text)] for line in describe_end(found, "b", "h")[3:]] == [text] * bool(text)
