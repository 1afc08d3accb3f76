"""Laws of mimicry on two drawn actors whose models are built as a user builds them.

Both show a performance of their own, small and short, so that what the flow cannot see bounds how equal two builds can
be; what must be equal by algebra is asked for by algebra, here and in test_mimic.py.
"""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from morphspace import notebook
from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame
from morphspace.grid import warp
from morphspace.io.images import write_image
from morphspace.linear.pca import Basis
from morphspace.linear.quality import psnr_db
from morphspace.model.morph import Morph, MorphOffset
from morphspace.synthetic import Expression, Identity
from morphspace.synthetic.drawn import drawn_actor
from morphspace.transfer.mimicry import auto_gain, mimic

pytestmark = pytest.mark.slow  # they build models

SIZE = (100, 120)
FRAMES = 10
COMPONENTS = 6
UNGUIDED = ("paper", "map", "transfer")
SEEDS = {"anna": 4, "ben": 9}


def performance(seed):
    """Expressions (n): neutral first, then random jaw, mouth corners, brows and lids; left and right differ."""
    rng = np.random.default_rng(seed)
    yield Expression()
    for amounts in rng.uniform(0.0, 0.8, (FRAMES - 1, 5)):
        names = ("jaw_open", "lip_corner_up", "brow_outer_raise", "lid_close_right", "lid_close_left")
        yield Expression(**dict(zip(names, map(float, amounts), strict=True)))


