"""The section on the design of controllers, from records made by hand."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from dpbench.bench.design.bracket import Trial, bracket_of
from dpbench.bench.design.design_file import DesignRecord, Designs, MissingDesign, write_design
from dpbench.bench.design.region_of_attraction import RegionOfAttraction
from dpbench.report.blocks import Bullets, Paragraph, Picture, Section, Tabular
from dpbench.report.section_design import design_section
from dpbench.report.style import styled
from dpbench.report.write import build_page, write_report


def region_of_attraction(
    weather: str, *held: float, fails: tuple[float, ...] = (), **more: Any
) -> RegionOfAttraction:
    trials = [Trial(offset, "holds") for offset in held]
    trials += [Trial(offset, **({"verdict": "fails", "side": "port"} | more)) for offset in fails]
    return RegionOfAttraction(weather, bracket_of(trials))


PAPER = DesignRecord(
    vessel="tug",
    controller="paper",
    tuning="paper",
    terminal="none",
    N_p=30,
    N_c=5,
    sample_s=0.3,
    length_m=30.0,
    model_scale=1.0,
    ramp_s=11.364,
    eigenvalues=((0.9, 0.1), (0.9, -0.1), (0.5, 0.0)),
    spectral_radius=0.90554,
    K_mpc=tuple(tuple(100.0 * i + j + 0.5 for j in range(9)) for i in (1, 2, 3)),
    K_y=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    states=9,
    controllable=9,
    condition_scaled=673.4,
    condition_si=141889.0,
    regions=(
        region_of_attraction("still water", 0.25, 0.5, 1.0, fails=(1.046875, 2.0)),
        region_of_attraction("calm", 0.25, 0.5, fails=(0.515625, 1.0)),
    ),
    wall_s=8.0,
)
ROBUST = replace(
    PAPER,
    controller="rough",
    tuning="robust",
    N_p=60,
    N_c=10,
    regions=(
        region_of_attraction("still water", 0.25, 64.0),
        region_of_attraction("calm", 0.25, 64.0),
    ),
)
MODEL = replace(
    PAPER,
    vessel="model",
    model_scale=100.0,
    sample_s=0.03,
    ramp_s=1.1364,
    condition_si=20.0,
    regions=(region_of_attraction("still water", 0.0025, fails=(0.005,)),),
)


def section_of(*records: DesignRecord, missing: tuple[MissingDesign, ...] = ()) -> Section:
    with styled():
        return design_section(Designs.of(records, missing))


def words(section: Section) -> str:
    """All running text."""
    found = [b.text for b in section.blocks if isinstance(b, Paragraph)]
    return "\n".join(
        [*found, *(t for b in section.blocks if isinstance(b, Bullets) for t in b.items)]
    )


def rows(section: Section, i: int) -> list[dict[str, str]]:
    """The rows of the i-th table by head."""
    table = [b.table for b in section.blocks if isinstance(b, Tabular)][i]
    return [dict(zip(table.heads, (cell.text for cell in row), strict=True)) for row in table.rows]


def test_the_table_shows_the_numbers_of_the_records() -> None:
    """Each vessel and controller has its row of figures, brackets rounded outwards."""
    paper, robust = rows(section_of(PAPER, ROBUST), 0)
    assert paper == {
        "vessel": "`tug`",
        "controller": "paper 30/5",
        "spectral radius": "0.9055",
        "smallest |λ|": "0.5000",
        "slowest mode [s]": "3.02",  # 0.3 s / −ln 0.90554
        "controllable": "9 of 9",
        "cond P, scaled": "673",
        "cond P, SI": "142\u202f000",
        "region, still water [m]": "1.00 – 1.05",
        "region, `calm` [m]": "0.500 – 0.516",
    }
    assert robust["region, still water [m]"] == "≥ 64"


def test_the_text_says_what_the_horizon_misses_and_what_is_held() -> None:
    """The paper's horizon is shorter than the ramp of its thrusters, the robust one longer."""
    text = words(section_of(PAPER, ROBUST))
    assert "looks 9 s ahead, less than the 11.4 s" in text
    assert "looks 18 s ahead, more than the 11.4 s" in text
    assert "no terminal cost. This is the paper's design." in text
    assert "holds least in `tug`, 1.00 – 1.05 m." in text
    assert "holds all that was tried, up to 64 m, in `tug`." in text
    assert "No offset was held beyond one that was not." in text


def test_a_model_ship_is_shown_at_full_size() -> None:
    """A model's times and offsets are those of full size; a missing region is a dash."""
    _, model = rows(section_of(PAPER, MODEL), 0)
    assert model["slowest mode [s]"] == "3.02"
    assert model["region, still water [m]"] == "0.250 – 0.500"
    assert model["region, `calm` [m]"] == "–"
    text = words(section_of(PAPER, MODEL))
    assert "looks 9 s ahead, less than the 11.4 s" in text
    assert "SI is the better one for `model` with paper 30/5." in text


