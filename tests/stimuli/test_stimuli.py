"""Laws of drawings, caricatures, regions and plausibility; truth is algebra on a model whose morphs are known."""

import json
import threading
from dataclasses import replace

import numpy as np
import pytest

from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame
from morphspace.model import model as model_module
from morphspace.model import revealed as revealed_module
from morphspace.sets.stimulus_set import notes_on
from morphspace.stimuli.caricature import caricatured, components_named
from morphspace.stimuli.drawing import Drawing, Placing, check_name, drawing_of
from morphspace.stimuli.drawn import _mask_of, _morph_at, draw, morphs_and_images
from morphspace.stimuli.plausibility import plausibility, plausible_limits_sd
from morphspace.stimuli.sampling import drawn_sd
from morphspace.verbs import sample

LOADINGS = np.array([[1.0, -0.5, 0.3], [0.2, 0.1, -2.0]])


@pytest.fixture
def marked(model):
    return replace(model, faceframe=FaceFrame((20.0, 28.0), (40.0, 29.0), (30.0, 44.0)))


def only(model, drawing):
    (image,) = draw(model, drawing)
    return image


def same_drawing(one, other):
    tables = ("loadings_sd", "colour_sd", "outside_sd")
    assert one.document() == other.document()
    for name in tables:
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None and b is None) or (a.tobytes() == b.tobytes())


def test_a_plain_drawing_is_the_models_own_rendering(model):
    drawing = Drawing("film", LOADINGS, frame_rate_hz=25.0, suffix=".mkv")
    frames = list(draw(model, drawing))
    for row, frame in zip(LOADINGS, frames, strict=True):
        np.testing.assert_array_equal(frame, model.render(row * model.sd))


def test_a_drawing_goes_through_json_bit_equal():
    rng = np.random.default_rng(0)
    table = rng.standard_normal((3, 5)) * 10.0 ** rng.integers(-9, 2, (3, 5))
    placing = Placing(("a", "b", "c"), ("0" * 64,) * 3, rng.standard_normal((3, 2, 3)), ("clip",))
    told = {"gain": 0.1 + 0.2, "frame": "a", "seed": 3, "flag": True, "none": None}
    drawing = Drawing("x/y", table, table * 3, "eyes", table / 7, 30000 / 1001, ".mp4", placing, told)
    back = drawing_of(json.loads(json.dumps(drawing.document())))
    same_drawing(drawing, back)
    assert back.placing is not None
    assert back.placing.registrations.tobytes() == placing.registrations.tobytes()


def test_shape_and_colour_may_have_loadings_of_their_own(model, monkeypatch):
    monkeypatch.setattr(revealed_module, "HIDDEN_AREA", 2.0)  # px^2; the drawn mouth hides nothing
    model = replace(model)  # which has not yet learned what is revealed
    drawing = Drawing("a", LOADINGS[:1], LOADINGS[1:])
    morph = _morph_at(model, drawing, 0, None)
    shape, colour = model.expand(LOADINGS[0] * model.sd), model.expand(LOADINGS[1] * model.sd)
    np.testing.assert_allclose(morph.displacement, shape.displacement, atol=1e-5)  # px: float32 rounding
    revealed = model.revealed.change(shape.displacement, colour.displacement)
    assert revealed.any()  # else nothing was tested
    np.testing.assert_allclose(morph.texture, colour.texture + revealed, atol=1e-6)
    same = _morph_at(model, Drawing("a", LOADINGS[:1], LOADINGS[:1]), 0, None)
    np.testing.assert_allclose(same.displacement, shape.displacement, atol=1e-5)


def test_what_is_revealed_is_learned_once_before_the_workers_start(model, monkeypatch):
    """From Python 3.12 on each thread would learn it."""
    learned, original = [], model_module.learn_revealed

    def learn(*given):
        learned.append(threading.current_thread() is threading.main_thread())
        return original(*given)

    monkeypatch.setattr(model_module, "learn_revealed", learn)
    rows = np.repeat(LOADINGS, 4, axis=0)
    drawing = Drawing("a", rows, 0 * rows, frame_rate_hz=25.0, suffix=".mkv")
    assert len(list(morphs_and_images(replace(model), drawing, None, 4))) == 8
    assert learned == [True]


def test_a_region_is_inside_inside_and_outside_outside(marked):
    drawing = Drawing("a", LOADINGS[:1], region="upper", outside_sd=LOADINGS[1:])
    mask = _mask_of(marked, drawing)
    morph = _morph_at(marked, drawing, 0, mask)
    inside, outside = marked.expand(LOADINGS[0] * marked.sd), marked.expand(LOADINGS[1] * marked.sd)
    for name in ("displacement", "texture"):
        found, one, other = (getattr(face, name) for face in (morph, inside, outside))
        np.testing.assert_allclose(found[mask > 0.9999], one[mask > 0.9999], atol=2e-3)
        np.testing.assert_allclose(found[mask < 0.0001], other[mask < 0.0001], atol=2e-3)
        assert np.abs(one - other).max() > 0.05  # else nothing was tested


def test_the_whole_face_as_a_region_is_no_region(model):
    plain = only(model, Drawing("a", LOADINGS[:1]))
    whole = only(model, Drawing("a", LOADINGS[:1], region="whole", outside_sd=LOADINGS[1:]))
    np.testing.assert_allclose(whole, plain, atol=1e-5)


def test_a_painted_region_of_another_size_is_refused(model):
    drawing = Drawing(
        "a", LOADINGS[:1], region="mask.png", outside_sd=LOADINGS[1:], region_mask=np.ones((5, 6))
    )
    with pytest.raises(BadInput, match=r"mask\.png is 6x5; expected 60x72"):
        only(model, drawing)


