"""What build-model and encode share of finding faces: whether the detector is there, and the crop it gives."""

from __future__ import annotations

from typing import Literal, get_args

from morphspace.errors import BadInput
from morphspace.face.crop import FoundCrop, head_crop, median_eyes_px
from morphspace.face.detector import models_present
from morphspace.face.finder import FaceFinder, own_finder
from morphspace.io.clips import Clip
from morphspace.model.reference import spread
from morphspace.steps import Step, Steps, in_order

Landmarks = Literal["auto", "anchor", "none"]
"""`auto`: the face is found in every frame where the detector's files are; `anchor`: it must be, and the flow is held
to its points; `none`: it is not looked for."""
CROP_FRAMES = 24  # of a clip, evenly spread, in which the face is looked for to crop it
WITHOUT = (
    "built without face points: rigid part and mask are where a cropped face usually has them, and the model has no "
    "keypoints; run `morphspace models fetch` once for better, or give --landmarks none to say that this is meant"
)


def finder_for(landmarks: str) -> tuple[FaceFinder | None, tuple[str, ...]]:
    """Give the detector if it is wanted and there, and one line on how to get it if it is wanted and not there.

    Raises `MissingModels` where it is needed and not there.
    """
    if landmarks not in get_args(Landmarks):
        raise BadInput(
            f"there is no way of using landmarks called {landmarks!r}: choose one of {', '.join(get_args(Landmarks))}"
        )
    if landmarks == "none":
        return None, ()
    if landmarks == "anchor" or models_present():
        return own_finder(), ()
    return None, (WITHOUT,)


def crop_steps(clip: Clip, finder: FaceFinder, aspect: float) -> Steps[FoundCrop]:
    """Find the face in a spread of frames and give one crop for all of them; a generator of steps.

    `aspect` is width over height. Raises `BadInput` where a face was found in less than half of them.
    """
    looked = spread(len(clip), CROP_FRAMES)
    faces = []
    for done, face in enumerate(in_order(finder.find, clip.images(looked)), 1):
        faces.append(face)
        yield Step("crop", done, len(looked))
    found = [face for face in faces if face is not None]
    if 2 * len(found) < len(looked):
        raise BadInput(
            f"a face was found in {len(found)} of {len(looked)} frames of {clip.name}, too few to crop the clip: give "
            "--crop x,y,w,h, or leave it out"
        )
    return FoundCrop(head_crop(found, clip.size, aspect), median_eyes_px(found), len(looked), len(found))
