"""Laws of the drawn and the photographed actor: the frame and the truth about it tell the same story."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput
from morphspace.synthetic import (
    ACTIONS,
    LABELS,
    Actor,
    ActorFrame,
    Capture,
    Expression,
    Identity,
    draw_actor_frame,
    draw_portrait_frame,
    drawn_actor,
    expression_sequence,
    portrait_actor,
)
from morphspace.synthetic.inverse import inverse_of, sample_linear
from morphspace.synthetic.parameters import SIGNED_ACTIONS
from morphspace.synthetic.performance import POSES

SIZE = (150, 180)
MOVED = Capture(shift_x_px=2.3, shift_y_px=-3.1, roll_deg=4.0, zoom=1.02)
FLAT = Capture(crease_gain=0.0)
FLAT_MOVED = replace(MOVED, crease_gain=0.0)


@pytest.fixture(scope="module", params=["drawn", "portrait"])
def actor(request: pytest.FixtureRequest) -> Actor:
    if request.param == "portrait":
        return portrait_actor(SIZE)
    return drawn_actor(PERSON, SIZE)


PERSON = Identity.random(np.random.default_rng([1, 3]))


def look_up(image: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Bicubic, one channel at a time (OpenCV rounds the coordinates of two-channel images)."""
    x, y = (points[..., k].astype(np.float32) for k in range(2))
    planes = [
        cv2.remap(np.ascontiguousarray(image[..., c]), x, y, cv2.INTER_CUBIC) for c in range(image.shape[2])
    ]
    return np.stack(planes, axis=-1)


def grid(frame: ActorFrame) -> np.ndarray:
    height, width = frame.image.shape[:2]
    return np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=2).astype(np.float64)


def skin_away_from_slits(actor: Actor) -> np.ndarray:
    inside = np.isin(actor.labels, [LABELS.index("eye"), LABELS.index("mouth")]).astype(np.uint8)
    return cv2.dilate(inside, np.ones((5, 5), np.uint8)) == 0


def test_rest_is_the_neutral_face_with_no_displacement(actor: Actor) -> None:
    frame = actor.draw()
    assert_array_equal(frame.displacement, 0.0)
    assert_array_equal(frame.visibility, 1.0)
    assert_array_equal(frame.image, actor.draw(Expression(), Capture()).image)
    assert 0.0 <= frame.image.min() < frame.image.max() <= 1.0
    assert frame.image.dtype == frame.displacement.dtype == frame.visibility.dtype == np.float32


def test_same_parameters_give_the_same_bytes() -> None:
    smile = Expression(lip_corner_up=0.8, cheek_raise=0.5)
    first = draw_actor_frame(PERSON, smile, size=(96, 116), capture=Capture(noise_sd=0.02, noise_seed=5))
    drawn_actor.cache_clear()
    again = draw_actor_frame(PERSON, smile, size=(96, 116), capture=Capture(noise_sd=0.02, noise_seed=5))
    for name in ("image", "displacement", "visibility", "keypoints"):
        assert_array_equal(getattr(first, name), getattr(again, name))
    other = draw_actor_frame(PERSON, smile, size=(96, 116), capture=Capture(noise_sd=0.02, noise_seed=6))
    assert not np.array_equal(first.image, other.image)
    assert (
        Identity.random(np.random.default_rng(4)).as_dict()
        == Identity.random(np.random.default_rng(4)).as_dict()
    )


@pytest.mark.parametrize("capture", [FLAT, FLAT_MOVED], ids=["still", "moved"])
def test_skin_is_found_where_the_truth_says(actor: Actor, capture: Capture) -> None:
    """The frame, looked up at p + u(p), is the neutral face.

    What is left is resampling twice (bicubic, then this test's own look-up): 2 grey levels rms, and 9 at the
    99th percentile on skin grain of about 8 levels. A truth wrong by half a pixel breaks this five-fold, see
    below.
    """
    neutral = actor.draw(capture=FLAT).image
    for _, pose in POSES[::2]:
        frame = actor.draw(Expression(**pose), capture)
        found = grid(frame) + frame.displacement
        height, width = neutral.shape[:2]
        away = np.all((found > 2) & (found < (width - 3, height - 3)), axis=2)
        seen = (frame.visibility > 0) & skin_away_from_slits(actor) & away
        error = np.abs(look_up(frame.image, found) - neutral).max(axis=2)[seen]
        assert seen.mean() > 0.7
        assert np.sqrt(np.mean(error**2)) < 2 / 255
        assert np.percentile(error, 99) < 9 / 255


