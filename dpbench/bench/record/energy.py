"""Energy of a processor package over a round of a replay, from the kernel's RAPL counters.

A counter ticks about once a millisecond and includes everything on its package: idle power and the
load of other cores. Nothing is subtracted, and nothing is estimated where there is no counter.
"""

import os
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dpbench.arrays import Flags, Floats, Ints

SHORTEST_ROUND_S = 0.02
"""Shortest round with an energy [s]: the ticks at its ends are then at most 10 % of it."""
MOST_W = 1000.0
"""Power of a package that is not exceeded: a round in which its counter could wrap twice has no
energy."""


@dataclass(frozen=True)
class EnergyCounters:
    """RAPL counters of the packages that this process runs on.

    files : with the energy so far [µJ]; ranges_J : the energy at which each starts from 0 again.
    missing : why there is none, "" if there is one.
    """

    files: tuple[Path, ...] = ()
    ranges_J: tuple[float, ...] = ()
    missing: str = ""

    def read_J(self) -> Floats:
        """Read the counters [J], one a package; NaN where one cannot be read."""
        try:
            return np.array([1e-6 * _read_count(file) for file in self.files])
        except (OSError, ValueError):
            return np.full(len(self.files), np.nan)

    def compute_energy_J(self, before_J: Floats, after_J: Floats, wall_s: float) -> float:
        """Return the energy [J] between two readings; NaN without counters or where unclear.

        wall_s : time between the readings.
        """
        if not self.files or wall_s < SHORTEST_ROUND_S or wall_s * MOST_W > min(self.ranges_J):
            return float("nan")
        difference_J = after_J - before_J
        difference_J[difference_J < 0.0] += np.array(self.ranges_J)[difference_J < 0.0]
        return float(difference_J.sum())


def find_energy_counters(
    system: Path = Path("/sys"), cores: Collection[int] | None = None
) -> EnergyCounters:
    """Return the readable counters of the packages of some cores, or why there are none.

    system : folder of sysfs; cores : those of this process where None.
    """
    zones = sorted((system / "class/powercap").glob("intel-rapl:*"))
    if not zones:
        return EnergyCounters(missing=f"no intel-rapl:* in {system / 'class/powercap'}")
    files, ranges_J = [], []
    try:
        for package in sorted(_find_packages(system, cores)):
            # A package of several dies has a zone for each of them.
            own = [zone for zone in zones if f"{_read_text(zone / 'name')}-".startswith(package)]
            if not own:
                return EnergyCounters(
                    missing=f"no zone of {package.rstrip('-')} among {len(zones)}"
                )
            for zone in own:
                _read_count(zone / "energy_uj")
                files.append(zone / "energy_uj")
                ranges_J.append(1e-6 * _read_count(zone / "max_energy_range_uj"))
    except OSError as error:
        return EnergyCounters(missing=f"{error.filename}: {error.strerror}")
    except ValueError as error:
        return EnergyCounters(missing=str(error))
    return EnergyCounters(tuple(files), tuple(ranges_J))


def compute_energy_per_step_J(energy_J: Floats, done: Ints, counts: Flags) -> float:
    """Return the energy a step [J] over the rounds that count; NaN without a measured one.

    energy_J, done, counts : of each round (R,): its energy, its steps, whether it counts.
    """
    measured = counts & (done > 0) & np.isfinite(energy_J)
    return float(energy_J[measured].sum() / done[measured].sum()) if measured.any() else np.nan


def _find_packages(system: Path, cores: Collection[int] | None) -> set[str]:
    """Return the beginnings of the names of the zones of some cores' packages."""
    topology = "devices/system/cpu/cpu{}/topology/physical_package_id"
    chosen = os.sched_getaffinity(0) if cores is None else cores
    return {f"package-{_read_count(system / topology.format(core))}-" for core in chosen}


def _read_text(path: Path) -> str:
    """Return the text of a file of the kernel."""
    return path.read_text(encoding="ascii").strip()


def _read_count(path: Path) -> int:
    """Return the number in a file of the kernel; ValueError for another text."""
    text = _read_text(path)
    if not text.isdigit():
        raise ValueError(f"{path}: found {text[:20]!r}; allowed: a whole number")
    return int(text)
