"""Draw the images of a drawing, frame by frame (Nagle section 2: mean + P L, then the warp of the texture)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from morphspace.arrays import Image, LoadingVector, Mask
from morphspace.errors import BadInput
from morphspace.model.keypoints import region_of
from morphspace.model.model import MorphModel
from morphspace.model.morph import Morph
from morphspace.steps import in_order
from morphspace.stimuli.drawing import Drawing


def draw(model: MorphModel, drawing: Drawing, originals: Iterable[Image] | None = None) -> Iterator[Image]:
    """Draw the frames (h, w, 3) of a drawing, in order, in constant memory.

    Parameters
    ----------
    model : MorphModel
    drawing : Drawing
    originals : iterable of n images (h, w, 3), or None
        The originals of the drawing's placing.

    Yields
    ------
    array (h, w, 3)

    Raises
    ------
    BadInput
        If the model has fewer components than the drawing, or the originals are missing.

    Examples
    --------
    >>> import numpy as np
    >>> import morphspace as ms
    >>> model = ms.load("anna.morph")
    >>> (face,) = draw(model, Drawing("mean", np.zeros((1, model.rank))))
    >>> np.allclose(face, np.clip(model.mean.render(), 0, 1), atol=1e-6)
    True
    """
    for morph, image in morphs_and_images(model, drawing, originals, 1):
        del morph
        yield image


def morphs_and_images(
    model: MorphModel, drawing: Drawing, originals: Iterable[Image] | None, workers: int
) -> Iterator[tuple[Morph, Image]]:
    """Yield the morph and the image (h, w, 3) of each frame, in order, drawn by `workers` threads.

    Raises `BadInput` if the faces are placed into frames and there are none.
    """
    mask = _mask_of(model, drawing)
    count = len(drawing.loadings_sd)
    if drawing.colour_sd is not None:
        _ = model.revealed  # learned once, before the threads start
    if drawing.placing is not None and originals is None:
        raise BadInput(
            f"{drawing.name} has no original frames; expected those into which it is placed. Give them"
        )

    def frame(item: tuple[int, Image | None]) -> tuple[Morph, Image]:
        row, original = item
        morph = _morph_at(model, drawing, row, mask)
        image = morph.render()
        if original is not None and drawing.placing is not None:
            image = model.placed(image, original, drawing.placing.registrations[row])
        return morph, image

    items = (
        ((row, None) for row in range(count))
        if originals is None or drawing.placing is None
        else zip(range(count), originals, strict=True)
    )
    yield from map(frame, items) if workers == 1 else in_order(frame, items, workers)


def _mask_of(model: MorphModel, drawing: Drawing) -> Mask | None:
    """Return the mask (h, w) of a drawing's region on the mean face; None for the whole face."""
    if drawing.region is None:
        return None
    mask = region_of(model, drawing.region) if drawing.region_mask is None else drawing.region_mask
    if mask.shape != model.mask.shape:
        raise BadInput(
            f"the region {drawing.region} is {mask.shape[1]}x{mask.shape[0]}; expected {model.size[0]}x"
            f"{model.size[1]}, the size of the model's frames. Paint it on a rendered mean face"
        )
    return mask


def _morph_at(model: MorphModel, drawing: Drawing, row: int, mask: Mask | None) -> Morph:
    """Return the morph of one frame of a drawing, with the mask that `_mask_of` returns."""
    colour = None if drawing.colour_sd is None else drawing.colour_sd[row]
    inside = _morph(model, drawing.loadings_sd[row], colour)
    if mask is None or drawing.outside_sd is None:
        return inside
    outside = model.expand(_loadings(model, drawing.outside_sd[row]))
    share = mask[..., None].astype(np.float32)
    return Morph.of(
        outside.texture + share * (inside.texture - outside.texture),
        outside.displacement + share * (inside.displacement - outside.displacement),
        inside.reference_id,
    )


def _morph(model: MorphModel, shape_sd: LoadingVector, colour_sd: LoadingVector | None) -> Morph:
    if colour_sd is None:
        return model.expand(_loadings(model, shape_sd))
    coloured, shaped = (model.expand(_loadings(model, values)) for values in (colour_sd, shape_sd))
    revealed = model.revealed.change(shaped.displacement, coloured.displacement)
    return Morph.of(coloured.texture + revealed, shaped.displacement, model.mean.reference_id)


def _loadings(model: MorphModel, values_sd: LoadingVector) -> LoadingVector:
    if len(values_sd) > model.rank:
        raise BadInput(
            f"the drawing has {len(values_sd)} loadings; expected at most {model.rank}, the components of "
            f"{model.identity}. Draw with the model they belong to"
        )
    return values_sd * model.sd[: len(values_sd)]
