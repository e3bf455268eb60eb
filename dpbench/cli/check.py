"""Text of `dpbench check`: a line on a sequence or a suite, a dozen on a ship (`check_ship`).

Each kind imports its own work, so that an error appears before anything heavy is loaded.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dpbench.bench.progress import Progress
from dpbench.errors import InputError, SituationError, find_nearest_names
from dpbench.scenario import problem_files as problems
from dpbench.scenario.tables.scenario_file import ScenarioFile
from dpbench.scenario.tables.vessel_file import VesselFile

if TYPE_CHECKING:
    from dpbench.bench.plan.cells import PlannedCell
    from dpbench.scenario.problem_files import ScenarioDocuments

CHECKED = (
    "a TOML file of a vessel, scenario or suite; a .npz, .json or .mat file of QPs, or a folder of "
    "them; a folder in results/community"
)
"""Files that `dpbench check` reads, for errors."""
NONE_PASSES = (
    "no configuration (solver, route, policy, settings) has both a closed loop and a replay, so "
    "none can pass"
)

FIRST_SOLVER = "daqp"
"""The solver of a short first run: fast, and right in every controller that is shipped."""
MOST_UNSTABLE = 3
"""Unstable loops of a suite that are described; the others are counted."""


def check_file(name: str, progress: Progress | None = None, *, quick: bool = False) -> str:
    """Check a stored name or file of a ship, scenario, suite or QPs; return its description.

    quick : try no offsets of a ship; a suite and QPs are checked as without.
    """
    if problems.is_shipped_sequence_name(name):
        return _check_sequence(problems.resolve_sequence_path(name), progress)
    # A scenario and a suite may have one name.
    kinds = [kind for kind in problems.KINDS if name in problems.list_shipped_problem_names(kind)]
    paths = [problems.find_problem_path(kind, name) for kind in kinds]
    if paths:
        return "\n".join(_check_document(path, progress, quick=quick) for path in paths)
    # Unlike Path.exists, these are False for a name that is too long to exist.
    if os.path.isdir(name):
        return _check_folder(Path(name), progress)
    if name.endswith(".py"):
        command = f"dpbench run smoke --solver-module {name} --solver NAME"
        raise SituationError(name, f"found a Python file; to test a solver, run `{command}`")
    if name.endswith(problems.SEQUENCE_SUFFIXES):
        return _check_sequence(Path(name), progress)
    if os.path.isfile(name):
        text = _check_document(Path(name), progress, quick=quick)
        return "\n".join([text, *_suggest_first_run(Path(name))])
    if "@" in name:
        return _check_scenario(name, progress, quick=quick)
    if name.endswith(".toml") or "/" in name:
        raise InputError(name, "", "no such file or folder", CHECKED)
    raise _make_unknown_name_error(name)


def _make_unknown_name_error(name: str) -> InputError:
    """Return the error for a name that `dpbench check` does not find, with the nearest ones."""
    kinds = (*problems.KINDS, problems.SEQUENCES)
    names = [known for kind in kinds for known in problems.list_shipped_problem_names(kind)]
    near = find_nearest_names(name, names, likeness=0.6)
    hint = f"{', '.join(near)} or another name" if near else "a name"
    shown = repr(name if len(name) <= 80 else f"{name[:77]}...")
    return InputError(
        "check", "", shown, f"{hint} that `dpbench list KIND` shows; SCENARIO@VESSEL; {CHECKED}"
    )


def _check_folder(folder: Path, progress: Progress | None) -> str:
    """Check a folder of submitted results or of qpsolvers' QPs; return its description."""
    from dpbench.report.documents.sent import SENDER, check_sent_folder

    if os.path.isfile(folder / SENDER):
        return check_sent_folder(folder)
    if os.path.isfile(folder / "runs.parquet"):
        remedy = "required: a folder written by `dpbench report --send`"
        raise SituationError(str(folder / SENDER), f"no such file; {remedy}")
    return _check_sequence(folder, progress)


