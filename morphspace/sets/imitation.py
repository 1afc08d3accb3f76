"""Write a measured imitation: measures, both sets of loadings, a side-by-side video and a page (Nagle section 5.1)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from morphspace.arrays import Image, LoadingTable
from morphspace.face.detector import Detector
from morphspace.imitation import Comparison, compare
from morphspace.imitation.imitator import METHOD, imitator_of
from morphspace.imitation.motions import (
    FacesSeen,
    Motion,
    at_common_rate,
    look_for_faces,
    measured,
    opened,
    part_of,
    share_of,
)
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
from morphspace.model.encode import components_used
from morphspace.model.model import MorphModel
from morphspace.outcome import RECORD_NAME, versions, write_record
from morphspace.report.advice.imitation import chance_words, mean_apart, size_words, strange_words
from morphspace.report.imitation_page import MeasuredImitation, imitation_page
from morphspace.report.pictures import panels_of
from morphspace.requests import AS_IT_IS, ClipOptions, check_no_options
from morphspace.sets.mimicry import VIDEO_NAME
from morphspace.sets.sources import FRAME_RATE_HZ
from morphspace.steps import Step, Steps, in_order
from morphspace.stimuli.table_checks import check_reach
from morphspace.storage import digest_of_file, make_folder, write_text

VERB = "measure-mimicry"
WORK_FOLDER = f"{VERB}.work"  # exists while files are written; marks the folder of a stopped run
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
# Not listed as settings
NOT_ON_PAGE = ("notes", "mask", "region", "outside_space", "still", "frames_without_face", "least_p")
PAIRS_SHOWN = 8  # pairs of frames on the page, evenly spread


@dataclass(frozen=True)
class MeasureSettings:
    """Settings of the measurement of an imitation.

    Attributes
    ----------
    components
        Number of first components; None for all that both sequences have.
    permutations
        Number of permutations for the chance level, drawn with `seed`.
    mask
        A grey picture on the mean face; both sequences are measured from this part of the face alone.
    region
        The same part by name.
    imitator
        Model of the imitating person if that is another person.
    options
        How both sequences are read.
    """

    components: int | None
    permutations: int
    seed: int
    mask: Path | None
    region: str
    imitator: Path | None
    options: ClipOptions = AS_IT_IS


@dataclass(frozen=True, eq=False)
class WrittenImitation:
    """A measured imitation: `entries` are those of measures.json; `still` and `notes` are read first."""

    comparison: Comparison
    entries: dict[str, object]
    still: tuple[str, ...]
    notes: tuple[str, ...]
    files: tuple[Path, ...]


def written_imitation(
    folder: Path,
    model_path: Path,
    model: MorphModel,
    stimulus_source: str,
    imitation_source: str,
    asked: MeasureSettings,
    detector: Detector | None,
) -> Steps[WrittenImitation]:
    """Measure how an imitation follows a stimulus, each a clip or a table, and write all results into the folder.

    Raises
    ------
    BadInput
        If a sequence cannot be read or does not belong to the model.
    """
    share_seen = share_of(model, asked.mask, asked.region)
    part = part_of(model, share_seen)
    imitator = None if asked.imitator is None else imitator_of(asked.imitator, model, share_seen)
    notes: list[str] = []
    sources = [
        opened("stimulus", stimulus_source, model, notes, options=asked.options),
        opened("imitation", imitation_source, model, notes, imitator, asked.options),
    ]
    if all(source.clip is None for source in sources):
        check_no_options(asked.options, "both motions are tables", "frame_rate_hz")
    known = min(source.components for source in sources)
    what = model.identity if known == model.rank else "a table"
    k, rank_notes = components_used(asked.components, known, what)
    notes += rank_notes
    make_folder(folder)
    faces: dict[str, FacesSeen] = {}
    for role, source in zip(ROLES, sources, strict=True):
        reader = source.imitator.model if source.imitator else model
        faces[role] = yield from look_for_faces(role, source, reader.mean.render(), reader.identity, detector)
    stimulus = yield from measured(sources[0], model, part)
    imitation = yield from measured(sources[1], model, part)
    stimulus, imitation = at_common_rate(stimulus, imitation, notes)
    a_sd, b_sd = stimulus.loadings_sd[:, :k], imitation.loadings_sd[:, :k]
    comparison = yield from compare(
        a_sd, b_sd, model.sd[:k], permutations=asked.permutations, seed=asked.seed
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
    video = folder / VIDEO_NAME
    panels, pairs = yield from _drawn(model, stimulus, imitation, a_sd, drawn_sd, rate_hz, video)
    if moved.any():
        panels = (*panels, "the imitation is drawn around the stimulus' mean")
    names = component_names(k)
    reasons = reasons_of(comparison, a_sd, b_sd)
    part_name = str(asked.mask) if asked.mask else asked.region
    settings = {
        "components": k,
        "permutations": asked.permutations,
        "seed": asked.seed,
        "mask": asked.mask.name if asked.mask else None,
        "region": asked.region,
        "imitator": asked.imitator.name if asked.imitator else None,
        "carried_by": METHOD if asked.imitator else None,
    }
    visible = part.visible_share[:k] if part else np.ones(k)
    entries: dict[str, object] = {
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
    written = [*write_measures(folder, comparison, share, visible, rate_hz, reasons, entries), video]
    for role, source, values in (("stimulus", stimulus, a_sd), ("imitation", imitation, b_sd)):
        written += _write_motion(folder / f"{role}.csv", source, values, model, part_name)
    page = folder / "index.html"
    contents = MeasuredImitation(
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
        settings=_settings_words(asked, entries, part),
        rows=names,
        reasons=reasons,
    )
    write_text(page, imitation_page(contents))
    inputs = {"model": digest_of_file(model_path)}
    if asked.mask:
        inputs["mask"] = digest_of_file(asked.mask)
    if imitator:
        inputs["imitator"] = imitator.digest
    for role, source in (("stimulus", stimulus), ("imitation", imitation)):
        inputs |= {f"{role}/{name}": digest for name, digest in source.inputs.items()}
    written.append(page)
    written.append(write_record(folder, VERB, {**settings, **asdict(asked.options)}, inputs, written))
    return WrittenImitation(comparison, {"no_face": faceless, **entries}, still, tuple(notes), tuple(written))


def _write_motion(
    path: Path, source: Motion, values: LoadingTable, model: MorphModel, part_name: str
) -> tuple[Path, Path]:
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
    return path, path.with_suffix(".json")


def _drawn(
    model: MorphModel,
    stimulus: Motion,
    imitation: Motion,
    a_sd: LoadingTable,
    b_sd: LoadingTable,
    rate_hz: float | None,
    path: Path,
) -> Steps[tuple[tuple[str, ...], list[tuple[str, Image, Image]]]]:
    """Write the video; return the names of its panels and a few pairs of faces."""
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
    sampled = set(np.linspace(0, n - 1, min(n, PAIRS_SHOWN)).round().astype(int).tolist())
    pairs: list[tuple[str, Image, Image]] = []

    def frames() -> Iterator[Image]:
        for index, images in enumerate(zip(*(images for _, images in rows), strict=True)):
            if index in sampled:
                label = f"{index / rate_hz:.2f} s" if rate_hz else f"frame {index}"
                pairs.append((label, images[left], images[left + 1]))
            yield panels_of(images, height)

    write_video(path, frames(), frame_rate_hz=rate_hz or FRAME_RATE_HZ, encoding="people")
    yield Step("video", n, n)
    return tuple(name for name, _ in rows), pairs


def _settings_words(
    asked: MeasureSettings, entries: dict[str, object], part: Posterior | None
) -> dict[str, str]:
    rows = {
        key.replace("_", " "): "not known" if value is None else str(value)
        for key, value in entries.items()
        if key not in NOT_ON_PAGE
    }
    where = f"the mask {asked.mask.name}" if asked.mask else asked.region
    if part is not None:
        where += f"; of the components it shows {', '.join(f'{x:.0%}' for x in part.visible_share[:8])} ..."
    return {"part of the face": where, **rows}


def last_measures(comparison: Comparison) -> dict[str, float | None]:
    """Return the measures of all components together as JSON, and the timing of the alignment."""
    last = {name: float(values[-1]) for name, values in comparison.measures.items()}
    measures = {name: value if np.isfinite(value) else None for name, value in last.items()}
    return {**measures, "alignment_timing_rms_frames": comparison.alignment.timing_rms_frames}


def measure_lines(folder: Path, made: WrittenImitation) -> tuple[str, ...]:
    """Report a measured imitation in a few lines."""
    last, entries = last_measures(made.comparison), made.entries
    first = f"{folder}: {entries['paired_frames']} frames in pairs, {entries['components']} components"
    if made.still:
        return first, *made.still

    def said(name: str, decimals: int = 2) -> str:
        value = last[name]
        return "undefined" if value is None else f"{value:.{decimals}f}"

    return (
        first,
        f"correlation {said('correlation')} (p {said('correlation_p', 3)}), gain {said('gain')}, distance "
        f"{said('distance_sd')} SD",
        f"correlation at its best lag of {said('lag_frames', 0)} frames {said('correlation_at_lag')} (p "
        f"{said('correlation_at_lag_p', 3)}, chance at its own best lag); aligned {said('correlation_aligned')} (p "
        f"{said('correlation_aligned_p', 3)}, chance aligned too), frames moved by "
        f"{made.comparison.alignment.timing_rms_frames:.1f} rms",
    )
