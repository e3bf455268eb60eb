"""The last section: definitions, and the traps of reading a solver benchmark."""

from __future__ import annotations

from dpbench.analysis.statistics import BLOCK_STEPS, LEAST_BLOCKS, RESAMPLES
from dpbench.report.blocks import Bullets, Paragraph, Section

DEFINITIONS = (
    "**error_move** is the largest distance, over the three axes, of the first move to the "
    "certified optimum of the *same* QP, as a fraction of the step the rate limit allows; "
    "**error_plan** is the same over all moves. A step without an answer has an infinite error.",
    "**claimed**: the solver says solved. **true**: in scaled units primal ≤ 1e-3, dual ≤ "
    "1e-3·(1 + ‖q‖∞) and error_plan ≤ 1e-2. A solver never evaluations itself.",
    "**certified bound**: how far the referee's own optimum may be from the true one, at most.",
    "**failed step**: there was no usable answer and the fallback acted, or an iterate was "
    "applied that the solver itself calls unfinished. To give no answer to a QP that is proven to "
    "have none is no failure; whether the solver said why is part of **claimed** and **true**.",
    "**algorithmic time**: per step the minimum over the replay rounds, of set-up + update + "
    "solve + read. Its percentiles run over steps and tell hard steps from easy ones. **Of "
    "medians**: the same with the median over the rounds, which is what a usual round takes.",
    "**raw time**: all samples of all rounds, pooled. Its tail is the machine's jitter as much "
    "as the solver's.",
    "**route**: `native` calls the solver's own library; `qpsolvers` goes through that wrapper, "
    "whose conversions are part of the solve and cannot be split further. Configurations on "
    "different "
    "routes differ by the wrapper too.",
    "**policy**: `fresh` sets up from nothing in every step; `reuse` keeps factorisation and "
    "memory; `warm` keeps the previous answer as well, shifted by one move where the solver takes "
    "a start. A policy that a solver cannot run is a refused cell with its reason.",
    "**default route**: `qpsolvers` where a solver was run on it, else the first route it was run "
    "on. The verdict is on the default route, policy fresh; every other way is judged on replays, "
    "and on closed loops where some were run that way.",
    "**settings**: `default` is what the library ships; `low`, `mid` and `high` ask for tolerances "
    "of 1e-3, 1e-6 and 1e-9; `polished` adds the solver's own polishing of the answer. Where "
    "settings have no effect, one run is shown under all names.",
    "**shifted geometric mean**: exp(mean ln(t + s)) − s over steps, every sequence of equal "
    "weight; the shift s is the median of the fastest configuration, as one of seconds would "
    "make it an "
    "arithmetic mean. **Performance profile**: the share of steps solved within so many times the "
    "fastest solver's time on the same step.",
    "**unsolved step** of a ranking at an accuracy: it failed, its answer is not **true**, or its "
    "error_move is larger than the accuracy. To meet the demand asks for error_move and failed "
    "steps alone, so a configuration whose later moves are off may meet it and still have "
    "unsolved steps. "
    "**other_ranks**: other places that another penalty, "
    "another shift or the loss of one sequence leads to.",
    "**the machine was quiet** or **disturbed**: judged by a rule stated beside it, from what the "
    "kernel counts around every replay round and from a reference kernel timed before and after "
    "it. A round in which that kernel is slowed by more than a quarter is disturbed and run again "
    "once; one disturbed twice does not count. Context switches that a configuration makes "
    "itself, such as by "
    "a thread in each solve, are named and do not count: one in every other step at least, and "
    "ten times as many a second as the median configuration and the rule allow.",
    "**no_op**, **copy_only**, **busy_wait**: configurations of the harness itself, of known "
    "cost, by which "
    "it measures its own overhead and shows that it measures right. They answer nothing, are "
    "judged by nobody, and no time is corrected by them.",
    "**slow-down**: the deadline over the largest algorithmic step time, rounded down; a "
    "computer that many times slower would still make the deadline on every step.",
)
TRAPS = (
    "An interval here covers which steps were drawn, not another day on the same machine; a "
    "ratio near 1 between two solvers may turn on another machine.",
    "A percentile is printed only with ten samples beyond it: p99 takes 1000 steps, p99.9 takes "
    "10 000 samples.",
    "A table of closed loops compares controllers, not solvers on equal problems: each solver "
    "sees the QPs of its own ship.",
    "A small residual is no small error: on a flat cost a wrong answer passes every residual "
    "test, which is why the error is measured against the optimum itself.",
    "A cell that was stopped early is judged on the steps it did, which are not the same steps "
    "as its neighbours'.",
)


def reading_section() -> Section:
    """How to read this report."""
    return Section(
        "reading",
        "How to read this report",
        [
            Bullets(DEFINITIONS),
            Paragraph(
                f"Bootstrap intervals draw blocks of {BLOCK_STEPS} consecutive steps, as "
                f"neighbouring steps resemble each other ({RESAMPLES} resamples for "
                f"percentiles, {4 * RESAMPLES} for paired ratios; fixed seed). Fewer than "
                f"{LEAST_BLOCKS * BLOCK_STEPS} steps give none."
            ),
            Paragraph("Traps:"),
            Bullets(TRAPS),
        ],
    )
