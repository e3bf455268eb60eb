"""Claims of solvers on random QPs whose optimum is known."""

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.random_claims import RandomClaims
from dpbench.report.charts.lines import draw_count_tiles
from dpbench.report.formats import Table, join_with_and
from dpbench.report.page.section import Figure, Topic


def build_random_topic(records: Records) -> Topic | None:
    """Return the report's part on random QPs with known optima; None without such runs."""
    claims = RandomClaims(records)
    if not claims.runs:
        return None
    by_solver = claims.sum_tallies_by_columns("solver")
    table = pd.DataFrame(
        [
            {"x": family, "y": solver, "count": tally.wrong_count}
            for (solver, family), tally in claims.sum_tallies_by_columns("solver", "family").items()
        ]
    )
    wrong = sorted(
        (-tally.wrong_count, name) for (name,), tally in by_solver.items() if tally.wrong_count
    )
    none = [name for (name,), tally in by_solver.items() if not tally.wrong_count]
    wording = [", ".join(f"{-count} by {name}" for count, name in wrong)] if wrong else []
    wording += [f"none by {join_with_and(none)}"] if none else []
    tallies = sorted(
        by_solver.items(), key=lambda item: (-item[1].wrong_count, -item[1].nothing, item[0])
    )
    steps = sum(tally.steps for tally in by_solver.values())
    rows = [
        {
            "solver": name,
            "steps": str(tally.steps),
            "claimed and true": str(tally.right_claims + tally.right_refusals),
            "false claims": str(tally.wrong_count),
            "true, not claimed": str(tally.not_claimed),
            "no answer": str(tally.nothing),
            "never reached": str(tally.missed),
        }
        for (name,), tally in tallies
    ]
    return Topic(
        id="random",
        title="Random QPs: reported and verified solutions",
        lines=(
            f"{-sum(count for count, _ in wrong)} false claims on {steps} certified steps: "
            f"{'; '.join(wording)}.",
            "These QPs are not from a ship; they test the accuracy of solvers, not their speed.",
        ),
        figures=(
            Figure(
                "random-claims", draw_count_tiles(table, "False claims", "family", "solver"), ""
            ),
        ),
        tables=(Table.from_rows(rows),),
    )
