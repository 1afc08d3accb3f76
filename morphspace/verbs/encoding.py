"""What encode and reconstruct share: opening a clip for a model, and encoding its frames in order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from morphspace.anchoring import was_anchored
from morphspace.arrays import Image
from morphspace.detection import models_present
from morphspace.detection.models import FETCH_COMMAND
from morphspace.faces import Frame, Framing
from morphspace.files.clips import open_clip
from morphspace.files.framed import FramedClip
from morphspace.model import Loadings, MorphModel
from morphspace.morph import Morph
from morphspace.progress import in_order


@dataclass(frozen=True, eq=False)
class EncodedFrame:
    """A frame aligned to the model's reference, its morph as the flow saw it, and its loadings (one row)."""

    frame: Frame
    morph: Morph
    loadings: Loadings


def framed_for(
    model: MorphModel, sources: tuple[str, ...], crop: tuple[int, int, int, int] | None
) -> FramedClip:
    """Open a clip for a model: scaled to its frames, and cropped as its own frames were where the size is the same."""
    clip = open_clip(sources)
    built = model.provenance["framing"]
    if crop is None and list(clip.size) == built["source_size"] and built["crop"] is not None:
        x, y, w, h = built["crop"]
        crop = (x, y, w, h)
    return FramedClip(clip, Framing(clip.size, crop, model.size))


def encoded_frames(model: MorphModel, source: FramedClip) -> Iterator[EncodedFrame]:
    """Encode each frame of the clip, in order, a few at a time."""
    flow = model.flow_from_reference  # prepared here, once, and not by each thread

    def encode(item: tuple[str, Image]) -> EncodedFrame:
        name, image = item
        frame = model.align(image, name)
        morph = model.morph_of(frame.image, flow)
        return EncodedFrame(frame, morph, model.fit(frame, morph))

    indices = list(range(len(source.names)))
    yield from in_order(encode, zip(source.names, source.images(indices), strict=True))


def notes_on_alignment(model: MorphModel) -> tuple[str, ...]:
    """Say where frames are brought to the reference with less than the build had."""
    if not was_anchored(model.provenance) or models_present():
        return ()
    return (
        f"{model.identity} was built with face points, and what finds them is not here now: frames are read by flow "
        f"alone, less like the model's own; run `{FETCH_COMMAND}` once",
    )


def joined(model: MorphModel, parts: list[Loadings]) -> Loadings:
    """Put single rows of loadings together, (n, k)."""
    values = np.concatenate([part.values for part in parts]) if parts else np.zeros((0, model.rank))
    return Loadings(values, tuple(name for part in parts for name in part.frame_names), model.model_id)
