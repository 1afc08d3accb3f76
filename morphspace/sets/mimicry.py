"""Write the mimicry of one person by another: pictures, video, tables and page (Nagle section 3).

Frames are drawn a few at a time, each of them once. Finished frames stay in the output folder under a name derived
from everything they depend on, so a stopped run resumes. The video is made in a second pass from the written
pictures.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from morphspace import cache
from morphspace.arrays import AnyArray, Image
from morphspace.face.detector import Detector, load_detector
from morphspace.face.mesh import FacePoints
from morphspace.io.clips import Clip, open_clip
from morphspace.io.clock import is_even, uneven_words
from morphspace.io.images import picture_names, read_image, write_image
from morphspace.io.tables import write_loadings_table
from morphspace.io.video import write_video
from morphspace.model.encode import energy_outside, first_components
from morphspace.model.keypoints import how_to_learn
from morphspace.model.model import MorphModel
from morphspace.outcome import RECORD_NAME, versions, write_record
from morphspace.report.advice import mimicry as advice
from morphspace.report.mimic_page import PAIRS_SHOWN, MimicryResult, mimic_page
from morphspace.report.pictures import of_width, panels_of
from morphspace.report.set_page import CLIPPED_PERCENT
from morphspace.requests import AS_IT_IS, ClipOptions, check_no_options, clip_options, settings_in
from morphspace.sets.models import MODELS_FOLDER, check_faces, check_landmarks, opened_model
from morphspace.sets.outputs import Output, check_apart, check_inputs
from morphspace.sets.protect import check_origins
from morphspace.sets.sources import FRAME_RATE_HZ
from morphspace.steps import Step, Steps, in_order
from morphspace.storage import digest_of_file, make_folder, remove_unfinished, write_text
from morphspace.transfer.driver import Driver, UsedModel
from morphspace.transfer.mimicry import (
    METHODS,
    WITH_RESIDUAL,
    Method,
    Mimic,
    auto_gain,
    mimic,
)
from morphspace.transfer.neutral import Neutral, neutral_names, neutral_of
from morphspace.transfer.quality import Quality, Reach, ReachOf, reach_of
from morphspace.transfer.quality_table import FaceSeen, FrameMade, made_of, quality_columns, write_quality

BEST = "auto"  # the most accurate method that the models allow
MIMIC_FRAMES = "frames"
VIDEO_NAME = "side-by-side.mp4"
MIMIC_FILES = (
    MIMIC_FRAMES,
    VIDEO_NAME,
    "loadings.csv",
    "loadings.json",
    "quality.csv",
    "quality.json",
    "index.html",
    RECORD_NAME,
)
WORK_FOLDER = "mimic.work"  # finished frames of a stopped run
WORK_FORMAT = "morphspace-mimic-frame-4"
THUMBNAIL_WIDTH_PX = 132  # px, of a picture on the page


@dataclass(frozen=True, eq=False)
class FinishedFrames:
    """The finished frames of this request in the output folder; the name of each depends on all its sources."""

    folder: Path
    common: list[Any]
    driver: Driver
    pictures: tuple[Path, ...]

    def file(self, place: int) -> Path:
        names = [entry.name for kind in (Quality, Reach) for entry in fields(kind)]
        own = [self.pictures[place].name, self.driver.digests[place]]
        return cache.result_file(self.folder, WORK_FORMAT, self.common, names, versions(), *own)

    def read(self, place: int) -> FrameMade | None:
        """Read a frame finished before; None if its row or its picture is missing or has changed."""
        file, picture = self.file(place), self.pictures[place]
        if not (picture.is_file() and cache.is_finished(file)):
            return None
        made = made_of(cache.read_result(file)[1])
        return made if made.sha256 == digest_of_file(picture) else None

    def write(self, place: int, made: FrameMade) -> None:
        cache.write_result(self.file(place), {}, made.document())

    def remove(self) -> None:
        """Remove finished frames and rows of this request and of earlier stopped ones."""
        cache.forget(self.folder)


def output_of(folder: Path, inputs: Sequence[Path] = ()) -> Output:
    """Return what a mimicry writes into a folder; `inputs` are files that must not be replaced."""
    return Output("mimic", folder, [folder / name for name in MIMIC_FILES], inputs=inputs)


def frame_steps(
    source: MorphModel, make: Mimic, reach: ReachOf, work: FinishedFrames, detect: Detector | None
) -> Steps[list[FrameMade]]:
    """Draw and write each missing frame, a few at a time; return the result of each.

    A detector that also aligns the source's frames examines each driving frame once.
    """
    driver, total = work.driver, len(work.pictures)
    read = source.basis.inner_products()
    made = {place: one for place in range(total) if (one := work.read(place)) is not None}
    missing = [place for place in range(total) if place not in made]
    if made:
        yield Step("mimic", len(made), total)
    if missing:
        # Caches are filled here once, not in each thread.
        make(source.offset(np.zeros(0)), np.zeros(source.rank))
        if driver.is_pictures:
            _ = source.flow_from_reference, read.weighted
    reader = source.for_person(driver.person)
    anchor = reader.anchor if detect is not None and driver.is_pictures else None
    aligns = anchor is not None and detect is not None and anchor.detector.is_same(detect)

    def one_frame(item: tuple[int, AnyArray]) -> tuple[int, FrameMade]:
        place, given = item
        found = None if detect is None else detect(driver.picture(given))
        face = None if detect is None else _seen(found, driver)
        offset = driver.offset(driver.names[place], given, found if aligns else None)
        known = read.with_offset(offset.vector) if driver.is_pictures else given
        mimicry = make(offset, known)
        clipped = write_image(work.pictures[place], mimicry.morph.render())
        digest = digest_of_file(work.pictures[place])
        loadings = tuple(mimicry.loadings.tolist())
        followed = reach(offset, mimicry.morph, mimicry.loadings, known)
        outside = energy_outside(offset, source, known) if driver.is_pictures else None
        return place, FrameMade(loadings, mimicry.quality, followed, face, outside, clipped, digest)

    under_way = cast(
        Generator[tuple[int, FrameMade]],
        in_order(one_frame, zip(missing, driver.given(missing), strict=True)),
    )
    with closing(under_way):  # the threads end before the folder is inspected
        for place, one in under_way:
            work.write(place, one)
            made[place] = one
            yield Step("mimic", len(made), total)
    return [made[place] for place in range(total)]


def _seen(points: FacePoints | None, driver: Driver) -> FaceSeen | None:
    """Return the face found in a driving frame; None if no statement is possible.

    A training frame is examined as drawn from its loadings. It is known to be a face, so a missed detection is due to
    the drawing.
    """
    if points is None:
        return FaceSeen(found=False) if driver.is_pictures else None
    if points.depth is None:
        return FaceSeen(found=True)
    yaw, pitch = points.turn_degrees
    return FaceSeen(found=True, is_turned=points.is_turned(), yaw_deg=yaw, pitch_deg=pitch)


def video_steps(
    driver: Driver, pictures: Sequence[Path], video: Path
) -> Steps[list[tuple[str, Image, Image]]]:
    """Write the video of source beside mimicry; return small pairs of a few frames for the page."""
    shown = driver.shown().tolist()
    total = len(shown)
    sampled = set(np.linspace(0, total - 1, min(total, PAIRS_SHOWN)).round().astype(int).tolist())
    pairs: list[tuple[str, Image, Image]] = []
    yield Step("video", 0, total)

    def frames() -> Iterator[Image]:
        sources = in_order(driver.picture, driver.given(shown))
        for place, picture in enumerate(sources):
            mimicry = read_image(pictures[shown[place]])
            if place in sampled:
                small = of_width(picture, THUMBNAIL_WIDTH_PX), of_width(mimicry, THUMBNAIL_WIDTH_PX)
                pairs.append((driver.names[shown[place]], *small))
            yield panels_of((picture, mimicry), mimicry.shape[0])

    write_video(video, frames(), frame_rate_hz=driver.rate_hz or FRAME_RATE_HZ, encoding="people")
    yield Step("video", total, total)
    return pairs


@dataclass(frozen=True, eq=False)
class MimicSettings:
    """Settings of the mimicry of one person by another.

    Attributes
    ----------
    method
        One of `METHODS`, or "auto": `guided` if both models have landmarks, else `transfer`.
    gain
        Factor of the loadings. With "auto" the target moves as far as the source (`transfer.mimicry.auto_gain`). None
        is "auto" for `guided` and `transfer`, and 1 for the other methods.
    max_sd
        Bound of each loading, SD.
    components
        Number of the target's first components; None for all.
    neutral
        The neutral faces of both persons (`transfer.neutral.neutral_of`).

    Raises
    ------
    BadInput
        If `neutral` names no frames.
    """

    method: str
    gain: float | Literal["auto"] | None
    max_sd: float
    components: int | None
    neutral: str

    def __post_init__(self) -> None:
        neutral_names(self.neutral)


def opened_pair(request: Any, detect: Detector | None) -> tuple[list[UsedModel | Clip], MimicSettings]:
    """Open both models or clips of a request of `mimic`, and raise any foreseeable error before a model is built."""
    settings, options = settings_in(request, MimicSettings), clip_options(request)
    sides = {"--src": request.source, "--dst": request.target}
    check_origins(output_of(request.output))
    opened = [opened_model(role, words, detect, options) for role, words in sides.items()]
    clips = [given for given in opened if isinstance(given, Clip)]
    if request.frames is None and not clips:
        check_no_options(options, "both persons are models and no driving clip is given (--frames)")
    for role, given in zip(sides, opened, strict=True):
        if isinstance(given, Clip):
            check_apart(request.output, given.paths)
            check_faces(role, given, request.output / MODELS_FOLDER, request.components, detect)
        if request.method == "guided":
            check_landmarks(given)
    if request.frames is not None and clips:
        check_apart(request.output, open_clip([request.frames], options).paths)
    return opened, settings


@dataclass(frozen=True, eq=False)
class WrittenMimicry:
    """A written mimicry: `settings` of the record, `columns` of quality.csv, `notes` for the user, and `files`."""

    settings: Mapping[str, Any]
    columns: Mapping[str, list[Any]]
    notes: tuple[str, ...]
    files: tuple[Path, ...]


@dataclass(frozen=True, eq=False)
class Drive:
    """A prepared pair of models: the `target` with its selected components, the mimicry and its notes."""

    target: MorphModel
    method: Method
    gain: float
    gain_asked: float | Literal["auto"]
    neutral: Neutral
    make: Mimic
    reach: ReachOf
    notes: tuple[str, ...]


def written_mimicry(
    folder: Path,
    source: UsedModel,
    target: UsedModel,
    driver: Driver,
    asked: MimicSettings,
    detector: Detector | None,
    inputs: Sequence[Path] = (),
    options: ClipOptions = AS_IT_IS,
) -> Steps[WrittenMimicry]:
    """Drive the target with each frame; write pictures, video, tables, page and record into the folder.

    Parameters
    ----------
    detector
        Searches each driving frame for a face; None if no detector is available.
    inputs
        Files read beside those of the driver; none of them may be replaced.
    options
        How clips were read, for the record.

    Raises
    ------
    BadInput
        If an input would be replaced, or the models cannot be linked.
    """
    pictures = tuple(folder / MIMIC_FRAMES / name for name in picture_names(driver.names))
    video, page = folder / VIDEO_NAME, folder / "index.html"
    check_apart(folder, driver.files)
    check_inputs((*pictures, video), [*driver.files, *inputs])
    make_folder(folder / MIMIC_FRAMES)
    cache.check_no_link(folder / WORK_FOLDER)
    remove_unfinished(folder / WORK_FOLDER)
    drive = drive_of(source, target, asked)
    if detector is not None and driver.person is not None:
        detector = load_detector(person=driver.person)
    looks = advice.looks_for_faces(driver, source.model, target.model, detector)
    settings = {
        "method": drive.method,
        "gain": drive.gain,
        "gain_asked": drive.gain_asked,
        "max_sd": asked.max_sd,
        "components": drive.target.rank,
        "neutral": drive.neutral.settings,
        "frames": "clip" if driver.is_pictures else "training",
        "faces_looked_for": looks.detector is not None,
    }
    work = FinishedFrames(folder / WORK_FOLDER, [settings, source.digest, target.digest], driver, pictures)
    made = yield from frame_steps(source.model, drive.make, drive.reach, work, looks.detector)
    pairs = yield from video_steps(driver, pictures, video)
    columns = quality_columns(driver.names, made)
    loadings = np.array([one.loadings for one in made]).reshape(len(made), drive.target.rank)
    loadings_sd = loadings / drive.target.sd
    notes = (
        *drive.notes,
        *driver.notes,
        *_uneven_note(driver),
        *_size_note(source.model, target.model),
        *looks.notes,
        *advice.advice_of(source.model, target.model, made, loadings_sd, looks, drive.gain, drive.neutral),
        *_clipped_note(made, drive.target),
    )
    record = {
        **settings,
        "source": _identified(source),
        "target": _identified(target),
        "driver": driver.name,
        "frame_rate_hz": driver.rate_hz,
        "notes": list(notes),
    }
    written = [*pictures, video, *write_quality(folder, columns, record)]
    written += _write_loadings(folder / "loadings.csv", loadings_sd, target, source, driver)
    result = MimicryResult(
        names=(source.model.identity, target.model.identity, driver.name),
        pairs=pairs,
        loadings_sd=loadings_sd,
        max_sd=asked.max_sd,
        columns=columns,
        notes=notes,
        video=video.name,
        settings=_settings_words(asked, record, source, target, driver),
    )
    write_text(page, mimic_page(result))
    written.append(page)
    digests = {"source": source.digest, "target": target.digest, **driver.inputs}
    written.append(write_record(folder, "mimic", {**settings, **asdict(options)}, digests, written))
    work.remove()
    return WrittenMimicry(settings, columns, notes, tuple(written))


def drive_of(source: UsedModel, target: UsedModel, asked: MimicSettings) -> Drive:
    """Choose method, neutral faces and gain, and prepare both models."""
    used, rank_notes = first_components(target.model, asked.components)
    method, method_notes = _method(source, target, asked)
    neutral = neutral_of(source.model, used, asked.neutral)
    gain_asked = asked.gain
    if gain_asked is None:
        gain_asked = "auto" if method in WITH_RESIDUAL else 1.0
    gain = auto_gain(source.model, used, method, neutral=neutral) if gain_asked == "auto" else gain_asked
    make = mimic(source.model, used, method, gain=gain, max_sd=asked.max_sd, neutral=neutral)
    reach = reach_of(source.model, used, gain, neutral)
    return Drive(used, method, gain, gain_asked, neutral, make, reach, (*method_notes, *rank_notes))


def _identified(used: UsedModel) -> dict[str, str]:
    return {"identity": used.model.identity, "model_id": used.model.model_id, "sha256": used.digest}


def _method(source: UsedModel, target: UsedModel, asked: MimicSettings) -> tuple[Method, tuple[str, ...]]:
    """Choose the method, and note what a better method requires."""
    for method in METHODS:
        if method == asked.method:
            if method == "guided":
                check_landmarks(source)
                check_landmarks(target)
            return method, ()
    unlearned = {used.digest: used for used in (source, target) if used.model.landmarks is None}
    if not unlearned:
        return "guided", ()
    ways = "; ".join(
        f"{used.path.name} has no landmarks: {how_to_learn(used.model, used.path.name)}"
        for used in unlearned.values()
    )
    return "transfer", (f"the method is transfer; guided follows lids and lips better, but {ways}",)


def _write_loadings(
    path: Path, loadings_sd: AnyArray, target: UsedModel, source: UsedModel, driver: Driver
) -> tuple[Path, Path]:
    """Write the loadings in SD of the target, with a sidecar as of `encode` that also names the source."""
    model = target.model
    document = {
        "model_id": model.model_id,
        "model_sha256": target.digest,
        "identity": model.identity,
        "consent": model.provenance.get("consent"),
        "licence": model.provenance.get("licence"),
        "frame_rate_hz": driver.rate_hz,
        "source_model_id": source.model.model_id,
        "source_identity": source.model.identity,
        "inputs": driver.inputs,
        "versions": versions(),
    }
    write_loadings_table(path, loadings_sd, driver.names, document, driver.times_s)
    return path, path.with_suffix(".json")


def _size_note(source: MorphModel, target: MorphModel) -> tuple[str, ...]:
    if source.size == target.size:
        return ()
    return (
        f"{source.identity} has frames of {source.size[0]}x{source.size[1]}, {target.identity} of {target.size[0]}x"
        f"{target.size[1]}: the motion is resampled to the latter",
    )


def _uneven_note(driver: Driver) -> tuple[str, ...]:
    if driver.times_s is None or driver.rate_hz is None or is_even(driver.times_s, driver.rate_hz):
        return ()
    rest = f"the video shows the nearest frame at each time of {driver.rate_hz:g} Hz; loadings.csv keeps their times"
    return (uneven_words(driver.name, driver.times_s, rest),)


def _clipped_note(made: Sequence[FrameMade], target: MorphModel) -> tuple[str, ...]:
    clipped = sum(one.clipped for one in made)
    if clipped <= CLIPPED_PERCENT / 100 * len(made) * target.mask.size * 3:
        return ()
    return (f"{clipped} colour values left the range of the files and were clipped",)


def _settings_words(
    asked: MimicSettings, settings: dict[str, Any], source: UsedModel, target: UsedModel, driver: Driver
) -> dict[str, str]:
    sizes = [f"{used.model.size[0]}x{used.model.size[1]}" for used in (source, target)]
    rate = "not known" if driver.rate_hz is None else f"{driver.rate_hz:g} Hz"
    what = "a clip" if driver.is_pictures else "the source's training frames, from their loadings"
    return {
        "method": settings["method"] + (" (auto)" if asked.method == BEST else ""),
        "gain": f"{settings['gain']:g}" + (" (auto)" if settings["gain_asked"] == "auto" else ""),
        "bound of each loading": f"{asked.max_sd:g} SD",
        "components": f"{settings['components']} of {target.model.rank}",
        "source": f"{source.model.identity}, model {source.model.model_id}, {sizes[0]}, {source.path.name}",
        "target": f"{target.model.identity}, model {target.model.model_id}, {sizes[1]}, {target.path.name}",
        "driven by": f"{driver.name}: {what}, {len(driver.names)} frames",
        "frame rate": rate,
        "neutral faces": _neutral_words(settings["neutral"]),
        "faces looked for": "yes" if settings["faces_looked_for"] else "no",
    }


def _neutral_words(neutral: dict[str, Any]) -> str:
    frames = [neutral[f"{role}_frame"] or "the mean" for role in ("source", "target")]
    how = f"--neutral {neutral['asked']}"
    apart = "" if neutral["apart"] is None else f", {neutral['apart']:.1%} of the eye distance apart"
    return f"source {frames[0]}, target {frames[1]}{apart} ({how})"
