"""Types of arrays; their shapes are documented where they are used."""

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]  # One axis
Matrix = NDArray[np.float64]  # Two axes
Floats = NDArray[np.float64]  # Any number of axes, or a list of numbers that is no vector
Ints = NDArray[np.int64]  # Whole numbers, times in nanoseconds among them
Flags = NDArray[np.bool_]  # Yes or no of each entry
Indices = NDArray[np.intp]  # Places in another array
