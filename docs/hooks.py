"""Hooks of mkdocs: pages made from the code join those written by hand."""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from sitegen import columns, command_line, library, notebook, python_names, solvers, toml_keys

SOURCES = {
    "CONTRIBUTING.md": "contributing.md",
    "dpbench/__init__.py": "reference/python.md",
    "dpbench/bench/plan/suite.py": "reference/suite.md",
    "dpbench/bench/record/schema.toml": "reference/columns.md",
    "dpbench/cli/arguments.py": "reference/command-line.md",
    "dpbench/scenario/tables/scenario_file.py": "reference/scenario.md",
    "dpbench/scenario/tables/vessel_file.py": "reference/vessel.md",
    "dpbench/solvers/contract.py": "reference/python.md#workspace",
    "dpbench/solvers/libraries": "solvers/index.md",
    "problems": "reference/library.md",
}
"""Pages of the site by the file or folder of the repository that they are made of."""
ROOT = Path(__file__).parents[1]
MAKERS = (
    toml_keys.pages,
    library.pages,
    columns.pages,
    command_line.pages,
    notebook.pages,
    python_names.pages,
    solvers.pages,
)


def pages() -> dict[str, str]:
    """Markdown of every page that is not in the folder, by its file."""
    made = {name: text for make in MAKERS for name, text in make().items()}
    # It stands where contributors look for it; within the site its links start one folder deeper.
    contributing = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    return made | {"contributing.md": contributing.replace("](docs/", "](")}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Every solver has its place in the navigation."""
    (entry,) = (part for part in config.nav or [] if "Solvers" in part)
    entry["Solvers"] = list(solvers.pages())
    return config


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Links to the repository lead to the pages made of those files."""
    up = "../" * (page.file.src_uri.count("/") + 1)
    for source, made in SOURCES.items():
        markdown = markdown.replace(f"]({up}{source})", f"]({up[3:]}{made})")
    return markdown


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The generated pages stand beside the written ones."""
    for name, text in pages().items():
        files.append(File.generated(config, name, content=text))
    for name, picture in notebook.pictures().items():
        files.append(File.generated(config, name, content=picture))
    return files
