"""The workflow of a release: its permissions, its order, its comparison of tag and version."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

yaml: Any = pytest.importorskip("yaml", reason="is of the group docs")
ROOT = Path(__file__).parents[2]
TEXT = (ROOT / ".github" / "workflows" / "release.yml").read_text(encoding="utf-8")
WORKFLOW: dict[Any, Any] = yaml.safe_load(TEXT)
JOBS: dict[str, dict[str, Any]] = WORKFLOW["jobs"]
STEPS = [step for job in JOBS.values() for step in job["steps"]]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_a_tag_alone_starts_it() -> None:
    # YAML 1.1 reads `on` as a truth value.
    assert WORKFLOW[True] == {"push": {"tags": ["v*"]}}


def test_each_job_may_do_what_its_steps_need_and_no_more() -> None:
    assert WORKFLOW["permissions"] == {}
    assert {name: job["permissions"] for name, job in JOBS.items()} == {
        "build": {"contents": "read"},
        "test": {},
        "image": {"contents": "read"},
        "attest": {"attestations": "write", "id-token": "write"},
        "publish": {"id-token": "write"},
    }
    assert JOBS["publish"]["environment"] == "pypi"
    assert "secrets" not in TEXT and "password" not in TEXT
    checkouts = [step for step in STEPS if step.get("uses", "").startswith("actions/checkout@")]
    assert all(step["with"]["persist-credentials"] is False for step in checkouts)


def test_only_what_was_tested_is_attested_and_published() -> None:
    """No distribution is built again on the way."""
    assert {name: job.get("needs") for name, job in JOBS.items()} == {
        "build": None,
        "test": "build",
        "image": None,
        "attest": ["test", "image"],
        "publish": "attest",
    }
    builds = [step["run"] for step in STEPS if "python -m build" in step.get("run", "")]
    assert len(builds) == 1
    attest, publish = (
        [step.get("uses", "") for step in JOBS[n]["steps"]] for n in ("attest", "publish")
    )
    assert [one.split("@")[0] for one in attest] == [
        "actions/download-artifact",
        "actions/attest-build-provenance",
    ]
    assert [one.split("@")[0] for one in publish] == [
        "actions/download-artifact",
        "pypa/gh-action-pypi-publish",
    ]


def test_every_action_is_pinned_and_shells_see_no_expression() -> None:
    """By a full commit hash with its version beside it; a tag's name is text of somebody else."""
    used = re.findall(r"uses: (.*)", TEXT)
    assert len(used) == sum("uses" in step for step in STEPS) > 0
    assert [one for one in used if not re.search(r"@[0-9a-f]{40} # v\d+\.\d+\.\d+$", one)] == []
    assert [step["name"] for step in STEPS if "${{" in step.get("run", "")] == []
    assert all(job["timeout-minutes"] <= 30 for job in JOBS.values())


def test_it_tests_each_python_that_the_metadata_names() -> None:
    """Both distributions, in images without a compiler."""
    matrix = JOBS["test"]["strategy"]["matrix"]
    prefix = "Programming Language :: Python :: 3."
    named = [one for one in PROJECT["classifiers"] if one.startswith(prefix)]
    assert [f"3.{one.removeprefix(prefix)}" for one in named] == matrix["python"]
    assert PROJECT["requires-python"] == f">={matrix['python'][0]}"
    assert matrix["file"] == ["whl", "tar.gz"]
    assert JOBS["test"]["container"].endswith("-slim-bookworm")


@pytest.mark.parametrize(
    ("tag", "cited", "head", "passes"),
    [
        ("v1.2.3", "1.2.3", "## [1.2.3] - 2026-11-28", True),
        ("v1.2.4", "1.2.3", "## [1.2.3] - 2026-11-28", False),
        ("v1.2.3", "1.2.2", "## [1.2.3] - 2026-11-28", False),
        ("v1.2.3", "1.2.3", "## [Unreleased]", False),
    ],
)
def test_a_tag_of_another_version_stops_it(
    tag: str, cited: str, head: str, passes: bool, tmp_path: Path
) -> None:
    """The version of the package, of the citation file and of the changelog are the tag's."""
    (step,) = [one for one in STEPS if one["name"] == "Compare the tag with the version"]
    (tmp_path / "pyproject.toml").write_text('[project]\nversion = "1.2.3"\n', encoding="utf-8")
    (tmp_path / "CITATION.cff").write_text(f"title: a\nversion: {cited}\n", encoding="utf-8")
    (tmp_path / "CHANGELOG.md").write_text(f"{head}\n", encoding="utf-8")
    (tmp_path / "python").symlink_to(sys.executable)
    done = subprocess.run(
        ["bash", "-e", "-c", step["run"]],
        cwd=tmp_path,
        env={"PATH": f"{tmp_path}:/usr/bin:/bin", "GITHUB_REF_NAME": tag},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode == 0) is passes, done.stderr
