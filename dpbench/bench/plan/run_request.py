"""A request of a user, a suite or a part of it in its call modes, and the plan it means."""

import hashlib
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

from dpbench.bench.judge.rules import LEAST_STRETCH, has_enough_samples_for_percentile
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.plan.configurations import (
    BASELINE_LAW,
    choose_solvers,
    name_solvers_of_suite,
)
from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.study_points import RouteName
from dpbench.bench.plan.suite import (
    SuiteFile,
    build_sequence_suite,
    load_path_and_suite,
    name_file_in_errors,
)
from dpbench.bench.sequences.source import read_sequence
from dpbench.errors import InputError, PolicyError, require_integer_at_least
from dpbench.scenario.problem_files import resolve_sequence_path
from dpbench.scenario.scenario import load_scenario
from dpbench.scenario.variation import format_as_toml
from dpbench.solvers.calibration import CALIBRATION
from dpbench.solvers.contract import Policy, Route, SolverRecord
from dpbench.solvers.own_settings import (
    expand_choice_over_option_grid,
    split_into_solver_and_options_text,
)
from dpbench.solvers.settings import has_preset_or_tolerance
from dpbench.solvers.table import (
    PluginFiles,
    find_solver_record,
    load_plugin_solvers,
    require_any_solver_available,
)

NO_P99 = "too few for a p99"
"""Beginning of a remark on a plan, of which a search that ranks by other percentiles has no use."""
MOST_NAMED = 3
"""Runs that a remark names; of the others their number is."""
WITHOUT_SAMPLE = (
    "these QPs have no known sample time, so no step time is judged; set limits in a suite with "
    "[[recorded]] and [requirements]"
)
"""Remark on a sequence without a deadline of its own."""


@dataclass(frozen=True, eq=False)
class Plan:
    """All planned runs that a user's request means, with the suite they come from.

    `document` is the requested content of the suite; `part` tells whether it is less than all;
    `remarks` are lines on what does not run as requested, or cannot be measured; `solvers` and
    `scenarios` are the names to which the request restricts the suite.
    """

    name: str
    path: Path
    document: SuiteFile
    cells: list[PlannedCell]
    part: bool
    remarks: Sequence[str]
    solvers: Sequence[str] = ()
    scenarios: Sequence[str] = ()

    def require_available_solver(self) -> None:
        """Raise SolverUnavailableError if solvers are selected and none can be used here."""
        require_any_solver_available(name_solvers_of_suite(self.solvers))

    def format_suite(self, folder: Path) -> str:
        """Return the suite as TOML that runs it again from `folder`; keys at defaults are left out.

        Its comment has the options that the file cannot contain.
        """
        document = self.document
        if self.solvers:
            update = {"solvers": list(self.solvers), "baseline_law": False, "calibration": False}
            document = document.model_copy(update=update)
        scenarios = _rename_files(list(self.scenarios), Path(), folder)
        options = "".join(f" --scenario {name}" for name in scenarios)
        tables = document.model_dump(mode="json", exclude_defaults=True)
        text = format_as_toml(_rename_files(tables, self.path.parent, folder))
        return f"# Run again: dpbench run suite.toml{options}\n{text}"

    @cached_property
    def digest(self) -> str:
        """Hash of the descriptions of all planned runs, by which plans are compared."""
        digest, separator = hashlib.sha256(), b""
        # One by one: all texts joined would take as much memory again.
        for text in sorted(planned.cell.to_json() for planned in self.cells):
            digest.update(separator + text.encode())
            separator = b"\n"
        return digest.hexdigest()[:16]


