"""Types of NumPy arrays, by what they hold."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
Counts = NDArray[np.uint64]
Flags = NDArray[np.bool_]
# whatever a function passes on
Numbers = NDArray[Any]
