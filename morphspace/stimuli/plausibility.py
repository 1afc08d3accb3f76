"""The distance of a stimulus from the model's mean, compared with that of the training faces (ours).

The rms of the loadings in SD is the Mahalanobis distance divided by the square root of the number of components:
about 1 for a face of the training distribution. A component is implausible if it exceeds both 3 SD and the largest
value of the training faces. A warp folds where a triangle of the mean face is flipped.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable
from morphspace.model.model import MorphModel

PLAUSIBLE_SD = 3.0  # SD; exceeded by one normal value in 370
TOLERANCE = 0.01  # relative; the error of encoding a training face again


@dataclass(frozen=True)
class Plausibility:
    """The plausibility of one stimulus, over all its frames.

    Attributes
    ----------
    largest_sd : float, SD
        The largest absolute loading.
    largest_component : int, from 1
        The component of that loading.
    rms_sd : float, SD
        The largest rms of a frame.
    beyond : tuple of int, from 1
        The implausible components.
    """

    largest_sd: float
    largest_component: int
    rms_sd: float
    beyond: tuple[int, ...]


def plausible_limits_sd(model: MorphModel) -> AnyArray:
    """Return the limit (k,) of each component, SD: 3, or the largest absolute value of the training faces.

    Examples
    --------
    >>> import morphspace as ms
    >>> plausible_limits_sd(ms.load("anna.morph")).tolist()
    [3.0, 3.0, 3.0]
    """
    sd = np.where(model.sd > 0, model.sd, 1)
    furthest = np.abs(model.training.values[:, : model.rank] / sd).max(axis=0, initial=0)
    return np.maximum(PLAUSIBLE_SD, furthest)


def plausibility(limits_sd: AnyArray, tables_sd: Iterable[LoadingTable]) -> Plausibility:
    """Compare the tables (n, j) SD of a stimulus with the limits (k,) of `plausible_limits_sd`.

    Examples
    --------
    >>> import numpy as np
    >>> plausibility(np.array([3.0, 3.0]), [np.array([[1.0, -4.0]])]).beyond
    (2,)
    """
    values = np.abs(np.concatenate(list(tables_sd)))
    largest = values.max(axis=0, initial=0)
    place = int(largest.argmax()) if largest.size else 0
    rms = np.sqrt((values * values).mean(axis=1)).max(initial=0) if values.size else 0.0
    beyond = np.flatnonzero(largest > limits_sd[: len(largest)] * (1 + TOLERANCE))
    return Plausibility(
        float(largest[place]) if largest.size else 0.0,
        place + 1,
        float(rms),
        tuple(int(component) + 1 for component in beyond),
    )
