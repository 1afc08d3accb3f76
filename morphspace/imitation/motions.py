"""The two motions of an imitation, from clips or tables, in one space, at one frame rate.

Notes record the changes that made the motions comparable; the page and the command line show them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from morphspace.arrays import AnyArray, Image, LoadingTable, LoadingVector, Mask
from morphspace.errors import BadInput, ReferenceMismatch
from morphspace.face.detector import Detector
from morphspace.face.regions import WHOLE
from morphspace.imitation import masked_basis
from morphspace.imitation.imitator import Imitator
from morphspace.imitation.shape import LEAST_FRAMES
from morphspace.io.clock import even_positions, is_even, sampled_at, sampled_words, uneven_words
from morphspace.io.framing import FramedClip
from morphspace.io.images import read_mask
from morphspace.io.tables import LoadingsDocument, read_loadings_table
from morphspace.linear.posterior import Posterior
from morphspace.model.encode import STRANGE, encoded_frames, energy_outside, framed_for, notes_on_frames
from morphspace.model.keypoints import region_of
from morphspace.model.model import MorphModel
from morphspace.model.morph import inner_product
from morphspace.requests import AS_IT_IS, ClipOptions
from morphspace.steps import Step, Steps, in_order
from morphspace.stimuli.table_checks import check_reach
from morphspace.storage import digest_of_file

# Tables as mimic, reconstruct and measure-mimicry call them
NAMED_BY_VERBS = ("loadings", "stimulus", "imitation")


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion in the space of a model.

    Attributes
    ----------
    name : str
    frame_names : tuple of n str
    loadings_sd : array (n, k), SD
    rate_hz : float or None
    clip : FramedClip or None
        The clip from which the loadings are encoded.
    components : int
        The number of known columns; the others are 0.
    places : array (n,) int
        The frame of the clip in each row.
    inputs : dict
        The digests of the files.
    imitator : Imitator or None
        The model of the clip or table, if it is not that of the stimulus.
    times_s : array (n,) s, or None
        The times of the frames, if they are known.
    outside : float or None
        The energy of the frames outside the model's space (see `encode.STRANGE`), if measured.
    """

    name: str
    frame_names: tuple[str, ...]
    loadings_sd: LoadingTable
    rate_hz: float | None
    clip: FramedClip | None
    components: int
    places: AnyArray
    inputs: dict[str, str]
    imitator: Imitator | None = None
    outside: float | None = None
    times_s: AnyArray | None = None

    @property
    def is_strange(self) -> bool:
        """Whether the frames clearly differ from the model's person, camera or light."""
        return self.outside is not None and self.outside > STRANGE


def share_of(model: MorphModel, mask: Path | None, region: str) -> Mask | None:
    """Return the weight (h, w) in [0, 1] of each point of the mean face, from the mask's file or the region.

    None for the whole face. Raises `BadInput` if the mask does not have the size of the model's frames.
    """
    if mask is None:
        return None if region == WHOLE else region_of(model, region)
    share = read_mask(mask)
    if share.shape != model.mask.shape:
        raise BadInput(
            f"the mask {mask} is {share.shape[1]}x{share.shape[0]}; expected {model.size[0]}x{model.size[1]}, the size "
            "of the model's frames. Draw it on the mean face"
        )
    return share


def part_of(model: MorphModel, share: Mask | None) -> Posterior | None:
    """Restrict the model's basis to a part of the face; None for the whole."""
    return None if share is None else masked_basis(model.basis, inner_product(share, 1.0))


