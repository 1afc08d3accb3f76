"""Names for the arrays that cross function borders, so that a signature says what an array is.

The axes, units and directions behind these names are fixed once, in `data_spec/conventions.md`.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
"""(h, w, 3) sRGB-coded colour in [0, 1], rows first; values outside survive until a file is written."""

Mask = NDArray[np.float32]
"""(h, w) weights in [0, 1]: how much a pixel counts as face."""

Displacement = NDArray[np.float32]
"""(h, w, 2) px, [..., 0] right, [..., 1] down; the point p of the grid is found in the frame at p + u(p)."""

Points = NDArray[np.float64]
"""(m, 2) px, each (x, y); pixel centres at integer coordinates."""

Affine = NDArray[np.float64]
"""(2, 3) px: maps (x, y) to A[:, :2] @ (x, y) + A[:, 2]."""

LoadingVector = NDArray[np.float64]
"""(k,) coordinates of one face on the principal components (statistics calls them scores)."""

LoadingTable = NDArray[np.float64]
"""(n, k) one loading vector a row."""

Rows = NDArray[np.float32]
"""(n, d) one serialised face a row."""

AnyArray = NDArray[Any]


def read_only(array: AnyArray) -> AnyArray:
    """Return a view of an array that cannot be written to; the array itself stays as it is."""
    view = np.asarray(array).view()
    view.flags.writeable = False
    return view
