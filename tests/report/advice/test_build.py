"""Advice on a build: given only where due, and naming only the fault at hand."""

from dataclasses import replace

import numpy as np
import pytest

from morphspace.face.faceframe import FaceFrame
from morphspace.face.track import FaceTrack
from morphspace.model.carried import Carried
from morphspace.model.morph import Morph
from morphspace.report.advice.build import Case, advice_for, head_path
from morphspace.report.build_page import build_page

SIZE = (64, 80)  # of the build's frames, px


def rules(found):
    return {advice.rule for advice in found}


def track_of(case, turns, turned_face):
    """A track whose faces have these turns (yaw, pitch), degrees; None is no face."""
    faces = tuple(None if turn is None else turned_face(yaw_deg=turn[0], pitch_deg=turn[1]) for turn in turns)
    return FaceTrack(case.names, faces, np.zeros(len(faces), bool))


def test_frames_without_a_face_and_turned_ones_are_named_the_most_turned_first(clean, turned_face):
    turns = [(0, 0)] * len(clean.names)
    turns[2], turns[5], turns[4] = (24, 0), (-30, 0), None
    found = advice_for(replace(clean, build=replace(clean.build, track=track_of(clean, turns, turned_face))))
    texts = {advice.rule: advice.text for advice in found}
    assert set(texts) == {"face", "face_turned"}
    assert f"no face in one frame ({clean.names[4]})" in texts["face"]
    assert (
        f"2 frames ({clean.names[5]}, {clean.names[2]}) the head is turned by more than 20"
        in texts["face_turned"]
    )
    assert f"the most in {clean.names[5]} (yaw -30, pitch " in texts["face_turned"]
    assert "not searched" in build_page(clean.build, clean.figures)
    track = track_of(clean, turns, turned_face)
    model = replace(
        clean.build.model, provenance={**clean.build.model.provenance, "landmarks": track.document()}
    )
    page = build_page(replace(clean.build, model=model, track=track), clean.figures)
    assert "yaw -30 to 24, pitch" in page and f"2 of {len(turns)} frames are turned by more than 20" in page
    assert f"found in {len(turns) - 1} of {len(turns)} frames; the flow of the others is not held" in page


def carried_with(left_over, slope, motion):
    return Carried(
        np.array([0.1, left_over, 0.1, 0.1]),
        np.array([1, slope, 1, 1.0]),
        np.array([0.1, motion, 0.1, 0.1]),
        9,
        np.array([0.71, 0.82]),
    )


@pytest.mark.parametrize(
    "figures, is_told", [((0.8, 0.3, 0.05), True), ((0.8, 0.3, 0.01), False), ((0.5, 0.9, 0.05), False)]
)
def test_motion_that_texture_paints_is_told_by_feature(clean, figures, is_told):
    build = replace(clean.build, carried=carried_with(*figures))
    found = {advice.rule: advice.text for advice in advice_for(replace(clean, build=build))}
    assert set(found) == ({"carried"} if is_told else set())
    assert not is_told or "motion of inner lips (left over 0.80, slope 0.30): it" in found["carried"]
    page = build_page(build, clean.figures)
    assert (
        f"<td>{figures[0]:.2f}</td>" in page and "<td>0.71</td>" in page and "was not estimated" not in page
    )
    assert "was not estimated" in build_page(clean.build, clean.figures)


@pytest.mark.parametrize(
    ("slope", "motion", "is_told"), [(0.5, 0.05, True), (0.5, 0.01, False), (0.9, 0.05, False)]
)
def test_an_opening_that_texture_paints_is_told(clean, slope, motion, is_told):
    """Eyes that hardly move are not judged, whatever their slope."""
    carried = replace(
        carried_with(0.1, 1, motion),
        motion=np.array([0.1, motion, 0.1, 0.01]),
        openings=np.array([slope, 0.3]),
    )
    case = replace(clean, build=replace(clean.build, carried=carried))
    found = {advice.rule: advice.text for advice in advice_for(case)}
    assert set(found) == ({"carried"} if is_told else set())
    assert not is_told or "the motion of mouth opening (slope 0.50): it" in found["carried"]


def test_clean_build_gets_no_advice(clean):
    assert advice_for(clean) == ()
    page = build_page(clean.build, clean.figures)
    assert "Nothing to mend" in page


