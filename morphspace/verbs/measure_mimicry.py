"""measure-mimicry: how close a real imitation comes to its stimulus, in the stimulus' own expression space.

Nagle section 5.1: both sequences are loadings on one model, and are compared by distances, correlation, mutual
information and entropy. A clip is encoded with the model; a table of loadings, such as `mimic` writes, is taken as it
is.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from morphspace.arrays import Image, LoadingTable
from morphspace.errors import BadInput
from morphspace.face.detector import Detector, own_detector
from morphspace.face.regions import WHOLE
from morphspace.imitation import Comparison, compare
from morphspace.imitation.faces_seen import FacesSeen, look_for_faces
from morphspace.imitation.imitator import METHOD, imitator_of
from morphspace.imitation.motions import Motion, at_rate_of, measured, opened, part_of, share_of
from morphspace.imitation.table import (
    component_names,
    reasons_of,
    still_components_words,
    still_names,
    still_words,
    write_measures,
)
from morphspace.io.tables import write_loadings_table
from morphspace.io.video import write_video
from morphspace.linear.posterior import Posterior
from morphspace.model.encode import check_components, components_used
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import RECORD_NAME, Outcome, versions, write_record
from morphspace.report.advice.imitation import chance_words, mean_apart, size_words, strange_words
from morphspace.report.imitation_page import MeasuredImitation, imitation_page
from morphspace.sets.protect import VIDEO_NAME, check_file, check_ours, no_empty_folders
from morphspace.sets.sources import FRAME_RATE_HZ
from morphspace.steps import Step, Steps, in_order
from morphspace.stimuli.table_checks import check_reach
from morphspace.storage import digest_of_file, make_folder, write_text

VERB = "measure-mimicry"
WORK_FOLDER = (
    f"{VERB}.work"  # there while files are written: a folder that a stopped run leaves is known by it
)
WRITTEN = (
    "measures.csv",
    "measures.json",
    "stimulus.csv",
    "stimulus.json",
    "imitation.csv",
    "imitation.json",
    VIDEO_NAME,
    "index.html",
    RECORD_NAME,
)
ROLES = "stimulus", "imitation"
UNSHOWN = "notes", "mask", "region", "outside_space", "still", "frames_without_face", "least_p"  # as settings
PAIRS_SHOWN = 8
GAP_PX = 4  # between the panels of the video


@dataclass(frozen=True)
class MeasureMimicryRequest:
    """Measure how `imitation` follows `stimulus`, each a clip or a loadings table (.csv), in the space of `model`.

    `output` is a folder (None: named after the imitation); `components` the first so many (None: all both have);
    `mask` a grey picture on the mean face, or `region` by name: both sequences are then measured from that part alone.
    `imitator` is the model of who imitates, where that is another person: the imitation is read in it and carried over.
    """

    stimulus: str
    imitation: str
    model: Path
    output: Path | None = None
    components: int | None = None
    permutations: int = 1000
    seed: int = 0
    mask: Path | None = None
    region: str = WHOLE
    imitator: Path | None = None


def run(request: MeasureMimicryRequest, detector: Detector | None = None) -> Steps[Outcome]:
    """Write measures.csv, the loadings of both, a video side by side and index.html. Returns an `Outcome`.

    Its document has `no_face`, the number of frames in which no face was found. `detector` None takes the package's
    own, where its files have been fetched.
    """
    model = load_model(request.model)
    _check_request(request, model)
    folder = request.output or Path(f"{Path(request.imitation).stem or 'clip'}-mimicry")
    kept = [Path(given) for given in (request.stimulus, request.imitation)]
    for name in WRITTEN:
        check_file(folder / name, Path(name).suffix, kept)
    for path in kept:
        if path.is_dir() and folder.resolve() == path.resolve():
            raise BadInput(
                f"the output folder {folder} is one of the two clips: choose another output folder"
            )
    check_ours(folder, VERB, WRITTEN)
    with no_empty_folders(folder, ()), _mark_of(folder):
        return (yield from _steps(request, model, folder, detector or own_detector()))


@contextmanager
def _mark_of(folder: Path) -> Iterator[None]:
    """Take away, however the block ends, the mark of a run that was begun, unless it left something of ours here."""
    try:
        yield
    finally:
        if not any((folder / name).exists() for name in WRITTEN):
            with suppress(FileNotFoundError):
                (folder / WORK_FOLDER).rmdir()


def _steps(
    request: MeasureMimicryRequest, model: MorphModel, folder: Path, detector: Detector | None
) -> Steps[Outcome]:
    share_seen = share_of(model, request.mask, request.region)
    part = part_of(model, share_seen)
    imitator = None if request.imitator is None else imitator_of(request.imitator, model, share_seen)
    notes: list[str] = []
    sources = [
        opened("stimulus", request.stimulus, model, notes),
        opened("imitation", request.imitation, model, notes, imitator),
    ]
    known = min(source.components for source in sources)
    what = model.identity if known == model.rank else "a table"
    k, rank_notes = components_used(request.components, known, what)
    notes += rank_notes
    make_folder(folder)
    faces: dict[str, FacesSeen] = {}
    for role, source in zip(ROLES, sources, strict=True):
        reader = source.imitator.model if source.imitator else model
        faces[role] = yield from look_for_faces(role, source, reader.mean.render(), reader.identity, detector)
    stimulus = yield from measured(sources[0], model, part)
    imitation = yield from measured(sources[1], model, part)
    imitation = at_rate_of(stimulus, imitation, notes)
    a_sd, b_sd = stimulus.loadings_sd[:, :k], imitation.loadings_sd[:, :k]
    comparison = yield from compare(
        a_sd, b_sd, model.sd[:k], permutations=request.permutations, seed=request.seed
    )
    still = still_words(a_sd, b_sd)
    unseen = [note for seen in faces.values() for note in seen.notes]
    nowhere = [role for role, seen in faces.items() if seen.is_all]
    faceless = sum(seen.count for seen in faces.values())
    notes[:0] = [*(unseen if faceless else ()), *strange_words(stimulus, imitation, model, nowhere)]
    notes += still_components_words(a_sd, b_sd) + size_words(a_sd * model.sd[:k], b_sd * model.sd[:k])
    moved = mean_apart(a_sd, b_sd, imitation, notes)
    if not still:
        notes += chance_words(comparison)
    if not faceless:
        notes += unseen
    rate_hz = stimulus.rate_hz or imitation.rate_hz
    drawn_sd = b_sd + moved
    for values, source in ((a_sd, stimulus), (drawn_sd, imitation)):
        check_reach(values, source.frame_names, Path(source.name))
    make_folder(folder / WORK_FOLDER)
    video = folder / VIDEO_NAME
    panels, pairs = yield from _drawn(model, stimulus, imitation, a_sd, drawn_sd, rate_hz, video)
    if moved.any():
        panels = (*panels, "the imitation is drawn about the stimulus' mean")
    names = component_names(k)
    reasons = reasons_of(comparison, a_sd, b_sd)
    part_name = str(request.mask) if request.mask else request.region
    settings = {
        "components": k,
        "permutations": request.permutations,
        "seed": request.seed,
        "mask": request.mask.name if request.mask else None,
        "region": request.region,
        "imitator": request.imitator.name if request.imitator else None,
        "carried_by": METHOD if request.imitator else None,
    }
    visible = part.visible_share[:k] if part else np.ones(k)
    told: dict[str, object] = {
        "model_id": model.model_id,
        "identity": model.identity,
        "imitator_model_id": imitator.model.model_id if imitator else None,
        "imitator_identity": imitator.model.identity if imitator else None,
        "frame_rate_hz": rate_hz,
        "stimulus_frames": len(a_sd),
        "imitation_frames": len(b_sd),
        "paired_frames": min(len(a_sd), len(b_sd)),
        "shifts": len(comparison.baseline.shifts),
        "shifts_of_information": len(comparison.baseline.costly),
        "shifts_are_all_there_are": comparison.baseline.is_exhaustive,
        "copies_of_lag": comparison.baseline.copies,
        "copies_of_alignment": comparison.baseline.costly_copies,
        "least_p": comparison.baseline.least,
        "outside_space": {"stimulus": stimulus.outside, "imitation": imitation.outside},
        "frames_without_face": {
            role: None if seen.without is None else list(seen.without) for role, seen in faces.items()
        },
        "still": still_names(a_sd, b_sd),
        "notes": notes,
        **settings,
    }
    share = 100 * model.basis.variances[:k] / model.basis.variances.sum()
    written = [*write_measures(folder, comparison, share, visible, rate_hz, reasons, told), video]
    for role, source, values in (("stimulus", stimulus, a_sd), ("imitation", imitation, b_sd)):
        path = folder / f"{role}.csv"
        document: dict[str, object] = {
            "model_id": model.model_id,
            "identity": model.identity,
            "region": part_name,
            "inputs": source.inputs,
            "versions": versions(),
        }
        if source.rate_hz:
            document["frame_rate_hz"] = source.rate_hz
        if source.imitator:
            own = source.imitator.model
            document |= {"source_model_id": own.model_id, "source_identity": own.identity}
        write_loadings_table(path, values, source.frame_names, document)
        written += [path, path.with_suffix(".json")]
    page = folder / "index.html"
    shown = MeasuredImitation(
        comparison=comparison,
        stimulus_sd=a_sd,
        imitation_sd=b_sd,
        rate_hz=rate_hz,
        names=(stimulus.name, imitation.name, model.identity),
        pairs=pairs,
        notes=(*still, *notes),
        still=still,
        read_in=imitator.model.identity if imitator else None,
        video=video.name,
        panels=panels,
        settings=_settings_shown(request, told, part),
        rows=names,
        reasons=reasons,
    )
    write_text(page, imitation_page(shown))
    inputs = {"model": digest_of_file(request.model)}
    if request.mask:
        inputs["mask"] = digest_of_file(request.mask)
    if imitator:
        inputs["imitator"] = imitator.digest
    for role, source in (("stimulus", stimulus), ("imitation", imitation)):
        inputs |= {f"{role}/{name}": digest for name, digest in source.inputs.items()}
    written.append(page)
    written.append(write_record(folder, VERB, settings, inputs, written))
    (folder / WORK_FOLDER).rmdir()
    return _outcome(folder, comparison, {"no_face": faceless, **told}, still, notes, written)


def _check_request(request: MeasureMimicryRequest, model: MorphModel) -> None:
    if model.rank == 0:
        raise BadInput(
            f"{request.model} has no component: nothing can be measured in its space; build it from more frames"
        )
    check_components(request.components)
    if request.permutations < 0:
        raise BadInput(f"{request.permutations} permutations cannot be drawn: give 0 or more")
    if request.mask is not None and request.region != WHOLE:
        raise BadInput(f"both the mask {request.mask} and the region {request.region} were given: choose one")


def _drawn(
    model: MorphModel,
    stimulus: Motion,
    imitation: Motion,
    a_sd: LoadingTable,
    b_sd: LoadingTable,
    rate_hz: float | None,
    path: Path,
) -> Steps[tuple[tuple[str, ...], list[tuple[str, Image, Image]]]]:
    """Write the video; give the names of its panels and a few pairs of faces."""
    n, k = min(len(a_sd), len(b_sd)), a_sd.shape[1]
    sd = model.sd[:k]
    yield Step("video", 0, n)
    rows: list[tuple[str, Iterator[Image]]] = [
        ("stimulus as the model draws it", in_order(model.render, a_sd[:n] * sd)),
        ("imitation in the same space", in_order(model.render, b_sd[:n] * sd)),
    ]
    if stimulus.clip is not None:
        rows.insert(0, ("stimulus", stimulus.clip.images(stimulus.places[:n].tolist())))
    if imitation.clip is not None:
        rows.append(("imitation", imitation.clip.images(imitation.places[:n].tolist())))
    left = 1 if stimulus.clip is not None else 0
    height = model.size[1]
    shown = set(np.linspace(0, n - 1, min(n, PAIRS_SHOWN)).round().astype(int).tolist())
    pairs: list[tuple[str, Image, Image]] = []

    def frames() -> Iterator[Image]:
        for index, images in enumerate(zip(*(images for _, images in rows), strict=True)):
            if index in shown:
                label = f"{index / rate_hz:.2f} s" if rate_hz else f"frame {index}"
                pairs.append((label, images[left], images[left + 1]))
            gap = np.ones((height, GAP_PX, 3), np.float32)
            parts = [part for image in images for part in (gap, of_height(image, height))][1:]
            yield np.concatenate(parts, axis=1)

    write_video(path, frames(), frame_rate_hz=rate_hz or FRAME_RATE_HZ, encoding="people")
    yield Step("video", n, n)
    return tuple(name for name, _ in rows), pairs


def of_height(image: Image, height: int) -> Image:
    """Give a picture (h, w, 3) at this height, its proportions kept."""
    if image.shape[0] == height:
        return image
    width = max(1, round(image.shape[1] * height / image.shape[0]))
    method = cv2.INTER_AREA if height < image.shape[0] else cv2.INTER_CUBIC
    scaled = cv2.resize(image, (width, height), interpolation=method)
    return np.asarray(np.clip(scaled, 0, 1), np.float32)


def _settings_shown(
    request: MeasureMimicryRequest, told: dict[str, object], part: Posterior | None
) -> dict[str, str]:
    shown = {
        key.replace("_", " "): "not known" if value is None else str(value)
        for key, value in told.items()
        if key not in UNSHOWN
    }
    where = f"the mask {request.mask.name}" if request.mask else request.region
    if part is not None:
        where += f"; of the components it shows {', '.join(f'{x:.0%}' for x in part.visible_share[:8])} ..."
    return {"part of the face": where, **shown}


def _outcome(
    folder: Path,
    comparison: Comparison,
    told: dict[str, object],
    still: tuple[str, ...],
    notes: list[str],
    written: list[Path],
) -> Outcome:
    last = {name: float(values[-1]) for name, values in comparison.measures.items()}
    document = {name: value if np.isfinite(value) else None for name, value in last.items()}
    document |= {"alignment_timing_rms_frames": comparison.alignment.timing_rms_frames}

    def said(name: str, decimals: int = 2) -> str:
        return f"{last[name]:.{decimals}f}" if np.isfinite(last[name]) else "undefined"

    first = f"{folder}: {told['paired_frames']} frames in pairs, {told['components']} components"
    if still:
        return Outcome(
            (first, *still), {"output": str(folder), **told, **document}, tuple(notes), tuple(written)
        )
    lines = (
        first,
        f"correlation {said('correlation')} (p {said('correlation_p', 3)}), gain {said('gain')}, distance "
        f"{said('distance_sd')} SD",
        f"correlation at its best lag of {said('lag_frames', 0)} frames {said('correlation_at_lag')} (p "
        f"{said('correlation_at_lag_p', 3)}, chance at its own best lag); aligned {said('correlation_aligned')} (p "
        f"{said('correlation_aligned_p', 3)}, chance aligned too), frames moved by "
        f"{comparison.alignment.timing_rms_frames:.1f} rms",
    )
    return Outcome(lines, {"output": str(folder), **told, **document}, tuple(notes), tuple(written))
