"""The tutorial notebook: run from its first cell to its last, and shown as a page."""

import base64
import json
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

NOTEBOOK = Path(__file__).parents[1] / "tutorial.ipynb"
PAGE = "tutorial.md"
DOWNLOAD = "[This notebook](tutorial.ipynb), stored with the outputs of one run.\n"
TIMEOUT_S = 300
_BLANK = re.compile(r"\n\s*\n")


def pages() -> dict[str, str]:
    """Markdown by file of the documentation."""
    title, *rest = (part for cell in _cells() for part in _cell(cell))
    head, _, introduction = title.partition("\n")
    return {PAGE: "\n\n".join((head, DOWNLOAD, introduction, *rest)) + "\n"}


def pictures() -> dict[str, bytes]:
    """PNG by file of the documentation."""
    return {
        _picture_name(cell, i): base64.b64decode(output["data"]["image/png"])
        for cell in _cells()
        for i, output in enumerate(cell.get("outputs", ()))
        if "image/png" in output.get("data", {})
    }


def _cells() -> list[dict[str, Any]]:
    cells: list[dict[str, Any]] = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    return cells


def _cell(cell: dict[str, Any]) -> Iterator[str]:
    """Markdown of a cell: its text, or its code and what it shows."""
    source = "".join(cell["source"])
    if cell["cell_type"] == "markdown":
        yield source
        return
    yield f"```python\n{source}\n```"
    for i, output in enumerate(cell["outputs"]):
        yield _output(cell, i, output)


def _output(cell: dict[str, Any], i: int, output: dict[str, Any]) -> str:
    """Markdown of an output: the picture, else the HTML without blank lines, else the text."""
    data = output.get("data", {})
    if "image/png" in data:
        return f"![Figure of the cell above]({_picture_name(cell, i)})"
    if "text/html" in data:
        html = _BLANK.sub("\n", "".join(data["text/html"]).strip())
        return f'<div class="output">\n{html}\n</div>'
    text = "".join(data.get("text/plain", output.get("text", "")))
    return f"```text\n{text.rstrip()}\n```"


def _picture_name(cell: dict[str, Any], i: int) -> str:
    return f"pictures/tutorial-{cell['id']}-{i}.png"


def run(folder: Path) -> Any:
    """Run the notebook in a folder, and return it with its outputs as an nbformat node."""
    import nbclient
    import nbformat

    notebook = nbformat.read(NOTEBOOK, as_version=4)  # type: ignore[no-untyped-call] # nbformat annotates no functions
    for cell in notebook.cells:
        cell.metadata.clear()
    about = dict(notebook.metadata)
    options: dict[str, Any] = {"timeout": TIMEOUT_S, "record_timing": False}
    nbclient.NotebookClient(
        notebook, resources={"metadata": {"path": str(folder)}}, **options
    ).execute()
    # The kernel adds its own versions.
    notebook.metadata = about
    return notebook


def main() -> None:
    """Run the notebook and store it with its outputs."""
    import nbformat

    with tempfile.TemporaryDirectory() as folder:
        notebook = run(Path(folder))
    nbformat.write(notebook, NOTEBOOK)  # type: ignore[no-untyped-call] # nbformat annotates no functions


if __name__ == "__main__":
    main()
