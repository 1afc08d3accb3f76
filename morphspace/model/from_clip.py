"""Build a model from a clip, with its crop, size, mask and reference frame (Nagle et al., section 2)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from morphspace.arrays import Mask
from morphspace.errors import BadInput
from morphspace.face.crop import FoundCrop, crop_steps
from morphspace.face.detector import Landmarks, detector_for, load_detector
from morphspace.face.faceframe import FaceFrame, RegistrationKind
from morphspace.face.track import given_points
from morphspace.flow import methods
from morphspace.flow.starts import StartKind
from morphspace.grid.warp import apply_affine, inverse_affine
from morphspace.io.clips import Clip
from morphspace.io.clock import is_even, uneven_words
from morphspace.io.framing import FramedClip, Framing, check_person
from morphspace.io.images import read_mask
from morphspace.io.names import composed
from morphspace.io.sidecars import MarkedFaceframe
from morphspace.model.passes import COMPONENTS, Build, BuildSettings, build_steps
from morphspace.outcome import versions
from morphspace.steps import Steps
from morphspace.storage import digest_of_array

DEFAULT_SIDE_PX = 400  # px, longer side; frames of a larger video are scaled to `DEFAULT_SIZE`
MOST_STILL_PX = 1_000_000  # px in all; larger photographs are scaled too, because builds would need gigabytes
FLOATS_PER_PIXEL = 5  # of a morph: three colours and a displacement
MOST_WEIGHT = 1000.0  # colour per px; builds choose 0.02 to 0.1
LEAST_FACEFRAME_PX = 4.0  # px; nearer points do not determine a face's position
DEFAULT_SIZE = (200, 240)  # px, w and h (Nagle et al., section 2)

Crop = tuple[int, int, int, int] | Literal["auto"]
"""A box (x, y, w, h) px of every frame, or `auto` for a box around the head."""


@dataclass(frozen=True, eq=False)
class ClipSettings:
    """Settings of a build from a clip.

    Attributes
    ----------
    components : int
        The largest number of components.
    size : (w, h) px, optional
        Of the model's frames; None for `default_size`.
    crop : (x, y, w, h) px or "auto", optional
        A box of every frame, or "auto" for a box around the head.
    landmarks : {"auto", "none"} or Path
        "auto" finds the face in every frame, and holds the flow to its points, if the detector's networks are
        installed. "none" runs no detector. A table or folder of points gives those of its frames; the face is found
        in the others.
    mask : Path, optional
        A grey picture of the reference's size, white inside the face.
    reference : str, optional
        Name or file of the reference frame; None to choose it.
    registration : {"none", "similarity", "affine"}
    flow : str
        Flow method.
    start : {"auto", "none"}
        "auto" repeats frames that were hard to match from a neighbour's flow.
    warp_weight : float, optional
        Colour per px; None to cross-validate.
    identity : str, optional
        Name of the person; None for the clip's.

    Raises
    ------
    BadInput
        If the warp weight is not above 0 and at most `MOST_WEIGHT`.
    """

    components: int = COMPONENTS
    size: tuple[int, int] | None = None
    crop: Crop | None = None
    landmarks: Landmarks | Path = "auto"
    mask: Path | None = None
    reference: str | None = None
    registration: RegistrationKind = "similarity"
    flow: str = methods.DEFAULT
    start: StartKind = "auto"
    warp_weight: float | None = None
    identity: str | None = None

    def __post_init__(self) -> None:
        weight = self.warp_weight
        if weight is not None and not 0 < weight <= MOST_WEIGHT:
            raise BadInput(
                f"the warp weight is {weight}; expected above 0 and at most {MOST_WEIGHT:g} colour per px. Give "
                "such a number, or auto"
            )


def build_clip(clip: Clip, asked: ClipSettings, work_folder: Path) -> Steps[tuple[Build, tuple[str, ...]]]:
    """Build a model from an open clip; a generator of steps.

    Parameters
    ----------
    clip : Clip
    asked : ClipSettings
    work_folder : Path
        Keeps finished frames, from which an interrupted build continues.

    Returns
    -------
    build : Build
    notes : tuple of str
        Changes that were made to the frames.

    Raises
    ------
    BadInput
        As `build_steps`; also if mask, reference or faceframe do not fit the clip, or no face is found to crop
        around.
    MissingModels
        If the settings need the detector and its networks are not installed.
    """
    if clip.person is not None and asked.landmarks == "none":
        raise BadInput(
            "--person selects a face, but landmarks is none: no face is detected. Leave one of them out"
        )
    person = clip.person or "largest"
    given = given_points(asked.landmarks, clip) if isinstance(asked.landmarks, Path) else None
    detector, missing = detector_for("auto" if given else str(asked.landmarks), person)
    if clip.person is not None or given is not None:
        detector, missing = load_detector(person=person), ()
    notes = [*clip.notes, *missing]
    rate_hz = clip.sidecar.frame_rate_hz
    if clip.times_s is not None and rate_hz is not None and not is_even(clip.times_s, rate_hz):
        rest = f"the model keeps their times, and {rate_hz:g} Hz"
        notes.append(uneven_words(clip.name, clip.times_s, rest))
    crop, found_crop = asked.crop, None
    if crop == "auto":
        width, height = asked.size or DEFAULT_SIZE
        found_crop = yield from crop_steps(clip, detector or load_detector(person=person), width / height)
        crop = found_crop.box
        notes += found_crop.notes
    framing = Framing(clip.size, crop, asked.size or default_size(clip, crop))
    source = FramedClip(clip, framing)
    check_person(source)
    notes += _size_notes(framing, asked)
    if detector is not None and source.person is not None:
        detector = load_detector(person=source.person)
    mask, mask_digest = _mask(asked.mask, framing, clip.size)
    faceframe, faceframe_index, faceframe_notes = _marked_faceframe(clip, framing)
    notes += faceframe_notes
    settings = BuildSettings(
        components=asked.components,
        registration=asked.registration,
        flow=asked.flow,
        start=asked.start,
        reference=None if asked.reference is None else _index_of(asked.reference, clip),
        warp_weight=asked.warp_weight,
        mask=mask,
        faceframe=faceframe,
        faceframe_index=faceframe_index,
        detector=detector,
        given=None if given is None else given.framed(framing.to_source),
        is_video=clip.video_indices is not None,
    )
    build = yield from build_steps(
        source, settings, work_folder, _provenance(clip, source, asked, mask_digest, found_crop)
    )
    return build, tuple(notes)


def _source_size(size: tuple[int, int], crop: tuple[int, int, int, int] | None) -> tuple[int, int]:
    """Return the size (w, h) px of the used part of each image: the crop, or the whole."""
    return size if crop is None else (crop[2], crop[3])


def default_size(clip: Clip, crop: tuple[int, int, int, int] | None) -> tuple[int, int]:
    """Return the default frame size (w, h) px of a model: the frames' own, or 200 x 240 if they are large.

    Frames of a video are large above `DEFAULT_SIDE_PX`, stills above `MOST_STILL_PX`.

    Examples
    --------
    >>> from morphspace.io.clips import open_clip
    >>> default_size(open_clip(["anna"]), None)
    (60, 72)
    """
    used = _source_size(clip.size, crop)
    is_large = (
        used[0] * used[1] > MOST_STILL_PX if clip.video_indices is None else max(used) > DEFAULT_SIDE_PX
    )
    return DEFAULT_SIZE if is_large else used


def _size_notes(framing: Framing, asked: ClipSettings) -> tuple[str, ...]:
    """Note that frames are scaled or cropped, or large, with the size of the model file at other sizes."""
    used, size = framing.box[2:], framing.size

    def megabytes(width: int, height: int) -> str:
        return f"{asked.components * FLOATS_PER_PIXEL * 4 * width * height / 1e6:.0f} MB"

    is_cropped = max(framing.cut_off) > 0
    words = []
    if is_cropped or (used != size and asked.size is None):
        cropped = f" and cropped to the middle {size[0]}x{size[1]}" if is_cropped else ""
        scaled = framing.scaled_size
        words.append(f"frames of {used[0]}x{used[1]} are scaled to {scaled[0]}x{scaled[1]}{cropped}")
    count = asked.components
    if asked.size is None and used != size:
        words.append(
            f"--size keeps more: {count} components of {used[0]}x{used[1]} px have {megabytes(*used)}, these have "
            f"{megabytes(*size)}"
        )
    elif asked.size is None and max(used) > DEFAULT_SIDE_PX:
        words.append(
            f"the frames keep their {size[0]}x{size[1]} px: {count} components have {megabytes(*size)}; with --size "
            f"{DEFAULT_SIZE[0]}x{DEFAULT_SIZE[1]} they have {megabytes(*DEFAULT_SIZE)}"
        )
    return ("; ".join(words),) if words else ()


def _mask(
    path: Path | None, framing: Framing, source_size: tuple[int, int]
) -> tuple[Mask | None, str | None]:
    if path is None:
        return None, None
    mask = read_mask(path)
    size = (mask.shape[1], mask.shape[0])
    if size == source_size and size != framing.size:
        mask = framing.apply(np.repeat(mask[..., None], 3, axis=2))[..., 0]
    elif size != framing.size:
        raise BadInput(
            f"the mask {path} is {size[0]}x{size[1]} px; expected {source_size[0]}x{source_size[1]}, the size of the "
            f"frames, or {framing.size[0]}x{framing.size[1]}, that of the model. Draw it at one of these sizes"
        )
    return mask, digest_of_array(mask)


def _index_of(reference: str, clip: Clip) -> int:
    """Find a frame by name, with or without folder and suffix."""
    reference = composed(reference)
    for wanted in (reference, Path(reference).name, Path(reference).stem):
        if wanted in clip.frame_names:
            return clip.frame_names.index(wanted)
    raise BadInput(
        f"frame {reference!r} is not in {clip.name}; expected a name from {clip.frame_names[0]} to "
        f"{clip.frame_names[-1]}"
    )


def _marked_faceframe(clip: Clip, framing: Framing) -> tuple[FaceFrame | None, int | None, tuple[str, ...]]:
    """Read the faceframe of a clip's sidecar at the model's size.

    Returns
    -------
    faceframe : FaceFrame or None
        None if the sidecar marks none.
    index : int or None
        The frame on which it was marked.
    notes : tuple of str

    Raises
    ------
    BadInput
        If points lie outside the picture or too close to each other.
    """
    marked = clip.sidecar.faceframe
    if marked is None:
        return None, None, ()
    notes = marked.notes
    marked = MarkedFaceframe(marked.image, marked.points, clip.size)  # raises outside the picture
    points = apply_affine(inverse_affine(framing.to_source), marked.points)
    width, height = np.hypot(*(points[1] - points[0])), np.hypot(*(points[2] - points[:2].mean(axis=0)))
    if min(width, height) < LEAST_FACEFRAME_PX:
        raise BadInput(
            f"the faceframe of {marked.image} is {width:.1f} px from eye to eye and {height:.1f} px from eyes to "
            f"philtrum at the model's size; expected at least {LEAST_FACEFRAME_PX:g} px. Mark it again"
        )
    return FaceFrame.at(points), _index_of(marked.image, clip), notes


def _provenance(
    clip: Clip,
    source: FramedClip,
    asked: ClipSettings,
    mask_digest: str | None,
    found_crop: FoundCrop | None,
) -> dict[str, Any]:
    framing = source.framing
    return {
        "identity": asked.identity or clip.sidecar.identity or clip.name,
        "consent": clip.sidecar.consent,
        "licence": clip.sidecar.licence,
        "frame_rate_hz": clip.sidecar.frame_rate_hz,
        **({} if clip.times_s is None else {"times_s": list(clip.times_s)}),
        "framing": {
            "source_size": list(framing.source_size),
            "crop": None if framing.crop is None else list(framing.crop),
            "size": list(framing.size),
            **({} if found_crop is None else {"crop_found": found_crop.document}),
        },
        "mask_sha256": mask_digest,
        "inputs": dict(zip(clip.frame_names, source.file_digests, strict=True)),
        "versions": versions(),
    }