@dataclass(frozen=True)
class RunRequest:
    """Request of a run: a suite or a sequence, and a choice of its parts."""

    suite: str | None = None
    sequence: str | None = None
    solvers: Sequence[str] | None = None
    scenarios: Sequence[str] | None = None
    settings: Sequence[str] | None = None
    routes: Sequence[str] | None = None
    policies: Sequence[str] | None = None
    steps: int | None = None
    solver_module: PluginFiles = None

    def make_plan(self) -> Plan:
        """Return the plan of all requested runs; InputError for what cannot be run."""
        load_plugin_solvers(self.solver_module)
        name, path, document = self._load_suite()
        check_mode_names(self.routes, self.policies)
        chosen = {"settings": self.settings, "routes": self.routes, "policies": self.policies}
        keys = {key: list(names) for key, names in chosen.items() if names}
        suite = document
        document = reduce_suite(suite, scenarios=self.scenarios, steps=self.steps, **keys)
        asked = self.solvers
        if self.settings:
            # A choice with options ignores the settings of a table.
            asked = add_solvers_without_options(asked or ())
        with name_file_in_errors(path, chosen=bool(self.settings), scenarios=self.scenarios):
            remarks: list[str] = []
            choices = asked or document.solvers
            if self.routes or self.policies:
                solvers = choose_solvers(document, asked)
                remarks = check_call_modes(document, solvers, "routes" in keys)
            if self.settings:
                chosen_solvers = choose_solvers(document, asked)
                remarks += list_solvers_without_settings(document, chosen_solvers, self.settings)
            is_timed = document.requirements.deadline_ms > 0.0
            if not is_timed and self.sequence is not None:
                remarks += [WITHOUT_SAMPLE]
            if self.scenarios:
                remarks += list_tables_left_out(document)
                remarks += list_windows_left_out(suite, self.scenarios)
            cells = plan_suite(
                document, solvers=asked, scenarios=self.scenarios, beside=path.parent
            )
            if self.steps is not None:
                remarks += list_runs_of_other_length(cells, self.steps)
        part = bool(self.solvers or self.scenarios or keys or self.steps is not None)
        remarks += list_replays_of_other_horizons(document, cells, path.parent)
        remarks += _list_remarks(cells, choices, is_timed)
        chosen_names = tuple(asked or ()), tuple(self.scenarios or ())
        return Plan(name, path, document, cells, part, remarks, *chosen_names)

    @property
    def _suite_file(self) -> Path | None:
        """Path of the suite's TOML file; None for a suite by name, or no suite."""
        named = self.suite is None or not self.suite.endswith(".toml")
        return None if named else Path(str(self.suite))

    @property
    def has_suite(self) -> bool:
        """Return whether the suite can be read on this machine."""
        return self._suite_file is None or self._suite_file.is_file()

    def with_absolute_path(self) -> "RunRequest":
        """Return the request with the suite's path made absolute."""
        file = self._suite_file
        return self if file is None else replace(self, suite=str(file.resolve()))

    def _load_suite(self) -> tuple[str, Path, SuiteFile]:
        """Return name, file and content of the requested suite, or of one for a sequence."""
        if self.suite is not None and self.sequence is None:
            path, document = load_path_and_suite(self.suite)
            return path.stem, path, document
        if self.sequence is not None and self.suite is None:
            if self.scenarios:
                raise InputError("`scenarios`", "", "with `sequence`", "one of the two")
            meta = read_sequence(resolve_sequence_path(self.sequence)).sequence.meta
            name = f"sequence-{Path(self.sequence).resolve().stem}"
            return name, Path("suite"), build_sequence_suite(self.sequence, meta)
        if self.suite is None:
            raise InputError("`suite`", "", "nothing", "`suite` or `sequence`")
        found = f"{self.suite} with `sequence` {self.sequence}"
        raise InputError("`suite`", "", found, "one of the two")


def _rename_files(value: Any, base: Path, folder: Path) -> Any:
    """Return a value of a suite with its files, relative to `base`, named relative to `folder`."""
    if isinstance(value, dict):
        return {key: _rename_files(one, base, folder) for key, one in value.items()}
    if isinstance(value, list):
        return [_rename_files(one, base, folder) for one in value]
    if not isinstance(value, str) or Path(value).is_absolute():
        return value
    is_path = "/" in value or bool(Path(value).suffix)
    if not (is_path and (base / value).exists()):
        return value
    return os.path.relpath((base / value).resolve(), folder.resolve())


