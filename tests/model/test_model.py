"""Laws of the model: rendering, sampling, truncating, placing, and the `.morph` file."""

import dataclasses
import json
import resource
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput, ModelFileError, MorphspaceError, ReferenceMismatch, UnwritableFile
from morphspace.face.faceframe import FaceFrame, Frame, identity_affine
from morphspace.flow import methods
from morphspace.grid import warp
from morphspace.linear.quality import psnr_db
from morphspace.model.file import ARRAY_KINDS, content_digest
from morphspace.model.loadings import Loadings
from morphspace.model.model import load_model
from morphspace.model.morph import Morph, MorphOffset, inner_product
from morphspace.storage import read_container, write_container

# expanding and rendering


def test_expanding_adds_components_to_the_mean(model):
    values = np.array([0.7, -0.4, 0.2])
    one = model.expand(values)
    expected = model.mean.vector + values @ model.basis.components
    assert_allclose(one.vector, expected, atol=1e-6)
    assert one.reference_id == model.mean.reference_id


def test_missing_loadings_are_zero(model):
    full = model.render(np.array([0.7, 0, 0]))
    assert_allclose(model.render(np.array([0.7])), full, atol=1e-6)
    assert_allclose(model.render(np.array([])), model.mean.render(), atol=1e-6)


@pytest.mark.parametrize("values", [np.zeros(4), np.array([np.nan]), np.array([0, np.inf, 0])])
def test_loadings_that_do_not_fit_are_refused(model, values):
    with pytest.raises(BadInput, match="expected at most 3, the model's components"):
        model.render(values)


def test_project_inverts_expand(model):
    values = np.array([0.7, -0.4, 0.2])
    assert_allclose(model.project(model.expand(values)), values, atol=1e-4)


def test_a_morph_of_another_reference_is_not_projected(model):
    other = Morph.of(model.mean.texture, model.mean.displacement, "elsewhere")
    with pytest.raises(ReferenceMismatch, match="elsewhere"):
        model.project(other)


def test_inner_product_weighs_texture_by_the_mask_and_warp_by_the_mask_and_s_squared(model):
    height, width = model.mask.shape
    rng = np.random.default_rng(0)
    a, b = (
        MorphOffset.of(
            rng.standard_normal((height, width, 3)).astype(np.float32),
            rng.standard_normal((height, width, 2)).astype(np.float32),
            "here",
        )
        for _ in range(2)
    )
    by_definition = (model.mask[..., None] * a.texture * b.texture).sum(dtype=np.float64)
    by_definition += 0.3**2 * (model.mask[..., None] * a.displacement * b.displacement).sum(dtype=np.float64)
    weight = inner_product(model.mask, 0.3).astype(np.float64)
    ours = (weight * a.vector * b.vector).sum()
    assert ours == pytest.approx(by_definition, abs=1e-3)


# encoding


def test_a_rendered_face_is_encoded_as_itself(model):
    truth = np.array([1.0, -0.7, 0.4]) * model.sd
    encoded = model.encode(model.render(truth), name="some.png")
    assert encoded.frame_names == ("some.png",)
    assert encoded.model_id == model.model_id
    assert encoded.values.shape == (1, 3)
    assert psnr_db(model.render(encoded.values[0]), model.render(truth), model.mask) > 38
    assert_allclose(
        encoded.in_sd(model).values[0], truth / model.sd, atol=0.25
    )  # SD; opening and smile share pixels


def test_a_model_of_a_removed_flow_method_renders_but_does_not_encode(model):
    old = replace(model, flow="dis-medium")
    image = old.render(np.zeros(3))
    assert_array_equal(image, model.render(np.zeros(3)))
    with pytest.raises(BadInput, match=r"flow is 'dis-medium'.*must be built again"):
        old.encode(image)


def test_a_model_of_rank_zero_encodes_every_face_as_no_loadings(model):
    encoded = model.truncate(0).encode(model.reference)
    assert encoded.values.shape == (1, 0)


def test_an_image_of_another_size_is_refused(model, picture):
    small = picture(70, 50)
    for use in (
        model.encode,
        model.align,
        lambda image: model.morph_of(Frame(image, "a", identity_affine())),
    ):
        with pytest.raises(BadInput, match=r"50x70 px; expected 60x72"):
            use(small)


def test_aligning_without_registration_leaves_the_image(model):
    frame = model.align(model.reference, "some")
    assert_array_equal(frame.image, model.reference)
    assert_array_equal(frame.registration, identity_affine())