def opened(
    role: str,
    given: str,
    model: MorphModel,
    notes: list[str],
    imitator: Imitator | None = None,
    options: ClipOptions = AS_IT_IS,
) -> Motion:
    """Open a clip or read a table (.csv). The loadings of a clip are 0 until `measured` encodes them.

    Parameters
    ----------
    role : "stimulus" or "imitation"
    given : str
        The clip or table.
    model : MorphModel
        The stimulus' model.
    notes : list of str
        Notes are appended.
    imitator : Imitator or None
        If set, its model encodes the clip or encoded the table.
    options : ClipOptions
        How the clip is read; the frame rate is also that of a table.

    Raises
    ------
    BadInput
        If there are too few frames, or the table does not fit the model.
    ReferenceMismatch
        If the table belongs to another model.
    """
    read_in = imitator.model if imitator else model
    if Path(given).suffix.lower() == ".csv":
        source = _at_rate(_table(Path(given), read_in, model, notes), options.frame_rate_hz)
    else:
        clip = framed_for(read_in, (given,), None, options)
        notes += notes_on_frames(clip, read_in.identity, f"frames of the {role}")
        inputs = dict(zip(clip.names, clip.file_digests, strict=True))
        rate_hz = clip.clip.sidecar.frame_rate_hz
        unknown = np.zeros((len(clip.names), read_in.rank))
        places = np.arange(len(clip.names))
        times_s = None if clip.clip.times_s is None else np.array(clip.clip.times_s)
        source = Motion(
            clip.clip.name, clip.names, unknown, rate_hz, clip, read_in.rank, places, inputs, times_s=times_s
        )
    if len(source.frame_names) < LEAST_FRAMES:
        raise BadInput(
            f"the {role} {given} has {len(source.frame_names)} frame(s); expected at least {LEAST_FRAMES} to compare "
            "motions. Give more frames"
        )
    # The transfer gives all of the stimulus' components, however many the imitator's table has.
    return replace(source, components=model.rank, imitator=imitator) if imitator else source


def _at_rate(table: Motion, rate_hz: float | None) -> Motion:
    """Give a table this rate, to which its times are stretched; None leaves them as they are."""
    if rate_hz is None:
        return table
    times_s = (
        None if table.times_s is None or table.rate_hz is None else table.times_s * (table.rate_hz / rate_hz)
    )
    return replace(table, rate_hz=rate_hz, times_s=times_s)


def _table(path: Path, model: MorphModel, stimulus: MorphModel, notes: list[str]) -> Motion:
    """Read a table of `model`, which is that of the stimulus or of the imitator."""
    table = read_loadings_table(path)
    columns = table.loadings_sd.shape[1]
    notes += table.notes
    document = table.document
    named = document and document.get("model_id")
    if document is None:
        notes.append(f"{path} has no sidecar: whether it belongs to {model.identity} cannot be checked")
    elif named != model.model_id:
        raise ReferenceMismatch(_other_table(path, named, model, stimulus))
    if columns > model.rank:
        raise BadInput(
            f"{path} has {columns} components; expected at most {model.rank}, those of {model.identity}. Encode the "
            "clip with this model"
        )
    if columns < model.rank:
        rest = "the others count as 0" if model is not stimulus else "the others are not measured"
        notes.append(f"{path} has {columns} of {model.rank} components of {model.identity}: {rest}")
    loadings = np.zeros((len(table.frame_names), model.rank))
    loadings[:, :columns] = table.loadings_sd
    check_reach(table.loadings_sd, table.frame_names, path)
    inputs = {path.name: digest_of_file(path)}
    places = np.arange(len(loadings))
    return Motion(
        _name_of_table(path, document),
        table.frame_names,
        loadings,
        table.rate_hz,
        None,
        columns,
        places,
        inputs,
        times_s=table.times_s,
    )


def _name_of_table(path: Path, document: LoadingsDocument | None) -> str:
    """Return the name of the motion in a table: the file's name, or the folder's if a verb named the file.

    Without a folder name it is the identity in the sidecar `document`.
    """
    if path.stem not in NAMED_BY_VERBS:
        return path.stem
    folder = path.absolute().parent.name
    whose = document and (document.get("source_identity") or document.get("identity"))
    return folder or whose or path.stem


