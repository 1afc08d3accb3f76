"""Laws of a blend, on two drawn actors whose models are built as a user builds them.

The actors are small and the blends of few expressions, so that flow errors bound how equal two blends can be; what must
be equal by algebra is asked for by algebra.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from morphspace.avatar import AvatarSettings, blend_steps
from morphspace.cli.main import main
from morphspace.errors import BadInput
from morphspace.io.images import write_image
from morphspace.linear.quality import psnr_db
from morphspace.model.encode import framed_for
from morphspace.model.model import load_model
from morphspace.notebook import build
from morphspace.requests import settings_in
from morphspace.steps import result_of
from morphspace.synthetic import Expression, Identity
from morphspace.synthetic.drawn import drawn_actor
from morphspace.verbs.blend_avatar import BlendAvatarRequest

pytestmark = pytest.mark.slow  # they build models

SIZE = (100, 120)
FRAMES = 9
SEEDS = {"anna": 4, "ben": 9}
SAME_DB = 40.0  # dB, of the issue: a difference of 1 % of white, below what a flow of such small faces leaves


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    return {name: tmp_path_factory.mktemp(name) for name in SEEDS}


@pytest.fixture(scope="module")
def models(tmp_path_factory, folders):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MORPHSPACE_MODELS", str(tmp_path_factory.mktemp("none")))
        yield {name: _model(name, seed, folders[name]) for name, seed in SEEDS.items()}


def _model(name, seed, folder):
    rng = np.random.default_rng(seed)
    actor = drawn_actor(Identity.random(rng), SIZE)
    names = ("jaw_open", "lip_corner_up", "brow_outer_raise", "lid_close_right", "lid_close_left")
    amounts = np.vstack([np.zeros(len(names)), rng.uniform(0, 0.7, (FRAMES - 1, len(names)))])
    for index, row in enumerate(amounts):
        shot = actor.draw(Expression(**dict(zip(names, map(float, row), strict=True))))
        write_image(folder / f"f{index:02d}.png", np.clip(shot.image, 0, 1), bits=16)
        if index == 0:
            marked = dict(zip(("right_eye", "left_eye", "philtrum"), shot.faceframe.tolist(), strict=True))
            (folder / "clip.json").write_text(json.dumps({"faceframe": {**marked, "frame": "f00.png"}}))
    return build(
        folder,
        components=6,
        size=SIZE,
        reference="f00",
        registration="none",
        flow="dis",
        warp_weight=0.05,
        identity=name,
    )


def settings_of(**changes):
    """Give the settings of a blend as the verb has them, but for some."""
    return settings_in(BlendAvatarRequest(("a", "b"), "avatar.morph", **changes), AvatarSettings)


@pytest.fixture(scope="module")
def blended(models, tmp_path_factory):
    """Give the function that blends actors by name, each way once."""
    kept = {}

    def blend(*names, **changes):
        key = (names, tuple(sorted(changes.items())))
        if key not in kept:
            settings = settings_of(
                **{"expressions": 3, "flow": "dis", "sharpen": 0.0, "components": 6, **changes}
            )
            folder = tmp_path_factory.mktemp("blend")
            kept[key] = result_of(blend_steps([models[name] for name in names], settings, folder))
        return kept[key]

    return blend


def own(models, avatar, expression):
    """Give the expression as the model of the one whose it is draws it."""
    model = models[avatar.identities[expression.source].split("_")[0]]
    place = model.training.frame_names.index(expression.frame)
    return model.render(model.training.values[place])


def lowest_db(pairs, mask):
    decibels = [psnr_db(one, other, mask) for one, other in pairs]
    assert decibels
    return min(decibels)


def test_a_model_with_itself_is_that_model(models, blended):
    avatar = blended("anna", "anna")
    pairs = [(avatar.blend(i), own(models, avatar, e)) for i, e in enumerate(avatar.expressions)]
    assert lowest_db(pairs, models["anna"].mask) >= SAME_DB


def test_the_model_of_a_blend_with_oneself_draws_those_faces(models, blended):
    avatar = blended("anna", "anna")
    drawn = dict(zip(avatar.model.training.frame_names, avatar.model.training.values, strict=True))
    pairs = [
        (avatar.model.render(drawn[expression.name]), own(models, avatar, expression))
        for expression in avatar.expressions
    ]
    # Flow and components of a small build stand between: what a build of the same frames reaches.
    assert lowest_db(pairs, models["anna"].mask) >= 30


def test_the_order_of_the_models_does_not_matter(blended):
    there, back = blended("anna", "ben"), blended("ben", "anna")
    assert {e.name for e in there.expressions} == {e.name for e in back.expressions}
    place = {e.name: i for i, e in enumerate(back.expressions)}
    for index, expression in enumerate(there.expressions):
        np.testing.assert_array_equal(there.blend(index), back.blend(place[expression.name]))


def test_order_does_not_matter_with_weights(blended):
    there = blended("anna", "ben", weights=(0.7, 0.3))
    back = blended("ben", "anna", weights=(0.3, 0.7))
    place = {e.name: i for i, e in enumerate(back.expressions)}
    for index, expression in enumerate(there.expressions):
        np.testing.assert_array_equal(there.blend(index), back.blend(place[expression.name]))


def test_weight_one_and_zero_gives_the_first(models, blended):
    avatar = blended("anna", "ben", weights=(1.0, 0.0))
    pairs = [
        (avatar.blend(i), own(models, avatar, e)) for i, e in enumerate(avatar.expressions) if e.source == 0
    ]
    assert lowest_db(pairs, models["anna"].mask) >= SAME_DB


def test_weights_count_by_their_shares_alone(blended):
    one, other = blended("anna", "ben", weights=(2.0, 6.0)), blended("anna", "ben", weights=(1.0, 3.0))
    np.testing.assert_allclose(one.weights, [0.25, 0.75])
    np.testing.assert_array_equal(one.blend(0), other.blend(0))


def test_more_weight_brings_the_blend_nearer_to_that_identity(models, blended):
    """The same expression of anna, with ben's part growing: its distance from anna's own picture grows with it."""
    distances = []
    for share in (0.8, 0.5, 0.2):
        avatar = blended("anna", "ben", weights=(share, 1 - share), faceframe="anna", surround="anna")
        index = next(i for i, e in enumerate(avatar.expressions) if e.source == 0)
        picture = own(models, avatar, avatar.expressions[index])
        distances.append(-psnr_db(avatar.blend(index), picture, models["anna"].mask))
    assert distances == sorted(distances)
    assert distances[2] - distances[0] > 3  # dB; a blend that ignores its weights has none


def test_weights_used_sum_to_one_and_the_sources_own_version_is_never_left_out(blended):
    for expression in blended("anna", "ben").expressions:
        assert expression.weights.sum() == pytest.approx(1)
        assert expression.weights[expression.source] > 0
        assert expression.plausibility[expression.source] == 1
        assert ((expression.plausibility >= 0) & (expression.plausibility <= 1)).all()


def test_pixel_average_is_the_weighted_mean_of_the_versions(blended):
    avatar = blended("anna", "ben", weights=(0.7, 0.3))
    for index, expression in enumerate(avatar.expressions[:2]):
        mean = np.tensordot(expression.weights, np.array(avatar.versions(index), np.float64), 1)
        np.testing.assert_allclose(avatar.pixel_average(index), mean, atol=1e-5)


def test_a_second_run_in_the_same_folder_gives_the_same_bytes(models, tmp_path):
    settings = settings_of(expressions=2, flow="dis", components=4)
    pair = [models["anna"], models["ben"]]
    paths = []
    for run in range(2):
        avatar = result_of(blend_steps(pair, settings, tmp_path / "work"))
        paths.append(tmp_path / f"{run}.morph")
        avatar.model.save(paths[-1])
    other = result_of(blend_steps(pair, settings, tmp_path / "elsewhere"))
    paths.append(tmp_path / "other.morph")
    other.model.save(paths[-1])
    first, second, elsewhere = (path.read_bytes() for path in paths)
    assert first == second == elsewhere


def test_with_clips_the_frames_themselves_are_blended(models, folders, tmp_path):
    """A model of few components draws a frame less well than the frame itself, taken apart and put together."""
    pair = [models["anna"].truncate(2), models["ben"].truncate(2)]
    clips = [framed_for(models[name], (str(folders[name]),), None) for name in ("anna", "ben")]
    settings = settings_of(weights=(1.0, 0.0), expressions=4, flow="dis", sharpen=0.0, components=4)
    drawn = result_of(blend_steps(pair, settings, tmp_path))
    taken = result_of(blend_steps(pair, replace(settings, clips=clips), tmp_path))
    assert [one.name for one in taken.expressions] == [one.name for one in drawn.expressions]
    assert taken.model.provenance["blend"]["frames_of"] == "clips"
    gained = []
    for index, expression in enumerate(taken.expressions):
        (frame,) = clips[0].images([clips[0].names.index(expression.frame)])
        before, after = (psnr_db(one.blend(index), frame, models["anna"].mask) for one in (drawn, taken))
        gained.append(after - before)
    assert np.median(gained) > 3  # dB; 0 if the models' faces were taken all the same


def test_a_clip_must_be_the_one_its_model_was_built_from(models, folders, tmp_path):
    pair = [models["anna"], models["ben"]]
    swapped = [framed_for(models["anna"], (str(folders[name]),), None) for name in ("ben", "anna")]
    with pytest.raises(BadInput, match=r"f00 of the clip .* is not the one the model of anna"):
        result_of(blend_steps(pair, replace(settings_of(), clips=swapped), tmp_path / "work"))
    with pytest.raises(BadInput, match="1 clips do not fit 2 models"):
        result_of(blend_steps(pair, replace(settings_of(), clips=swapped[:1]), tmp_path / "work"))
    assert not (tmp_path / "work").exists()


def test_the_command_takes_clips_in_the_order_of_the_models(models, folders, tmp_path):
    words = []
    for name in ("anna", "ben"):
        models[name].save(tmp_path / f"{name}.morph")
        words += [str(tmp_path / f"{name}.morph"), "--clips", str(folders[name])]
    words += ["-o", str(tmp_path / "avatar.morph"), "--expressions", "3", "--flow", "dis"]
    ran = CliRunner().invoke(main, ["blend-avatar", *words])
    assert ran.exit_code == 0, ran.output
    assert load_model(tmp_path / "avatar.morph").provenance["blend"]["frames_of"] == "clips"
