"""Laws of photographs warped by known fields: the truth is true, and the pictures differ by nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from morphspace.errors import BadInput
from morphspace.grid import warp
from morphspace.synthetic import warped
from morphspace.synthetic.warped import WARP_KINDS, FaceMarks, astronaut_face, flow_pair

SIZE = 96
PEAK_PX = 6.0
FACE = FaceMarks(
    right_eye=(150.0, 160.0),
    left_eye=(230.0, 164.0),
    mouth=np.array([(155.0, 252.0), (175.0, 255.0), (192.0, 257.0), (210.0, 256.0), (228.0, 250.0)]),
    side_px=288.0,
)
CODE = 1 / 255


def waves(scale=1):
    """A picture (400, 380, 3) times `scale` of waves so long (75 px) that sampling and averaging hardly touch them."""
    y, x = (np.mgrid[: 400 * scale, : 380 * scale] + 0.5) / scale
    channels = [
        np.sin(2 * np.pi * (np.cos(turn) * x + np.sin(turn) * y) / 75 + turn) for turn in (0.3, 1.4, 2.6)
    ]
    return (0.5 + 0.35 * np.stack(channels, axis=-1)).astype(np.float32)


def pair_of(kind, peak_px=PEAK_PX, seed=3, photograph=None, marks=FACE):
    return flow_pair(
        waves() if photograph is None else photograph, marks, kind=kind, peak_px=peak_px, seed=seed, size=SIZE
    )


def jump_px(truth):
    """How far the field jumps from a pixel to the one below it, (h - 1, w)."""
    return np.hypot(*np.moveaxis(np.diff(truth, axis=0), -1, 0))


def away_from_the_lips(pair, marks=FACE):
    """Pixels whose end point lies well inside the frame, but for those at the line between the lips.

    There one pixel shows both sides, and the spline that samples rings by 2 % of an edge 3 px away; within 4 px of the
    frame's border it knows too little of what lies beyond.
    """
    line = on_picture(marks.mouth, marks)
    y, x = np.mgrid[:SIZE, :SIZE]
    at_line = np.abs(y - np.interp(x, *line.T)) < 5
    at_line &= (x > line[0, 0] - 5) & (x < line[-1, 0] + 5)
    there_x, there_y = warp.positions(pair.truth)
    deep = np.minimum(np.minimum(there_x, SIZE - 1 - there_x), np.minimum(there_y, SIZE - 1 - there_y)) > 4
    return pair.visible & deep & ~at_line


def on_picture(points, marks):
    """Where points of the photograph stand in the picture: the eyes at `EYE_LEVEL`, in the middle."""
    middle = (np.array(marks.right_eye) + marks.left_eye) / 2
    return (points - middle) * SIZE / marks.side_px + np.array([0.5, warped.EYE_LEVEL]) * SIZE - 0.5


def area_px(corners):
    """The area of a polygon (m, 2)."""
    x, y = corners.T
    return abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / 2


@pytest.mark.parametrize("kind", ["smooth", "mouth"])
def test_the_truth_maps_the_frame_onto_the_reference(kind):
    pair = pair_of(kind)
    inside = away_from_the_lips(pair)
    assert inside.mean() > 0.7
    miss = (warp.sample(pair.frame, pair.truth) - pair.reference)[inside]
    # Rounding leaves up to 1 code, sd 0.41; a pixel of the reference sees up to three of the frame, which damps by 1.
    assert np.abs(miss).max() < 2.2 * CODE
    assert np.sqrt((miss**2).mean()) < 0.6 * CODE


def test_the_truth_has_no_shift():
    pair = pair_of("smooth")
    inside = away_from_the_lips(pair)
    slope = np.stack(np.gradient(warp.sample(pair.frame, pair.truth), axis=(1, 0)), axis=-1)[inside]
    miss = (warp.sample(pair.frame, pair.truth) - pair.reference)[inside]
    shift_px = np.linalg.lstsq(slope.reshape(-1, 2), miss.reshape(-1), rcond=None)[0]
    assert (
        np.abs(shift_px).max() < 0.003
    )  # rounding leaves sd 0.41 codes / 12 codes a px / sqrt(27648) = 0.0002


@pytest.mark.parametrize("kind", WARP_KINDS)
def test_the_longest_displacement_is_what_was_asked_for(kind):
    length = np.hypot(*np.moveaxis(pair_of(kind).truth.astype(np.float64), -1, 0))
    assert length.max() == pytest.approx(PEAK_PX, abs=1e-5)


@pytest.mark.parametrize("kind", WARP_KINDS)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_nothing_folds(kind, seed):
    truth = pair_of(kind, peak_px=8.0, seed=seed).truth  # so far that not every draw will do
    assert (
        warp.determinants(truth).min() > 0.5 * warped.LEAST_DETERMINANT
    )  # cells are coarser than the formula


def test_a_mouth_opens_at_the_line_between_the_lips_and_nowhere_else():
    smooth, mouth = pair_of("smooth"), pair_of("mouth")
    assert jump_px(smooth.truth).max() < 1.0  # px; the skin stretches, but holds together
    y, x = np.nonzero(jump_px(mouth.truth) > 1.5)
    line = on_picture(FACE.mouth, FACE)
    assert 0.5 * np.ptp(line[:, 0]) < np.ptp(x) < np.ptp(line[:, 0])
    assert (
        np.abs(y + 0.5 - np.interp(x, *line.T)).max() < 1
    )  # px; half of it where the line crosses the pair of rows


def test_the_inside_of_a_mouth_fills_the_gap():
    """A white photograph stays white but for the mouth, which no point of the reference is found in."""
    white = np.ones((400, 380, 3), np.float32)
    pair = pair_of("mouth", photograph=white)
    gap = pair.frame.min(axis=2) < 0.8  # teeth are 0.68 in blue
    line = on_picture(FACE.mouth, FACE)
    x = np.arange(np.ceil(line[0, 0]), line[-1, 0]).astype(int)
    y = np.floor(np.interp(x, *line.T)).astype(int)
    upper = np.stack([x, y], axis=1) + pair.truth[y, x]
    lower = np.stack([x, y + 1], axis=1) + pair.truth[y + 1, x]
    between = area_px(np.concatenate([upper, lower[::-1]])) - len(x)  # at rest a row lies between them
    assert gap.sum() == pytest.approx(
        between, abs=0.7 * len(x)
    )  # px; a third of a pixel of blend along each lip
    assert (pair.reference == 1).all()


@pytest.mark.parametrize("kind", WARP_KINDS)
def test_the_same_seed_gives_the_same_bytes_and_another_seed_another_field(kind):
    one, again, other = pair_of(kind), pair_of(kind), pair_of(kind, seed=4)
    for name in ("reference", "frame", "truth", "visible"):
        assert getattr(one, name).tobytes() == getattr(again, name).tobytes()
    assert np.abs(one.truth - other.truth).max() > 1.0  # px


def test_light_changes_the_frame_and_not_the_geometry():
    plain, lit = pair_of("smooth"), pair_of("lit")
    np.testing.assert_array_equal(plain.truth, lit.truth)
    np.testing.assert_array_equal(plain.reference, lit.reference)
    y, x = np.mgrid[:SIZE, :SIZE] / (SIZE - 1) * 2 - 1
    seen = lit.frame.max(axis=2) < 1  # not cut off at white
    design = (plain.frame[seen][..., None] * np.stack([np.ones_like(x), x, y], -1)[seen][:, None]).reshape(
        -1, 3
    )
    light, *_ = np.linalg.lstsq(design, lit.frame[seen].reshape(-1), rcond=None)
    gain, ramp = light[0], np.abs(light[1:]).sum() / light[0]
    assert warped.GAIN_RANGE[0] - 0.01 < gain < warped.GAIN_RANGE[1] + 0.01
    assert ramp == pytest.approx(warped.RAMP, abs=0.01)
    noise = lit.frame[seen].reshape(-1) - design @ light
    assert noise.std() == pytest.approx(warped.NOISE_SD, rel=0.1)  # rounding adds 4 % to it


@pytest.mark.parametrize("kind", ["smooth", "mouth"])
def test_a_peak_of_zero_gives_the_same_picture_twice(kind):
    pair = pair_of(kind, peak_px=0.0)
    assert not pair.truth.any() and pair.visible.all()
    np.testing.assert_array_equal(pair.reference, pair.frame)


def test_visible_is_what_lands_inside_the_frame():
    pair = pair_of("smooth", marks=replace(FACE, side_px=200.0))  # the cheeks at the border
    x, y = warp.positions(pair.truth)
    inside = (x >= -0.5) & (x <= SIZE - 0.5) & (y >= -0.5) & (y <= SIZE - 0.5)
    np.testing.assert_array_equal(pair.visible, inside)
    assert 0 < (~pair.visible).sum() < 0.1 * SIZE**2


def test_a_finer_photograph_gives_the_same_pair():
    """The large one is shrunk first; its marks must go along."""
    doubled = FaceMarks(
        tuple(2 * np.array(FACE.right_eye) + 0.5),
        tuple(2 * np.array(FACE.left_eye) + 0.5),
        2 * FACE.mouth + 0.5,
        2 * FACE.side_px,
    )
    one, other = pair_of("mouth"), pair_of("mouth", photograph=waves(2), marks=doubled)
    np.testing.assert_allclose(one.truth, other.truth, atol=1e-4)
    assert (
        np.abs(one.reference - other.reference).max() < 2.5 * CODE
    )  # averaging damps these waves by 0.7 codes


def test_pictures_are_eight_bit_codes():
    pair = pair_of("lit")
    for image in (pair.reference, pair.frame):
        assert image.dtype == np.float32
        np.testing.assert_allclose(image * 255, np.round(image * 255), atol=1e-4)
        assert image.min() >= 0 and image.max() <= 1


def test_the_astronaut_can_be_warped():
    photograph, marks = astronaut_face()
    pair = flow_pair(photograph, marks, kind="mouth", peak_px=8.0, seed=1, size=SIZE)
    inside = away_from_the_lips(pair, marks)
    miss = (warp.sample(pair.frame, pair.truth) - pair.reference)[inside]
    still = (pair.frame - pair.reference)[inside]
    assert np.sqrt((miss**2).mean()) < 0.2 * np.sqrt(
        (still**2).mean()
    )  # a real picture has edges that sampling blurs


def test_a_mouth_needs_points_from_left_to_right():
    for mouth in (FACE.mouth[:3], FACE.mouth[::-1]):
        with pytest.raises(BadInput, match="4 points or more, from left to right"):
            pair_of("mouth", marks=replace(FACE, mouth=mouth))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"kind": "wobbly"}, "no warp of kind 'wobbly'"),
        ({"kind": "smooth", "peak_px": -1.0}, "a peak of -1.0 px"),
        ({"kind": "smooth", "peak_px": float("nan")}, "a peak of nan px"),
        ({"kind": "mouth", "peak_px": 60.0}, "without folds"),
    ],
)
def test_a_warp_that_cannot_be_is_refused(words, said):
    with pytest.raises(BadInput, match=said):
        flow_pair(waves(), FACE, size=64, **words)
