"""The tutorial is stored as it was run, and runs from its first cell to its last."""

import base64
import json
import re
from pathlib import Path
from typing import Any

import pytest

from sitegen import notebook

CELLS: list[dict[str, Any]] = json.loads(notebook.NOTEBOOK.read_text(encoding="utf-8"))["cells"]
CODE = [cell for cell in CELLS if cell["cell_type"] == "code"]
SILENT = re.compile(r"^\w+( = |\.\w+\()|^import ")
"""The last line of a cell that shows nothing: an assignment, an import."""
OF_MACHINE = re.compile(r"/(tmp|home|root|work|usr|Users|var)/|[A-Z]:\\|hostname")


def _texts(output: dict[str, Any]) -> list[str]:
    """Return the text that an output shows."""
    data = {kind: text for kind, text in output.get("data", {}).items() if "image" not in kind}
    return ["".join(text) for text in (*data.values(), output.get("text", []))]


def test_it_is_stored_as_run_from_top_to_bottom() -> None:
    assert len(CODE) > 10
    assert [cell["execution_count"] for cell in CODE] == list(range(1, len(CODE) + 1))
    kinds = {output["output_type"] for cell in CODE for output in cell["outputs"]}
    assert kinds == {"stream", "execute_result"}
    streams = [(o["name"], "".join(o["text"])) for c in CODE for o in c["outputs"] if "name" in o]
    # What a run remarks stays; progress and compiling are not stored.
    (remark,) = (text for name, text in streams if name != "stdout")
    assert remark.startswith("dpbench: the replays have at most ")


def test_each_cell_that_shows_something_is_stored_with_it() -> None:
    for cell in CODE:
        source = "".join(cell["source"])
        last = source.splitlines()[-1]
        shows = "print(" in source or not (last.startswith((" ", ")", "}")) or SILENT.match(last))
        assert bool(cell["outputs"]) >= shows, source
    results = [o["data"] for cell in CODE for o in cell["outputs"] if "data" in o]
    drawn = [base64.b64decode(data["image/png"]) for data in results if "image/png" in data]
    plots = sum(".plot." in "".join(cell["source"]) for cell in CODE)
    assert len(drawn) == plots >= 3
    assert all(picture.startswith(b"\x89PNG") and len(picture) > 5000 for picture in drawn)


def test_its_outputs_have_a_date_and_no_place_of_the_machine_that_ran_it() -> None:
    outputs = [text for cell in CODE for output in cell["outputs"] for text in _texts(output)]
    assert re.match(r"\d\d \w+ \d{4}, dpbench \d", outputs[0])
    assert [text for text in outputs if OF_MACHINE.search(text)] == []
    assert "on the day printed below" in "".join(CELLS[0]["source"])


def test_the_page_has_every_cell_in_order_and_its_pictures() -> None:
    (page,), pictures = notebook.pages().values(), notebook.pictures()
    places = [page.index("".join(cell["source"])) for cell in CELLS[1:]]
    assert places == sorted(places)
    assert re.findall(r"\]\((pictures/[^)]*)\)", page) == list(pictures)
    assert "<caption>Optimum of 15 variables</caption>" in page
    blocks = re.findall(r'<div class="output">\n(.*?)\n</div>\n\n', page, re.S)
    assert len(blocks) > 4 and not any("\n\n" in block for block in blocks)


@pytest.mark.slow
def test_every_cell_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder in ("TMPDIR", "IPYTHONDIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(folder, str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(notebook.NOTEBOOK.parents[1]), prepend=":")
    cells = notebook.run(tmp_path).cells
    outputs = [o for cell in cells if cell.cell_type == "code" for o in cell.outputs]
    text = " ".join(text for output in outputs for text in _texts(output))
    assert all(word in text for word in ("<Scenario paper", "<Optimum of 15", "<Results smoke"))
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 4
    stored = [
        [o["output_type"] for o in cell["outputs"] if o.get("name") != "stderr"] for cell in CODE
    ]
    code = [cell for cell in cells if cell.cell_type == "code"]
    # Kernels that were not compiled yet add a line on standard error.
    again = [[o.output_type for o in c.outputs if o.get("name") != "stderr"] for c in code]
    assert stored == again
    assert (tmp_path / "results/tutorial/report.html").stat().st_size > 100_000
