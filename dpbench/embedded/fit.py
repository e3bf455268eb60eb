"""Find the largest control horizon whose program fits in a memory, by compiling and running it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from dpbench.embedded.table import StepCounts

KILOBYTE = 1024
FIRST, MOST = 5, 100
"""Control horizons: the first that is tried, and the largest."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Program of a solver for one control horizon.

    Parameters
    ----------
    N_c : control horizon.
    counts : of its steps; None where they could not be counted.
    reason : why they could not; "" where they were.
    """

    N_c: int
    counts: StepCounts | None
    reason: str = ""

    @property
    def memory_bytes(self) -> int | None:
        """Bytes of code, constants, static data, heap and deepest stack; None if not counted."""
        if self.counts is None:
            return None
        return sum(self.counts.sizes.values()) + int(self.counts.steps["stack"].max())

    def fits_in_memory(self, kilobytes: int) -> bool:
        """Return whether the program ran and takes no more than this memory."""
        return self.memory_bytes is not None and self.memory_bytes <= kilobytes * KILOBYTE


@dataclass(frozen=True, eq=False)
class Fit:
    """Largest control horizon that fits in a memory, and the next one.

    Parameters
    ----------
    kilobytes : of memory, each of 1024 bytes.
    largest : its trial; None where not even N_c = 1 fits.
    following : trial of the next horizon, which does not fit; None where `MOST` fits.
    """

    kilobytes: int
    largest: Trial | None
    following: Trial | None


def find_largest_horizon_for_memory(try_horizon: Callable[[int], Trial], kilobytes: int) -> Fit:
    """Return trials of the largest horizon that fits in a memory and of the next, which does not.

    The horizon is doubled from `FIRST` until it does not fit, and the interval is then bisected, so
    that both trials of the result were compiled and run.
    """
    low, high = 0, FIRST
    while try_horizon(high).fits_in_memory(kilobytes):
        if high == MOST:
            return Fit(kilobytes, try_horizon(MOST), None)
        low, high = high, min(2 * high, MOST)
    while high - low > 1:
        middle = (low + high) // 2
        if try_horizon(middle).fits_in_memory(kilobytes):
            low = middle
        else:
            high = middle
    return Fit(kilobytes, try_horizon(low) if low else None, try_horizon(high))


def summarise_fit_as_dict(fit: Fit) -> dict[str, Any]:
    """Return a fit in a few numbers; None where there is none of them."""
    largest, following = fit.largest, fit.following
    counts = largest.counts if largest else None
    return {
        "kilobytes": fit.kilobytes,
        "control_horizon": largest.N_c if largest else None,
        "variables": counts.z.shape[1] if counts else None,
        "memory_bytes": largest.memory_bytes if largest else None,
        "instructions_max": int(counts.steps["instructions"].max()) if counts else None,
        "error_move": float(counts.error_move.max()) if counts else None,
        "next_control_horizon": following.N_c if following else None,
        "next_memory_bytes": following.memory_bytes if following else None,
        "next_reason": following.reason if following else "",
    }