def test_the_truth_law_notices_half_a_pixel(actor: Actor) -> None:
    frame = actor.draw(Expression(jaw_open=0.5), FLAT)
    seen = (frame.visibility > 0) & skin_away_from_slits(actor)
    error = np.abs(
        look_up(frame.image, grid(frame) + frame.displacement + 0.5) - actor.draw(capture=FLAT).image
    )
    assert np.sqrt(np.mean(error.max(axis=2)[seen] ** 2)) > 4 / 255


def test_inverse_sheet_undoes_the_sheet(actor: Actor) -> None:
    for _, pose in POSES[::2]:
        for field in actor.sheets(Expression(**pose)):
            back = inverse_of(field)
            height, width = field.shape[:2]
            at = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=2) + back
            planes = [
                cv2.remap(
                    np.ascontiguousarray(field[..., k]),
                    at[..., 0].astype(np.float32),
                    at[..., 1].astype(np.float32),
                    cv2.INTER_LINEAR,
                    borderMode=cv2.BORDER_REPLICATE,
                )
                for k in range(2)
            ]
            miss = np.hypot(*(back[..., k] + planes[k] for k in range(2)))
            on_skin = cv2.erode((np.abs(actor.above[::2, ::2]) > 12).astype(np.uint8), np.ones((3, 3))) > 0
            assert np.percentile(miss[on_skin], 99.9) < 0.01  # px: Newton's last step


def test_skin_never_folds(actor: Actor) -> None:
    """The sheet keeps its orientation everywhere on the skin, or one pixel would show two places at once."""
    margin = actor.margin
    rng = np.random.default_rng(0)
    performed = expression_sequence(60, rng)
    for expression in [Expression(**pose) for _, pose in POSES] + performed:
        for field, distance in zip(actor.sheets(expression), (actor.above, actor.below), strict=True):
            by_x, by_y = np.diff(field, axis=1)[:-1], np.diff(field, axis=0)[:, :-1]
            area = (1 + by_x[..., 0]) * (1 + by_y[..., 1]) - by_x[..., 1] * by_y[..., 0]
            skin = (distance[::2, ::2] > 0)[:-1, :-1]
            skin[:margin], skin[-margin:], skin[:, :margin], skin[:, -margin:] = False, False, False, False
            assert area[skin].min() > 0.1


def test_keypoints_move_as_the_field_where_they_are(actor: Actor) -> None:
    rest = actor.draw()
    for pose in (dict(POSES)["surprise"], dict(POSES)["laugh"], dict(POSES)["chew"]):
        frame = actor.draw(Expression(**pose), MOVED)
        for name in (
            "nose_tip",
            "right_brow_middle",
            "chin",
            "left_cheek",
            "philtrum",
            "forehead",
            "nose_bridge",
        ):
            k = frame.keypoint_names.index(name)
            at = rest.keypoints[k]
            x, y = np.floor(at).astype(int)
            fx, fy = at - (x, y)
            corners = frame.displacement[y : y + 2, x : x + 2].astype(np.float64)
            moved = np.einsum("i,j,ijk->k", [1 - fy, fy], [1 - fx, fx], corners)
            assert_allclose(frame.keypoints[k], at + moved, atol=1e-3)  # px: float32


def test_faceframe_is_eye_middles_and_philtrum(actor: Actor) -> None:
    frame = actor.draw()
    right, left, philtrum = frame.faceframe
    assert right[0] < philtrum[0] < left[0]
    assert max(right[1], left[1]) < philtrum[1]
    for eye in (right, left):
        assert actor.labels[round(eye[1]), round(eye[0])] == LABELS.index("eye")