def test_advice_names_only_the_fault_at_hand(clean):
    n = len(clean.names)
    wave = np.sin(np.arange(n))
    still = clean.build.registrations
    moved = still.copy()
    moved[:, 0, 2] = 0.06 * SIZE[0] * wave
    turned = still.copy()
    angle = np.radians(7 * wave)
    turned[:, :, :2] = np.moveaxis([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]], 2, 0)
    centre = (np.array(SIZE) - 1) / 2
    turned[:, :, 2] = centre - turned[:, :, :2] @ centre
    nearer = still.copy()
    nearer[:, :, :2] *= (1 + 0.07 * wave)[:, None, None]
    nearer[:, :, 2] = centre - nearer[:, :, :2] @ centre
    lost = still.copy()
    lost[5, :, :2] *= 0.5
    opened = np.where(np.arange(n) % 2, 0.1, 0.0)
    opened[clean.build.choice.index] = 0
    one_bad = np.arange(n) == 9
    build, figures, model = clean.build, clean.figures, clean.build.model
    cases = {
        "build": Case(replace(build, warnings=("2 frames are identical to the reference",)), figures),
        "registration": Case(replace(build, registrations=lost), figures),
        "exposure": Case(build, replace(figures, exposure_stops=0.2 * wave)),
        "head_turned": Case(build, replace(figures, rigid_motion_px=np.where(one_bad, 5.0, 0.2))),
        "mouth_closed": Case(build, replace(figures, mouth_contrast=opened)),
        "folds": Case(build, replace(figures, fold_fractions=np.where(one_bad, 0.02, 0.0))),
        "confidence": Case(replace(build, confidences=np.where(one_bad, 0.4, 0.8)), figures),
        "psnr": Case(build, replace(figures, psnr_db=np.where(one_bad, 25.0, 42.0))),
        "mask": Case(replace(build, model=replace(model, mask=np.ones_like(model.mask))), figures),
        "rank": Case(
            replace(build, model=replace(model, provenance={"identity": "", "components_asked": 50})), figures
        ),
        "few_frames": Case(replace(build, model=_of_few_frames(build)), figures),
        "source_size": Case(build, figures, (2 * SIZE[0], 2 * SIZE[1])),
    }
    for rule, case in cases.items():
        assert rules(advice_for(case)) == {rule}, rule
    for registrations in (moved, turned, nearer):
        assert rules(advice_for(Case(replace(build, registrations=registrations), figures))) == {"head_moved"}


def test_small_deviations_stay_unmentioned(clean):
    n = len(clean.names)
    wave = np.sin(np.arange(n))
    moved = clean.build.registrations.copy()
    moved[:, 0, 2] = 0.03 * SIZE[0] * wave
    figures = replace(
        clean.figures,
        exposure_stops=0.1 * wave,
        fold_fractions=np.full(n, 0.005),
        psnr_db=38 + wave,
        mouth_contrast=0.1 + 0.1 * np.cos(np.arange(n) - clean.build.choice.index - 1.5),
    )
    build = replace(clean.build, registrations=moved, confidences=np.full(n, 0.55))
    assert advice_for(Case(build, figures, SIZE)) == ()


def test_advice_tells_drift_from_flicker(clean):
    n = len(clean.names)
    drift = replace(clean.figures, exposure_stops=np.linspace(0, 1, n))
    flicker = replace(clean.figures, exposure_stops=np.where(np.arange(n) % 2, 0.5, 0.0))
    assert "drifts" in advice_for(Case(clean.build, drift))[0].text
    assert "up and down" in advice_for(Case(clean.build, flicker))[0].text


def test_advice_proposes_slightly_open_frames(clean):
    dark = np.full(len(clean.names), 0.1)
    dark[:12] = 0.0
    reference, fitting = clean.build.choice.index, 3
    dark[reference] = 0.0
    if reference == fitting:
        fitting = 4
    dark[fitting] = 0.03
    (advice,) = advice_for(Case(clean.build, replace(clean.figures, mouth_contrast=dark)))
    assert f"Frames to try: {clean.names[fitting]}." in advice.text


def test_many_poor_frames_blame_the_model(clean):
    (advice,) = advice_for(Case(clean.build, replace(clean.figures, psnr_db=np.full(len(clean.names), 25.0))))
    assert "more components" in advice.text


def test_mask_without_texture_is_told(clean):
    model = clean.build.model
    flat = Morph.of(np.full_like(model.mean.texture, 0.5), model.mean.displacement, model.mean.reference_id)
    tiny = np.zeros_like(model.mask)
    tiny[:4, :4] = 1
    for changed, word in ((replace(model, mean=flat), "texture"), (replace(model, mask=tiny), "closer")):
        (advice,) = advice_for(Case(replace(clean.build, model=changed), clean.figures))
        assert advice.rule == "mask"
        assert word in advice.text


@pytest.mark.parametrize(("share", "found"), [(0.19, set()), (0.17, {"face_small"})])
def test_a_face_is_small_where_its_eyes_are_nearer_than_their_least_share(clean, share, found, turned_face):
    """EYES_LEAST_SHARE, of the frame's width."""
    frame = FaceFrame.at(np.array([[20.0, 30], [20 + share * SIZE[0], 30], [25, 50]]))
    model = clean.build.model
    model = replace(model, faceframe=frame, provenance={**model.provenance, "framing": {}})
    build = replace(clean.build, model=model, track=track_of(clean, [(0, 0)] * len(clean.names), turned_face))
    assert rules(advice_for(Case(build, clean.figures))) == found


def _of_few_frames(build):
    training = build.model.training
    return replace(
        build.model,
        training=replace(training, values=training.values[:9], frame_names=training.frame_names[:9]),
    )


def test_head_path_undoes_a_known_movement():
    angle, scale, shift = np.radians(5), 1.1, np.array([3.0, -2.0])
    centre = (np.array(SIZE) - 1) / 2
    linear = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    affine = np.column_stack([linear, centre + shift - linear @ centre])
    path = head_path(affine[None], SIZE)
    np.testing.assert_allclose(path.shift_px[0], shift, atol=1e-12)
    assert path.turn_deg[0] == pytest.approx(5)
    assert path.scale[0] == pytest.approx(1.1)
