"""Types of arrays, for numeric files (numpy is loaded)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]


class Stack(np.ndarray[Any, np.dtype[np.float64]]):
    """Matrices (k, rows, columns) of which each is transposed."""

    @property
    def T(self) -> Any:
        return self.swapaxes(-1, -2)
