"""The two motions of a measured imitation: from clips or tables, in one space, of one part of the face, at one rate.

What was done to make them comparable is said in notes, which the page and the command line show.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray, Image, LoadingTable, LoadingVector, Mask
from morphspace.errors import BadInput, ReferenceMismatch
from morphspace.face.detector import Detector
from morphspace.face.regions import WHOLE
from morphspace.imitation import masked_basis
from morphspace.imitation.imitator import Imitator
from morphspace.imitation.shape import LEAST_FRAMES, resampled
from morphspace.io.framing import FramedClip
from morphspace.io.images import read_mask
from morphspace.io.tables import read_loadings_table
from morphspace.linear.posterior import Posterior
from morphspace.model.encode import STRANGE, encoded_frames, energy_outside, framed_for, notes_on_enlarging
from morphspace.model.keypoints import region_of
from morphspace.model.model import MorphModel, inner_product
from morphspace.steps import Step, Steps, in_order
from morphspace.stimuli.table_checks import check_reach
from morphspace.storage import digest_of_file

NAMED_BY_VERBS = (
    "loadings",
    "stimulus",
    "imitation",
)  # tables as mimic, reconstruct and measure-mimicry call them


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion in the space of a model: `loadings_sd` (n, k), `rate_hz` or None, and the clip it came from, if any.

    `components` says how many columns are known (the rest are 0); `places` (n,) which frame of the clip each row shows;
    `imitator` whose model the clip is read in or the table belongs to, where it is not the stimulus'; `outside` how
    much of the frames the model cannot show (see `encoding.STRANGE`), where that was measured.
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

    @property
    def is_strange(self) -> bool:
        """Whether the frames are evidently not of the model's person, camera and light."""
        return self.outside is not None and self.outside > STRANGE


def share_of(model: MorphModel, mask: Path | None, region: str) -> Mask | None:
    """Give how much each point of the mean face counts, (h, w) in [0, 1], by the mask's file or the region.

    None where all of the face is measured. Raises `BadInput` for a mask of another size.
    """
    if mask is None:
        return None if region == WHOLE else region_of(model, region)
    share = read_mask(mask)
    if share.shape != model.mask.shape:
        raise BadInput(
            f"the mask {mask} is {share.shape[1]}x{share.shape[0]}, the model's frames are "
            f"{model.size[0]}x{model.size[1]}: draw it on the mean face at that size"
        )
    return share


def part_of(model: MorphModel, share: Mask | None) -> Posterior | None:
    """Give the basis seen through a part of the face; None where all of it is measured."""
    return None if share is None else masked_basis(model.basis, inner_product(share, 1.0))


def opened(
    role: str, given: str, model: MorphModel, notes: list[str], imitator: Imitator | None = None
) -> Motion:
    """Open a clip or read a table (.csv); a clip's loadings are still to be found by `measured`.

    Where there is an `imitator`, both are of its model. Raises `BadInput`.
    """
    read_in = imitator.model if imitator else model
    if Path(given).suffix.lower() == ".csv":
        source = _table(Path(given), read_in, model, notes)
    else:
        clip = framed_for(read_in, (given,), None)
        notes += notes_on_enlarging(clip.framing, read_in.identity, f"frames of the {role}")
        inputs = dict(zip(clip.names, clip.file_digests, strict=True))
        rate_hz = clip.clip.sidecar.frame_rate_hz
        unknown = np.zeros((len(clip.names), read_in.rank))
        places = np.arange(len(clip.names))
        source = Motion(clip.clip.name, clip.names, unknown, rate_hz, clip, read_in.rank, places, inputs)
    if len(source.frame_names) < LEAST_FRAMES:
        raise BadInput(
            f"the {role} {given} has {len(source.frame_names)} frame(s), at least {LEAST_FRAMES} are needed to compare "
            "motions: give more frames"
        )
    # Whatever an imitator's table knows, all of the stimulus' components answer to it.
    return replace(source, components=model.rank, imitator=imitator) if imitator else source


def _table(path: Path, model: MorphModel, stimulus: MorphModel, notes: list[str]) -> Motion:
    """Read a table of `model`, which is the stimulus' or the imitator's."""
    table = read_loadings_table(path)
    columns = table.loadings_sd.shape[1]
    document = table.document or {}
    named = document.get("model_id")
    if table.document is None:
        notes.append(f"{path} has no sidecar: whether it belongs to {model.identity} cannot be checked")
    elif named != model.model_id:
        raise ReferenceMismatch(_other_table(path, named, model, stimulus))
    if columns > model.rank:
        raise BadInput(
            f"{path} has {columns} components, {model.identity} has {model.rank}: encode with this model"
        )
    if columns < model.rank:
        rest = "the others count as 0" if model is not stimulus else "the others are not measured"
        notes.append(f"{path} has {columns} of {model.rank} components of {model.identity}: {rest}")
    rate = document.get("frame_rate_hz")
    rate_hz = float(rate) if isinstance(rate, int | float) and rate > 0 else None
    loadings = np.zeros((len(table.frame_names), model.rank))
    loadings[:, :columns] = table.loadings_sd
    check_reach(table.loadings_sd, table.frame_names, path)
    inputs = {path.name: digest_of_file(path)}
    places = np.arange(len(loadings))
    return Motion(
        name_of_table(path, document), table.frame_names, loadings, rate_hz, None, columns, places, inputs
    )


def name_of_table(path: Path, document: Mapping[str, Any]) -> str:
    """Give what people call the motion in a table: the file's name, or its folder's where verbs gave the file its name.

    Where there is no folder to name it after, whose motion it is, as the sidecar `document` tells.
    """
    if path.stem not in NAMED_BY_VERBS:
        return path.stem
    folder = path.absolute().parent.name
    whose = document.get("source_identity") or document.get("identity")
    return folder or (whose if isinstance(whose, str) and whose else path.stem)


