"""Noise of the sensors: its size, its whiteness and what is refused."""

from __future__ import annotations

import numpy as np

from dpbench.ship.environment import SensorNoise


def test_noise_has_its_standard_deviations() -> None:
    """Each measured axis has white noise of the given size."""
    noise = SensorNoise(np.array([0.1, 0.2, 0.001])).table(40_000, 3)
    # 40 000 draws: 0.35 % on a standard deviation, 0.5 % on a correlation; five of those.
    np.testing.assert_allclose(noise.std(axis=0), [0.1, 0.2, 0.001], rtol=0.02)
    np.testing.assert_allclose(np.corrcoef(noise.T), np.eye(3), atol=0.025)
    neighbours = np.mean(noise[1:] * noise[:-1], axis=0) / noise.var(axis=0)
    np.testing.assert_allclose(neighbours, 0.0, atol=0.025)