def test_the_reference_is_prepared_once_a_model(model, monkeypatch):
    model = replace(model)  # of its own: the shared one may have been used
    prepared = []
    plain = methods.METHODS[model.flow]

    def counting(reference):
        prepared.append(reference)
        return plain(reference)

    monkeypatch.setitem(methods.METHODS, model.flow, counting)
    assert prepared == []  # not by opening a model
    for amount in (0.2, 0.4):
        model.encode(model.render([amount]))
    assert len(prepared) == 1
    assert prepared[0] is model.reference


def test_encoding_an_aligned_frame_is_encoding_its_image(model):
    image = model.render(np.array([0.5, 0.5, 0.1]))
    aligned = model.encode_aligned(Frame(image, "some", identity_affine()))
    assert_array_equal(aligned.values, model.encode(image, name="some").values)


# loadings


def test_loadings_in_sd_have_unit_standard_deviation(model):
    assert_allclose(model.training.in_sd(model).values.std(axis=0, ddof=1), 1, rtol=1e-6)


def test_loadings_know_their_unit(model):
    raw = Loadings(model.training.values[2:3], ("one",), model.model_id)
    in_sd = raw.in_sd(model)
    assert (raw.unit, in_sd.unit) == ("raw", "sd")
    assert in_sd.in_sd(model) is in_sd and raw.in_raw(model) is raw
    assert_allclose(in_sd.in_raw(model).values, raw.values, rtol=1e-12)
    assert_allclose(model.render(in_sd), model.render(raw.values[0]), atol=1e-6)
    with pytest.raises(BadInput, match="training loadings of a model are in SD"):
        dataclasses.replace(model, training=model.training.in_sd(model))
    with pytest.raises(BadInput, match="12 faces were given; expected one face"):
        model.render(model.training)


def test_arrays_of_a_model_cannot_be_written_to(model):
    for array in (model.training.values, model.mask, model.basis.components, model.mean.texture):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_loadings_of_another_model_are_refused(model):
    other = Loadings(np.zeros((1, 3)), ("one",), "0123456789abcdef")
    with pytest.raises(ReferenceMismatch, match=f"0123456789abcdef.*{model.model_id}"):
        other.in_sd(model)
    with pytest.raises(ReferenceMismatch, match="0123456789abcdef"):
        model.render(other)


@pytest.mark.parametrize(("shape", "names"), [((2, 3), ("one",)), ((3,), ("a", "b", "c"))])
def test_loadings_need_a_name_for_each_row(shape, names):
    with pytest.raises(BadInput, match=r"expected . rows, one for each frame name"):
        Loadings(np.zeros(shape), names, "id")


def test_samples_have_the_statistics_of_the_training_faces(model):
    n = 20_000
    drawn = model.sample(np.random.default_rng(1), n)
    assert drawn.values.shape == (n, 3)
    assert len(set(drawn.frame_names)) == n
    in_sd = drawn.in_sd(model).values
    error = 5 / np.sqrt(n)  # five standard errors
    assert_allclose(in_sd.mean(axis=0), 0, atol=error)
    assert_allclose(in_sd.std(axis=0), 1, atol=error)
    assert_allclose(np.corrcoef(in_sd.T), np.eye(3), atol=error)
    assert np.mean(np.abs(in_sd) < 1) == pytest.approx(0.6827, abs=error)


def test_the_same_seed_draws_the_same_faces(model):
    one, same, other = (model.sample(np.random.default_rng(seed), 4).values for seed in (7, 7, 8))
    assert_array_equal(one, same)
    assert (one != other).any()


# truncating


def test_a_truncated_model_keeps_the_first_components_and_all_else(model):
    small = model.truncate(2)
    assert (small.rank, model.rank) == (2, 3)
    assert_array_equal(small.basis.components, model.basis.components[:2])
    assert_array_equal(small.sd, model.sd[:2])
    assert_array_equal(small.training.values, model.training.values[:, :2])
    assert small.mean is model.mean
    assert small.identity == model.identity
    assert_allclose(small.render([0.5, -0.3]), model.render([0.5, -0.3, 0]), atol=1e-6)


def test_a_truncated_model_has_its_own_name(model):
    names = {model.model_id, *(model.truncate(k).model_id for k in (0, 1, 2))}
    assert len(names) == 4
    assert model.truncate(2).model_id == model.truncate(2).model_id
    with pytest.raises(ReferenceMismatch):
        model.training.in_sd(model.truncate(2))


