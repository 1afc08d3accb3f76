"""Build the model of two people's mean faces: one component, from one to the other, on the mean of both (ours).

The mean faces are put in correspondence as those of an avatar (`common_grid`), and are then treated as two frames of
one clip: mean shape, morphs and component follow as in any build (Nagle section 2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from morphspace.arrays import Affine
from morphspace.avatar.build import joint_entry
from morphspace.avatar.common_grid import common_face, placed
from morphspace.avatar.selection import labels_of, model_key
from morphspace.avatar.settings import check_models
from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame, identity_affine
from morphspace.face.mesh import RIGID_POINTS, SCHEME
from morphspace.face.registration import fitted_similarity
from morphspace.grid import warp
from morphspace.linear.pca import fit_basis
from morphspace.linear.rows import RowArray
from morphspace.model.keypoints import landmarks_of, lip_of, required_faceframe
from morphspace.model.loadings import Loadings
from morphspace.model.model import MorphModel, model_digest
from morphspace.model.morph import Morph, inner_product, invert_mean_shape, resource
from morphspace.storage import digest_of_array, digest_of_json

POINT_DIGITS = 2  # of a px, as `keypoints --auto` writes them


@dataclass(frozen=True, eq=False)
class Pair:
    """The model of two faces: its training loadings (2, 1) are the first and the second face.

    `place` (2, 3) is the similarity that brings the second mean face to the first, from brow to nose.
    """

    model: MorphModel
    place: Affine


def pair_model(
    models: Sequence[MorphModel], *, flow: str, inputs: Mapping[str, str], versions: Mapping[str, str]
) -> Pair:
    """Build the model of the mean faces of two models.

    The first stays in place. The second is moved, turned and scaled until its rigid part lies on that of the first,
    so that only shape differs.

    Parameters
    ----------
    models : sequence of two MorphModel
    flow : str
        The flow between the mean faces.
    inputs : mapping
        Name to SHA-256, for the provenance.
    versions : mapping
        Package to version, for the provenance.

    Raises
    ------
    BadInput
        If a model has no keypoints, the sizes differ, or both show the same face.

    References
    ----------
    Nagle et al., section 2; the space of two people is ours.

    Examples
    --------
    >>> import morphspace as ms
    >>> pair = pair_model([ms.load("anna.morph"), ms.load("ben.morph")], flow="dis", inputs={}, versions={})
    >>> pair.model.rank
    1
    """
    if len(models) != 2:
        raise BadInput(f"{len(models)} models make no pair: give 2")
    check_models(models)
    keys = [model_key(model) for model in models]
    if keys[0] == keys[1]:
        raise BadInput(
            f"both models are the same one, of {models[0].identity}; expected two. Give another model for one end"
        )
    home, other = models
    place = _place(other, home)
    common = common_face(models, keys, 0, flow)
    fields = [
        placed(warp.compose(model.mean.displacement, field), at)
        for model, field, at in zip(models, common.fields, (identity_affine(), place), strict=True)
    ]
    mean_field = (0.5 * (fields[0] + fields[1])).astype(np.float32)
    try:
        to_home = invert_mean_shape(mean_field)
    except BadInput as error:
        raise BadInput(
            f"no face lies between those of {home.identity} and {other.identity}, whose points cannot be put in "
            "correspondence: check the keypoints of both with `morphspace keypoints`"
        ) from error
    height, width = home.mask.shape
    rows = np.stack(
        [
            Morph.of(
                warp.sample(model.mean.texture, warp.compose(across, to_home)), resource(field, to_home), ""
            ).vector
            for model, across, field in zip(models, common.fields, fields, strict=True)
        ]
    )
    mask = np.clip(warp.sample_field(common.mask, to_home), 0, 1).astype(np.float32)
    weight = float(np.sqrt(home.warp_weight * other.warp_weight))
    mean, basis, loadings = fit_basis(RowArray(rows), inner_product(mask, weight), 1)
    if basis.rank == 0:
        raise BadInput(
            f"the mean faces of {home.identity} and {other.identity} do not differ: give two that do"
        )
    halves = Morph(mean, (height, width), "")
    reference_id = digest_of_json([digest_of_array(halves.texture), digest_of_array(halves.displacement)])[
        :16
    ]
    mean_morph = Morph(mean, (height, width), reference_id)
    reference = np.clip(mean_morph.render(), 0, 1)
    faceframe = FaceFrame.at(warp.move_points(mean_field, required_faceframe(home).points))
    labels = labels_of(models, keys)
    provenance = {
        **_provenance(models, labels, inputs, versions),
        "reference": {
            "frame": "mean",
            "reason": "it lies halfway between the two faces",
            "sha256": digest_of_array(reference),
        },
        "keypoints": _keypoints(home, mean_field),
        "pair": {
            "identities": list(labels),
            "model_ids": [model.model_id for model in models],
            "placed": place.tolist(),
        },
    }
    model = MorphModel(
        mean=mean_morph,
        basis=basis,
        warp_weight=weight,
        mask=mask,
        reference=reference,
        mean_inverse=np.zeros((height, width, 2), np.float32),
        faceframe=faceframe,
        reference_faceframe=faceframe,
        training=Loadings(loadings, labels, model_digest(basis, mean_morph, provenance)),
        registration="similarity",
        flow=flow,
        provenance=provenance,
    )
    return Pair(model, place)


def _place(other: MorphModel, home: MorphModel) -> Affine:
    """Fit the similarity (2, 3) between two mean faces, by rigid points of the mesh or by the keypoints."""
    points = [landmarks_of(model) for model in (other, home)]
    if points[0] is None or points[1] is None:
        return fitted_similarity(required_faceframe(other).points, required_faceframe(home).points)
    rigid = list(RIGID_POINTS)
    return fitted_similarity(points[0][rigid], points[1][rigid])


def _keypoints(home: MorphModel, mean_field: Any) -> dict[str, Any]:
    """Return the provenance of the pair's keypoints, with the mesh points of the first model where it has them."""
    told: dict[str, Any] = {"source": "pair", "lip": lip_of(home), "on": "mean"}
    points = landmarks_of(home)
    if points is not None:
        moved = warp.move_points(mean_field, points)
        told["scheme"] = SCHEME
        told["points"] = [[round(float(x), POINT_DIGITS), round(float(y), POINT_DIGITS)] for x, y in moved]
    return told


def _provenance(
    models: Sequence[MorphModel],
    labels: tuple[str, ...],
    inputs: Mapping[str, str],
    versions: Mapping[str, str],
) -> dict[str, Any]:
    width, height = models[0].size
    return {
        "identity": "-".join(labels),
        "consent": joint_entry(labels, [model.provenance.get("consent") for model in models]),
        "licence": joint_entry(labels, [model.provenance.get("licence") for model in models]),
        "frame_rate_hz": None,
        "framing": {"source_size": [width, height], "crop": None, "size": [width, height]},
        "mask_sha256": None,
        "inputs": dict(inputs),
        "flow_start": "none",
        "components_asked": 1,
        "warp_weight_trials": [],
        "versions": dict(versions),
    }
