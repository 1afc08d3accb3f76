"""Flow fields in files: Middlebury's `.flo`, and `.exr` with the confidence beside the field.

`.flo` is the format of the Middlebury benchmark (Baker et al., A database and evaluation methodology for optical flow,
IJCV 92, 2011; its `flowIO.h`): every program that deals with flow reads it. It has no place for a confidence; EXR has,
under names. EXR sorts its channels by name, so they are read by name and never by position. `data_spec/flow-file.md`
says what both hold.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from morphspace.arrays import AnyArray, Displacement, Mask
from morphspace.errors import BadInput, UnreadableFile, UnwritableFile
from morphspace.io.images import first_line, write_through
from morphspace.storage import whole_file

FIELD_SUFFIXES = (".flo", ".exr")
TAG = b"PIEH"  # the float 202021.25, little-endian
HEADER = struct.Struct("<4sii")  # tag, width, height
MOST_PX = 99_999  # a side; flowIO.h takes no more
UNKNOWN_ABOVE_PX = 1e9  # flowIO.h: a component beyond it means that the flow is unknown there
UNKNOWN_PX = 1e10  # what flowIO.h calls UNKNOWN_FLOW, written where a field is unknown
CHANNELS = ("u", "v", "confidence")


@dataclass(frozen=True, eq=False)
class StoredFlow:
    """A flow as a file holds it: displacement (h, w, 2) px, confidence (h, w) in [0, 1], and where it is known.

    `known` (h, w) bool; where it is False, displacement and confidence are 0.
    """

    displacement: Displacement
    confidence: Mask
    known: AnyArray


def check_field_name(path: Path) -> None:
    """Raise `BadInput` where a field's name ends in neither .flo nor .exr."""
    if path.suffix.lower() not in FIELD_SUFFIXES:
        raise BadInput(f"{path} is no field by its name: a flow ends in {' or '.join(FIELD_SUFFIXES)}")


def read_flow(path: str | Path) -> StoredFlow:
    """Read a `.flo` or `.exr` field; a `.flo` has confidence 1 where it is known.

    Raises `UnreadableFile` (missing, cut short, too long, another kind of file, an impossible size) and `BadInput`
    (another suffix, other channels, values that are not finite, a confidence outside [0, 1]).
    """
    path = Path(path)
    check_field_name(path)
    try:
        with path.open("rb"):
            size = path.stat().st_size
    except OSError as error:
        raise UnreadableFile(
            f"cannot read {path}: {error.strerror}; check the name and the permissions"
        ) from error
    if size == 0:
        raise UnreadableFile(f"{path} is empty (0 bytes): copy it again")
    try:
        field, confidence = _read_flo(path) if path.suffix.lower() == ".flo" else _read_exr(path)
    except UnicodeDecodeError as error:  # OpenImageIO hands on a damaged header's bytes as text
        raise UnreadableFile(f"{path} is damaged: its header is not text; copy it again") from error
    bad = int(np.count_nonzero(~np.isfinite(field)) + np.count_nonzero(~np.isfinite(confidence)))
    if bad:
        raise BadInput(
            f"{path} holds {bad} values that are not finite: mark unknown flow by {UNKNOWN_PX:g} and write it again"
        )
    low, high = float(confidence.min()), float(confidence.max())
    if low < 0 or high > 1:
        raise BadInput(f"{path} has a confidence from {low:.4g} to {high:.4g}: keep it in [0, 1]")
    known = np.logical_and(*np.moveaxis(np.abs(field) <= UNKNOWN_ABOVE_PX, -1, 0))
    field[~known] = 0
    return StoredFlow(field, np.where(known, confidence, np.float32(0)), known)


def write_flow(
    path: str | Path, displacement: Displacement, confidence: Mask, known: AnyArray | None = None
) -> None:
    """Write a field as its suffix says, `.flo` or `.exr`, whole or not at all; the same flow gives the same bytes.

    A `.flo` holds no confidence. Where `known` (h, w) is False the mark for unknown flow is written. Raises `BadInput`
    (another suffix, shapes that disagree, values that are not finite or would read back as unknown) and
    `UnwritableFile`.
    """
    path = Path(path)
    check_field_name(path)
    field, confidence = _checked(path, displacement, confidence, known)
    with whole_file(path) as temporary:
        _write_into(temporary, path, field, confidence)


def write_flows(fields: Mapping[Path, tuple[Displacement, Mask]]) -> None:
    """Write several fields and confidences that belong together: all of them, or none. Raises as `write_flow` does."""
    with contextlib.ExitStack() as all_or_none:
        for path, parts in fields.items():
            check_field_name(path)
            field, confidence = _checked(path, *parts, None)
            temporary = all_or_none.enter_context(whole_file(path))
            _write_into(temporary, path, field, confidence)


