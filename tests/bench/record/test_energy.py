"""Energy counters of a made-up sysfs: packages of the cores, wrap-around, reasons."""

import math
from pathlib import Path

import numpy as np
import pytest

from dpbench.bench.record.energy import compute_energy_per_step_J, find_energy_counters

MOST = 65_532_610_987
ZONES = {
    "intel-rapl:0": ("package-0", MOST - 1_000_000),
    "intel-rapl:0:0": ("core", 1),
    "intel-rapl:1": ("package-1", 7_000_000),
    "intel-rapl:2": ("package-10", 1),
    "intel-rapl:3": ("psys", 1),
    "intel-rapl-mmio:0": ("package-0", 1),
}


@pytest.fixture
def system(tmp_path: Path) -> Path:
    for zone, (name, energy) in ZONES.items():
        folder = tmp_path / "class/powercap" / zone
        folder.mkdir(parents=True)
        for file, text in {"name": name, "energy_uj": energy, "max_energy_range_uj": MOST}.items():
            (folder / file).write_text(f"{text}\n", encoding="ascii")
    for core, package in enumerate((0, 0, 1, 5)):
        folder = tmp_path / f"devices/system/cpu/cpu{core}/topology"
        folder.mkdir(parents=True)
        (folder / "physical_package_id").write_text(f"{package}\n", encoding="ascii")
    return tmp_path


def _set(system: Path, zone: str, text: str) -> None:
    (system / "class/powercap" / zone / "energy_uj").write_text(text, encoding="ascii")


def test_energy_is_of_the_cores_packages_and_passes_the_wrap_around(system: Path) -> None:
    one, both = (find_energy_counters(system, cores) for cores in ((0, 1), (1, 2)))
    assert [path.parent.name for path in one.files] == ["intel-rapl:0"]
    before = one.read_J(), both.read_J()
    _set(system, "intel-rapl:0", "2000000")  # 1 J to the wrap-around and 2 J after it
    _set(system, "intel-rapl:1", "11000000")
    assert one.compute_energy_J(before[0], one.read_J(), 0.5) == pytest.approx(3.0)
    assert both.compute_energy_J(before[1], both.read_J(), 0.5) == pytest.approx(7.0)


def test_dies_of_a_package_are_added(system: Path) -> None:
    for die in (0, 1):
        zone = system / "class/powercap" / f"intel-rapl:{die}"
        (zone / "name").write_text(f"package-0-die-{die}\n", encoding="ascii")
    assert len(find_energy_counters(system, (0,)).files) == 2


@pytest.mark.parametrize("wall_s", [0.019, 66.0], ids=["a few ticks", "two wraps possible"])
def test_an_unclear_round_has_no_energy(system: Path, wall_s: float) -> None:
    counters = find_energy_counters(system, (2,))
    now = counters.read_J()
    assert counters.compute_energy_J(now, now + 1.0, 1.0) == 1.0
    assert math.isnan(counters.compute_energy_J(now, now + 1.0, wall_s))


def test_without_a_readable_counter_there_is_a_reason_and_no_number(system: Path) -> None:
    assert "no zone of package-5" in find_energy_counters(system, (3,)).missing
    counters = find_energy_counters(system, (0,))
    file = system / "class/powercap/intel-rapl:0/energy_uj"
    _set(system, "intel-rapl:0", "many")
    assert "found 'many'; allowed: a whole number" in find_energy_counters(system, (0,)).missing
    assert np.isnan(counters.read_J()).all()
    file.unlink()
    missing = find_energy_counters(system, (0,))
    assert missing.missing == f"{file}: No such file or directory"
    assert math.isnan(missing.compute_energy_J(missing.read_J(), missing.read_J(), 1.0))
    nothing = find_energy_counters(system / "nowhere", (0,))
    assert nothing.missing.startswith("no intel-rapl:* in")


def test_a_step_has_the_mean_energy_of_the_rounds_that_count() -> None:
    energy_J = np.array([50.0, 1.0, np.nan, 3.0, 9.0, 0.0])
    done = np.array([5, 10, 10, 10, 10, 0])
    counts = np.array([False, True, True, True, False, True])
    assert compute_energy_per_step_J(energy_J, done, counts) == pytest.approx(0.2)
    assert math.isnan(compute_energy_per_step_J(energy_J, done, counts & (done == 5)))
