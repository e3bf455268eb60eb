"""Packed arrays: one compressed block of text that a page unpacks by itself.

    block = base64(zlib(head ‖ arrays)); head = length of the JSON as uint32, then the JSON:
    {"arrays": [[kind, start, count, scale, places], ...], ...}

Numbers become small integers, since a screen shows no more:

    log     uint16, round(200·log10(x / 1e-16)) + 2, 1.2 % apart; 0 missing, 1 zero, 65535 infinite
    linear  int16, round(x / scale); −32768 missing
    count   uint16; 65535 missing
    flag    uint8
    place   uint16, rising, as differences from element to element, not modulo anything

An array of a few elements of a long one has the number of the array of their `places` behind it,
whose scale is the length of the long one; other elements are missing, or 0 of a flag. 16-bit arrays
have their low bytes first; linear and count arrays are differences from element to element. The
track of a closed loop is its distance from the run nearest to the reference loop.
"""

import base64
import json
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpbench.analysis.records.thinned_runs import (
    FORCES,
    ThinnedRun,
    Track,
    compute_common_length_limit,
)
from dpbench.arrays import Floats

Kind = Literal["log", "linear", "count", "flag", "place"]
PER_DECADE = 200
SMALLEST = 1e-16
MISSING, ZERO, INFINITE = 0, 1, 65535
"""Codes of a `log` array; of a `count` array the last is missing."""
GAP = -32768
LEVEL = 6
"""Compression level of zlib; the highest saves 1.5 % more in three times the time."""


class Block:
    """Numeric arrays in one compressed text block, which the page unpacks."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._entries: list[list[Any]] = []
        self._size = 0

    def add_as_uint16_logs(self, values: ArrayLike, places: int | None = None) -> int:
        """Add positive numbers, as uint16 logarithms, to the packed arrays; return their index."""
        return self._append_encoded_array("log", encode_as_uint16_logs(values), 1.0, places)

    def add_as_int16_multiples(self, values: ArrayLike, scale: float) -> int:
        """Add numbers, as int16 multiples of `scale`, to the packed arrays; return their index."""
        x = np.asarray(values, dtype=np.float64) / scale
        codes = np.clip(np.round(np.nan_to_num(x)), -32767, 32767)
        codes[np.isnan(x)] = GAP
        return self._append_encoded_array(
            "linear", _encode_differences(codes.astype(np.int16).view(np.uint16)), scale
        )

    def add_as_uint16_counts(self, values: ArrayLike, places: int | None = None) -> int:
        """Add whole numbers up to 65534, or NaN, to the packed arrays; return their index."""
        x = np.asarray(values, dtype=np.float64)
        codes = np.where(np.isnan(x) | (x < 0), INFINITE, np.minimum(np.nan_to_num(x), 65534))
        return self._append_encoded_array(
            "count", _encode_differences(codes.astype(np.uint16)), 1.0, places
        )

    def add_as_flag_bytes(self, values: ArrayLike, places: int | None = None) -> int:
        """Add bytes of bit flags to the packed arrays; return their index."""
        return self._append_encoded_array("flag", np.asarray(values, dtype=np.uint8), 1.0, places)

    def add_rising_indices(self, values: ArrayLike, length: int) -> int:
        """Add rising indices below `length`; return their index. ValueError for wide gaps."""
        apart = np.diff(np.asarray(values, dtype=np.int64), prepend=0)
        if apart.size and apart.max() > INFINITE:
            raise ValueError(f"offsets are {apart.max()} apart")
        return self._append_encoded_array("place", apart.astype(np.uint16), length)

    def _append_encoded_array(
        self, kind: Kind, codes: NDArray[Any], scale: float, places: int | None = None
    ) -> int:
        """Append an encoded array to the block; return its index."""
        raw = _pack_low_then_high_bytes(codes) if codes.dtype == np.uint16 else codes.tobytes()
        entry = [kind, self._size, len(codes), scale]
        self._entries.append(entry if places is None else [*entry, places])
        self._parts.append(raw)
        self._size += len(raw)
        return len(self._entries) - 1

    def compress_to_base64(self, document: dict[str, Any]) -> str:
        """Return the compressed arrays, together with a JSON document, as base64 text."""
        head = json.dumps(
            document | {"arrays": self._entries},
            separators=(",", ":"),
            ensure_ascii=False,
            allow_nan=False,
        ).encode()
        raw = struct.pack("<I", len(head)) + head + b"".join(self._parts)
        return base64.b64encode(zlib.compress(raw, LEVEL)).decode("ascii")


def encode_as_uint16_logs(values: ArrayLike) -> NDArray[np.uint16]:
    """Return positive numbers as uint16 logarithms; negative ones and NaN count as missing."""
    x = np.asarray(values, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        codes = np.round(PER_DECADE * (np.log10(x) - np.log10(SMALLEST))) + 2
    codes = np.where(x == 0.0, ZERO, np.clip(np.nan_to_num(codes), 2, INFINITE - 1))
    codes = np.where(np.isposinf(x), INFINITE, codes)
    return np.where(np.isnan(x) | (x < 0), MISSING, codes).astype(np.uint16)


def _encode_differences(codes: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return the differences between neighbouring elements of a uint16 array, which pack better."""
    return np.diff(codes, prepend=np.uint16(0)).astype(np.uint16)


