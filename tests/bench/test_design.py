"""The design of the paper's controller: poles, the offset it holds, and how its record is kept."""

import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from dpbench import load_scenario
from dpbench.bench import design as region
from dpbench.bench.design import (
    OFFSETS_M,
    WIDTH,
    WORK,
    Bracket,
    Design,
    Designs,
    DesignStudy,
    can_recover_from_offset,
    find_bracket_of_recovery,
    load_stability_records,
    pair_controllers_with_vessels,
)
from dpbench.bench.engines.dispatcher import Dispatcher
from dpbench.bench.engines.engine import SourceFiles
from dpbench.bench.engines.open_engine import LocalEngine
from dpbench.bench.plan.suite import DesignTable
from dpbench.bench.progress import Silent
from dpbench.bench.run.exact_loop import solve_loop_exactly
from dpbench.errors import CertificateError, InputError, RenamedWarning, ResultsError
from dpbench.qp.referee.referee import certify
from dpbench.scenario.problem_files import find_folder_of_shipped_problems
from dpbench.scenario.scenario import Scenario, build_scenario_from_documents, condense

pytestmark = pytest.mark.slow

TABLE = DesignTable(controllers=["paper"], vessels=["supply_fs99"])


def study(designs: list[Design], out: Path, machine: str = "machine") -> DesignStudy:
    (out / "cells").mkdir(parents=True, exist_ok=True)
    return DesignStudy(designs, out / "cells", machine)


def run(designs: list[Design], out: Path) -> Designs:
    """Run such designs into a folder and return the contents of `design.json`."""
    with LocalEngine(len(os.sched_getaffinity(0))) as engine:
        looked_into = study(designs, out)
        sources = SourceFiles(out / "cells")
        engine.prepare(sources, [], Silent())
        looked_into.run(Dispatcher(engine, sources, Silent()), Silent())
        looked_into.write(out)
    designs_there = load_stability_records(out)
    assert designs_there is not None
    return designs_there


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("out")


@pytest.fixture(scope="module")
def designs(out: Path) -> Designs:
    """The paper's controller in the paper's ship, looked into in a process of its own."""
    return run(pair_controllers_with_vessels(TABLE), out)


@pytest.fixture(scope="module")
def still() -> Scenario:
    files = pair_controllers_with_vessels(TABLE)[0].files
    return build_scenario_from_documents(
        files | {"scenario": files["scenario"] | {"environment": {}}}
    )


def test_what_it_does_not_hold_ends_in_a_limit_cycle_of_some_five_metres(still: Scenario) -> None:
    state = solve_loop_exactly(replace(still, start=np.array([0.0, 1.8, 0.0]))).state
    away = np.hypot(state[-200:, 3], state[-200:, 4])
    assert 5.0 < away.max() < 6.0


def test_the_paper_holds_1_65_m_and_not_1_8_m(designs: Designs, still: Scenario) -> None:
    assert can_recover_from_offset(still, 1.65) and not can_recover_from_offset(still, 1.8)
    held = designs.records[0].held
    assert held["still water"].fails_m is not None
    assert 1.65 <= held["still water"].holds_m < held["still water"].fails_m <= 1.8
    assert held["calm"].holds_m < held["still water"].holds_m


def test_the_eigenvalues_are_the_poles_of_the_loop_the_optima_close(designs: Designs) -> None:
    builder = condense(load_scenario("paper"))
    model = builder.control.model
    columns = []
    for x in np.eye(9):
        # So small that no limit is active; the loop is linear there.
        step = builder.emit(1e-6 * x, np.zeros(3), np.zeros(3))
        move = builder.moves(certify(builder.problem(step)).z)[0]
        columns.append(model.A @ x + model.B @ (1e6 * move))
    poles = np.linalg.eigvals(np.column_stack(columns))
    (record,) = designs.records
    recorded = np.array([complex(*root) for root in record.eigenvalues])
    # Nearest pole, as conjugates may come in any order; certified z is good to 1e-13.
    distance = np.abs(poles[:, None] - recorded[None, :])
    assert distance.min(axis=0).max() < 1e-6
    assert distance.min(axis=1).max() < 1e-6
    assert record.spectral_radius == pytest.approx(np.abs(poles).max(), abs=1e-6)
    assert (record.vessel, record.controller) == ("supply_fs99", "paper")


