"""What mimicry starts from: the two models, given or built from clips, and the frames that drive.

A driving frame is either a picture, which is aligned and taken apart on the source's mean face, or a row of the
source's own training loadings. Frames are handed on one at a time, so that a clip may be of any length.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphspace.arrays import AnyArray, Image
from morphspace.errors import BadInput
from morphspace.face.detector import Detector, load_detector, models_folder, models_present
from morphspace.face.detector.models import FETCH_COMMAND, ORIGIN, state_of
from morphspace.face.mesh import FacePoints
from morphspace.flow import methods
from morphspace.io.clips import VIDEO_SUFFIXES, Clip, open_clip
from morphspace.model.encode import framed_for, notes_on_framing
from morphspace.model.file import check_content
from morphspace.model.from_clip import ClipSettings, default_size
from morphspace.model.keypoints import detect_faceframe, how_to_learn, with_detected
from morphspace.model.landmarks import LEAST_FACES
from morphspace.model.model import MorphModel, load_model
from morphspace.model.morph import MorphOffset
from morphspace.model.passes import COMPONENTS, MIN_FRAMES
from morphspace.model.reference import spread
from morphspace.outcome import check_folder, versions, work_folder_of
from morphspace.sets.models import written_model
from morphspace.steps import Step, Steps
from morphspace.storage import digest_of_file, digest_of_json
from morphspace.transfer.mimicry import offset_of

MODEL_SUFFIX = ".morph"
LOOKED_AT = 9  # frames of a clip, for a face


@dataclass(frozen=True, eq=False)
class UsedModel:
    """A model that takes part, the file it lies in, and that file's SHA-256."""

    model: MorphModel
    path: Path
    digest: str


@dataclass(frozen=True, eq=False)
class Driver:
    """The frames that drive.

    `names` of the frames | `digests` of what each is | `inputs` name to digest, for the record | `given` yields what is
    known of the frames at these places, one at a time: pictures (h, w, 3) of the source's size, or loadings (k,) |
    `offset` takes one of them apart, by its name, relative to the source's mean, told what the source's own detector
    found in it where that was asked | `picture` draws one of them (h, w, 3) | `files` they lie in | `notes` on what was
    done to the frames | `is_pictures` tells whether faces can be looked for in them, or their loadings are known.
    """

    name: str
    names: tuple[str, ...]
    digests: tuple[str, ...]
    inputs: dict[str, str]
    rate_hz: float | None
    given: Callable[[Sequence[int]], Iterator[AnyArray]]
    offset: Callable[[str, AnyArray, FacePoints | None], MorphOffset]
    picture: Callable[[AnyArray], Image]
    files: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()
    is_pictures: bool = True


def training_driver(source: UsedModel) -> Driver:
    """Let the source's own training frames drive, from their loadings; a picture of one is its reconstruction."""
    model = source.model
    loadings = model.training.values
    if len(loadings) == 0:
        raise BadInput(f"{source.path} holds no training frames: give driving frames with --frames")
    rate = model.provenance.get("frame_rate_hz")
    return Driver(
        name=model.identity,
        names=model.training.frame_names,
        digests=tuple(digest_of_json([source.digest, place]) for place in range(len(loadings))),
        inputs={},
        rate_hz=float(rate) if rate else None,
        given=lambda places: (np.array(loadings[place], np.float64) for place in places),
        offset=lambda name, row, found: offset_of(model, row),
        picture=model.render,
        is_pictures=False,
    )


def clip_driver(source: UsedModel, frames: str) -> Driver:
    """Let a clip drive: each frame is aligned to the source's reference and taken apart on its mean face."""
    model = source.model
    framed = framed_for(model, (frames,), None)

    def offset(name: str, picture: Image, found: FacePoints | None) -> MorphOffset:
        aligned = model.align(picture, name, found).image
        return model.morph_of(aligned, model.flow_from_reference) - model.mean

    return Driver(
        name=framed.clip.name,
        names=framed.names,
        digests=framed.digests,
        inputs={
            f"frames/{name}": digest for name, digest in zip(framed.names, framed.file_digests, strict=True)
        },
        rate_hz=framed.clip.sidecar.frame_rate_hz,
        given=lambda places: framed.images(list(places)),
        offset=offset,
        picture=lambda picture: picture,
        files=framed.clip.paths,
        notes=notes_on_framing(framed.framing, model.identity, "driving frames"),
    )


def own_detector() -> Detector | None:
    """Give the detector of faces where its files have been fetched, else None."""
    return load_detector() if models_present() else None


def check_apart(output: Path, inputs: Sequence[Path]) -> None:
    """Raise `BadInput` where frames lie in the output folder itself: they and what is written would be mixed."""
    for path in inputs:
        if path.suffix.lower() not in VIDEO_SUFFIXES and path.parent.resolve() == output.resolve():
            raise BadInput(
                f"the output folder {output} holds the frames that are read, such as {path.name}: choose another "
                "output folder, such as one in it"
            )


def check_landmarks(used: UsedModel | Clip) -> None:
    """Raise `BadInput` with what helps where a model that is to guide does not know its landmarks, or cannot learn
    them.
    """
    if isinstance(used, Clip):
        if len(used) < LEAST_FACES:
            raise BadInput(
                f"--method guided needs landmarks, and the {len(used)} frames of {used.name} are too few to learn them "
                f"from: give at least {LEAST_FACES}, or choose another method"
            )
    elif used.model.landmarks is None:
        raise BadInput(
            f"--method guided needs landmarks, and {used.path} does not know them: "
            f"{how_to_learn(used.model, str(used.path))}, or choose another method"
        )