def reduce_suite(
    suite: SuiteFile,
    *,
    scenarios: Sequence[str] | None = None,
    steps: int | None = None,
    **calls: list[str],
) -> SuiteFile:
    """Return a suite reduced to some scenarios, calls and `steps` of each loop and replay.

    calls : `settings`, `routes` and `policies` in place of those of every table; the last two also
        of custom settings.

    Unless the suite names all `scenarios`, they replace its own, by name or TOML file: each closed
    loop and replay runs with them, from the first step on. InputError for less than one step.
    """
    if steps is not None:
        steps = require_integer_at_least("`steps`", steps, 1)
    asked = list(scenarios or ())
    tables: dict[str, list[Any]] = {
        key: list(getattr(suite, key)) for key in SuiteFile.list_names_of_run_tables()
    }
    if not set(asked) <= set(suite.scenario_names):
        own_scenarios = {"scenarios": asked, "vessels": [], "steps": 0}
        tables["closed_loop"] = [t.model_copy(update=own_scenarios) for t in suite.closed_loop]
        tables["replay"] = [
            t.model_copy(update={"scenario": name, "first": 0, "steps": 0})
            for t in suite.replay
            for name in asked
        ]
    for key, own in tables.items():
        tables[key] = [t.model_copy(update=calls) for t in own]
    if steps is not None:
        for key in ("closed_loop", "replay", "study"):
            tables[key] = [
                t.model_copy(update={"steps": min(steps, t.steps or steps)}) for t in tables[key]
            ]
        tables["replay"] = [
            t.model_copy(update={"hardest": min(steps, t.hardest)}) for t in tables["replay"]
        ]
    if not (scenarios or calls or steps is not None):
        return suite
    # Tables may have become equal.
    once = {
        key: [table for i, table in enumerate(own) if table not in own[:i]]
        for key, own in tables.items()
    }
    keys = {"route": "routes", "policy": "policies"}
    replaced = {key: None for key, names in keys.items() if names in calls}
    named = {name: table.model_copy(update=replaced) for name, table in suite.settings.items()}
    update = {"settings": named, **once}
    if "settings" in calls:
        update["solvers"] = add_solvers_without_options(suite.solvers)
    return suite.model_copy(update=update)


def add_solvers_without_options(choices: Sequence[str]) -> list[str]:
    """Return choices of solvers; one that is named only with options is added without them."""
    alone = dict.fromkeys(split_into_solver_and_options_text(choice)[0] for choice in choices)
    return [*choices, *(solver for solver in alone if solver not in choices)]


def list_tables_left_out(suite: SuiteFile) -> list[str]:
    """Return a remark on the suite's tables of no scenario, which a choice of these leaves out."""
    of_none = ("study", "recorded", "random", "capability")
    tables = [f"[[{name}]]" for name in of_none if getattr(suite, name)]
    return [f"not run, because scenarios are selected: {', '.join(tables)}"] if tables else []


def list_windows_left_out(suite: SuiteFile, scenarios: Sequence[str]) -> list[str]:
    """Return a remark if a window of consequence analysis is not used for other scenarios."""
    is_cut = any(table.consequence and (table.first or table.steps) for table in suite.replay)
    if not is_cut or set(scenarios) <= set(suite.scenario_names):
        return []
    return [
        "the consequence analysis begins at step 0 and may include steps after a loss, because "
        "`first` and `steps` of the suite apply to its own scenarios only"
    ]