def _checked(
    path: Path, displacement: Displacement, confidence: Mask, known: AnyArray | None
) -> tuple[AnyArray, Mask]:
    """Give the two arrays as they will be stored, little-endian float32, or raise `BadInput`."""
    field = np.array(displacement, "<f4")
    confidence = np.array(confidence, "<f4")
    if field.ndim != 3 or field.shape[2] != 2 or field.size == 0 or confidence.shape != field.shape[:2]:
        raise BadInput(
            f"cannot write {path}: a field of shape {field.shape} with a confidence of shape {confidence.shape}, "
            "(h, w, 2) and (h, w) were expected"
        )
    if max(field.shape) > MOST_PX:
        raise BadInput(
            f"cannot write {path}: {field.shape[1]}x{field.shape[0]} px, a side has at most {MOST_PX}"
        )
    if known is not None:
        field[~known], confidence[~known] = 0, 0
    bad = int(np.count_nonzero(~(np.abs(field) <= UNKNOWN_ABOVE_PX)))
    if bad:
        raise BadInput(f"cannot write {path}: {bad} of its values are not finite, or no displacement")
    if not ((confidence >= 0) & (confidence <= 1)).all():
        raise BadInput(f"cannot write {path}: the confidence is not in [0, 1] everywhere")
    if known is not None:
        field[~known] = UNKNOWN_PX
    return field, confidence


def _read_flo(path: Path) -> tuple[AnyArray, Mask]:
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(HEADER.size)
        if head[:4] != TAG[: len(head)]:
            raise UnreadableFile(
                f"{path} is not a .flo file: it starts with {head[:4]!r}, {TAG!r} was expected"
            )
        if len(head) < HEADER.size:
            raise UnreadableFile(f"{path} is cut short: {size} bytes, its header alone has {HEADER.size}")
        _, width, height = HEADER.unpack(head)
        if not (1 <= width <= MOST_PX and 1 <= height <= MOST_PX):
            raise UnreadableFile(
                f"{path} claims {width}x{height} px, a side has 1 to {MOST_PX}: it is damaged, or its numbers are "
                "big-endian; write it again"
            )
        expected = HEADER.size + 8 * width * height
        if size != expected:
            fault = "cut short" if size < expected else "too long"
            raise UnreadableFile(
                f"{path} is {fault}: {width}x{height} px take {expected} bytes, it has {size}; copy it again"
            )
        content = file.read()
    field = np.frombuffer(content, "<f4").reshape(height, width, 2).astype(np.float32)
    return field, np.ones((height, width), np.float32)


def _read_exr(path: Path) -> tuple[AnyArray, Mask]:
    source = oiio.ImageInput.open(str(path))
    if source is None or source.format_name() != "openexr":
        reason = first_line(oiio.geterror()) if source is None else f"it is a {source.format_name()} file"
        raise UnreadableFile(f"{path} is not a readable EXR file: {reason}")
    try:
        spec = source.spec()
        names = [name.lower() for name in spec.channelnames]
        if sorted(names) not in (["u", "v"], sorted(CHANNELS)):
            raise BadInput(
                f"{path} has the channels {', '.join(spec.channelnames)}, not {', '.join(CHANNELS)}"
            )
        if (spec.width, spec.height) != (spec.full_width, spec.full_height):
            raise BadInput(
                f"{path} stores {spec.width}x{spec.height} px of a picture of {spec.full_width}x{spec.full_height}: "
                "save it with its data window equal to its display window"
            )
        stored = source.read_image(0, 0, 0, spec.nchannels, "float")
        if stored is None or source.has_error:
            raise UnreadableFile(
                f"{path} is damaged or cut short ({path.stat().st_size} bytes): {first_line(source.geterror())}; "
                "copy it again"
            )
    finally:
        source.close()
    field = np.stack([stored[..., names.index(name)] for name in ("u", "v")], axis=-1)
    if "confidence" not in names:
        return field, np.ones(field.shape[:2], np.float32)
    return field, np.ascontiguousarray(stored[..., names.index("confidence")])


def _write_into(temporary: Path, path: Path, field: AnyArray, confidence: Mask) -> None:
    """Write a checked field into a temporary file that will be called `path`."""
    height, width = field.shape[:2]
    if path.suffix.lower() == ".flo":
        temporary.write_bytes(HEADER.pack(TAG, width, height) + field.tobytes())
        return
    values = np.dstack([field, confidence])
    spec = oiio.ImageSpec(width, height, len(CHANNELS), "float")
    spec.channelnames = CHANNELS
    spec.attribute("DateTime", "")  # else the hour of writing enters the file and equal fields differ
    spec.attribute("compression", "zip")
    write_through(path, temporary, spec, values)
    _check_written(path, temporary, values)


def _check_written(path: Path, temporary: Path, values: AnyArray) -> None:
    """Read a new file back: a disk that fills up with the very last block gives OpenImageIO no error."""
    try:
        field, confidence = _read_exr(temporary)
    except UnreadableFile as error:
        raise UnwritableFile(
            f"cannot write {path}: it does not read back; is the disk full? Nothing was changed"
        ) from error
    if not np.array_equal(np.dstack([field, confidence]), values):
        raise UnwritableFile(f"cannot write {path}: it reads back with other values; nothing was changed")