def test_more_components_than_there_are_cannot_be_kept(model):
    for components in (-1, 4):
        with pytest.raises(BadInput, match=f"components are {components}"):
            model.truncate(components)


# placing


def test_placing_leaves_what_is_outside_the_mask_bit_equal(model, picture):
    original = picture(*model.mask.shape, seed=44)
    rendered = model.render(np.array([1.0, 0.5, 0.0]))
    placed = model.placed(rendered, original, identity_affine())
    outside, full = model.mask == 0, model.mask == 1
    assert outside.any()
    assert_array_equal(placed[outside], original[outside])
    assert_allclose(placed[full], rendered[full], atol=1e-6)
    soft = ~outside & ~full
    expected = original + model.mask[..., None] * (rendered - original)
    assert_allclose(placed[soft], expected[soft], atol=1e-6)


def test_placing_puts_the_face_where_the_registration_says(model, picture):
    original = picture(150, 130, seed=45)
    before = original.copy()
    rendered = model.render(np.zeros(3))
    registration = np.array([[1.0, 0.0, 40.0], [0.0, 1.0, 55.0]])
    placed = model.placed(rendered, original, registration)
    assert_array_equal(original, before)
    height, width = model.mask.shape
    there = placed[55 : 55 + height, 40 : 40 + width]
    full = model.mask == 1
    assert_allclose(there[full], rendered[full], atol=1e-5)
    elsewhere = np.ones(original.shape[:2], bool)
    elsewhere[55 : 55 + height, 40 : 40 + width] = False
    assert_array_equal(placed[elsewhere], original[elsewhere])


def test_placing_undoes_aligning(model, picture):
    angle = np.deg2rad(8)
    registration = np.array(
        [[1.1 * np.cos(angle), -1.1 * np.sin(angle), 30.0], [1.1 * np.sin(angle), 1.1 * np.cos(angle), 20.0]]
    )
    original = picture(140, 130, seed=46, sd_px=4.0)
    aligned = warp.sample(original, warp.affine_displacement(registration, *model.mask.shape))
    assert_allclose(model.placed(aligned, original, registration), original, atol=0.01)  # colour


# the file


@pytest.fixture
def saved(model, tmp_path):
    path = tmp_path / "some.morph"
    model.save(path)
    return path


def test_a_saved_model_comes_back_with_its_facts(model, saved):
    loaded = load_model(saved)
    for name in ("model_id", "warp_weight", "registration", "flow", "identity", "rank", "size", "faceframe"):
        assert getattr(loaded, name) == getattr(model, name)
    assert loaded.provenance == model.provenance
    assert loaded.training.frame_names == model.training.frame_names
    assert loaded.mean.reference_id == model.mean.reference_id
    assert loaded.basis.discarded_variance == model.basis.discarded_variance
    assert_array_equal(loaded.basis.weight, model.basis.weight)
    assert_array_equal(loaded.render([0.5, 0.2]), model.render([0.5, 0.2]))


def test_a_faceframe_survives_the_file(model, tmp_path):
    from dataclasses import replace

    faceframe = FaceFrame((20.25, 30.5), (40.125, 30.0), (30.0, 0.1))
    replace(model, faceframe=faceframe, reference_faceframe=FaceFrame.at(faceframe.points + 1)).save(
        tmp_path / "with.morph"
    )
    loaded = load_model(tmp_path / "with.morph")
    assert_array_equal(loaded.faceframe.points, faceframe.points)
    assert_array_equal(loaded.reference_faceframe.points, faceframe.points + 1)


@pytest.mark.parametrize(
    "array_of",
    [
        lambda model: model.basis.components,
        lambda model: model.basis.variances,
        lambda model: model.mean_inverse,
        lambda model: model.mask,
        lambda model: model.reference,
        lambda model: model.training.values,
    ],
    ids=[name for name in ARRAY_KINDS if name not in ("mean_texture", "mean_displacement")],
)
def test_every_array_but_the_mean_stays_on_the_disk(saved, array_of):
    array = array_of(load_model(saved))
    base = array
    while base is not None and not isinstance(base, np.memmap):
        base = base.base
    assert isinstance(base, np.memmap)
    assert not array.flags.writeable


def test_saving_twice_gives_the_same_bytes_and_saving_the_loaded_too(model, saved, tmp_path):
    model.save(tmp_path / "again.morph")
    load_model(saved).save(tmp_path / "loaded.morph")
    assert (tmp_path / "again.morph").read_bytes() == saved.read_bytes()
    assert (tmp_path / "loaded.morph").read_bytes() == saved.read_bytes()


