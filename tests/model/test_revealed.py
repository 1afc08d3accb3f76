"""Colours that a warp hides or reveals; truth is a strip whose colour is a known function of its height."""

import numpy as np
import pytest

from morphspace.model import revealed
from morphspace.model.morph import Morph
from morphspace.model.revealed import learn_revealed

SIZE = (40, 30)  # h, w
INSIDE = slice(12, 24)  # rows of the strip
LIPS, DARK = 0.8, 0.1  # colours where the strip is shut and where it is as high as on the mean face


def face(area: float, colour: float | None = None) -> Morph:
    """Return a face whose strip has this area a place; its colour falls from `LIPS` to `DARK` with the area."""
    displacement = np.zeros((*SIZE, 2), np.float32)
    rows = np.clip(np.arange(SIZE[0]) - INSIDE.start, 0, INSIDE.stop - INSIDE.start)
    displacement[..., 1] = ((area - 1) * rows)[:, None]
    texture = np.full((*SIZE, 3), 0.5, np.float32)
    texture[INSIDE] = LIPS + (DARK - LIPS) * area if colour is None else colour
    return Morph.of(texture, displacement, "mean")


def learned(areas, **kinds):
    faces = [face(area, **kinds) for area in areas]
    return learn_revealed(
        lambda row: faces[int(row[0])] if len(row) else faces[0], np.arange(len(faces))[:, None]
    )


AREAS = np.linspace(0.05, 1.6, 12)


def test_a_warp_alone_shows_the_colours_of_faces_that_are_open_so_far():
    found = learned(AREAS)
    usual = face(1.0)
    for area in (0.1, 0.5, 1.5):
        colour = usual.texture + found.change(face(area).displacement, usual.displacement)
        # The ridge shrinks the slope by less than a tenth.
        np.testing.assert_allclose(colour[15:21], face(area).texture[15:21], atol=0.08)
        np.testing.assert_array_equal(colour[:8], usual.texture[:8])


def test_beyond_what_was_seen_colours_do_not_change():
    found = learned(AREAS)
    usual, widest = face(1.0).displacement, face(1.6).displacement
    np.testing.assert_array_equal(found.change(face(1.9).displacement, usual), found.change(widest, usual))


def test_a_warp_that_belongs_to_its_texture_changes_nothing():
    found = learned(AREAS)
    assert not found.change(face(0.3).displacement, face(0.3).displacement).any()


def test_skin_keeps_its_colour_in_a_crease():
    found = learned(np.linspace(0.5, 1.5, 12))
    assert not found.slope.any()


def test_what_is_hidden_without_a_change_of_colour_stays():
    np.testing.assert_allclose(learned(AREAS, colour=0.5).slope, 0, atol=1e-6)


@pytest.mark.parametrize(
    "count, is_learned", [(revealed.LEAST_FACES - 1, False), (revealed.LEAST_FACES, True)]
)
def test_a_few_faces_teach_nothing(count, is_learned):
    assert learned(np.linspace(0.05, 1.6, count)).slope.any() == is_learned


def test_a_model_learns_from_a_bounded_number_of_faces():
    seen = []

    def expand(row):
        seen.append(row)
        return face(0.05 + 1.5 * float(row[0]) if len(row) else 1.0)

    learn_revealed(expand, np.linspace(0, 1, 5 * revealed.FACES)[:, None])
    assert len(seen) == revealed.FACES + 1
