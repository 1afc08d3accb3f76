"""Every example in a docstring runs and returns its result, in a folder with two models and a clip."""

import ast
import doctest
import importlib
import inspect
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

import morphspace as ms
from morphspace.storage import digest_of_file

PACKAGE = Path(__file__).parents[2] / "morphspace"
WITH_EXAMPLES = sorted(
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")
    for path in PACKAGE.rglob("*.py")
    if ">>> " in path.read_text(encoding="utf-8")
)


PUBLIC = [name for name in ms.__all__ if inspect.isfunction(getattr(ms, name))]


@pytest.fixture(scope="module")
def people(model, tmp_path_factory):
    """A folder with anna.morph, ben.morph and the clip anna."""
    folder = tmp_path_factory.mktemp("people")
    framing = {"source_size": [60, 72], "crop": None, "size": [60, 72]}
    inputs = {}
    for name, row in zip(model.training.frame_names, model.training.values, strict=True):
        ms.write_image(folder / "anna" / f"{name}.png", model.render(row))
        inputs[name] = digest_of_file(folder / "anna" / f"{name}.png")
    for name, x in (("anna", 20.0), ("ben", 18.0)):
        origin = {"identity": name, "framing": framing, "inputs": inputs}
        person = replace(model, provenance={**model.provenance, **origin})
        person.with_faceframe(ms.FaceFrame((x, 30.0), (44.0, 30.0), (32.0, 50.0))).save(
            folder / f"{name}.morph"
        )
    return folder


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_the_examples_of_a_module_run(name, people, tmp_path, monkeypatch):
    monkeypatch.chdir(shutil.copytree(people, tmp_path / "people"))
    result = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert result.attempted > 0 and result.failed == 0


@pytest.mark.parametrize("name", PUBLIC)
def test_every_public_function_has_an_example(name):
    assert ">>> " in getattr(ms, name).__doc__


ROOMS = ("avatar", "face", "flow", "grid", "imitation", "io", "linear", "model", "stimuli", "transfer")
NO_EXAMPLE = {
    "the networks, or what they find": """
        face.anchor: anchor_of_build, face_of_reference, points_of, rigid_movement, was_held; face.crop: several_notes
        face.detector.fetch: download_with_pip, downloaded, read_from, write_files; face.detector.models: state_of
        face.expression: distance_from_neutral, expression_of, mean_gap
        face.regions: inside_outline, origin_of_mask, place_of_mask, skin_share
        face.track: framed_points, given_points
        imitation.imitator: imitator_of; model.keypoints: required_landmarks, with_detected
        model.landmarks: error_summary; transfer.quality: reach_of""",
    "words, records and tables of one verb": """
        imitation.motions: at_common_rate, opened, part_of, share_of
        imitation.table: reasons_of, still_components_words, write_measures; io.clock: sampled_words, uneven_words
        io.stimulus_sidecars: essentials, essentials_in, file_texts, read_stimulus_sidecar
        model.encode: notes_on_frames, notes_on_framing, notes_on_own
        model.keypoint_sources: far_notes, point_lines, points_document, read_keypoints
        model.keypoints: how_to_learn, lip_of, point_names; model.model: model_digest, points_document
        stimuli.drawing: drawing_of; stimuli.motion_words: operations_help
        transfer.quality_table: made_of, quality_columns, rounded, write_quality""",
    "a function of `ms` that shows it": """
        avatar.settings: blend_settings; flow.starts: flow_between, flow_from_best; io.framing: same_size
        io.images: jpeg_bytes, png_bytes, read_mask; linear.rows: temporary_rows; model.display: picture_tag
        model.keypoints: reference_to_mean; model.model: load_model
        stimuli.caricature: change_of; stimuli.continuum: spaced_positions; stimuli.drawn: morphs_and_images
        stimuli.operations: worked; stimuli.stepping: change; transfer.driver: clip_driver, training_driver""",
    "what a whole avatar is made of": "avatar.distances: mean_face_distances",
}
"""What the functions need that have no example, and their names by module."""


def functions_of(path):
    """The public functions of a module. Checks return nothing, and long work yields steps: neither has an example."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        is_public = isinstance(node, ast.FunctionDef) and not node.name.startswith(("_", "check"))
        if is_public and "Steps[" not in ast.unparse(node.returns):
            yield node


def module_of(path):
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts)


@pytest.fixture(scope="module")
def borrowed():
    """What each module takes from modules of other rooms: pairs of module and name."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        tree, room = ast.parse(path.read_text(encoding="utf-8")), path.relative_to(PACKAGE).parts[0]
        taken = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("morphspace"):
                for one in node.names:
                    module = str(node.module).removeprefix("morphspace").removeprefix(".")
                    taken[one.asname or one.name] = (module, one.name)
        pairs = set(taken.values())
        for node in ast.walk(tree):
            if (
                isinstance(node, ast.Attribute)
                and isinstance(node.value, ast.Name)
                and node.value.id in taken
            ):
                pairs.add((".".join(filter(None, taken[node.value.id])), node.attr))
        found |= {(module, name) for module, name in pairs if module.partition(".")[0] != room}
    return found


def test_a_function_that_another_room_uses_has_an_example_or_a_reason(borrowed):
    lists = re.split(r"[;\n]\s*", "\n".join(NO_EXAMPLE.values()))
    named = [line.strip().split(": ") for line in lists if line.strip()]
    excused = {(module, name) for module, names in named for name in names.split(", ")}
    lacking = {
        (module_of(path), node.name)
        for room in ROOMS
        for path in (PACKAGE / room).rglob("*.py")
        for node in functions_of(path)
        if (module_of(path), node.name) in borrowed and ">>> " not in str(ast.get_docstring(node))
    }
    assert lacking == excused


METHODS = """
    avatar.bands: banded; avatar.build: blend_steps; avatar.distances: shape_percent; avatar.selection: spread_out
    avatar.sharpness: sharpened; face.anchor: spline_from; face.detector.boxes: suppress; face.registration: register
    flow.baselines: deepflow, dis, tvl1; flow.constraints: tensor; flow.motion: motion; flow.multiscale: method
    flow.paper: method; grid.warp: sample; imitation.alignment: align; imitation.comparison: compare
    imitation.chance: familywise, of_random_phases, p_values; imitation.information: entropy, mutual_information
    io.colour: linear_of_srgb, srgb_of_linear; linear.pca: basis_from_gram, principal_axes
    linear.quality: angular_error_deg, ssim; linear.simplex: nearest_mixture; model.landmarks: learn_landmarks
    model.morph: invert_mean_shape, morph_of, resource; model.passes: build_steps; stimuli.sampling: drawn_sd
    stimuli.image_statistics: image_statistics, spectral_slope; stimuli.stepping: ciede2000
    stimuli.timing: positions_like, smoothed; stimuli.trajectory: averaged, caricatured, scrambled_phase
    transfer.mimicry: mimic; transfer.probable: posterior_of"""
"""Functions that compute what a paper describes, by module."""


@pytest.mark.parametrize("line", re.split(r"[;\n]\s*", METHODS.strip()))
def test_a_function_that_computes_a_published_method_names_it(line):
    module, names = line.split(": ")
    for name in names.split(", "):
        _, _, references = getattr(importlib.import_module(f"morphspace.{module}"), name).__doc__.partition(
            "References\n    ----------\n"
        )
        assert re.search(r"\b(19|20)\d\d\b|section \d|IEC \d", references), name
