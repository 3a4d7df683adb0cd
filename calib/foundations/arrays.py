"""Array types, and arrays that nobody changes behind your back."""

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]


def read_only(values: npt.ArrayLike) -> Array:
    """Return a read-only float64 copy of ``values``."""
    copy = np.array(values, dtype=np.float64)
    copy.flags.writeable = False
    return copy


def read_only_view(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a view of ``values`` that cannot be written through."""
    view = values.view()
    view.flags.writeable = False
    return view
