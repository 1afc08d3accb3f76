"""The imitator's own model, where another person imitates: what is read in it is carried over by mimicry.

A stranger's picture, projected straight onto the stimulus' components, tells whose face it is more than what it does.
Read in a model of the stranger it is a difference from the stranger's own mean, and mimicry lays that on the stimulus'
face (Nagle section 3); only then are the two compared (section 5.1). Tried where the right answer is known, a drawn
actor who does the same and a real one driven by the stimulus: correlations rose from .86, .32 and .28 to .93, .95, .95.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphspace.arrays import AnyArray, LoadingVector, Mask
from morphspace.errors import BadInput
from morphspace.imitation import masked_basis
from morphspace.model.model import MorphModel, inner_product, load_model
from morphspace.storage import digest_of_file
from morphspace.transfer.mimicry import Method, mimic
from morphspace.transfer.projection import Projection

METHOD: Method = (
    "map"  # the most probable face of the stimulus: of all ways the closest to it, and it needs no points
)


@dataclass(frozen=True, eq=False)
class Imitator:
    """The model of who imitates, its file and SHA-256, and `carry`: its loadings (k',) to the stimulus' own (k,)."""

    model: MorphModel
    path: Path
    digest: str
    carry: Callable[[AnyArray], LoadingVector]


def imitator_of(path: Path, stimulus: MorphModel, share: Mask | None) -> Imitator:
    """Open the imitator's model and prepare the way to the stimulus' space, seen through `share` (h, w) or whole.

    Nothing is bounded: a bound would make extreme frames look more alike than they are. Raises `BadInput` where a model
    lacks keypoints, or the imitator's is the stimulus' own.
    """
    model = load_model(path)
    if model.model_id == stimulus.model_id:
        raise BadInput(
            f"--imitator {path} is the model of the stimulus itself: leave it out where a person imitates themselves, "
            "or give the model of who imitates"
        )
    for role, used in (("--model", stimulus), ("--imitator", model)):
        if used.faceframe is None:
            raise BadInput(
                f"{role} {used.identity} has no keypoints, which carry one face to the other: set them with "
                "`morphspace keypoints MODEL --auto`, or with --set or --from"
            )
        if used.rank == 0:
            raise BadInput(f"{role} {used.identity} has no component: build it from more frames")
    return Imitator(model, path, digest_of_file(path), _carry(model, stimulus, share))


def _carry(
    imitator: MorphModel, stimulus: MorphModel, share: Mask | None
) -> Callable[[AnyArray], LoadingVector]:
    if share is None:
        whole = mimic(imitator, stimulus, METHOD, max_sd=np.inf)
        return lambda loadings: whole(imitator.offset(loadings)).loadings
    projection = Projection(imitator, stimulus)
    part = masked_basis(stimulus.basis, inner_product(share * projection.source_mask, 1.0))

    def seen(loadings: AnyArray) -> LoadingVector:
        return part.mean(projection.carried(imitator.offset(loadings)).vector)

    return seen
