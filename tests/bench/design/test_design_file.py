"""The file of designs: read as it was written, refused in one line when it is damaged."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from dpbench.bench.design.bracket import Trial, bracket_of
from dpbench.bench.design.design_file import (
    DesignRecord,
    Designs,
    MissingDesign,
    load_design,
    write_design,
)
from dpbench.bench.design.region_of_attraction import RegionOfAttraction
from dpbench.errors import ResultsError

TRIALS = (Trial(0.1 + 0.2, "holds"), Trial(0.5, "undecided", "port"), Trial(1.0, "fails"))
RECORD = DesignRecord(
    vessel="tug",
    controller="paper",
    tuning="paper",
    terminal="none",
    N_p=30,
    N_c=5,
    sample_s=0.3,
    length_m=30.0,
    model_scale=1.0,
    ramp_s=34.1 / 3.0,
    eigenvalues=((0.9, 0.1), (0.9, -0.1), (0.5, 0.0)),
    spectral_radius=0.82**0.5,
    K_mpc=((1.0 / 3.0, 0.0, 1e-17),) * 3,
    K_y=((1e9 / 7.0, 0.0, 0.0),) * 3,
    states=9,
    controllable=9,
    condition_scaled=673.4,
    condition_si=1.4e5,
    regions=(
        RegionOfAttraction("calm", bracket_of(TRIALS)),
        RegionOfAttraction("still water", bracket_of(TRIALS[:1])),
    ),
    wall_s=8.0,
)
FOUND = Designs.of([RECORD], [MissingDesign("osv", "paper", "killed by SIGKILL")])


def test_designs_come_back_from_their_file(tmp_path: Path) -> None:
    """What was written is read again, number for number; without a file there are none."""
    assert load_design(tmp_path) is None
    write_design(tmp_path, FOUND)
    assert load_design(tmp_path) == FOUND
    write_design(tmp_path, None)
    assert load_design(tmp_path) is None


def _cut(text: str) -> str:
    return text[: len(text) // 2]


def _edited(edit: Callable[[dict[str, Any]], object]) -> Callable[[str], str]:
    def damage(text: str) -> str:
        document = json.loads(text)
        edit(document)
        return json.dumps(document)

    return damage


DAMAGE = {
    "cut": (_cut, "no JSON"),
    "a list": (lambda text: f"[{text}]", "list"),
    "another schema": (_edited(lambda d: d.update(schema=2)), "schema: found schema 2"),
    "no records": (_edited(lambda d: d.pop("records")), "records: found nothing"),
    "a key too few": (
        _edited(lambda d: d["records"][0].pop("K_mpc")),
        "records.0.K_mpc: found nothing",
    ),
    "a key too many": (
        _edited(lambda d: d["records"][0].update(extra=1)),
        "records.0.extra: found 1",
    ),
    "no number": (
        _edited(lambda d: d["records"][0].update(wall_s="1")),
        "records.0.wall_s: found '1'",
    ),
    "NaN": (
        _edited(lambda d: d["records"][0].update(condition_si=float("nan"))),
        "records.0.condition_si: found nan",
    ),
    "an unknown verdict": (
        _edited(lambda d: d["records"][0]["regions"][0]["bracket"]["tried"][0].update(verdict="?")),
        "tried.0.verdict: found '?'",
    ),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_a_damaged_file_is_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    """The line names the file, the key and what was found there."""
    damage, says = DAMAGE[kind]
    write_design(tmp_path, FOUND)
    path = tmp_path / "design.json"
    path.write_text(damage(path.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(ResultsError) as error:
        load_design(tmp_path)
    text = str(error.value)
    assert text.startswith(str(path))
    assert says in text
    assert "\n" not in text
