"""Arrays of float64, as every room names them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
"""One axis; its length stands where it is used."""
Matrix = NDArray[np.float64]
"""Two axes."""