def how_to_get_networks() -> str:
    """Say what to do where the detector's files are missing or damaged."""
    damaged = [file.name for file in ORIGIN.files if state_of(file, models_folder()) == "damaged"]
    if damaged:
        return f"run `{FETCH_COMMAND}` again, since {' and '.join(damaged)} of theirs is damaged"
    return f"run `{FETCH_COMMAND}` once"


def own_detector_of(source: MorphModel, driver: Driver) -> Detector | None:
    """Give the same one as the source aligns driving pictures with, so that each is looked at once; else None."""
    anchor = source.anchor if driver.is_pictures else None
    return None if anchor is None else anchor.finder.find


def opened_model(role: str, given: str, detector: Detector | None) -> UsedModel | Clip:
    """Open a model or a clip and check, before any work, that it has or can get keypoints. Raises `BadInput`."""
    path = Path(given)
    if path.suffix.lower() == MODEL_SUFFIX and not path.exists():
        raise BadInput(
            f"{role} {path} does not exist: give a model ({MODEL_SUFFIX}), or a clip to build one of"
        )
    if path.suffix.lower() == MODEL_SUFFIX and not path.is_dir():
        check_content(path)
        model = load_model(path)
        if model.faceframe is None:
            raise BadInput(
                f"{role} {path} has no keypoints: set them with `morphspace keypoints {path} --auto`, or with --set or "
                "--from"
            )
        return UsedModel(model, path, digest_of_file(path))
    if path.is_file() and path.suffix.lower() not in VIDEO_SUFFIXES:
        raise BadInput(
            f"{role} {path} is one file: give a model ({MODEL_SUFFIX}), or a folder, a quoted pattern or a video to "
            "build one of"
        )
    clip = open_clip([given])
    if len(clip) < MIN_FRAMES:
        raise BadInput(
            f"{role} {given} is a clip of {len(clip)} frame{'s' if len(clip) > 1 else ''}, too few for a model: "
            f"give at least {MIN_FRAMES}, better some hundred, or a model ({MODEL_SUFFIX})"
        )
    if clip.sidecar.faceframe is None and detector is None:
        raise BadInput(
            f"{role} {given} is a clip, and the keypoints of its model cannot be found without the networks: "
            f"{how_to_get_networks()}, or give a model with keypoints (`morphspace keypoints`)"
        )
    return clip


def check_faces(
    role: str, clip: Clip, folder: Path, components: int | None, detector: Detector | None
) -> None:
    """Raise `BadInput` where the keypoints of a clip's model are to be found and its frames show the detector no face.

    A few frames are looked at, before the minutes of a build. A model of the clip that lies in `folder` is taken as it
    is, so that one whose keypoints were set by hand is.
    """
    if detector is None or clip.sidecar.faceframe is not None:
        return
    if _found(clip, folder, max(COMPONENTS, components or 0))[1] is not None:
        return
    places = spread(len(clip.frame_names), LOOKED_AT)
    if not any(detector(picture) is not None for picture in clip.images([int(place) for place in places])):
        raise BadInput(
            f"{role} {clip.name} is a clip, and none of {len(places)} frames spread over it shows a face, which the "
            "keypoints of its model are found in: give a clip of a face, mark a faceframe in its clip.json, or give a "
            "model with keypoints (`morphspace keypoints`)"
        )


def ready_model(
    given: UsedModel | Clip, folder: Path, components: int | None, detector: Detector | None
) -> Steps[UsedModel]:
    """Give the model, found in `folder` or built into it where a clip was given, with keypoints. A generator of steps.

    A model there is taken where its clip's digests, its settings and the version are the same.
    """
    if isinstance(given, UsedModel):
        return given
    asked = max(COMPONENTS, components or 0)
    path, model = _found(given, folder, asked)
    if model is None:
        work = folder / f"{path.name}.work"
        settings = ClipSettings(components=asked)
        check_folder(folder)
        with work_folder_of(work, path):
            yield from written_model(given, settings, path, path.with_suffix(".html"), work)
        shutil.rmtree(work, ignore_errors=True)
        model = load_model(path)
    if model.faceframe is None:
        if detector is None:
            raise BadInput(
                f"the model {path} has no keypoints, and they cannot be found without the networks: "
                f"{how_to_get_networks()}, or set them with `morphspace keypoints {path} --set`"
            )
        found = yield from detect_faceframe(model, detector)
        with_detected(model, found).save(path)
        model = load_model(path)
    yield Step("models", 1, 1)
    return UsedModel(model, path, digest_of_file(path))


def _found(clip: Clip, folder: Path, components: int) -> tuple[Path, MorphModel | None]:
    """Give the model built of this clip with these settings, or the free name for one."""
    inputs = dict(zip(clip.frame_names, clip.digests(), strict=True))
    size = default_size(clip.size, None)
    number = 1
    while True:
        path = folder / f"{clip.name}{'' if number == 1 else f'-{number}'}{MODEL_SUFFIX}"
        if not path.exists():
            return path, None
        model = load_model(path)
        told = model.provenance
        same = (
            told.get("inputs") == inputs
            and told.get("identity") == (clip.sidecar.identity or clip.name)
            and told.get("consent") == clip.sidecar.consent
            and told.get("licence") == clip.sidecar.licence
            and told.get("frame_rate_hz") == clip.sidecar.frame_rate_hz
            and (model.reference_faceframe is None) == (clip.sidecar.faceframe is None)
            and told.get("components_asked") == components
            and model.flow == methods.DEFAULT
            and model.size == size
            and told.get("versions") == versions()
        )
        if same:
            return path, model
        number += 1
