"""A damaged file is refused in one line, or read as it was: no fault of ours leaves a reader."""

import random
from pathlib import Path

import numpy as np
import pytest

from morphspace.errors import MorphspaceError
from morphspace.io import flow_fields, images, points, points_table, sidecars, tables, video
from morphspace.io.clips import Clip
from morphspace.io.recipe import grammar
from morphspace.io.stimulus_sidecars import read_stimulus_sidecar
from morphspace.model.file import read_model_file
from morphspace.requests import recipe_verbs

pytestmark = pytest.mark.faults
MUTANTS = 60  # of each kind of file


def mutants(content: bytes, seed: str, count: int = MUTANTS):
    """Damaged copies: a flipped bit, a cut, inserted or removed bytes, a block of zeros, a copied block."""
    draw = random.Random(seed)
    for number in range(count):
        data = bytearray(content)
        place = draw.randrange(len(data))
        match number % 6:
            case 0:
                data[place] ^= 1 << draw.randrange(8)
            case 1:
                del data[place:]
            case 2:
                data[place:place] = draw.randbytes(draw.randint(1, 40))
            case 3:
                del data[place : place + draw.randint(1, 40)]
            case 4:
                length = min(len(data) - place, draw.randint(1, 200))
                data[place : place + length] = bytes(length)
            case 5:
                source = draw.randrange(len(data))
                block = bytes(data[source : source + 100])
                data[place : place + len(block)] = block
        yield bytes(data)


def frames_of(path: Path) -> list[bytes]:
    return [frame.tobytes() for frame in video.read_frames(path)]


SUFFIXES = {
    "model": ".morph",
    "loadings": ".csv",
    "metrics": ".csv",
    "clip": ".json",
    "stimulus": ".json",
    "recipe": ".yaml",
    "points": ".tem",
    "track": ".csv",
    "png": ".png",
    "exr": ".exr",
    "jpg": ".jpg",
    "flow": ".flo",
    "lossless": ".mkv",
    "video": ".mp4",
}
READERS = {
    "model": read_model_file,
    "loadings": tables.read_loadings_table,
    "metrics": tables.read_metrics_table,
    "clip": sidecars.read_sidecar,
    "stimulus": read_stimulus_sidecar,
    "points": points.read_landmarks,
    "track": lambda path: points_table.read_points(path, CLIP, "three", 3),
    "png": images.read_image,
    "exr": images.read_image,
    "jpg": images.read_image,
    "flow": flow_fields.read_flow,
    "lossless": frames_of,
    "video": frames_of,
    "recipe": lambda path: grammar.read_recipe(
        path, {name: verb.settings for name, verb in recipe_verbs().items()}
    ),
}
CLIP = Clip("c", ("a",), (60, 72), sidecars.Sidecar(), (Path("a.png"),), None)
EXACT = ("model", "lossless")  # what they hold is checked: damage is refused, or is outside of what is read


@pytest.fixture(scope="session")
def samples(inputs, tmp_path_factory):
    """One small file of each kind."""
    folder = tmp_path_factory.mktemp("samples")
    picture = images.read_image(inputs / "A.png")
    made = {kind: folder / f"{kind}{suffix}" for kind, suffix in SUFFIXES.items()}
    made["model"] = inputs / "a.morph"
    made["loadings"] = inputs / "a.csv"
    made["clip"] = inputs / "actors" / "actor_01" / "clip.json"
    made["stimulus"] = next((inputs / "stimuli").glob("sample_*.json"))
    made["recipe"] = inputs / "recipe.yaml"
    tables.write_metrics_table(made["metrics"], {"frame": ["a", "b"], "psnr_db": [30.5, 31.25]})
    for kind in ("png", "exr", "jpg"):
        images.write_image(made[kind], picture)
    flow_fields.write_flows({made["flow"]: (picture[..., :2], picture[..., 2])})
    for kind, encoding in (("lossless", "lossless"), ("video", "people")):
        video.write_video(made[kind], [picture, picture[::-1]], frame_rate_hz=25, encoding=encoding)
    marks = [f"{x} {y}" for x, y in ((17, 24), (31, 24), (24, 38))]
    marked = points_table.FramePoints(np.array([[17.0, 24.0], [31.0, 24.5], [24.0, 38.25]]))
    points_table.write_points_table(made["track"], {"a": marked}, 3, {"scheme": "three", "size": [60, 72]})
    made["points"].write_text("\n".join([str(len(marks)), *marks, "0"]) + "\n")
    return made


@pytest.mark.parametrize("kind", READERS)
def test_damage_is_refused_by_a_message_of_ours(samples, tmp_path, kind):
    path = tmp_path / f"damaged{SUFFIXES[kind]}"
    content = samples[kind].read_bytes()
    path.write_bytes(content)
    read = READERS[kind]
    whole = read(path)
    refused = 0
    for mutant in mutants(content, kind):
        path.write_bytes(mutant)
        try:
            found = read(path)
        except MorphspaceError as error:
            assert "\n" not in str(error)
            refused += 1
            continue
        if kind in EXACT:
            assert describe(found) == describe(whole)
    assert refused > 0


def describe(read):
    """Return what was read as something that can be compared."""
    if isinstance(read, tuple):
        arrays, document = read
        return {name: array.tobytes() for name, array in arrays.items()}, document
    return read