def _check_sequence(path: Path, progress: Progress | None) -> str:
    """Certify every step of a sequence file anew; return the result as text."""
    from dpbench.bench.sequences.source import verify_sequence

    return verify_sequence(path, progress)


def _check_document(file: Path, progress: Progress | None, *, quick: bool) -> str:
    """Check a TOML file of a vessel, scenario or suite by its tables; return a description."""
    document = problems.read_toml_as_dict(file)
    if "limits" in document or "thrusters" in document:
        return _check_vessel(file, progress, quick=quick)
    if "controller" in document or "environment" in document:
        problems.validate_settings_as_model(document, ScenarioFile, str(file))
        return _check_scenario(file, progress, quick=quick)
    return _check_suite(file, document)


def _check_vessel(file: Path, progress: Progress | None, *, quick: bool) -> str:
    """Validate a vessel file; return the ship's properties as text."""
    vessel = problems.read_toml_as_model(file, VesselFile).build_vessel(file.stem, str(file))
    from dpbench.cli.ship.check_ship import describe_checked_vessel

    return describe_checked_vessel(file, vessel, progress, quick=quick)


def _check_scenario(name: str | Path, progress: Progress | None, *, quick: bool) -> str:
    """Load a scenario, which validates it; return its ship, weather and controller as text."""
    from dpbench.cli.ship.check_ship import describe_checked_scenario
    from dpbench.scenario.scenario import load_scenario

    return describe_checked_scenario(name, load_scenario(name), progress, quick=quick)


def _check_suite(file: Path, document: dict[str, Any]) -> str:
    """Validate a file that describes a suite of solver runs; return their number, time and size."""
    from dpbench.bench.plan.suite import SuiteFile, load_path_and_suite, name_file_in_errors

    of_suite = SuiteFile.list_names_of_run_tables()
    of_vessel = VesselFile.model_fields.keys()
    # A vessel has one table [capability]; a suite has a list of them.
    if not any(
        table in document and (table not in of_vessel or isinstance(document[table], list))
        for table in of_suite
    ):
        allowed = (
            "[limits] or [[thrusters]] (a vessel), [controller] and [environment] (a scenario), "
            f"or {', '.join(f'[[{table}]]' for table in of_suite)} (a suite)"
        )
        keys = f"only the key{'s' * (len(document) > 1)} {', '.join(document)}"
        found = f"no vessel, scenario or suite, {keys if document else 'as it has no keys'}"
        raise SituationError(str(file), f"found {found}; required: {allowed}")
    suite_path, suite = load_path_and_suite(file)
    from dpbench.bench.design import pair_controllers_with_vessels
    from dpbench.bench.embedded_counts import pair_sequences_with_cores
    from dpbench.bench.engines.open_engine import count_slots
    from dpbench.bench.estimate import estimate_plan
    from dpbench.bench.plan.run_request import RunRequest

    plan = RunRequest(str(file)).make_plan()
    with name_file_in_errors(suite_path):
        if suite.design:
            pair_controllers_with_vessels(suite.design, suite_path.parent)
        counts = (
            pair_sequences_with_cores(suite.embedded, suite_path.parent) if suite.embedded else []
        )
    also = [f"also {len(counts)} instruction counts on embedded cores"] if counts else []
    missing = [] if _can_pass(plan.cells) else [f"{file}: {NONE_PASSES}"]
    missing += [f"{file}: {text}" for text in _describe_unstable_loops(plan.cells)]
    estimate = estimate_plan(plan, Path("results") / suite_path.stem, count_slots(None))
    to_run, *expected = estimate.lines
    whole = f"{file}: a suite of {len(plan.cells)} cells{_count_refused_and_rows(plan.cells)}"
    counted = [whole, *[to_run] * bool(estimate.finished)]
    return "\n".join([*missing, *counted, *expected, *also])


