"""Hooks of mkdocs: add the pages that are generated from the code."""

import tomllib
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from sitegen import columns, command_line, library, notebook, python_names, solvers

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
"""Pages of the site by the file or folder of the repository that they are made from."""
FIGURES = "results/reference/figures"
"""Figures of the reference run, which guides show."""
ROOT = Path(__file__).parents[1]
MAKERS = (
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
    # In the site its links start one folder deeper than in the repository.
    contributing = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    return made | {"contributing.md": contributing.replace("](docs/", "](")}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add the pages of solvers, the version, and the edit link if the repository is known."""
    (reference,) = (part["Reference"] for part in config.nav or [] if "Reference" in part)
    (entry,) = (part for part in reference if "Solvers" in part and isinstance(part, dict))
    entry["Solvers"] = list(solvers.pages())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    config.copyright = f"dpbench {project['version']}"
    if address := project.get("urls", {}).get("Repository"):
        config.repo_url, config.edit_uri = address, "edit/main/docs/"
    return config


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Replace links to files of the repository by links to the pages made from them."""
    up = "../" * (page.file.src_uri.count("/") + 1)
    for source, made in SOURCES.items():
        markdown = markdown.replace(f"]({up}{source})", f"]({up[3:]}{made})")
    return markdown.replace(f"]({up}{FIGURES}/", f"]({up[3:]}pictures/reference/")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages and pictures."""
    for name, text in pages().items():
        files.append(File.generated(config, name, content=text))
    reference = {f"pictures/reference/{path.name}": path for path in (ROOT / FIGURES).glob("*.svg")}
    pictures = {name: path.read_bytes() for name, path in reference.items()}
    for name, picture in (pictures | notebook.pictures()).items():
        files.append(File.generated(config, name, content=picture))
    return files