def test_head_motion_is_exactly_the_given_similarity(actor: Actor) -> None:
    rest, frame = actor.draw(), actor.draw(capture=MOVED)
    turned = np.deg2rad(MOVED.roll_deg)
    linear = MOVED.zoom * np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]])
    assert_allclose(frame.head_motion[:, :2], linear, atol=1e-12)
    expected = grid(frame) @ linear.T + frame.head_motion[:, 2]
    assert_allclose(grid(frame) + frame.displacement, expected, atol=1e-4)  # px: float32
    assert_allclose(frame.keypoints, rest.keypoints @ linear.T + frame.head_motion[:, 2], atol=1e-9)
    shifted = actor.draw(capture=Capture(shift_x_px=3.0, shift_y_px=-2.0))
    assert_allclose(shifted.displacement, np.broadcast_to([3.0, -2.0], shifted.displacement.shape), atol=1e-4)
    assert_allclose(shifted.image[:-2, 3:], rest.image[2:, :-3], atol=1e-5)


@pytest.mark.parametrize("name", ACTIONS)
def test_every_action_changes_the_picture_where_it_should(actor: Actor, name: str) -> None:
    rest = actor.draw()
    for amount in (1.0, -1.0) if name in SIGNED_ACTIONS else (1.0,):
        frame = actor.draw(Expression(**{name: amount}))
        change = np.abs(frame.image - rest.image).max(axis=2)
        assert np.percentile(change, 99.9) > 0.05
        assert np.hypot(*np.moveaxis(frame.displacement, 2, 0)).max() > 1.0
        assert change[: change.shape[0] // 12].max() < 0.02  # the top of the head stays where it is


def test_open_jaw_lowers_the_chin_and_shows_a_dark_cavity() -> None:
    actor = drawn_actor(PERSON, SIZE)
    rest, frame = actor.draw(), actor.draw(Expression(jaw_open=1.0))
    name = frame.keypoint_names.index
    drop = frame.keypoints[:, 1] - rest.keypoints[:, 1]
    assert drop[name("chin")] > 0.25 * actor.geometry.unit_px
    assert abs(drop[name("nose_tip")]) < 0.5
    assert drop[name("lip_lower_middle")] > 5 * abs(drop[name("lip_upper_middle")])
    top, bottom = (round(frame.keypoints[name(f"lip_{k}_middle"), 1]) for k in ("upper", "lower"))
    column = round(frame.keypoints[name("lip_upper_middle"), 0])
    between = frame.image[top + 1 : bottom, column].mean(axis=1)
    assert between.min() < 0.2 < rest.image[round(rest.keypoints[name("chin"), 1]) - 8, column].mean()
    assert between.max() > 0.45  # the upper teeth


def test_closed_lids_hide_the_eyes_and_only_them(actor: Actor) -> None:
    frame = actor.draw(Expression(lid_close_right=1.0))
    eye = actor.labels == LABELS.index("eye")
    right = eye & (grid(frame)[..., 0] < actor.draw().faceframe[:, 0].mean())
    core = cv2.erode(right.astype(np.uint8), np.ones((3, 3))) > 0
    assert core.sum() > 20
    assert frame.visibility[core].max() == 0
    assert frame.visibility[eye & ~right].min() == 1
    assert frame.visibility[~eye].mean() > 0.999


def test_gaze_moves_the_iris_and_not_the_skin(actor: Actor) -> None:
    rest, frame = actor.draw(), actor.draw(Expression(gaze_x=1.0))
    for side in ("right_iris", "left_iris"):
        k = frame.keypoint_names.index(side)
        shift = frame.keypoints[k] - rest.keypoints[k]
        assert shift[0] > 2.0
        assert shift[1] == 0.0
        x, y = np.round(rest.keypoints[k]).astype(int)
        assert_allclose(frame.displacement[y, x], shift, atol=1e-4)  # px: float32
    skin = ~np.isin(actor.labels, [LABELS.index("eye")])
    assert_array_equal(frame.displacement[skin], 0.0)


def test_upper_teeth_stay_on_the_skull_while_the_jaw_drops(actor: Actor) -> None:
    rest, frame = actor.draw(), actor.draw(Expression(jaw_open=0.7))
    mouth = cv2.erode((actor.labels == LABELS.index("mouth")).astype(np.uint8), np.ones((3, 3))) > 0
    teeth = mouth & (rest.image.mean(axis=2) > 0.5)
    assert teeth.sum() > 10
    assert_array_equal(frame.displacement[teeth], 0.0)
    assert frame.visibility[teeth].min() == 1
    change = np.abs(frame.image - rest.image)[teeth]
    assert np.median(change) < 0.01
    assert change.max() < 0.08  # beside the lip, whose shadow moves a little


def test_pressed_lips_hide_the_teeth() -> None:
    actor = drawn_actor(PERSON, SIZE)
    mouth = actor.labels == LABELS.index("mouth")
    assert mouth.sum() > 40
    assert actor.draw(Expression(lip_press=1.0)).visibility[mouth].mean() < 0.1


def test_points_outside_the_frame_are_not_visible(actor: Actor) -> None:
    frame = actor.draw(capture=Capture(shift_x_px=10.0))
    assert_array_equal(frame.visibility[:, -10:], 0.0)
    assert frame.visibility[:, :-11].all()


def test_light_and_noise_are_what_they_are_called() -> None:
    actor = drawn_actor(PERSON, SIZE)
    rest = actor.draw()
    assert_allclose(actor.draw(capture=Capture(gain=0.8)).image, 0.8 * rest.image, atol=1e-6)
    lit = actor.draw(capture=Capture(gain=0.7, gradient_x=0.2)).image
    assert_allclose(lit[:, 0], 0.7 * 0.9 * rest.image[:, 0], atol=1e-6)
    noisy = actor.draw(capture=Capture(noise_sd=0.02, noise_seed=3)).image
    middle = (rest.image > 0.1) & (rest.image < 0.9)  # where nothing is clipped
    assert np.std((noisy - rest.image)[middle]) == pytest.approx(0.02, rel=0.02)  # of 50000 samples


def test_creases_darken_skin_without_moving_it() -> None:
    actor = drawn_actor(PERSON, SIZE)
    frown = Expression(brow_lower=1.0)
    with_them, without = actor.draw(frown), actor.draw(frown, FLAT)
    assert_array_equal(with_them.displacement, without.displacement)
    assert (without.image - with_them.image).max() > 0.05


def test_identities_differ_and_keep_their_truth() -> None:
    one, two = (draw_actor_frame(Identity.random(np.random.default_rng(k)), size=(96, 116)) for k in (10, 11))
    assert np.abs(one.image - two.image).mean() > 0.02
    assert one.keypoint_names == two.keypoint_names
    assert not np.allclose(one.keypoints, two.keypoints, atol=0.2)


def test_amounts_out_of_range_are_refused() -> None:
    with pytest.raises(BadInput, match=r"jaw_open is 1\.5"):
        Expression(jaw_open=1.5)
    with pytest.raises(BadInput, match="gaze_x"):
        Expression(gaze_x=-1.1)
    with pytest.raises(BadInput, match="too small"):
        draw_portrait_frame(size=(20, 20))


def test_a_look_up_at_many_points_is_that_at_each():
    field = np.random.default_rng(3).random((5, 7, 2), np.float32)
    x = np.tile(np.linspace(0, 6, 41, dtype=np.float32), 2000)[:, None]
    y = np.tile(np.linspace(0, 4, 41, dtype=np.float32), 2000)[:, None]
    found = sample_linear(field, x, y)
    assert found.shape == (82_000, 1, 2)
    np.testing.assert_array_equal(found.reshape(2000, 41, 2), np.broadcast_to(found[:41, 0], (2000, 41, 2)))
