"""The workflow file of the guide and the action that it uses."""

import re
from pathlib import Path
from typing import Any

import pytest

from dpbench.ci import gate
from dpbench.ci.revisions import _build_parser
from tests.docs.markdown_blocks import DOCS, blocks_of

yaml: Any = pytest.importorskip("yaml", reason="is of the group docs")
ACTION = DOCS.parent / ".github" / "actions" / "compare" / "action.yml"
OURS = "OWNER/dpbench/.github/actions/compare@COMMIT"


@pytest.fixture(scope="module")
def action() -> dict[str, Any]:
    """The action that compares two revisions."""
    found: dict[str, Any] = yaml.safe_load(ACTION.read_text(encoding="utf-8"))
    return found


@pytest.fixture(scope="module")
def workflow(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The workflow of the guide, copied word for word."""
    (block,) = [one for one in blocks_of(DOCS / "guide" / "ci.md") if one.language == "yaml"]
    file = tmp_path_factory.mktemp("repository") / Path(block.title).name
    assert block.title == f".github/workflows/{file.name}"
    file.write_text(block.body, encoding="utf-8")
    found: dict[str, Any] = yaml.safe_load(file.read_text(encoding="utf-8"))
    return found


def test_the_workflow_has_what_the_action_needs(
    workflow: dict[str, Any], action: dict[str, Any]
) -> None:
    """Its event, a permission for the comment, and inputs that the action has."""
    # YAML 1.1 reads `on` as a truth value.
    assert workflow[True] == "pull_request"
    assert workflow["permissions"] == {"contents": "read", "pull-requests": "write"}
    (job,) = workflow["jobs"].values()
    (ours,) = [step for step in job["steps"] if step["uses"] == OURS]
    assert set(ours["with"]) <= set(action["inputs"])
    assert all(isinstance(value, str) for value in ours["with"].values())
    for step in job["steps"][:-1]:
        assert step["uses"].startswith("actions/")


def test_every_step_has_a_name_and_what_it_uses_is_pinned(
    workflow: dict[str, Any], action: dict[str, Any]
) -> None:
    """By a full commit hash, as a tag can be moved."""
    (job,) = workflow["jobs"].values()
    steps = [*job["steps"], *action["runs"]["steps"]]
    assert len({step["name"] for step in steps}) == len(steps) == 6
    used = [step["uses"] for step in steps if "uses" in step]
    assert [one for one in used if not re.search(r"@([0-9a-f]{40}|COMMIT)$", one)] == []


def test_the_action_gives_every_input_to_its_scripts(action: dict[str, Any]) -> None:
    """No input is without effect, and no script reads one that does not exist."""
    read = re.findall(r"\$\{\{ inputs\.([\w-]+) \}\}", ACTION.read_text(encoding="utf-8"))
    assert sorted(read) == sorted(action["inputs"])


def test_every_option_of_revisions_is_an_input_and_the_guide_lists_all(
    action: dict[str, Any],
) -> None:
    """With the default of the option; the comment is the action's own file."""
    own = {
        one.dest.replace("_", "-"): None if one.default == [] else one.default
        for one in _build_parser()._actions
    }
    options = own.keys() - {"help", "base", "head", "markdown"}
    assert options <= action["inputs"].keys()
    defaults = {name: yaml.safe_load(action["inputs"][name]["default"]) for name in options}
    assert defaults == {name: own[name] for name in options}
    guide = (DOCS / "guide" / "ci.md").read_text("utf-8")
    rows = re.findall(r"^\| `([a-z][a-z-]*)` \|", guide, re.M)
    assert sorted(rows) == sorted(action["inputs"])
    # pytest would not find the fixtures without the extra.
    assert "dpbench[ci]" in action["inputs"]["dpbench"]["description"]


def test_the_guide_lists_every_option_of_the_gate() -> None:
    guide = (DOCS / "guide" / "ci.md").read_text("utf-8")
    known = {name for one in gate._build_parser()._actions for name in one.option_strings}
    assert {*re.findall(r"^\| `(--[a-z-]+)[^`]*` \|", guide, re.M)} == known - {"-h", "--help"}