def test_a_model_can_be_saved_over_the_file_it_was_loaded_from(model, saved):
    load_model(saved).truncate(2).save(saved)
    loaded = load_model(saved)
    assert loaded.model_id == model.truncate(2).model_id
    assert_array_equal(loaded.basis.components, model.basis.components[:2])


def assert_refused(path, match=None):
    with pytest.raises(ModelFileError, match=match) as caught:
        load_model(path)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message


@pytest.mark.parametrize("share", [0, 0.0001, 0.001, 0.01, 0.3, 0.7, 0.9999])
def test_a_file_cut_short_is_refused(saved, share):
    content = saved.read_bytes()
    saved.write_bytes(content[: int(len(content) * share)])
    assert_refused(saved)


def test_a_file_cut_short_by_one_byte_or_missing_is_refused(saved):
    saved.write_bytes(saved.read_bytes()[:-1])
    assert_refused(saved, "cut short")
    saved.unlink()
    assert_refused(saved, "No such file")
    saved.mkdir()
    assert_refused(saved)


def test_random_bytes_are_refused(tmp_path):
    rng = np.random.default_rng(0)
    for size in (1, 7, 8, 9, 100, 10_000):
        path = tmp_path / f"{size}.morph"
        path.write_bytes(rng.bytes(size))
        assert_refused(path)


def rewritten(saved, change):
    """Write the container again after `change(arrays, document)`."""
    arrays, document = read_container(saved)
    arrays = {name: np.array(array) for name, array in arrays.items()}
    change(arrays, document)
    write_container(saved, arrays, document)


def test_a_future_version_and_another_format_are_refused(saved):
    rewritten(saved, lambda arrays, document: document.update(version=2))
    assert_refused(saved, r"some\.morph: version is 2; expected 1\. Install")
    rewritten(saved, lambda arrays, document: document.update(version=1, format="morphspace-avatar"))
    assert_refused(saved, 'format is "morphspace-avatar"; expected morphspace-model')


NAMES = [
    "components",
    "variances",
    "mean_texture",
    "mean_displacement",
    "mean_inverse",
    "mask",
    "reference",
    "training_loadings",
]


@pytest.mark.parametrize("name", NAMES)
def test_arrays_of_the_wrong_shape_or_absent_are_refused(saved, name):
    original = saved.read_bytes()
    rewritten(saved, lambda arrays, document: arrays.update({name: arrays[name][..., :-1]}))
    assert_refused(saved, "has shape .* expected")
    saved.write_bytes(original)
    rewritten(saved, lambda arrays, document: arrays.update({name: arrays[name][None]}))
    assert_refused(saved, name)
    saved.write_bytes(original)
    rewritten(saved, lambda arrays, document: arrays.pop(name) is None)
    assert_refused(saved, name)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", [np.float16, np.int32, np.uint8, "other float"])
def test_arrays_of_the_wrong_type_are_refused(saved, name, kind):
    def change(arrays, document):
        right = arrays[name].dtype
        other = (np.float64 if right == np.float32 else np.float32) if kind == "other float" else kind
        arrays[name] = arrays[name].astype(other)

    rewritten(saved, change)
    wanted = "float64" if name in ("variances", "training_loadings") else "float32"
    assert_refused(saved, f"{name} is .*; expected {wanted} with . axes")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1e-12])
@pytest.mark.parametrize("place", [0, 2])
def test_variances_that_cannot_be_are_refused(saved, place, value):
    rewritten(saved, lambda arrays, document: arrays["variances"].__setitem__(place, value))
    assert_refused(saved, "variances holds values that are not finite|a variance is negative")


def test_a_variance_of_zero_is_none_the_worse(saved):
    def without_variance(arrays, document):
        arrays["variances"][2] = 0.0
        document["content_sha256"] = content_digest(arrays, document)

    rewritten(saved, without_variance)
    assert load_model(saved).sd[2] == 0


@pytest.mark.parametrize(("name", "value"), [("components", np.nan), ("components", 0.5), ("mask", 0.25)])
def test_an_array_that_was_changed_is_refused_on_opening(saved, name, value):
    load_model(saved)
    rewritten(saved, lambda arrays, document: arrays[name].reshape(-1).__setitem__(3, value))
    assert_refused(saved, "not finite" if np.isnan(value) else "was changed after it was written")


