"""Types of the arrays in signatures, which name what an array is.

Their axes, units and directions are defined in `data_spec/conventions.md`.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
"""(h, w, 3) sRGB-coded colour in [0, 1]; values outside are clipped only when a file is written."""

Mask = NDArray[np.float32]
"""(h, w) weights in [0, 1]: 1 inside the face."""

Displacement = NDArray[np.float32]
"""(h, w, 2) px, [..., 0] right, [..., 1] down: point p of the grid lies at p + u(p) in the frame."""

Points = NDArray[np.float64]
"""(m, 2) px, each (x, y); pixel centres at integer coordinates."""

Affine = NDArray[np.float64]
"""(2, 3) px: maps (x, y) to A[:, :2] @ (x, y) + A[:, 2]."""

LoadingVector = NDArray[np.float64]
"""(k,) coordinates of one face on the principal components (scores in statistics)."""

LoadingTable = NDArray[np.float64]
"""(n, k) one loading vector a row."""

Rows = NDArray[np.float32]
"""(n, d) one serialised face a row."""

AnyArray = NDArray[Any]


def read_only(array: AnyArray) -> AnyArray:
    """Return a read-only view of an array; the array itself stays writable."""
    view = np.asarray(array).view()
    view.flags.writeable = False
    return view
