"""Write a scenario, and its ship where dpbench has none such, as TOML files in one folder."""

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from dpbench.files.regular_files import write_text_atomically
from dpbench.scenario.problem_files import ScenarioDocuments, list_shipped_problem_names
from dpbench.scenario.scenario import read_validated_vessel_documents

_BARE = re.compile(r"[\w-]+", re.ASCII)


def write_scenario_and_own_ship_files(
    files: ScenarioDocuments, path: Path, comment: str = ""
) -> list[Path]:
    """Write a scenario's documents, and beside it a ship that is not shipped; return the paths.

    comment : lines above the scenario, without `#`.
    """
    ship = files["vessel_name"]
    shipped = ship in list_shipped_problem_names("vessels")
    paths = [path]
    if not shipped or read_validated_vessel_documents(ship)["vessel"] != files["vessel"]:
        own = path.with_name(f"{path.stem}_ship.toml")
        write_text_atomically(own, format_as_toml(files["vessel"]))
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
