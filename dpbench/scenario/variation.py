"""A scenario with other values of some keys, whether a key makes any difference, and its files.

A scenario is written as TOML, and its ship too where dpbench has none such, into one folder.
"""

import json
import pickle
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from dpbench.files.regular_files import write_text_atomically
from dpbench.scenario.dotted_keys import copy_documents_with_values, read_validated_vessel_documents
from dpbench.scenario.problem_files import ScenarioDocuments, list_shipped_problem_names
from dpbench.scenario.scenario import Scenario, build_scenario_from_documents
from dpbench.ship.plant import SUBSTEPS

SEED = "environment.seed"  # Any whole number makes a sea of its own, and changes nothing else
_LABELS = {"name": "", "title": "", "shows": "", "files": {}}


def copy_scenario_with_values(
    scenario: Scenario, values: Mapping[str, object], where: str, *, beside: Path | None = None
) -> Scenario:
    """Return a scenario with values replaced, given by dotted keys such as `start.east_m`.

    values : by the dotted names of the keys, in the units of the files.
    where : what names the keys in errors; beside : the folder a vessel's file is looked for in.
    """
    files = copy_documents_with_values(scenario.files, values, where, beside=beside)
    return build_scenario_from_documents(files, where=where, vessel_where=f"{where}: vessel")


def differ_in_behaviour_within_steps(one: Scenario, other: Scenario, steps: int) -> bool:
    """Return whether two scenarios differ in anything that affects a run of `steps` samples."""
    return _serialise_what_affects_run(one, steps) != _serialise_what_affects_run(other, steps)


def _serialise_what_affects_run(scenario: Scenario, steps: int) -> bytes:
    """Return all of a scenario that affects a run as bytes, without names and titles."""
    sea, sample_s = scenario.environment, scenario.sample_s
    weather = (
        sea.build_weather_table_at_stages(steps, sample_s, SUBSTEPS),
        sea.wave_frequency_motion_at_samples(steps, sample_s),
        sea.draw_measurement_noise(steps),
        sea.wind_and_drift_coefficients(scenario.vessel),
    )
    ships = [
        replace(ship, id="", title="", source="", where="")
        for ship in (scenario.vessel, scenario.true_ship)
    ]
    estimation = replace(scenario.estimation, where="")
    fields = vars(scenario) | _LABELS | {"environment": None, "estimation": estimation}
    fields |= {"vessel": ships[0], "true_ship": ships[1], "steps": steps}
    fields["controller"] = replace(scenario.controller, tuning="")
    return pickle.dumps((weather, fields))


_BARE = re.compile(r"[\w-]+", re.ASCII)


def write_scenario_and_own_ship_files(
    files: ScenarioDocuments, path: Path, comment: str = ""
) -> list[Path]:
    """Write a scenario's documents, and beside it a ship that is not shipped; return the paths.

    comment : lines above the scenario, without `#`. Scenarios of one ship share its file, by which
    reports know that it is the same one.
    """
    ship = files["vessel_name"]
    shipped = ship in list_shipped_problem_names("vessels")
    paths = [path]
    if not shipped or read_validated_vessel_documents(ship)["vessel"] != files["vessel"]:
        text = format_as_toml(files["vessel"])
        own = path.with_name(f"{ship}.toml")
        if shipped or own == path or (own.exists() and own.read_text(encoding="utf-8") != text):
            own = path.with_name(f"{path.stem}_ship.toml")
        write_text_atomically(own, text)
        paths, ship = [path, own], own.name
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    write_text_atomically(path, head + format_as_toml(files["scenario"] | {"vessel": ship}))
    return paths


def format_as_toml(document: Mapping[str, Any]) -> str:
    """Return plain values as a TOML document; keys whose value is None are left out.

    Examples
    --------
    >>> print(format_as_toml({"a": 1, "b": {"c": [0.5, 1e-7]}, "d": None}), end="")
    a = 1
    <BLANKLINE>
    [b]
    c = [0.5, 1e-07]
    """
    return "\n".join(_yield_lines_of_toml_table("", document)).lstrip("\n") + "\n"


def _yield_lines_of_toml_table(name: str, table: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of a table: its values first, then the tables inside it."""
    inner = []
    for key, value in table.items():
        shown = key if _BARE.fullmatch(key) else json.dumps(key, ensure_ascii=False)
        tables = [value] if isinstance(value, dict) else value
        if isinstance(tables, list) and tables and isinstance(tables[0], dict):
            ends = ("[", "]") if isinstance(value, dict) else ("[[", "]]")
            inner += [(f"{name}{shown}", ends, part) for part in tables]
        elif value is not None:
            # TOML's texts, numbers and lists of them are those of JSON.
            yield f"{shown} = {json.dumps(value, ensure_ascii=False)}"
    for whole, (left, right), part in inner:
        yield f"\n{left}{whole}{right}"
        yield from _yield_lines_of_toml_table(f"{whole}.", part)