def _pack_low_then_high_bytes(codes: NDArray[np.uint16]) -> bytes:
    """Return a uint16 array as bytes: the low bytes of all elements, then the high ones."""
    return (codes & 0xFF).astype(np.uint8).tobytes() + (codes >> 8).astype(np.uint8).tobytes()


TOLD_APART = (1e-3, 1e-3, 1e-4)
"""Resolution of a track: 1 mm, and 0.006 degrees."""
FORCE_SHARE = 1e-3
"""Resolution of a force, as a share of its limit."""
FLAGS = ("claimed", "true", "failed", "late", "fallback", "clipped")
"""Bits of a step's flag, the lowest first; the next bit marks a hard step that enters no mean."""
MOST_STEPS, MOST_POINTS = 480_000, 240_000
"""Steps, and points of tracks, that the page has room for, all runs together."""
MOST_POINTS_EACH = 400
MANY_RUNS, STEPS_A_RUN, POINTS_A_RUN = 1000, 25, 12
"""Number of runs beyond which each further run takes the room of so many steps and points."""
MOST_HARD = 15_000
"""Hard steps on the page, of all runs by all measures."""


@dataclass(frozen=True)
class Room:
    """Largest numbers of steps and of ship positions that the page has room for in each run."""

    steps: int
    points: int

    @classmethod
    def from_run_lengths(cls, lengths: Sequence[int]) -> "Room":
        """Return the most steps and points to keep of each run, one limit for all runs."""
        more = max(0, len(lengths) - MANY_RUNS)
        points = compute_common_length_limit(lengths, max(0, MOST_POINTS - POINTS_A_RUN * more))
        steps = compute_common_length_limit(lengths, max(0, MOST_STEPS - STEPS_A_RUN * more))
        return cls(steps, min(MOST_POINTS_EACH, points))


def pack_steps(block: Block, run: ThinnedRun) -> dict[str, int]:
    """Add a run's step times, errors, iterations, flags to packed arrays; return indices."""
    steps, first = run.steps, int(run.steps.k[0])
    count = run.last - first + 1
    # Of a whole run the places follow from the missing ones, which pack to nothing.
    at = None if run.is_whole else block.add_rising_indices(steps.k - first, count)

    def spread(values: Floats, missing: float = np.nan) -> Floats:
        if at is not None:
            return values
        out = np.full(count, missing)
        out[steps.k - first] = values
        return out

    flags = enumerate((*(getattr(steps, name) for name in FLAGS), run.extra))
    bits = np.sum([flag.astype(np.float64) * (1 << bit) for bit, flag in flags], axis=0)
    entry = {
        "first": first,
        "t": block.add_as_uint16_logs(spread(steps.time_ns), at),
        "e": block.add_as_uint16_logs(spread(steps.error), at),
        "i": block.add_as_uint16_counts(spread(steps.iterations), at),
        "a": block.add_as_uint16_counts(spread(steps.n_active), at),
        "f": block.add_as_flag_bytes(spread(bits, 0.0), at),
    }
    if steps.rounds > 1:
        entry["r"] = block.add_as_uint16_logs(spread(steps.raw_ns), at)
    return entry


def pack_track(block: Block, track: Track, reference: Track | None) -> dict[str, Any]:
    """Add ship positions and forces, less a reference run's, to packed arrays; return indices."""
    position, force = track.position.copy(), track.force.copy()
    if reference is not None and reference.every == track.every:
        count = min(len(position), len(reference.position))
        position, force = position[:count], force[:count]
        position -= reference.position[:count]
        force -= reference.force[:count]
    return {
        "every": track.every,
        "x": [block.add_as_int16_multiples(position[:, i], s) for i, s in enumerate(TOLD_APART)],
        "u": [block.add_as_int16_multiples(force[:, i], FORCE_SHARE) for i in range(len(FORCES))],
    }