def list_replays_of_other_horizons(
    suite: SuiteFile, planned: Sequence[PlannedCell], beside: Path
) -> list[str]:
    """Return remarks on replays whose prediction horizons are none of the loops' of a scenario."""
    remarks: dict[str, None] = {}
    for table in suite.replay:
        replayed = sorted({pair[0] for pair in table.horizon_pairs if pair is not None})
        if not replayed or not any(p.cell.mode == "replay" for p in planned):
            continue
        name = table.scenario
        studies = {study.name or study.base for study in suite.study if study.base == name}
        steered = {
            int(p.cell.scenario["scenario"]["controller"]["prediction_horizon"])
            for p in planned
            if p.cell.study is not None and p.cell.study.name in studies
        }
        if any(name in closed.scenario_list for closed in suite.closed_loop):
            own = load_scenario(name, beside=beside).files["scenario"]["controller"]
            steered.add(int(own["prediction_horizon"]))
        if steered and not steered.intersection(replayed):
            loops, others = (" and ".join(map(str, sorted(n))) for n in (steered, replayed))
            remarks[f"{name} has N_p = {loops}; the replay uses {others}"] = None
    return list(remarks)


def list_runs_of_other_length(planned: Sequence[PlannedCell], steps: int) -> list[str]:
    """Return remarks on runs that are shorter than `steps`, and on those it does not shorten."""
    # A window is chosen from a replay of its own.
    cells = [p.cell for p in planned if not p.cell.is_hardest_window]
    lengths = {cell.sequence or cell.scenario_name: cell.steps for cell in cells}
    fewer = [f"{name} ({n})" for name, n in lengths.items() if n < steps]
    whole = [f"{name} ({n})" for name, n in lengths.items() if n > steps]
    heads = {
        f"fewer than the {steps} requested steps": fewer,
        f"not shortened to {steps} steps, as only closed loops and replays of scenarios are": whole,
    }
    return [f"{head}: {_name_a_few(names)}" for head, names in heads.items() if names]


def _name_a_few(names: Sequence[str]) -> str:
    """Return the first names as text, and how many more there are."""
    more = [f"{len(names) - MOST_NAMED} more"] if len(names) > MOST_NAMED else []
    return ", ".join([*names[:MOST_NAMED], *more])


def _list_remarks(
    planned: Sequence[PlannedCell], choices: Sequence[str], is_timed: bool
) -> list[str]:
    """Return remarks on settings given twice, and on what the planned runs cannot measure.

    choices : of solvers, as the suite or the request has them; is_timed : step times are judged.
    """
    texts = Counter(
        text for one in choices if "[" in one for text in expand_choice_over_option_grid(one)
    )
    remarks = [f"{text} is given {n} times and is run once" for text, n in texts.items() if n > 1]
    remarks += _list_merged_settings(planned)
    timed = [p.cell for p in planned if p.cell.is_timed and is_timed]
    longest = max((cell.steps for cell in timed), default=0)
    if timed and not has_enough_samples_for_percentile(longest, 99):
        of, hardest = max((cell.source.count_stretch_steps(0), cell.steps) for cell in timed)
        percents = (p for p in (95, 50) if has_enough_samples_for_percentile(longest, p))
        percent = next(percents, None)
        judged = (
            f"the p99 of {of} steps, estimated from a window of {hardest}, is judged instead"
            if of >= LEAST_STRETCH
            else "the longest step is judged instead"
            if percent is None
            else f"the p{percent} and the longest step are judged instead"
        )
        most = f"{longest} step{'s' * (longest != 1)}"
        remarks.append(f"the replays have at most {most}, {NO_P99}; {judged}")
    return remarks


def _list_merged_settings(planned: Sequence[PlannedCell]) -> list[str]:
    """Return remarks on custom settings that share the row of others, with the same options.

    The call modes are named where the settings also have rows of their own, in other modes.
    """
    own = {(p.cell.solver, p.cell.settings) for p in planned}
    modes: dict[tuple[str, str, tuple[str, ...]], dict[str, None]] = {}
    for p in planned:
        if p.merged_settings:
            key = p.cell.solver, p.cell.settings, p.merged_settings
            modes.setdefault(key, {})[f"{p.cell.route} {p.cell.policy}"] = None
    remarks = []
    for (solver, first, merged), shared in modes.items():
        where = ""
        if any((solver, name) in own for name in merged):
            where = f" in the call mode{'s' * (len(shared) > 1)} {', '.join(shared)}"
        remarks.append(
            f"{solver}: settings {', '.join(merged)} have the same options as {first} and share "
            f"its row{where}"
        )
    return remarks