@pytest.fixture(scope="module", autouse=True)
def without_networks(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MORPHSPACE_MODELS", str(tmp_path_factory.mktemp("none")))
        yield


@pytest.fixture(scope="module")
def drawn():
    """For each actor the frames (n, h, w, 3) and the faceframe on the first one, (3, 2) px."""
    clips = {}
    for name, seed in SEEDS.items():
        actor = drawn_actor(Identity.random(np.random.default_rng(seed)), SIZE)
        shots = [actor.draw(expression) for expression in performance(seed)]
        clips[name] = [shot.image for shot in shots], shots[0].faceframe
    return clips


@pytest.fixture(scope="module")
def built(drawn, tmp_path_factory):
    """Return the function that builds an actor's model once: as drawn, mirrored, or scaled."""
    models = {}

    def build(name, how="drawn"):
        if (name, how) not in models:
            images, points = drawn[name]
            points = points.copy()
            if how == "mirrored":
                images = [np.ascontiguousarray(image[:, ::-1]) for image in images]
                points = np.column_stack([SIZE[0] - 1 - points[:, 0], points[:, 1]])[[1, 0, 2]]
            elif how == "scaled":
                size = tuple(round(1.3 * side) for side in SIZE)
                scale = np.array(size) / SIZE
                images = [cv2.resize(image, size, interpolation=cv2.INTER_CUBIC) for image in images]
                points = scale * (points + 0.5) - 0.5
            folder = tmp_path_factory.mktemp(f"{name}-{how}")
            for index, image in enumerate(images):
                write_image(folder / f"f{index:02d}.png", np.clip(image, 0, 1), bits=16)
            marked = dict(zip(("right_eye", "left_eye", "philtrum"), points.tolist(), strict=True))
            (folder / "clip.json").write_text(json.dumps({"faceframe": {**marked, "frame": "f00.png"}}))
            size = (images[0].shape[1], images[0].shape[0])
            models[name, how] = notebook.build(
                folder,
                components=COMPONENTS,
                size=size,
                reference="f00",
                registration="none",
                warp_weight=0.05,
                identity=name,
            )
        return models[name, how]

    return build


def faces(source, target, method="map", **more):
    to_target = mimic(source, target, method, **more)
    return [to_target(source.offset(row)) for row in source.training.values]


def mirror(image):
    return image[:, ::-1]


def mirrored_offset(offset):
    return MorphOffset.of(
        np.ascontiguousarray(mirror(offset.texture)),
        np.ascontiguousarray(mirror(offset.displacement) * np.float32((-1, 1))),
        offset.reference_id,
    )


def mirrored_model(model):
    """The mirrored model, by algebra, without a build."""
    height, width = model.mask.shape

    def flipped(vector):
        return mirrored_offset(MorphOffset(vector, (height, width), "r")).vector

    weight = MorphOffset(model.basis.weight, (height, width), "r")
    mean = mirrored_offset(MorphOffset(model.mean.vector, (height, width), model.mean.reference_id))
    points = model.faceframe.points
    there = np.column_stack([width - 1 - points[:, 0], points[:, 1]])[[1, 0, 2]]
    return replace(
        model,
        mean=Morph(mean.vector, mean.shape, mean.reference_id),
        basis=Basis(
            np.stack([flipped(np.asarray(row)) for row in model.basis.components]),
            model.basis.variances,
            MorphOffset.of(mirror(weight.texture), mirror(weight.displacement), "r").vector,
            model.basis.discarded_variance,
        ),
        mask=np.ascontiguousarray(mirror(model.mask)),
        faceframe=FaceFrame.at(there),
    )


@pytest.mark.parametrize("method", UNGUIDED)
def test_a_mirrored_model_mimics_in_the_mirror(built, method):
    source, target = built("anna"), built("ben")
    there = mimic(mirrored_model(source), mirrored_model(target), method)
    here = mimic(source, target, method)
    for row in source.training.values[1:4]:
        one = here(source.offset(row))
        other = there(mirrored_offset(source.offset(row)))
        assert_allclose(other.loadings, one.loadings, atol=1e-3 * np.sqrt(target.basis.variances[0]))
        expected = one.morph.displacement * np.float32((-1, 1))
        assert np.abs(mirror(other.morph.displacement) - expected).max() < 0.02  # px
        assert np.abs(mirror(other.morph.texture) - one.morph.texture).max() < 0.002


def inside_db(target, one, other):
    """PSNR in dB inside the mask of the target, median over frames; pictures as files hold them."""
    return np.median(
        [
            psnr_db(np.clip(a.morph.render(), 0, 1), np.clip(b, 0, 1), target.mask)
            for a, b in zip(one, other, strict=True)
        ]
    )


@pytest.mark.parametrize("method", UNGUIDED)
def test_a_mirrored_actor_gives_mirrored_mimicry(built, method):
    """The limit is that of two flows of one picture; a face of the wrong side reaches 43 dB, the mean 22."""
    source, target = built("anna"), built("ben")
    made = faces(source, target, method)
    there = faces(built("anna", "mirrored"), built("ben", "mirrored"), method)
    back = [mirror(one.morph.render()) for one in there]
    assert inside_db(target, made, back) > 52


@pytest.mark.parametrize("method", UNGUIDED)
def test_a_larger_clip_of_the_source_changes_nothing_but_by_resampling(built, method):
    source, target = built("anna"), built("ben")
    larger = built("anna", "scaled")
    assert larger.size == (130, 156)
    made, same = faces(source, target, method), faces(larger, target, method)
    assert inside_db(target, made, [one.morph.render() for one in same]) > 44
    one, other = (np.array([face.loadings for face in some]) for some in (made, same))
    assert np.corrcoef(one[:, 0], other[:, 0])[0, 1] > 0.998


@pytest.mark.parametrize("method", UNGUIDED)
def test_two_equal_models_may_change_places(built, method):
    anna = built("anna")
    twin = replace(anna, provenance={**anna.provenance, "identity": "twin"})
    for one, other in zip(faces(anna, twin, method), faces(twin, anna, method), strict=True):
        assert np.array_equal(one.loadings, other.loadings)
        assert np.array_equal(one.morph.displacement, other.morph.displacement)
        assert np.array_equal(one.morph.texture, other.morph.texture)


@pytest.mark.parametrize("method", UNGUIDED)
def test_mimic_of_oneself_is_reconstruction(built, method):
    """Exact for inner products; the prior of the other methods shrinks towards the mean."""
    anna = built("anna")
    made = faces(anna, anna, method, max_sd=1e3)
    own = [anna.render(row) for row in anna.training.values]
    assert inside_db(anna, made, own) > {"paper": 90, "map": 52, "transfer": 52}[method]
    assert auto_gain(anna, anna, method) == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize("method", UNGUIDED)
def test_gain_0_is_the_mean_whatever_drives(built, method):
    source, target = built("anna"), built("ben")
    mean = target.mean.render()
    for one in faces(source, target, method, gain=0.0):
        assert not one.loadings.any()
        assert_allclose(one.morph.render(), mean, atol=1e-6)


def test_models_of_other_sizes_are_resampled(built):
    """A displacement carried to a model of another size keeps its length in eye distances."""
    small, large = built("anna"), built("anna", "scaled")
    offset = small.offset(small.training.values[2])
    made = mimic(small, large, "map", max_sd=1e3)(offset)
    moved = made.morph.displacement - large.mean.displacement
    wanted = 1.3 * cv2.resize(offset.displacement, large.size, interpolation=cv2.INTER_LINEAR)
    inside = large.mask > 0.9
    lengths = [np.sqrt((field[inside] ** 2).sum(axis=1).mean()) for field in (moved - wanted, wanted)]
    assert lengths[0] < 0.25 * lengths[1]


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (((35.0, 55.0), (49.0, 55.0), (63.0, 55.0)), "on one line"),
        (((35.0, 55.0), (63.0, 55.0), (63.0, 55.0)), "on one line"),
        (((35.0, 55.0), (63.0, 55.0), (49.0, 20.0)), "above the eyes"),
    ],
)
def test_a_degenerate_faceframe_of_either_model_is_refused(built, points, words):
    anna, ben = built("anna"), built("ben")
    bad = replace(anna, faceframe=FaceFrame(*points))
    for source, target in ((bad, ben), (ben, bad)):
        with pytest.raises(BadInput, match=words) as refusal:
            mimic(source, target, "map")
        assert "\n" not in str(refusal.value)


def test_the_affine_of_the_faceframes_is_what_links_the_models(built):
    """Keypoints of the source moved with its picture change nothing: mimicry knows faces, not frames."""
    source, target = built("anna"), built("ben")
    offset = source.offset(source.training.values[3])
    shift = np.array([[1.0, 0, 4], [0, 1, -3]])
    moved = replace(source, faceframe=FaceFrame.at(warp.apply_affine(shift, source.faceframe.points)))
    height, width = source.mask.shape
    back = warp.affine_displacement(warp.inverse_affine(shift), height, width)
    there = MorphOffset.of(
        warp.sample(offset.texture, back), warp.sample(offset.displacement, back), offset.reference_id
    )
    one = mimic(source, target, "paper", max_sd=1e3)(offset).loadings
    other = mimic(moved, target, "paper", max_sd=1e3)(there).loadings
    assert_allclose(other, one, atol=0.05 * np.abs(one).max())
