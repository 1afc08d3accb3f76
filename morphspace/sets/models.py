"""Open the models of a set from files, or build them from clips and write them with their reports."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.cache import work_folder
from morphspace.errors import BadInput, MorphspaceError, UnreadableFile
from morphspace.face.anchor import was_held
from morphspace.face.detector import Detector, Person, how_to_get_networks, person_of
from morphspace.flow import methods
from morphspace.io.clips import VIDEO_SUFFIXES, Clip, open_clip
from morphspace.io.framing import FramedClip, Framing
from morphspace.model.carried import quality_lines
from morphspace.model.file import read_model_file
from morphspace.model.from_clip import ClipSettings, build_clip, default_size
from morphspace.model.keypoints import detect_faceframe, how_to_learn, with_detected
from morphspace.model.landmarks import LEAST_FACES
from morphspace.model.model import MorphModel, load_model
from morphspace.model.passes import COMPONENTS, MIN_FRAMES, Build
from morphspace.outcome import versions
from morphspace.report.advice.build import Case
from morphspace.report.build_page import write_build_page
from morphspace.report.frames import measure_frames
from morphspace.requests import AS_IT_IS, ClipOptions
from morphspace.steps import Step, Steps, spread
from morphspace.storage import digest_of_file, make_folder, remove_unfinished
from morphspace.transfer.driver import UsedModel

MODELS_FOLDER = "models"  # models built from clips
MODEL_SUFFIX = ".morph"
LOOKED_AT = 9  # frames of a clip that are searched for a face


@dataclass(frozen=True, eq=False)
class WrittenModel:
    """A model that was built and written: its build, the figures of each frame as a `Case`, and notes on the frames."""

    build: Build
    case: Case
    notes: tuple[str, ...]


def written_model(
    clip: Clip, settings: ClipSettings, output: Path, report: Path, work_folder: Path
) -> Steps[WrittenModel]:
    """Build a model from a clip; write the model and its report."""
    build, notes = yield from build_clip(clip, settings, work_folder)
    figures = yield from measure_frames(build)
    build.model.save(output)
    framing = build.model.provenance["framing"]
    width, height = framing["source_size"] if framing["crop"] is None else framing["crop"][2:]
    used = int(width), int(height)
    write_build_page(report, build, figures, source_size=used)
    return WrittenModel(build, Case(build, figures, used), notes)


def check_landmarks(used: UsedModel | Clip) -> None:
    """Check that a model for guided mimicry has landmarks or can learn them. Raises `BadInput` with the remedy."""
    if isinstance(used, Clip):
        if len(used) < LEAST_FACES:
            raise BadInput(
                f"--method guided needs landmarks, but {used.name} has {len(used)} frames; expected at least "
                f"{LEAST_FACES}. Give more frames, or choose another method"
            )
    elif used.model.landmarks is None:
        raise BadInput(
            f"--method guided needs landmarks, but {used.path} has none: "
            f"{how_to_learn(used.model, str(used.path))}, or choose another method"
        )


def opened_model(
    role: str, given: str, detector: Detector | None, options: ClipOptions = AS_IT_IS
) -> UsedModel | Clip:
    """Open a model or a clip; check, before any work, that it has keypoints or can get them. Raises `BadInput`."""
    path = Path(given)
    if path.suffix.lower() == MODEL_SUFFIX and not path.exists():
        raise BadInput(
            f"{role} {path} does not exist. Give a model ({MODEL_SUFFIX}), or a clip to build one from"
        )
    if path.suffix.lower() == MODEL_SUFFIX and not path.is_dir():
        model = load_model(path)
        if model.faceframe is None:
            raise BadInput(
                f"{role} {path} has no keypoints. Set them with `morphspace keypoints {path} --auto`, or with --set or "
                "--from"
            )
        return UsedModel(model, path, digest_of_file(path))
    if path.is_file() and path.suffix.lower() not in VIDEO_SUFFIXES:
        raise BadInput(
            f"{role} {path} is one file. Give a model ({MODEL_SUFFIX}), or a folder, a quoted pattern or a video to "
            "build one from"
        )
    clip = open_clip([given], options)
    if len(clip) < MIN_FRAMES:
        raise BadInput(
            f"{role} {given} is a clip of {len(clip)} frame{'s' if len(clip) > 1 else ''}, too few for a model. "
            f"Give at least {MIN_FRAMES}, better some hundred, or a model ({MODEL_SUFFIX})"
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
    """Check that the detector finds a face in a clip from whose frames the keypoints are found.

    A few frames are examined before the minutes of a build. A model of the clip in `folder` is accepted as it is, so
    keypoints set by hand are kept. Raises `BadInput`.
    """
    if detector is None or clip.sidecar.faceframe is not None:
        return
    if _found(clip, folder, max(COMPONENTS, components or 0))[1] is not None:
        return
    places = spread(len(clip.frame_names), LOOKED_AT)
    if not any(detector(picture) is not None for picture in clip.images([int(place) for place in places])):
        raise BadInput(
            f"{role} {clip.name} is a clip, but none of {len(places)} frames spread over it shows a face, from which "
            "the keypoints are found. Give a clip of a face, mark a faceframe in its clip.json, or give a "
            "model with keypoints (`morphspace keypoints`)"
        )


def ready_model(
    given: UsedModel | Clip, folder: Path, components: int | None, detector: Detector | None
) -> Steps[UsedModel]:
    """Return the model with keypoints, built into `folder` if a clip was given.

    A model in `folder` is reused if its clip's digests, its settings and the versions are the same. Raises `BadInput`
    if keypoints are missing and cannot be detected.
    """
    if isinstance(given, UsedModel):
        return given
    asked = max(COMPONENTS, components or 0)
    path, model = _found(given, folder, asked)
    if model is None:
        work = folder / f"{path.name}.work"
        settings = ClipSettings(components=asked)
        report = path.with_suffix(".html")
        make_folder(folder)
        remove_unfinished(folder, names=(path.name, report.name))
        with work_folder(work, path):
            yield from written_model(given, settings, path, report, work)
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
    """Return the model of this clip with these settings and its path; without one, None and a free path."""
    inputs = dict(zip(clip.frame_names, clip.digests(), strict=True))
    size = default_size(clip, None)
    person = FramedClip(clip, Framing(clip.size, None, size)).person
    number = 1
    while True:
        path = folder / f"{clip.name}{'' if number == 1 else f'-{number}'}{MODEL_SUFFIX}"
        if not path.exists():
            return path, None
        model = load_model(path)
        provenance = model.provenance
        same = (
            provenance.get("inputs") == inputs
            and provenance.get("identity") == (clip.sidecar.identity or clip.name)
            and provenance.get("consent") == clip.sidecar.consent
            and provenance.get("licence") == clip.sidecar.licence
            and provenance.get("frame_rate_hz") == clip.sidecar.frame_rate_hz
            and _person_of(provenance) in (person, None if person == "largest" else person)
            and (provenance.get("mask_from") == "faceframe") == (clip.sidecar.faceframe is not None)
            and provenance.get("components_asked") == components
            and model.flow == methods.DEFAULT
            and model.size == size
            and provenance.get("versions") == versions()
        )
        if same:
            return path, model
        number += 1


def _person_of(provenance: Mapping[str, Any]) -> Person | None:
    """Return the person that the detector of a build looked for; None for the largest."""
    entry = (provenance.get("landmarks") or {}).get("detector") or {}
    return person_of(entry["person"]) if "person" in entry else None


@contextlib.contextmanager
def held_models(paths: Sequence[Path]) -> Iterator[list[Path]]:
    """Yield copies of model files for the duration of the block. Raises `BadInput` if a copy is incomplete.

    A model file is read while it is used. Replacing or truncating the original during a blend would change the result
    or end the process.
    """
    with tempfile.TemporaryDirectory(prefix="morphspace-", ignore_cleanup_errors=True) as folder:
        held = []
        for number, path in enumerate(paths):
            if path.suffix.lower() != MODEL_SUFFIX or path.is_dir():
                raise BadInput(
                    f"{path} is not a {MODEL_SUFFIX} file. Build a model of the clip first with `morphspace "
                    "build-model`"
                )
            read_model_file(path)
            copy = Path(folder) / f"{number}{MODEL_SUFFIX}"
            try:
                shutil.copyfile(path, copy)
            except OSError as error:
                raise UnreadableFile(
                    f"cannot copy {path} to the temporary folder {folder}: {error.strerror or error}"
                ) from error
            if not _is_unchanged(copy):
                raise UnreadableFile(
                    f"{path} changed while it was read ({copy.stat().st_size} bytes were copied). Let the program "
                    "that writes it finish, then start again"
                )
            held.append(copy)
        yield held


def _is_unchanged(copy: Path) -> bool:
    try:
        read_model_file(copy)
    except BadInput:
        return False
    return True


def build_lines(made: WrittenModel, output: Path, report: Path) -> tuple[str, ...]:
    """Report a build in a few lines."""
    build, model = made.build, made.build.model
    psnr, share = np.array(made.case.figures.psnr_db), model.basis.variance_explained
    return (
        f"{output}: {model.identity}, {len(model.training.frame_names)} frames, {model.size[0]}x{model.size[1]}, "
        f"{model.rank} components ({share:.1%} of the variance)",
        f"reference {build.choice.name}: {build.choice.reason}",
        *quality_lines(model.provenance),
        f"training frames are reconstructed at {np.median(psnr):.1f} dB (median), {np.percentile(psnr, 10):.1f} dB "
        f"(10th percentile); {build.fold_fractions.mean():.2%} of the warp folds",
        f"flow {model.flow}: confidence {build.confidences.mean():.2f} (mean), {build.confidences.min():.2f} (lowest); "
        f"{int(build.from_neighbour.sum())} frames kept from a neighbour's start",
        *_found_lines(build),
        f"report: {report}",
    )


def _found_lines(build: Build) -> tuple[str, ...]:
    """Describe in how many frames the face was found, and the crop if it was found automatically."""
    framing = build.model.provenance["framing"]
    lines: tuple[str, ...] = ()
    if "crop_found" in framing:
        search = framing["crop_found"]
        box = ",".join(map(str, framing["crop"]))
        lines += (f"crop {box}: around the head, found in {search['found']} of {search['frames']} frames",)
    if (track := build.track) is not None:
        keypoints = "set" if build.model.faceframe is not None else "not set"
        if build.model.faceframe is not None and build.model.landmarks is None:
            keypoints += (
                " as marked, landmarks not learned: `morphspace keypoints MODEL --auto` sets and learns both"
            )
        held = "the flow is held to it" if was_held(build.model.provenance) else "the flow is not held to it"
        lines += (f"face {track.words}, {held}; keypoints {keypoints}",)
    return lines


def build_document(made: WrittenModel) -> dict[str, Any]:
    """Return the figures of a build as JSON."""
    build, model = made.build, made.build.model
    psnr = np.array(made.case.figures.psnr_db)
    return {
        "model_id": model.model_id,
        "identity": model.identity,
        "frames": len(model.training.frame_names),
        "size": list(model.size),
        "components": model.rank,
        "variance_explained": model.basis.variance_explained,
        "reference": build.choice.name,
        "warp_weight": model.warp_weight,
        "psnr_db_held_out": build.held_out_db,
        "carried": None if build.carried is None else build.carried.document(),
        "psnr_db_median": float(np.median(psnr)),
        "psnr_db_10th_percentile": float(np.percentile(psnr, 10)),
        "fold_fraction": float(build.fold_fractions.mean()),
        "flow_confidence_mean": float(build.confidences.mean()),
        "flow_confidence_lowest": float(build.confidences.min()),
        "neighbour_starts": int(build.from_neighbour.sum()),
        "crop": model.provenance["framing"]["crop"],
        "frames_with_face": None if build.track is None else int(build.track.known.sum()),
        "frames_given": None if build.track is None else int(build.track.given.sum()),
        "frames_turned": None if build.track is None else len(build.track.turned()),
        "keypoints": None if model.faceframe is None else model.faceframe.points.tolist(),
    }


@contextlib.contextmanager
def naming_what_stays(folder: Path) -> Iterator[None]:
    """Add to an error of the block the names of the finished or begun models that stay in the folder."""
    before = _models_in(folder)
    try:
        yield
    except MorphspaceError as error:
        made = [path.name for path in _models_in(folder) if path not in before]
        if not made:
            raise
        raise type(error)(
            f"{error}; the models made for it stay in {folder / MODELS_FOLDER} ({', '.join(made)}), and the next run "
            "here reuses them"
        ) from error


def _models_in(folder: Path) -> list[Path]:
    """List the models, and the work folders of begun models."""
    place = folder / MODELS_FOLDER
    return sorted(path for kind in ("*.morph", "*.morph.work") for path in place.glob(kind))