def check_mode_names(routes: Sequence[str] | None, policies: Sequence[str] | None) -> None:
    """Raise PolicyError for an unknown route or policy."""
    for argument, chosen, known in (
        ("`routes`", routes, get_args(RouteName)),
        ("`policies`", policies, get_args(Policy)),
    ):
        for name in chosen or ():
            if name not in known:
                raise PolicyError(argument, "", repr(name)[:90], ", ".join(known))


def check_call_modes(suite: SuiteFile, solvers: Sequence[str], has_routes: bool) -> list[str]:
    """Return remarks on the solvers that do not run in the chosen routes and policies.

    suite : with the chosen routes and policies in its tables; solvers : its choices of solvers.
    has_routes : whether routes are chosen, and not policies alone.

    Raises PolicyError if no solver has one of the call modes.
    """
    names = {split_into_solver_and_options_text(choice)[0] for choice in solvers} - {
        BASELINE_LAW,
        *CALIBRATION,
    }
    records = {name: find_solver_record(name) for name in sorted(names)}
    modes = {
        (route, policy)
        for key in SuiteFile.list_names_of_run_tables()
        for table in getattr(suite, key)
        for route in table.routes
        for policy in table.policies
    }
    lacking = {name: _explain_lack(row, modes) for name, row in records.items()}
    missing = {name: reason for name, reason in lacking.items() if reason}
    if lacking and len(missing) == len(lacking):
        name, (found, allowed) = next(iter(missing.items()))
        found = f"{'routes and policies' if ', ' in found else 'route and policy'} {found}"
        argument = "`routes`" if has_routes else "`policies`"
        if len(missing) > 1:
            found = f"{found}, which none of the {len(missing)} solvers supports"
            raise PolicyError(
                argument,
                "",
                found,
                f"a route and policy that one of them supports, such as {allowed} ({name})",
            )
        raise PolicyError(argument, "", f"{found}, which {name} does not support", allowed)
    return [
        f'{name} does not run: it does not support route and policy "{found}"'
        for name, (found, _) in missing.items()
    ]


def list_solvers_without_settings(
    suite: SuiteFile, solvers: Sequence[str], settings: Sequence[str]
) -> list[str]:
    """Return a remark on each of the chosen settings that some of the solvers do not have."""
    own = (BASELINE_LAW, *CALIBRATION)
    named = [name for name in solvers if "[" not in name and name not in own]
    remarks = []
    for name in dict.fromkeys(settings):
        table = suite.settings[name].options_by_solver if name in suite.settings else {}
        lacking = [s for s in named if s not in table and not has_preset_or_tolerance(s, name)]
        if lacking:
            text = f"solvers not run with settings {name}, as they do not have them"
            remarks.append(f"{text}: {_name_a_few(lacking)}")
    return remarks


def _explain_lack(
    row: SolverRecord, modes: set[tuple[RouteName, Policy]]
) -> tuple[str, str] | None:
    """Return the call modes that a solver lacks and those it has; None if it has one of them."""
    wanted: set[tuple[Route, Policy]] = {
        (row.default_route if route == "default" else route, p) for route, p in modes
    }
    offered = {(route, p) for route in row.routes for p in row.get_route_record(route).policies}
    if wanted & offered:
        return None
    return _join_modes(wanted), _join_modes(offered)


def _join_modes(modes: set[tuple[Route, Policy]]) -> str:
    """Return call modes as text, such as `native fresh, native warm`."""
    return ", ".join(f"{route} {policy}" for route, policy in sorted(modes))
