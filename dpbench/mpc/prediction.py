"""Predicted outputs over the horizon from Markov parameters (paper eq. 13-15).

    Y = F x(k) + Φ ΔU,    F = [C A; …; C A^{N_p}],    Φ_{ij} = h_{i−j},    h_t = C A^t B

One recursion G_t = C A^t (never a matrix power) gives every block of F and of Φ.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from dpbench.arrays import Matrix
from dpbench.mpc.kernels import markov_blocks
from dpbench.mpc.model import StateSpace


def markov(model: StateSpace, N_p: int) -> tuple[Matrix, NDArray[np.float64]]:
    """F (N_p·n_y, n_x) of eq. 15 and the Markov parameters h (N_p, n_y, n_u)."""
    F = np.empty((N_p * model.n_y, model.n_x))
    h = np.empty((N_p, model.n_y, model.n_u))
    markov_blocks(model.A, model.B, model.C, F, h)
    return F, h


def toeplitz(h: NDArray[np.float64], N_c: int) -> Matrix:
    """Φ (N_p·n_y, N_c·n_u) of eq. 15, the block-Toeplitz matrix of h (N_p, n_y, n_u)."""
    N_p, n_y, n_u = h.shape
    padded = np.zeros((N_c - 1 + N_p, n_y, n_u))
    padded[N_c - 1 :] = h
    s_block, s_row, s_column = padded.strides
    blocks = as_strided(
        padded[N_c - 1 :],
        shape=(N_p, n_y, N_c, n_u),
        strides=(s_block, s_row, -s_block, s_column),
        writeable=False,
    )
    return blocks.reshape(N_p * n_y, N_c * n_u)