def _other_table(path: Path, named: object, model: MorphModel, stimulus: MorphModel) -> str:
    if model is stimulus:
        return (
            f"{path} belongs to model {named}; expected {model.model_id} ({model.identity}), that of --model. Give its "
            "clip instead, or measure in the other model's space. If it is the imitation of another person, give that "
            "person's model with --imitator"
        )
    if named == stimulus.model_id:
        return (
            f"{path} belongs to the model of the stimulus, {stimulus.identity}; expected that of --imitator. Leave out "
            "--imitator"
        )
    return (
        f"{path} belongs to model {named}; expected {model.model_id} ({model.identity}), that of --imitator. Give the "
        "table's own model"
    )


def measured(source: Motion, model: MorphModel, part: Posterior | None) -> Steps[Motion]:
    """Encode the motion's clip, or restrict its table to the part of the face. The generator returns the motion.

    A part is projected without fitting the image: on few pixels of another face, a fit follows the skin. Loadings in
    an imitator's model are transferred to the stimulus' space.
    """
    if source.imitator is not None:
        return (yield from _carried(source, source.imitator, model))
    if source.clip is None:
        if part is None:
            return source
        return replace(source, loadings_sd=part.mean_of_faces(source.loadings_sd * model.sd) / model.sd)
    rows: list[AnyArray] = []
    outside: list[float] = []
    for loadings, left in _read(source.clip, model, part):
        rows.append(loadings)
        outside.append(left)
        yield Step(f"encode {source.name}", len(rows), len(source.frame_names))
    return replace(source, loadings_sd=np.stack(rows) / model.sd, outside=float(np.median(outside)))


def _read(
    clip: FramedClip, model: MorphModel, part: Posterior | None
) -> Iterator[tuple[LoadingVector, float]]:
    """Yield the loadings (k,) of each frame, and the energy of its residual in variances of the model."""
    if part is None:
        for encoded in encoded_frames(model, clip):
            yield encoded.loadings.values[0], energy_outside(encoded.morph - model.mean, model)
        return
    model = model.for_person(clip.person)
    _ = model.flow_from_reference  # prepared once, and not by each thread

    def project(item: tuple[str, Image]) -> tuple[LoadingVector, float]:
        name, image = item
        offset = model.morph_of(model.align(image, name)) - model.mean
        return part.mean(offset.vector), energy_outside(offset, model)

    indices = list(range(len(clip.names)))
    yield from in_order(project, zip(clip.names, clip.images(indices), strict=True))


def _carried(source: Motion, imitator: Imitator, model: MorphModel) -> Steps[Motion]:
    """Encode the frames in the imitator's model, or take its table, and transfer each row to the stimulus' space."""
    own = imitator.model
    known: Iterable[AnyArray] = source.loadings_sd * own.sd
    if source.clip is not None:
        known = (encoded.loadings.values[0] for encoded in encoded_frames(own, source.clip))
    rows = []
    for loadings in known:
        rows.append(imitator.carry(loadings))
        yield Step(f"encode {source.name}", len(rows), len(source.frame_names))
    return replace(source, loadings_sd=np.stack(rows) / model.sd)


def at_common_rate(stimulus: Motion, imitation: Motion, notes: list[str]) -> tuple[Motion, Motion]:
    """Sample both motions at even times, at the stimulus' rate if it is known, and append notes on timing.

    Raises `BadInput` if too few frames of the imitation are left.
    """
    own_hz, count = imitation.rate_hz, len(imitation.loadings_sd)
    was_even = is_even(imitation.times_s, own_hz)
    stimulus = _evened(stimulus, stimulus.rate_hz, notes)
    imitation = _evened(imitation, stimulus.rate_hz or own_hz, notes)
    if stimulus.rate_hz and own_hz and stimulus.rate_hz != own_hz:
        rate_hz, samples = stimulus.rate_hz, len(imitation.loadings_sd)
        if was_even:
            notes.append(
                f"the stimulus has {rate_hz:g} Hz, the imitation {own_hz:g} Hz: the imitation was resampled "
                f"linearly to {rate_hz:g} Hz, from {count} to {samples} frames"
            )
        if samples < LEAST_FRAMES:
            raise BadInput(
                f"the imitation has {samples} frame(s) at the stimulus' {rate_hz:g} Hz; expected at least "
                f"{LEAST_FRAMES}. Give a longer imitation"
            )
    elif (stimulus.rate_hz is None) != (imitation.rate_hz is None):
        known = "stimulus" if stimulus.rate_hz else "imitation"
        notes.append(
            f"only the {known} has a frame rate, {stimulus.rate_hz or imitation.rate_hz:g} Hz; the same is assumed for "
            "the other. If that is wrong, write frame_rate_hz into its clip.json"
        )
    n, m = len(stimulus.loadings_sd), len(imitation.loadings_sd)
    if n != m:
        notes.append(
            f"the stimulus has {n} frames, the imitation {m}: correlation, distance, gain, information and entropy use "
            f"the first {min(n, m)} of each; lag and alignment use all"
        )
    return stimulus, imitation


