"""How far from the model's mean a stimulus lies, and whether its face is one the model can vouch for (ours).

The rms of the loadings in SD is the Mahalanobis distance over the square root of the number of components: 1 for a
typical face of the training distribution. A component is beyond what is plausible where it is further out than 3 SD
and than any training face was; a warp folds where a triangle of the mean face turns over.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable
from morphspace.model.model import MorphModel

PLAUSIBLE_SD = 3.0  # one training value in 370 lies further out, were they normal
TOLERANCE = 0.01  # a training face that is encoded again comes back within it


@dataclass(frozen=True)
class Plausibility:
    """Of one stimulus, over its frames: `largest_sd` and the component (from 1) that has it; `rms_sd`, the largest of
    a frame; `beyond`, the components (from 1) that are beyond what is plausible.
    """

    largest_sd: float
    largest_component: int
    rms_sd: float
    beyond: tuple[int, ...]


def plausible_limits_sd(model: MorphModel) -> AnyArray:
    """Give how far each component (k,) may go, in SD: 3, or as far as a training face went."""
    sd = np.where(model.sd > 0, model.sd, 1)
    furthest = np.abs(model.training.values[:, : model.rank] / sd).max(axis=0, initial=0)
    return np.maximum(PLAUSIBLE_SD, furthest)


def plausibility(limits_sd: AnyArray, tables_sd: Iterable[LoadingTable]) -> Plausibility:
    """Judge the tables (n, j) of a stimulus by the limits (k,) that `plausible_limits_sd` gives."""
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
