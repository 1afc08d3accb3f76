"""Name identities and select their expressions (Nagle section 4, steps 1 and 2).

Everything here depends on the models alone, never on their order.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from morphspace.arrays import LoadingTable
from morphspace.model.keypoints import affine_between_models, landmarks_of, required_faceframe
from morphspace.model.model import MorphModel, points_document
from morphspace.storage import digest_of_array, digest_of_json


def model_key(model: MorphModel) -> str:
    """Compute a digest of all of a model that a blend depends on: loadings, keypoints and landmarks."""
    learned = model.landmarks
    parts = [] if learned is None else [learned.mean, learned.weights, learned.error_px]
    return digest_of_json(
        [
            model.model_id,
            model.mean.reference_id,
            model.identity,
            points_document(model.faceframe),
            model.provenance.get("keypoints"),
            [digest_of_array(np.ascontiguousarray(part)) for part in parts],
        ]
    )


def places_in_order(models: Sequence[MorphModel], keys: Sequence[str]) -> list[int]:
    """Sort models by name, then by mean face and digest, so that no order of input and no words change a blend."""
    return sorted(
        range(len(models)), key=lambda i: (models[i].identity, models[i].mean.reference_id, keys[i], i)
    )


def labels_of(models: Sequence[MorphModel], keys: Sequence[str]) -> tuple[str, ...]:
    """Return a unique name for each model: its identity, or NAME_2, NAME_3 in the order of `places_in_order`."""
    labels: dict[int, str] = {}
    for place in places_in_order(models, keys):
        name, number = models[place].identity, 1
        while name in labels.values():
            number += 1
            name = f"{models[place].identity}_{number}"
        labels[place] = name
    return tuple(labels[place] for place in range(len(models)))


def nearest_to_all(models: Sequence[MorphModel]) -> int:
    """Return the place of the model whose mean face is nearest to all others; the first of equals.

    Distances are those of the mesh points after the affine, or of the mean textures where a model has no mesh points.
    """
    totals = [
        sum(_apart(model, other) for other in models if other is not model) if len(models) > 1 else 0.0
        for model in models
    ]
    return int(np.argmin(np.round(totals, 6)))


def _apart(source: MorphModel, target: MorphModel) -> float:
    """Compute the distance of two mean faces in eye distances of the target, by mesh points or else by keypoints."""
    points = [landmarks_of(model) for model in (source, target)]
    faceframe = required_faceframe(target).points
    eyes_px = float(np.hypot(*(faceframe[1] - faceframe[0])))
    if points[0] is None or points[1] is None:
        return float(np.abs(required_faceframe(source).points - faceframe).mean()) / eyes_px
    affine = affine_between_models(source, target)
    off = points[0] @ affine[:, :2].T + affine[:, 2] - points[1]
    return float(np.sqrt((off**2).sum(axis=1).mean())) / eyes_px


def spread_out(loadings: LoadingTable, most: int | None) -> list[int]:
    """Choose at most `most` of n faces (n, k), spread out in loading space; all if None. Places in rising order.

    The first is the face nearest to the mean; each next one is the farthest from those chosen.
    Distances are those of the model's inner product.

    References
    ----------
    Gonzalez, Theoretical Computer Science 38, 1985.

    Examples
    --------
    >>> import numpy as np
    >>> spread_out(np.array([[0.0], [0.1], [2.0], [-3.0]]), 3)
    [0, 2, 3]
    """
    count = len(loadings)
    if most is None or most >= count:
        return list(range(count))
    chosen = [int((loadings**2).sum(axis=1).argmin())]
    far = np.full(count, np.inf)
    while len(chosen) < most:
        far = np.minimum(far, ((loadings - loadings[chosen[-1]]) ** 2).sum(axis=1))
        far[chosen] = -1.0
        chosen.append(int(far.argmax()))
    return sorted(chosen)
