"""The drawn actor: an identity painted once, then moved. Ours."""

from __future__ import annotations

from functools import lru_cache

from morphspace.synthetic.actor import (
    NEUTRAL,
    PLAIN,
    Actor,
    ActorFrame,
    check_size,
    picture_labels,
    slit_distances,
)
from morphspace.synthetic.creases import crease_maps
from morphspace.synthetic.fields import SEAM, basis_fields
from morphspace.synthetic.geometry import geometry_of
from morphspace.synthetic.interior import paint_interior
from morphspace.synthetic.painting import FINE, paint_neutral
from morphspace.synthetic.parameters import Capture, Expression, Identity

DEFAULT_SIZE = (200, 240)  # px, width and height: the size of a model
MARGIN_SHARE = 0.10  # of the picture's height, painted around it for head motion


@lru_cache(maxsize=4)
def drawn_actor(identity: Identity, size: tuple[int, int] = DEFAULT_SIZE) -> Actor:
    """Paint an identity for pictures of `size` (width, height) px; the last four painted are kept.

    Raises `BadInput` for a picture too small to hold a face. Ours.
    """
    check_size(size)
    margin = round(MARGIN_SHARE * size[1])
    width, height = size[0] + 2 * margin, size[1] + 2 * margin
    face = geometry_of(identity, size, margin)
    x, y = face.grid(width, height, FINE)
    skin, fine_labels = paint_neutral(identity, face, width, height)
    above, below = slit_distances(face, width, height)
    seam = face.origin_px[1] + face.unit_px * sum(SEAM) / 2
    return Actor(
        size=size,
        margin=margin,
        geometry=face,
        skin=skin,
        above=above,
        below=below,
        creases=crease_maps(face, x, y),
        basis=basis_fields(face, width, height),
        interior=paint_interior(identity, face, x, y),
        labels=picture_labels(fine_labels, size, margin, above, below, seam),
        identity=identity,
    )


def draw_actor_frame(
    identity: Identity,
    expression: Expression = NEUTRAL,
    *,
    size: tuple[int, int] = DEFAULT_SIZE,
    capture: Capture = PLAIN,
) -> ActorFrame:
    """Draw one frame of an identity, with its truth. Ours.

    `size` (width, height) px. The identity is painted on first use and kept. Raises `BadInput` as
    `drawn_actor`.
    """
    return drawn_actor(identity, size).draw(expression, capture)