def test_uncertified_steps_are_not_held(still: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(scenario: Scenario) -> None:
        raise CertificateError(f"{scenario.name}: step 0 has no certified optimum")

    monkeypatch.setattr(region, "solve_loop_exactly", refuse)
    assert not can_recover_from_offset(still, 1.0)


def test_a_model_ship_is_tried_on_its_own_scale() -> None:
    """With the damping of the model alone, and less far off with the drag of the ship."""
    files = pair_controllers_with_vessels(
        DesignTable(controllers=["paper"], vessels=["cybership2"])
    )[0].files
    linear = {key: value for key, value in files["vessel"].items() if key != "drag"}
    scenario, without_drag = (
        build_scenario_from_documents(files),
        build_scenario_from_documents(files | {"vessel": linear}),
    )
    assert scenario.steps == without_drag.steps == 2000
    assert can_recover_from_offset(without_drag, 1.0) and not can_recover_from_offset(
        without_drag, 1.25
    )
    assert can_recover_from_offset(scenario, 0.5) and not can_recover_from_offset(scenario, 1.0)


@given(st.floats(min_value=OFFSETS_M[0], max_value=OFFSETS_M[-1], exclude_max=True))
def test_the_bracket_holds_the_threshold_and_is_narrow(threshold: float) -> None:
    bracket = find_bracket_of_recovery(lambda offset: offset <= threshold)
    assert bracket.fails_m is not None
    assert bracket.holds_m <= threshold < bracket.fails_m
    assert bracket.fails_m - bracket.holds_m <= WIDTH * bracket.fails_m


def test_a_bracket_may_have_one_end_only() -> None:
    assert find_bracket_of_recovery(lambda offset: True) == Bracket(64.0, None)
    assert find_bracket_of_recovery(lambda offset: offset <= 0.1) == Bracket(0.0, 0.25)


def test_a_finished_design_is_not_looked_into_again(designs: Designs, out: Path) -> None:
    planned = pair_controllers_with_vessels(TABLE)
    (path,) = (out / "cells").glob("design-*.json")
    written = path.stat().st_mtime_ns
    assert study(planned, out).work == 0
    assert run(planned, out) == designs and path.stat().st_mtime_ns == written
    other = pair_controllers_with_vessels(
        DesignTable(controllers=["rough"], vessels=["supply_fs99"])
    )
    assert study(other, out).work == study(planned, out, "another").work == WORK
    assert DesignStudy(planned, out / "cells", "machine", fresh=True).work == WORK
    text = path.read_text(encoding="utf-8")
    path.write_text(text[: len(text) // 2], encoding="utf-8")
    assert study(planned, out).work == WORK
    path.write_text(text, encoding="utf-8")


def test_a_design_whose_process_fails_is_missing_with_the_reason(tmp_path: Path) -> None:
    (design,) = pair_controllers_with_vessels(TABLE)
    broken = run([Design("paper", design.files | {"vessel": {}})], tmp_path)
    assert broken.records == ()
    (missing,) = broken.missing
    assert (missing.vessel, missing.controller) == ("supply_fs99", "paper")
    assert "missing; required: text" in missing.reason


@pytest.mark.parametrize(
    ("controllers", "vessels", "says"),
    [
        (["papre"], ["osv"], "'papre'"),
        (["paper"], ["osw"], "'osw'"),
        (["paper", "paper"], ["osv"], "'paper' twice"),
        (["paper"], ["osv", "osv"], "'osv' twice"),
        (["paper"], ["no/such.toml"], "no/such.toml"),
    ],
)
def test_bad_tables_are_refused(controllers: list[str], vessels: list[str], says: str) -> None:
    with pytest.raises(InputError, match=says):
        pair_controllers_with_vessels(DesignTable(controllers=controllers, vessels=vessels))


def test_files_beside_the_suite_are_designs_too(tmp_path: Path) -> None:
    problems = find_folder_of_shipped_problems()
    ship = (problems / "vessels" / "osv.toml").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(ship, encoding="utf-8")
    text = (problems / "scenarios" / "rough.toml").read_text(encoding="utf-8")
    text = text.replace("sample_s = 0.3", "sample_s = 0.6")
    (tmp_path / "coarse.toml").write_text(text, encoding="utf-8")
    table = DesignTable(controllers=["coarse.toml"], vessels=["mine.toml"])
    (design,) = pair_controllers_with_vessels(table, tmp_path)
    assert (design.controller, design.vessel) == ("coarse", "mine")
    scenario = build_scenario_from_documents(design.files)
    assert (scenario.sample_s, scenario.steps, scenario.controller.tuning) == (0.6, 1000, "robust")


def _edited(edit: Callable[[dict[str, Any]], object]) -> Callable[[str], str]:
    def damage(text: str) -> str:
        document = json.loads(text)
        edit(document)
        return json.dumps(document)

    return damage


DAMAGE = {
    "cut": (lambda text: text[: len(text) // 2], "invalid JSON"),
    "a list": (lambda text: f"[{text}]", "list"),
    "a newer one": (_edited(lambda d: d.update(schema=3)), "schema: found schema 3"),
    "no records": (_edited(lambda d: d.pop("records")), "records: missing"),
    "a key too few": (
        _edited(lambda d: d["records"][0].pop("N_p")),
        "records, entry 1, key N_p: missing",
    ),
    "a key too many": (_edited(lambda d: d["records"][0].update(extra=1)), "key extra: found 1"),
    "no number": (_edited(lambda d: d["records"][0].update(N_p="1")), "key N_p: found '1'"),
    "NaN": (
        _edited(lambda d: d["records"][0]["held"]["calm"].update(holds_m=float("nan"))),
        "key held.calm.holds_m: found nan",
    ),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_damaged_files_are_refused(designs: Designs, out: Path, tmp_path: Path, kind: str) -> None:
    damage, says = DAMAGE[kind]
    path = tmp_path / "design.json"
    path.write_text(damage((out / "design.json").read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(ResultsError) as error:
        load_stability_records(tmp_path)
    text = str(error.value)
    assert text.startswith(str(path)) and says in text and "\n" not in text


def test_an_older_file_is_passed_over_with_one_line(tmp_path: Path) -> None:
    assert load_stability_records(tmp_path) is None
    (tmp_path / "design.json").write_text('{"schema": 1, "records": []}', encoding="utf-8")
    with pytest.warns(RenamedWarning, match="schema 1 are not shown"):
        assert load_stability_records(tmp_path) is None