def _evened(motion: Motion, rate_hz: float | None, notes: list[str]) -> Motion:
    """Sample a motion at even times at a rate, Hz; each sample's picture is that of the nearest frame."""
    own_hz = motion.rate_hz
    if rate_hz is None or own_hz is None:
        return motion
    is_steady = is_even(motion.times_s, own_hz)
    if is_steady and rate_hz == own_hz:
        return motion
    frames = len(motion.loadings_sd)
    times_s = np.arange(frames) / own_hz if motion.times_s is None else motion.times_s
    positions = even_positions(times_s, rate_hz)
    if not is_steady:
        words = sampled_words(frames, rate_hz, len(positions))
        notes.append(uneven_words(motion.name, times_s, words))
    return replace(
        motion,
        frame_names=tuple(f"{motion.name}_{index:06d}" for index in range(len(positions))),
        loadings_sd=sampled_at(motion.loadings_sd, positions),
        rate_hz=rate_hz,
        places=motion.places[np.rint(positions).astype(np.intp)],
        times_s=None,
    )


@dataclass(frozen=True, eq=False)
class FacesSeen:
    """The result of the face detector on the frames of a motion.

    Attributes
    ----------
    without : tuple of str, or None
        The frames without a face; None if the frames were not inspected.
    notes : tuple of str
    is_all : bool
        Whether no frame has a face.
    """

    without: tuple[str, ...] | None
    notes: tuple[str, ...] = ()
    is_all: bool = False

    @property
    def count(self) -> int:
        """The number of frames without a face."""
        return len(self.without or ())


def look_for_faces(
    role: str, source: Motion, mean: Image, identity: str, detector: Detector | None
) -> Steps[FacesSeen]:
    """Detect faces in the frames of a clip; a table has none. The generator returns a `FacesSeen`.

    A detector that finds no face in the `mean` (h, w, 3) of the model that encodes the clip, for example of a drawn
    face, will find none in its frames. They are then not inspected.
    """
    if source.clip is None:
        return FacesSeen(None)
    if detector is None:
        return FacesSeen(
            None,
            (
                f"the frames of the {role} {source.name} were not searched for faces, which needs the networks. Run "
                "`morphspace models fetch`",
            ),
        )
    if detector(np.clip(mean, 0, 1)) is None:
        return FacesSeen(
            None,
            (
                f"the detector finds no face in the mean of {identity}, so the frames of the {role} {source.name} were "
                "not searched for faces",
            ),
        )
    total = len(source.frame_names)
    missing = []
    images = source.clip.images(list(range(total)))
    for place, found in enumerate(in_order(detector, images)):
        if found is None:
            missing.append(source.frame_names[place])
        yield Step(f"look at {source.name}", place + 1, total)
    return FacesSeen(
        tuple(missing), _faceless_words(role, source.name, missing, total), len(missing) == total
    )


def _faceless_words(role: str, name: str, missing: Sequence[str], total: int) -> tuple[str, ...]:
    if not missing:
        return ()
    which = "" if len(missing) == total else f" (the first is {missing[0]})"
    return (
        f"the detector finds no face in {len(missing)} of {total} frames of the {role} {name}{which}: their measures "
        "are not meaningful. measures.json lists them under frames_without_face",
    )
