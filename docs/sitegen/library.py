"""Reference of the vessels, scenarios and suites of the package, from their files."""

from dpbench.bench.plan.suite import load_path_and_suite
from dpbench.scenario.problem_files import list_shipped_problem_names
from dpbench.scenario.scenario import load_scenario, load_vessel
from sitegen.markup import code, prose, table

INTRODUCTION = """# Suites, scenarios and vessels

To run a scenario with another vessel, write `rough@osv`. Every file is under `problems/` and
names the source of its numbers.
"""


def pages() -> dict[str, str]:
    """Markdown by file of the documentation."""
    parts = [INTRODUCTION, "## Suites\n", _suites(), "## Scenarios\n", _scenarios()]
    return {"reference/library.md": "\n".join([*parts, "## Vessels\n", _vessels()])}


def _suites() -> str:
    titles = (
        (name, load_path_and_suite(name)[1].title) for name in list_shipped_problem_names("suites")
    )
    return table(("suite", "question"), ((code(name), prose(title)) for name, title in titles))


def _scenarios() -> str:
    rows = []
    for name in list_shipped_problem_names("scenarios"):
        run = load_scenario(name)
        tuning = run.controller.tuning_and_horizons_label
        rows.append((code(name), run.vessel.id, tuning, str(run.steps), prose(run.shows)))
    return table(("scenario", "vessel", "tuning", "steps", "what it shows"), rows)


def _vessels() -> str:
    ships = [load_vessel(name) for name in list_shipped_problem_names("vessels")]
    rows = ((code(ship.id), prose(ship.title), prose(ship.source)) for ship in ships)
    return table(("vessel", "ship", "source"), rows)