def _count_refused_and_rows(planned: Sequence[PlannedCell]) -> str:
    """Return text on cells of the baseline law, refused cells, and rows of `runs.parquet`.

    The rows are given where they outnumber the cells: a cell has a further row under each other
    name of equal settings.
    """
    from dpbench.bench.plan.configurations import BASELINE_LAW

    counts = {
        "with the baseline law": sum(one.cell.solver == BASELINE_LAW for one in planned),
        "refused (reasons: dpbench run SUITE --dry-run)": sum(bool(one.refused) for one in planned),
    }
    rows = sum(1 + len(one.alias_settings) for one in planned)
    text = "".join(f", {count} {kind}" for kind, count in counts.items() if count)
    return text + (f"; {rows} rows in runs.parquet" if rows > len(planned) else "")


def _suggest_first_run(file: Path) -> list[str]:
    """Return lines with a short first run of a suite, or of the suite beside a ship's file.

    A scenario that the suite does not contain is run in place of its own. None where there is no
    such suite, or it is wrong: that is for its own check.
    """
    stems = ("_".join(file.stem.split("_")[:n]) for n in range(file.stem.count("_") + 1, 0, -1))
    beside = (file.with_name(f"{stem}_suite.toml") for stem in stems)
    path = file if file.stem.endswith("_suite") else next(filter(os.path.isfile, beside), None)
    if path is None:
        return []
    from dpbench.bench.plan.configurations import name_solvers_of_suite
    from dpbench.bench.plan.run_request import RunRequest

    try:
        whole = RunRequest(str(path)).make_plan()
        own = [path.parent / name for name in whole.document.scenario_names]
        is_other = "controller" in problems.read_toml_as_dict(file) and file not in own
        run = RunRequest(str(path), solvers=[FIRST_SOLVER], settings=["default"])
        part = replace(run, scenarios=[str(file)] * is_other).make_plan()
    except InputError:
        return []
    if FIRST_SOLVER not in name_solvers_of_suite(whole.document.solvers) or not part.cells:
        return []
    share = f"{len(part.cells)} of the suite's {len(whole.cells)} cells"
    options, folder = f"--solver {FIRST_SOLVER} --settings default", "first"
    if is_other:
        share = "the suite does not contain this scenario"
        options, folder = f"--scenario {file} {options}", f"first-{file.stem}"
    # Solvers that are added to the folder later are not timed beside it.
    command = f"dpbench run {path} {options} --out results/{folder}"
    return [f"short first run ({share}), in a folder of its own:", f"  {command}"]


def _describe_unstable_loops(planned: Sequence[PlannedCell]) -> list[str]:
    """Return lines on scenarios and study points whose loop is unstable without limits."""
    from dpbench.scenario.stability import describe_unstable_loop, find_unstable_radius

    loops: dict[tuple[str, int], ScenarioDocuments] = {}
    for cell in (one.cell for one in planned if one.cell.mode == "closed_loop"):
        at = f", point {cell.study.point}" if cell.study else ""
        name = cell.study.name if cell.study else cell.scenario["name"]
        horizon = cell.scenario["scenario"]["controller"]["prediction_horizon"]
        loops.setdefault((f"{name}{at}", horizon), cell.scenario)
    found = {key: find_unstable_radius(files) for key, files in loops.items()}
    unstable = {key: radius for key, radius in found.items() if not math.isnan(radius)}
    shown = [
        f"{name}: {describe_unstable_loop(str(horizon), radius)}"
        for (name, horizon), radius in list(unstable.items())[:MOST_UNSTABLE]
    ]
    others = len(unstable) - len(shown)
    return [*shown, *([f"{others} more loops are unstable without limits"] if others > 0 else [])]


def _can_pass(planned: Sequence[PlannedCell]) -> bool:
    """Return whether some configuration has both modes, or no run is meant for a verdict."""
    modes: dict[tuple[str, ...], set[str]] = {}
    for cell in (one.cell for one in planned if not one.refused):
        if cell.units == "scaled" and cell.source.is_judged and not cell.study:
            key = cell.solver, cell.route, cell.policy, cell.settings, cell.options
            modes.setdefault(key, set()).add(cell.mode)
    return not modes or any(len(own) > 1 for own in modes.values())
