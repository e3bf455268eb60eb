"""To add a solver is to add its file: in a copy of the package, as CONTRIBUTING says."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import dpbench
from dpbench.errors import DpbenchError
from dpbench.solvers.adapter import import_all_adapters

HERE, ROOT = Path(__file__).parent, Path(dpbench.__file__).parents[1]
(TEXT,) = re.findall(
    r"^- \*\*a solver\*\*:(.*?)^- ", (ROOT / "CONTRIBUTING.md").read_text(), re.M | re.S
)
(LIBRARIES,) = re.findall(r"`(dpbench/solvers/\w+/)`", TEXT)
NEWCOMERS = ("newcomer", "newcomer_wrapped")


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package with two more files in it, and of these tests."""
    root = tmp_path_factory.mktemp("copied")
    # With the caches of what is compiled: compiling takes a minute. What another test is writing
    # just now, bytecode or such a cache, has a name that is gone a moment later.
    passing = shutil.ignore_patterns("*.pyc*", "*.tmp*")
    shutil.copytree(ROOT / "dpbench", root / "dpbench", ignore=passing)
    shutil.copytree(HERE, root / "tests", ignore=passing)
    shutil.copy(HERE / "example_native.py", root / LIBRARIES / "newcomer.py")
    shutil.copy(HERE / "example_wrapped.py", root / LIBRARIES / "newcomer_wrapped.py")
    return root


def _run(root: Path, *arguments: str) -> str:
    environment = {**os.environ, "PYTHONPATH": f"{root}:{os.environ.get('PYTHONPATH', '')}"}
    command = [sys.executable, *arguments]
    done = subprocess.run(
        command, check=False, cwd=root, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_a_file_is_all_that_a_solver_takes(copied: Path) -> None:
    program = f"""
import json
from dpbench.report.charts.style import FAMILY_COLOURS
from dpbench.solvers.settings import describe_option_presets, list_preset_names
from dpbench.solvers.settings import resolve_settings_to_options
from dpbench.solvers.table import TABLE, find_solver_availability, get_native_adapter
facts = {{}}
for name in {NEWCOMERS}:
    row = TABLE[name]
    facts[name] = dict(
        routes=row.policies_by_route, ok=find_solver_availability(name).ok,
        levels=describe_option_presets(name).splitlines(),
        licence=row.project.licence.value, language=row.project.language.value,
        c_code=row.project.c_code.value, aboard=row.reason_not_deployable == "",
        refusal=row.state_why_policy_is_unavailable(row.default_route, "reuse"), family=row.family,
        coloured=row.family in FAMILY_COLOURS)
adapter = get_native_adapter("newcomer")
facts["own key"] = dict(resolve_settings_to_options({{"precision": 0.5}}, adapter))
print(json.dumps(facts))
"""
    facts: dict[str, Any] = json.loads(_run(copied, "-c", program))
    native, wrapped = (facts[name] for name in NEWCOMERS)
    assert native["routes"] == {"native": ["fresh"]}
    assert wrapped["routes"] == {"qpsolvers": ["fresh"]}
    assert native["levels"][:2] == ["default: care=1", "low: care=1, precision=0.001"]
    assert facts["own key"] == {"care": 1, "precision": 0.5}
    project = native["licence"], native["language"], native["c_code"]
    assert project == ("MIT", "C", "yes, all of it")
    assert native["refusal"] == "the example keeps nothing"
    assert (native["family"], wrapped["family"]) == ("augmented Lagrangian", "active set")
    assert all(one[key] for one in (native, wrapped) for key in ("ok", "aboard", "coloured"))


@pytest.mark.slow
def test_it_is_listed(copied: Path) -> None:
    listed = _run(copied, "-m", "dpbench", "list", "solvers")
    assert all(re.search(rf"^{name}\b", listed, re.M) for name in NEWCOMERS)
    assert "that of the" in listed[listed.index("newcomer") :]


@pytest.mark.slow
def test_conformance_is_tested_from_its_record(copied: Path) -> None:
    (asked,) = re.findall(r"`pytest tests/solvers (-k NAME)`", TEXT)
    option, _ = asked.split()
    lines = _run(copied, "-m", "pytest", "-v", "tests/test_conformance.py", option, "newcomer")
    for name in NEWCOMERS:
        assert lines.count(f"{name}-") >= 20


def test_a_file_without_an_adapter_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "two_solvers"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "helper.py").write_text("x = 1\n")
    for name in ("one", "two"):
        (folder / f"{name}.py").write_text((HERE / "example_native.py").read_text())
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(DpbenchError, match=r"two_solvers.helper has no adapter"):
        import_all_adapters("two_solvers", besides=())
    with pytest.raises(DpbenchError, match=r"two_solvers.two: solver newcomer is defined twice"):
        import_all_adapters("two_solvers", besides=("helper",))
    native, wrapped = import_all_adapters("two_solvers", besides=("helper", "two"))
    assert list(native) == ["newcomer"] and not wrapped


@pytest.mark.parametrize("field", ["family", "levels", "project", "routes"])
def test_a_forgotten_field_is_an_error(tmp_path: Path, field: str) -> None:
    text = (HERE / "example_native.py").read_text()
    incomplete = re.sub(rf"^    {field}=.*?(?=^    \w+=)", "", text, count=1, flags=re.M | re.S)
    assert incomplete != text
    with pytest.raises(TypeError, match=field):
        exec(compile(incomplete, "newcomer.py", "exec"), {})