def test_gain_one_is_the_identity_and_gain_zero_the_mean():
    np.testing.assert_array_equal(caricatured(LOADINGS, 1.0), LOADINGS)
    np.testing.assert_array_equal(caricatured(LOADINGS, 0.0), np.zeros((2, 3)))
    np.testing.assert_array_equal(caricatured(caricatured(LOADINGS, 2.0), 0.5), LOADINGS)
    np.testing.assert_array_equal(caricatured(LOADINGS, -1.0), -LOADINGS)


def test_components_that_are_not_named_stay():
    out = caricatured(LOADINGS, 3.0, (1,))
    np.testing.assert_array_equal(out[:, 1], 3 * LOADINGS[:, 1])
    np.testing.assert_array_equal(out[:, [0, 2]], LOADINGS[:, [0, 2]])


def test_components_are_read_as_numbers_and_spans():
    assert components_named("1-3,8, 2", 10) == (0, 1, 2, 7)
    for words in ("0", "3-1", "11", "a", "", "1-", "1--2", "1;2"):
        with pytest.raises(BadInput, match="components"):
            components_named(words, 10)


def test_a_face_beyond_every_training_face_is_marked(model):
    limits = plausible_limits_sd(model)
    training = model.training.values / model.sd
    assert plausibility(limits, [training]).beyond == ()
    far = training[:1].copy()
    far[0, 1] = limits[1] * 1.02
    judged = plausibility(limits, [far])
    assert judged.beyond == (2,) and judged.largest_component == 2
    assert judged.largest_sd == pytest.approx(limits[1] * 1.02)
    # n faces on k components of unit variance (n - 1): the mean square distance is k (n - 1) / n
    squares = [plausibility(limits, [row[None]]).rms_sd ** 2 for row in training]
    assert np.mean(squares) == pytest.approx(len(training[1:]) / len(training), rel=1e-6)


def test_redrawn_faces_are_those_that_rejection_would_leave():
    values, again = drawn_sd(np.random.default_rng(1), 4000, 5, spread=1.0, max_sd=1.5)
    assert np.abs(values).max() <= 1.5 and again > 0
    # The variance of a standard normal cut off at 1.5: 1 - 2 a phi(a) / (2 Phi(a) - 1); error of 20,000 draws 0.004.
    assert values.var() == pytest.approx(0.5517, abs=0.015)
    whole, none = drawn_sd(np.random.default_rng(1), 40, 5, spread=2.0, max_sd=None)
    np.testing.assert_array_equal(whole, 2 * np.random.default_rng(1).standard_normal((40, 5)))
    assert none == 0
    with pytest.raises(BadInput, match="max-sd"):
        drawn_sd(np.random.default_rng(1), 4, 5, spread=1.0, max_sd=0.001)


@pytest.mark.parametrize(
    "name",
    ["", "a/", "/a", "a//b", "..", "a/../b", ".hidden", "a.", "a b ", "a\\b", "a:b", "a\nb", "CON", "nul.x"],
)
def test_names_that_cannot_be_files_everywhere_are_refused(name):
    with pytest.raises(BadInput, match="rename it"):
        check_name(name)


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        ({"loadings_sd": np.array([[np.nan, 1.0]])}, "pc001 comes to nan"),
        ({"loadings_sd": np.array([[0.0, 1e5]])}, r"pc002 comes to 1e\+05 SD, at most 1000"),
        ({"loadings_sd": np.zeros((2, 2))}, "2 frames and no frame rate"),
        ({"loadings_sd": np.zeros((0, 2))}, "one row a frame"),
        ({"colour_sd": np.zeros((1, 3))}, r"colour_sd has the shape \(1, 3\)"),
        ({"region": "eyes"}, "expected both or neither"),
        ({"suffix": ".gif"}, "'.gif'"),
        ({"frame_rate_hz": 25.0}, "'.png'"),
        ({"frame_rate_hz": 0.0, "suffix": ".mp4"}, "is 0 Hz; expected 0.01 to 10000"),
        ({"variables": {"gain": float("inf")}}, "gain is inf"),
        ({"variables": {"gain": [1]}}, "gain is"),
    ],
)
def test_drawings_that_do_not_fit_together_are_refused(entries, said):
    with pytest.raises(BadInput, match=said):
        Drawing(**{"name": "a", "loadings_sd": np.zeros((1, 2)), **entries})


def test_more_loadings_than_components_are_refused(model):
    with pytest.raises(BadInput, match="4 loadings; expected at most 3"):
        only(model, Drawing("a", np.zeros((1, 4))))


@pytest.mark.parametrize(
    ("verb", "clipped", "folded"),
    [
        ("caricature", "lower the gain", "look at them, or lower the gain"),
        ("sweep", "use fewer SD", "look at them, or use fewer SD"),
        ("continuum", "look at them", "look at them"),
    ],
)
def test_what_is_advised_is_something_the_verb_has(verb, clipped, folded):
    row = {"name": "a", "verb": verb, "beyond": "", "outlier_in": "", "largest_sd": 1.0}
    notes = notes_on([{**row, "clipped_percent": 3.0, "folded_percent": 2.0}])
    assert [note.rpartition(": ")[2] for note in notes] == [clipped, folded]


def test_a_bound_that_is_no_number_is_refused(model, tmp_path):
    with pytest.raises(BadInput, match="max_sd is nan; expected a number from"):
        sample.SampleRequest(tmp_path / "a.morph", tmp_path, max_sd=float("nan"))