def test_an_unstable_or_uncontrollable_design_is_marked() -> None:
    """A root outside the unit circle has no time of decay."""
    bad = replace(PAPER, spectral_radius=1.02, eigenvalues=((1.02, 0.0),), controllable=8)
    (row,) = rows(section_of(bad), 0)
    assert row["slowest mode [s]"] == "–"
    table = next(b.table for b in section_of(bad).blocks if isinstance(b, Tabular))
    assert [cell.text for cell in table.rows[0] if cell.mark == "bad"] == ["1.0200", "8 of 9"]


def test_what_holds_beyond_the_edge_and_what_is_undecided_is_said() -> None:
    """A region that is no single interval, or not fully decided, is named as such."""
    trials = [Trial(1.0, "holds"), Trial(2.0, "undecided", "starboard"), Trial(4.0, "holds")]
    odd = replace(PAPER, regions=(RegionOfAttraction("calm", bracket_of(trials)),))
    section = section_of(odd)
    assert rows(section, 0)[0]["region, `calm` [m]"] == "1.00 – 2.00, undecided"
    assert "Held again beyond the edge: 4 m (paper 30/5 in `tug`, `calm`" in words(section)
    assert "1 trial met a step without a certified optimum" in words(section)
    assert rows(section, 1)[0]["not held"] == "2 (undecided, starboard)"


def test_nothing_held_is_said_to_be_below_the_smallest_offset() -> None:
    """Where even the smallest offset fails there is no lower end."""
    (row,) = rows(
        section_of(replace(PAPER, regions=(region_of_attraction("calm", fails=(0.25, 0.5)),))), 0
    )
    assert row["region, `calm` [m]"] == "< 0.250"


def test_gains_and_trials_are_folded_and_complete() -> None:
    """Every entry of K_mpc and every offset tried can be read."""
    section = section_of(PAPER)
    folded = [b.table for b in section.blocks if isinstance(b, Tabular) and b.table.folded]
    assert len(folded) == 2
    assert [row["held"] for row in rows(section, 1)] == ["0.25, 0.5, 1", "0.25, 0.5"]
    assert rows(section, 1)[0]["not held"] == "1.047 (port), 2 (port)"
    gains = rows(section, 2)
    assert [row["axis"] for row in gains] == ["surge", "sway", "yaw"]
    assert list(gains[1].values())[3:] == [f"{200.5 + j:.3g}" for j in range(9)]


def test_controllers_of_one_tuning_are_told_apart_by_their_scenario() -> None:
    """Two scenarios with equal tuning and horizons keep two names."""
    names = {
        row["controller"] for row in rows(section_of(ROBUST, replace(ROBUST, controller="x")), 0)
    }
    assert names == {"robust 60/10 of rough", "robust 60/10 of x"}


def test_both_figures_hold_every_design() -> None:
    """A panel a controller with all roots of the upper half plane; a bar a region."""
    pictures = {
        b.name: b.figure for b in section_of(PAPER, ROBUST).blocks if isinstance(b, Picture)
    }
    panels = pictures["design_eigenvalues"].axes
    assert [panel.get_title(loc="left") for panel in panels] == ["paper 30/5", "robust 60/10"]
    for panel in panels:
        roots = [line for line in panel.lines if line.get_marker() == "o"]
        assert [list(line.get_xdata()) for line in roots] == [[0.9, 0.5]]
    (bars,) = pictures["design_regions"].axes
    ends = sorted(patch.get_x() + patch.get_width() for patch in bars.patches)
    assert ends == pytest.approx([0.5, 1.0, 64.0, 64.0])


def test_a_design_that_is_missing_is_named_with_its_reason() -> None:
    """Without any record the section still says what failed."""
    missing = MissingDesign("tug", "paper", "it took more than 600 s and was killed")
    assert "`paper` in `tug`: it took more than 600 s" in words(section_of(missing=(missing,)))


@pytest.mark.slow
def test_a_report_has_the_section_where_there_is_a_design_file(
    records: Any, tmp_path: Path
) -> None:
    """With `design.json` the section and its figures are written; without it there is neither."""
    records.loop("daqp")
    html = write_report(records.write(tmp_path))
    assert "Stability and design" not in html.read_text(encoding="utf-8")
    write_design(tmp_path, Designs.of([PAPER, ROBUST]))
    text = write_report(tmp_path).read_text(encoding="utf-8")
    assert '<section id="design">' in text
    assert (tmp_path / "figures" / "design_regions.svg").is_file()
    before = (tmp_path / "figures" / "design_eigenvalues.svg").read_bytes()
    shutil.rmtree(tmp_path / "figures")
    write_report(tmp_path)
    assert (tmp_path / "figures" / "design_eigenvalues.svg").read_bytes() == before
    assert "design" not in {section.key for section in build_page(records.results()).sections}
