"""A change of a suite that runs finished cells again is named."""

from pathlib import Path

import pytest

from dpbench import run_campaign
from dpbench.bench.progress import Silent
from tests.bench.deterministic import suite_file, suite_toml


class _Remarks(Silent):
    """Keeps the remarks of a campaign."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []

    def remark(self, text: str) -> None:
        self.texts.append(text)


@pytest.mark.slow
def test_the_key_that_runs_cells_again_is_named(tmp_path: Path) -> None:
    loop = [{"scenarios": ["paper"], "steps": 3}]
    text = suite_toml(solvers=["daqp"], cell_limit_s=60.0, closed_loop=loop)
    suite, out = suite_file(tmp_path, text), tmp_path / "out"
    said = []
    for limit in ("60.0", "60.0", "61.0"):
        suite.write_text(text.replace("60.0", limit), encoding="utf-8")
        remarks = _Remarks()
        run_campaign(suite, out, jobs=1, may_leave_out=True, progress=remarks)
        said.append([one for one in remarks.texts if "changed" in one])
    assert said[:2] == [[], []]
    (line,) = said[2]
    assert line.endswith("cells are run again, as the suite changed: cell_limit_s 60.0 → 61.0")