def _other_table(path: Path, named: object, model: MorphModel, stimulus: MorphModel) -> str:
    if model is stimulus:
        return (
            f"{path} belongs to model {named}, --model is {model.model_id} ({model.identity}): give its clip instead, "
            "encode it with this model, measure in the other model's space, or, where it is the imitation, give its "
            "model with --imitator"
        )
    if named == stimulus.model_id:
        return f"{path} is in the space of the stimulus already, the model of {stimulus.identity}: leave out --imitator"
    return f"{path} belongs to model {named}, --imitator is {model.model_id} ({model.identity}): give its own model"


def measured(source: Motion, model: MorphModel, part: Posterior | None) -> Steps[Motion]:
    """Give the sequence with its loadings, of the whole face or of the part.

    A part is projected and not fitted to the picture besides: on few pixels of another face, a fit follows the skin.
    What an imitator's model has read is carried over from its loadings there.
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
    """Give for each frame its loadings (k,), and the energy of what the model cannot show of it, in its variances."""
    if part is None:
        for encoded in encoded_frames(model, clip):
            yield encoded.loadings.values[0], energy_outside(encoded.morph - model.mean, model)
        return
    flow = model.flow_from_reference  # prepared once, and not by each thread

    def project(item: tuple[str, Image]) -> tuple[LoadingVector, float]:
        name, image = item
        offset = model.morph_of(model.align(image, name).image, flow) - model.mean
        return part.mean(offset.vector), energy_outside(offset, model)

    indices = list(range(len(clip.names)))
    yield from in_order(project, zip(clip.names, clip.images(indices), strict=True))


def _carried(source: Motion, imitator: Imitator, model: MorphModel) -> Steps[Motion]:
    """Read the frames in the imitator's model where they are pictures, and carry each row to the stimulus' space."""
    own = imitator.model
    known: Iterable[AnyArray] = source.loadings_sd * own.sd
    if source.clip is not None:
        known = (encoded.loadings.values[0] for encoded in encoded_frames(own, source.clip))
    rows = []
    for loadings in known:
        rows.append(imitator.carry(loadings))
        yield Step(f"encode {source.name}", len(rows), len(source.frame_names))
    return replace(source, loadings_sd=np.stack(rows) / model.sd)


def at_rate_of(stimulus: Motion, imitation: Motion, notes: list[str]) -> Motion:
    """Bring the imitation to the stimulus' frame rate where both are known, and say what was done about time."""
    if stimulus.rate_hz and imitation.rate_hz and stimulus.rate_hz != imitation.rate_hz:
        rate_hz = stimulus.rate_hz
        loadings = resampled(imitation.loadings_sd, imitation.rate_hz, rate_hz)
        places = np.round(np.arange(len(loadings)) / rate_hz * imitation.rate_hz).astype(np.intp)
        places = np.minimum(places, len(imitation.places) - 1)
        notes.append(
            f"the stimulus runs at {rate_hz:g} Hz, the imitation at {imitation.rate_hz:g} Hz: the imitation was "
            f"brought to {rate_hz:g} Hz, linear between frames, {len(imitation.places)} frames becoming {len(loadings)}"
        )
        if len(loadings) < LEAST_FRAMES:
            raise BadInput(
                f"the imitation has {len(loadings)} frame(s) at the stimulus' {rate_hz:g} Hz, at least {LEAST_FRAMES} "
                "are needed: give a longer imitation"
            )
        names = tuple(f"{imitation.name}_{index:06d}" for index in range(len(loadings)))
        imitation = replace(
            imitation, frame_names=names, loadings_sd=loadings, rate_hz=rate_hz, places=places
        )
    elif (stimulus.rate_hz is None) != (imitation.rate_hz is None):
        told = "stimulus" if stimulus.rate_hz else "imitation"
        notes.append(
            f"only the {told} tells its frame rate, {stimulus.rate_hz or imitation.rate_hz:g} Hz: the other is taken "
            "to have the same; write frame_rate_hz into its clip.json if not"
        )
    n, m = len(stimulus.loadings_sd), len(imitation.loadings_sd)
    if n != m:
        notes.append(
            f"the stimulus has {n} frames, the imitation {m}: correlation, distance, gain, information and entropy are "
            f"of the first {min(n, m)} of each; lag and alignment use all"
        )
    return imitation


@dataclass(frozen=True, eq=False)
class FacesSeen:
    """The frames of a motion in which no face was found, by name; None where they were not looked at, or are a table's.

    `is_all` says that it is all of them; `notes` what to know of it.
    """

    without: tuple[str, ...] | None
    notes: tuple[str, ...] = ()
    is_all: bool = False

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.without or ())


def look_for_faces(
    role: str, source: Motion, mean: Image, identity: str, detector: Detector | None
) -> Steps[FacesSeen]:
    """Look at each frame of a clip; a table has none.

    A detector that does not know the face on the `mean` (h, w, 3) of the model that reads the clip, that of `identity`,
    such as a drawn one, will not know it in the frames: they are not looked at then.
    """
    if source.clip is None:
        return FacesSeen(None)
    if detector is None:
        return FacesSeen(
            None,
            (
                f"whether the frames of the {role} {source.name} show a face was not looked at: that needs the "
                "networks (morphspace models fetch)",
            ),
        )
    if detector(np.clip(mean, 0, 1)) is None:
        return FacesSeen(
            None,
            (
                f"the detector sees no face in the mean of {identity}: the frames of the {role} {source.name} were not "
                "looked at for faces",
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
        f"{len(missing)} of {total} frames of the {role} {name} show no face to the detector{which}: what was measured "
        "of them means nothing; measures.json names them, frames_without_face",
    )
