"""How much the warp carries: points that do not hold the flow judge it; truth is the motion given to the points."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.face.anchor import HELD, FaceAnchor
from morphspace.face.detector import Detector
from morphspace.face.mesh import (
    FACE_OUTLINE,
    FEATURES,
    GROUPS,
    INNER_LIPS,
    LEFT_BROW,
    LEFT_LIDS,
    OUTER_LIPS,
    POINT_COUNT,
    RIGHT_BROW,
    RIGHT_LIDS,
    FacePoints,
)
from morphspace.flow import Flow, methods
from morphspace.model.carried import FRAMES, THIRDS, carried_steps, figures, left_out, quality_lines
from morphspace.model.work_frames import FramePlan, frame_steps
from morphspace.steps import result_of, using_workers

SIZE = (72, 60)
COUNT = FRAMES + 4


def ring(places, middle, radii):
    turn = np.linspace(0, 2 * np.pi, len(places), endpoint=False)
    return np.array(middle) + np.array(radii) * np.column_stack([np.cos(turn), np.sin(turn)])


def drawn_points():
    """478 points, px, of a face whose outline, eyes, brows and lips lie on ellipses."""
    places = np.random.default_rng(4).uniform((25, 30), (35, 40), (POINT_COUNT, 2))
    for group, middle, radii in (
        (FACE_OUTLINE, (30, 36), (24, 32)),
        (RIGHT_LIDS, (20, 28), (5, 2.5)),
        (LEFT_LIDS, (40, 28), (5, 2.5)),
        (RIGHT_BROW, (20, 20), (6, 1.5)),
        (LEFT_BROW, (40, 20), (6, 1.5)),
        (OUTER_LIPS, (30, 54), (9, 5)),
        (INNER_LIPS, (30, 54), (7, 3)),
    ):
        places[list(group)] = ring(group, middle, radii)
    return places


def points(number):
    """The face in one frame; its points move smoothly over face and time."""
    places = drawn_points()
    return places + 1.5 * np.sin(number) * np.sin(places[:, ::-1] / 14 + number / 3)


@pytest.fixture
def make(picture, wavy_field, make_clip, tmp_path, monkeypatch):
    """A function that writes the frames of these faces, and returns their plan and files."""

    def still(reference):
        return lambda frame, start: Flow(np.zeros((*SIZE, 2), np.float32), np.ones(SIZE, np.float32))

    monkeypatch.setitem(methods.METHODS, "still", still)
    monkeypatch.setattr(methods, "for_morphs", methods.named)
    pictures = [np.clip(picture(*SIZE, seed=12) + 0.001 * number, 0, 1) for number in range(COUNT)]
    source = make_clip(pictures, [np.zeros((*SIZE, 2), np.float32)] * COUNT, pictures[0])

    def written(faces):
        found = [None if one is None else FacePoints(one, 1.0) for one in faces]
        plan = FramePlan(
            reference=pictures[0],
            reference_index=0,
            region=np.ones(SIZE, np.float32),
            mask=np.ones(SIZE, np.float32),
            registration="none",
            flow="still",
            start="none",
            anchor=FaceAnchor(Detector(lambda image: None, {"version": 1}), found[0]),
        )
        return plan, result_of(frame_steps(source, plan, tmp_path, found))

    return written


def test_a_field_that_follows_leaves_nothing_over(make):
    found = result_of(carried_steps(*make([points(number) for number in range(COUNT)])))
    assert found.frames == FRAMES
    assert (found.left_over < 0.25).all() and (abs(found.slopes - 1) < 0.1).all()
    assert (found.motion > 0.01).all()


def test_points_that_judge_do_not_hold(make):
    """Points with a motion of their own are followed by a field that they hold, and missed by one that they do not."""
    rng = np.random.default_rng(1)
    still = points(0)
    faces = [still.copy() for _ in range(COUNT)]
    for number in range(1, COUNT):
        for third in range(THIRDS):
            faces[number][list(left_out(third))] += rng.normal(0, 0.6, 2)
    found = result_of(carried_steps(*make(faces)))
    assert (found.left_over > 0.8).all()


def test_thirds_leave_out_every_point_of_the_features_once():
    every = [place for third in range(THIRDS) for place in left_out(third)]
    assert sorted(every) == sorted(place for name in FEATURES for place in GROUPS[name])
    assert {*every} <= {*HELD}


@pytest.mark.parametrize("third", range(THIRDS))
def test_a_point_that_judges_has_neighbours_that_hold(third):
    """On its rim both, and the one on the other rim of the lip."""
    out = left_out(third)
    for ring in (INNER_LIPS, RIGHT_LIDS, LEFT_LIDS):  # each rim of an opening is judged
        half = len(ring) // 2
        assert {*ring[1:half]} & {*out} and {*ring[half + 1 :]} & {*out}
    for ring in (OUTER_LIPS, INNER_LIPS, RIGHT_BROW, LEFT_BROW, RIGHT_LIDS, LEFT_LIDS):
        assert not any(
            one in out and other in out for one, other in zip(ring, ring[1:] + ring[:1], strict=True)
        )
    assert not any(one in out and other in out for one, other in zip(OUTER_LIPS, INNER_LIPS, strict=True))


@pytest.mark.parametrize("faces", [FRAMES, FRAMES + 1])
def test_too_few_faces_give_no_figures(make, faces):
    """The reference is one of the faces, and judges nothing."""
    shown = [points(number) if number < faces else None for number in range(COUNT)]
    assert (result_of(carried_steps(*make(shown))) is None) == (faces == FRAMES)


def test_without_hold_there_are_no_figures(make):
    plan, files = make([points(number) for number in range(COUNT)])
    assert result_of(carried_steps(replace(plan, anchor=None), files)) is None


def test_figures_are_kept_and_do_not_depend_on_workers(make, monkeypatch):
    plan, files = make([points(number) for number in range(COUNT)])
    with using_workers(2):
        first = result_of(carried_steps(plan, files))
    monkeypatch.setattr(FaceAnchor, "held", lambda *given: lambda frame: pytest.fail("estimated again"))
    again = result_of(carried_steps(plan, files))
    assert_array_equal(again.left_over, first.left_over)
    assert_array_equal(again.slopes, first.slopes)


def test_left_over_and_slope_are_shares_of_the_motion():
    rng = np.random.default_rng(3)
    true = 100 + rng.normal(size=(9, POINT_COUNT, 2))
    aside = rng.normal(size=true.shape)
    assert_allclose(figures(true, 7 + 0.3 * true, 50.0).slopes, 0.3)
    assert_allclose(figures(true, 7 + 0.3 * true, 50.0).left_over, 0.7)
    assert_allclose(figures(true, true + 0.4 * aside, 50.0).left_over, 0.4, atol=0.05)
    assert_allclose(figures(true, np.full_like(true, 5.0), 50.0).left_over, 1)
    assert_allclose(figures(true, true, 50.0).motion, np.sqrt(2 * 8 / 9) / 50, rtol=0.1)


def test_openings_have_slopes_of_their_own():
    """Lips that open half as far as in the frames; a motion that both rims share counts in no opening."""
    true = np.full((9, POINT_COUNT, 2), 50.0)
    made = true.copy()
    far = np.linspace(0, 8, 9)[:, None]
    shared = np.sin(np.arange(9))[:, None]
    lower, lids = list(INNER_LIPS[11:]), list(RIGHT_LIDS[9:])
    true[:, lower, 1] += far
    made[:, lower, 1] += far / 2
    true[:, lids, 1] += far
    made[:, lids, 1] += far / 4
    made[:, list(INNER_LIPS), 0] += shared
    assert_allclose(figures(true, made, 50.0).openings, [0.5, 0.25])


def test_features_that_stand_still_leave_nothing_over():
    still = np.full((9, POINT_COUNT, 2), 50.0)
    found = figures(still, still, 50.0)
    assert (found.left_over == 0).all() and (found.slopes == 1).all() and (found.openings == 1).all()
    assert (found.motion == 0).all()


def test_a_blink_is_among_the_frames_beside_wider_mouths(make, monkeypatch):
    """Every other mouth is further from the reference, in px, than the closed eyes are."""
    faces = [drawn_points() for _ in range(COUNT)]
    for number, face in enumerate(faces):
        face[list(OUTER_LIPS[11:] + INNER_LIPS[11:]), 1] += 0.6 * number
    faces[6] = faces[0].copy()
    upper = list(RIGHT_LIDS[9:] + LEFT_LIDS[9:])
    faces[6][upper, 1] += 0.3
    judged = []
    monkeypatch.setattr("morphspace.model.carried.figures", lambda true, made, eyes_px: judged.append(true))
    result_of(carried_steps(*make(faces)))
    assert np.nanmax(judged[0][:, upper] - faces[0][upper]) == pytest.approx(0.3)


def test_a_model_is_described_by_what_its_build_recorded():
    entry = {"frames": 9, **{kind: dict.fromkeys(FEATURES, 0.5) for kind in ("left_over", "slope", "motion")}}
    entry["opening_slope"] = {"mouth opening": 0.75, "eye opening": 0.5}
    lines = quality_lines(
        {"warp_weight_trials": [[0.1, 30.0], [0.2, 31.04]], "landmarks": {"carried": entry}}
    )
    assert "31.0 dB" in lines[0] and "outer lips 0.50" in lines[1] and "9 frames" in lines[2]
    assert "mouth opening 0.75" in lines[2]
    assert quality_lines({"warp_weight_trials": [], "landmarks": None}) == ()
