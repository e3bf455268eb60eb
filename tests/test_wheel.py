"""An installed wheel is complete: names resolve without the source tree."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
def test_names_resolve_from_a_wheel_in_an_empty_folder(tmp_path: Path) -> None:
    """The wheel carries problems and all parts of the page; the command line works from it."""
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*build, "--wheel-dir", str(tmp_path), str(ROOT)], check=True)
    (wheel,) = tmp_path.glob("dpbench-*.whl")
    site, empty = tmp_path / "site", tmp_path / "empty"
    empty.mkdir()
    zipfile.ZipFile(wheel).extractall(site)
    script = (
        "import dpbench, dpbench.report.write as w; from dpbench.cli.main import main;"
        "print(dpbench.__file__, dpbench.load_scenario('rough').steps,"
        " dpbench.load_sequence('rough-60-10').base.n);"
        "raise SystemExit(main(['list', 'scenarios']))"
    )
    environment = {**os.environ, "PYTHONPATH": str(site)}
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=empty,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert str(site) in done.stdout.splitlines()[0]
    assert done.stdout.splitlines()[0].endswith(" 2000 30")
    assert "paper_tight" in done.stdout
    page = site / "dpbench" / "report" / "page"
    templates = ("templates/page.html.j2", "templates/compare.html.j2", "templates/page.css")
    for part in (*templates, "scripts/page.js", "vendor/vega.min.js"):
        assert (page / part).stat().st_size > 0
    assert (page.parent / "glossary.toml").is_file()
