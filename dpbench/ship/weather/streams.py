"""Independent random streams, one per source of randomness, all drawn from one seed.

The name of the source is part of the key, so a source draws the same numbers whatever other
sources there are and in whatever order they are asked.
"""

from __future__ import annotations

import numpy as np


def stream(seed: int, name: str) -> np.random.Generator:
    """Return the stream of the source `name` under `seed` (0 or more), at its beginning.

    The generator is named (PCG64), because NumPy may change its default one.
    """
    key = np.random.SeedSequence(seed, spawn_key=tuple(name.encode()))
    return np.random.Generator(np.random.PCG64(key))
