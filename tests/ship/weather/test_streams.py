"""Random streams: one per source, the same everywhere."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from dpbench.ship.weather.harmonics import random_stream

NAMES = ("wind", "waves", "noise")


def test_sources_draw_from_different_streams() -> None:
    """No two sources of one seed, and no two seeds of one source, begin with the same numbers."""
    draws = {tuple(random_stream(seed, name).random(4)) for seed in range(50) for name in NAMES}
    assert len(draws) == 150


def test_streams_of_one_seed_are_uncorrelated() -> None:
    """The streams of different sources have no common part."""
    draws = np.array([random_stream(7, name).standard_normal(40_000) for name in NAMES])
    # The correlation of independent series has a standard deviation of 1/√40000 = 0.005.
    np.testing.assert_allclose(np.corrcoef(draws), np.eye(3), atol=0.025)


@pytest.mark.parametrize("hash_seed", ["0", "1"])
def test_a_stream_is_the_same_in_another_process(hash_seed: str) -> None:
    """The key does not hang on anything that a process draws at its start."""
    imported = "from dpbench.ship.weather.harmonics import random_stream"
    script = f"{imported}; print(random_stream(3, 'wind').random().hex())"
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={"PYTHONHASHSEED": hash_seed, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == random_stream(3, "wind").random().hex()