def test_components_that_are_not_finite_are_refused_even_with_a_right_digest(saved):
    def poisoned(arrays, document):
        arrays["components"][1, 5] = np.inf
        document["content_sha256"] = content_digest(arrays, document)

    rewritten(saved, poisoned)
    assert_refused(saved, "components holds values that are not finite")


@pytest.mark.parametrize(
    "provenance", [{}, {"identity": None}, {"identity": 3}, {"identity": ["drawn"]}, ["drawn"]]
)
def test_a_model_of_nobody_is_refused(saved, provenance):
    rewritten(saved, lambda arrays, document: document.update(provenance=provenance))
    assert_refused(saved, r"some\.morph: provenance\S* is .*; expected")


DAMAGES = [
    {"reference_id": None, "warp_weight": "heavy"},
    {"warp_weight": None},
    {"discarded_variance": [1]},
    {"faceframe": {"right_eye": [1, 2]}},
    {"faceframe": [1, 2, 3]},
    {"faceframe": {"right_eye": [1], "left_eye": [1, 2], "philtrum": [3, 4]}},
    {"registration": "projective"},
    {"registration": ["none"]},
    {"training_frames": 12},
    {"training_frames": None},
    {"provenance": 3},
    {"provenance": None},
    {"version": None},
    {"format": 1},
]


@pytest.mark.parametrize("damage", DAMAGES, ids=[str(sorted(damage)) for damage in DAMAGES])
def test_a_damaged_document_is_refused(saved, damage):
    rewritten(saved, lambda arrays, document: document.update(damage))
    assert_refused(saved)


@pytest.mark.parametrize(
    "key", ["format", "version", "model_id", "reference_id", "warp_weight", "faceframe", "flow", "provenance"]
)
def test_a_document_that_lacks_an_entry_is_refused(saved, key):
    rewritten(saved, lambda arrays, document: document.pop(key))
    assert_refused(saved)


@pytest.fixture(scope="module")
def model_bytes(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "some.morph"
    model.save(path)
    return path.read_bytes()


@settings(max_examples=60, deadline=None, derandomize=True)
@given(data=st.data())
def test_a_header_with_a_wrong_byte_loads_or_is_refused_by_name(tmp_path_factory, model_bytes, data):
    (length,) = struct.unpack("<Q", model_bytes[:8])
    place = data.draw(st.integers(0, 8 + length - 1))
    path = tmp_path_factory.mktemp("damaged") / "damaged.morph"
    path.write_bytes(model_bytes[:place] + bytes([data.draw(st.integers(0, 255))]) + model_bytes[place + 1 :])
    try:
        load_model(path)
    except MorphspaceError as error:
        assert isinstance(error, ModelFileError)
        assert "\n" not in str(error)


def test_the_header_says_what_the_file_is(saved):
    content = saved.read_bytes()
    (length,) = struct.unpack("<Q", content[:8])
    document = json.loads(json.loads(content[8 : 8 + length])["__metadata__"]["morphspace"])
    assert document["format"] == "morphspace-model"
    assert document["version"] == 1


def test_a_full_disk_leaves_the_old_model(model, saved):
    old = saved.read_bytes()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(old) // 2, before[1]))
    try:
        with pytest.raises(UnwritableFile, match=r"some\.morph"):
            model.truncate(2).save(saved)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert saved.read_bytes() == old
    assert [path.name for path in saved.parent.iterdir()] == ["some.morph"]


def test_a_place_that_cannot_be_written_is_named(model, saved):
    with pytest.raises(UnwritableFile, match=r"cannot write .*some\.morph"):
        model.save(saved / "inside.morph")


def test_a_model_is_not_saved_over_another_kind_of_file(model, tmp_path):
    path = tmp_path / "a.morph"
    path.write_bytes(b"mine, and long enough for a header")
    with pytest.raises(UnwritableFile, match="no file of morphspace"):
        model.save(path)
    assert path.read_bytes().startswith(b"mine")
    path.write_bytes(b"")
    model.save(path)
    model.save(path)


@pytest.mark.parametrize("loadings", ["x", object(), {"a": 1}, [[1.0], [2.0, 3.0]], ["a", "b"]])
@pytest.mark.parametrize("method", ["render", "expand", "offset"])
def test_loadings_that_are_no_numbers_are_refused_in_one_line(model, method, loadings):
    with pytest.raises(
        BadInput, match=r"the loadings are .*; expected numbers, one for each component"
    ) as told:
        getattr(model, method)(loadings)
    assert "\n" not in str(told.value)
