"""The tutorial runs from its first cell to its last, and shows what it speaks of."""

import json
from pathlib import Path
from typing import Any

import pytest

NOTEBOOK = Path(__file__).parents[2] / "docs" / "tutorial.ipynb"


def _shown(notebook: Any) -> list[dict[str, str]]:
    """What each code cell shows at its end, by kind; nothing of one that shows nothing."""
    shown = []
    for cell in notebook.cells:
        if cell.cell_type == "code":
            results = [o.data for o in cell.outputs if o.output_type == "execute_result"]
            shown.append(dict(results[-1]) if results else {})
    return shown


def test_it_is_kept_without_outputs() -> None:
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert len(code) > 10
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in code)


@pytest.mark.slow
def test_every_cell_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import nbclient
    import nbformat

    for folder in ("TMPDIR", "IPYTHONDIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(folder, str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(NOTEBOOK.parents[1]), prepend=":")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    client = nbclient.NotebookClient(
        notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}
    )
    client.execute()
    shown = _shown(notebook)
    text = " ".join(part.get("text/plain", "") for part in shown)
    assert all(word in text for word in ("<Scenario paper", "<Optimum of 15", "<Results smoke"))
    html = [part["text/html"] for part in shown if "text/html" in part]
    assert any("Optimum of 15 variables" in page for page in html)
    assert sum("vegaEmbed" in page for page in html) == 3
    (page,) = tmp_path.rglob("report.html")
    assert page.stat().st_size > 100_000
