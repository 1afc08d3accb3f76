"""The imitator's own model, if another person imitates: the loadings in it are transferred to the stimulus' model.

The image of another person, projected directly onto the components of the stimulus, reflects identity more than
expression. In the imitator's own model it is a difference from the imitator's mean. Mimicry transfers this difference
to the stimulus' face (Nagle section 3) before the two are compared (section 5.1). With known truth (a drawn actor
with the same motion, and a real actor driven by the stimulus) correlations rose from .86, .32 and .28 to .93, .95 and
.95.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphspace.arrays import AnyArray, LoadingVector, Mask
from morphspace.errors import BadInput
from morphspace.imitation import masked_basis
from morphspace.model.model import MorphModel, load_model
from morphspace.model.morph import inner_product
from morphspace.storage import digest_of_file
from morphspace.transfer.mimicry import Method, mimic
from morphspace.transfer.projection import Projection

METHOD: Method = "map"  # the most probable face; the closest to known imitations, and it needs no landmarks


@dataclass(frozen=True, eq=False)
class Imitator:
    """The imitator's model.

    Attributes
    ----------
    model : MorphModel
    path : Path
    digest : str
        The SHA-256 of the file.
    carry : function
        Transfers loadings (k',) of this model to loadings (k,) of the stimulus' model.
    """

    model: MorphModel
    path: Path
    digest: str
    carry: Callable[[AnyArray], LoadingVector]


def imitator_of(path: Path, stimulus: MorphModel, share: Mask | None) -> Imitator:
    """Load the imitator's model and prepare the transfer to the stimulus' space.

    Loadings are not limited: a limit would make extreme frames more similar.

    Parameters
    ----------
    path : Path
    stimulus : MorphModel
    share : array (h, w) in [0, 1], or None
        The part of the face that is measured; None for the whole.

    Raises
    ------
    BadInput
        If a model has no keypoints or no components, or both models are the same.
    """
    model = load_model(path)
    if model.model_id == stimulus.model_id:
        raise BadInput(
            f"--imitator {path} is the model of the stimulus itself; expected that of another person. Leave it out if "
            "a person imitates themselves, or give the imitator's model"
        )
    for role, used in (("--model", stimulus), ("--imitator", model)):
        if used.faceframe is None:
            raise BadInput(
                f"{role} {used.identity} has no keypoints; expected three, which align the two faces. Set them with "
                "`morphspace keypoints MODEL --auto`, or with --set or --from"
            )
        if used.rank == 0:
            raise BadInput(
                f"{role} {used.identity} has 0 components; expected at least 1. Build it from more frames"
            )
    return Imitator(model, path, digest_of_file(path), _carry(model, stimulus, share))


def _carry(
    imitator: MorphModel, stimulus: MorphModel, share: Mask | None
) -> Callable[[AnyArray], LoadingVector]:
    """Return the function that transfers loadings, through the part of the face or the whole."""

    if share is None:
        whole = mimic(imitator, stimulus, METHOD, max_sd=np.inf)
        return lambda loadings: whole(imitator.offset(loadings)).loadings
    projection = Projection(imitator, stimulus)
    part = masked_basis(stimulus.basis, inner_product(share * projection.source_mask, 1.0))

    def seen(loadings: AnyArray) -> LoadingVector:
        return part.mean(projection.carried(imitator.offset(loadings)).vector)

    return seen
