"""Flow fields in files: Middlebury's `.flo`, and `.exr` that also holds the confidence.

`.flo` is the format of the Middlebury benchmark (Baker et al., A database and evaluation methodology for optical
flow, IJCV 92, 2011; its `flowIO.h`), which most flow software reads. It cannot store a confidence; EXR can, as a
named channel. EXR sorts its channels by name, so they are read by name and not by position. `data_spec/flow-file.md`
describes both.
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
MOST_PX = 99_999  # a side; the limit of flowIO.h
UNKNOWN_ABOVE_PX = 1e9  # flowIO.h: a larger component marks unknown flow
UNKNOWN_PX = 1e10  # UNKNOWN_FLOW of flowIO.h
CHANNELS = ("u", "v", "confidence")


@dataclass(frozen=True, eq=False)
class StoredFlow:
    """A flow field as read from a file.

    Attributes
    ----------
    displacement : array (h, w, 2) float32, px
    confidence : array (h, w) float32 in [0, 1]
    known : array (h, w) bool
        Where it is False, displacement and confidence are 0.
    """

    displacement: Displacement
    confidence: Mask
    known: AnyArray


def check_field_name(path: Path) -> None:
    """Raise `BadInput` if the name of a flow file does not end in .flo or .exr."""
    if path.suffix.lower() not in FIELD_SUFFIXES:
        raise BadInput(
            f"{path} is not a flow file by its name; expected {' or '.join(FIELD_SUFFIXES)}. Rename it"
        )


def read_flow(path: str | Path) -> StoredFlow:
    """Read a `.flo` or `.exr` flow field. The confidence of a `.flo` is 1 wherever the flow is known.

    Raises
    ------
    UnreadableFile
        If the file is missing, truncated, too long, of another format or of an impossible size.
    BadInput
        If the suffix or the channels are others, a value is not finite, or a confidence lies outside [0, 1].

    References
    ----------
    Baker et al., A database and evaluation methodology for optical flow, IJCV 92, 2011 (`.flo`).

    Examples
    --------
    >>> import numpy as np
    >>> write_flows({Path("one.flo"): (np.ones((2, 3, 2), np.float32), np.ones((2, 3), np.float32))})
    >>> read_flow("one.flo").displacement[0, 0].tolist()
    [1.0, 1.0]
    """
    path = Path(path)
    check_field_name(path)
    try:
        with path.open("rb"):
            size = path.stat().st_size
    except OSError as error:
        raise UnreadableFile(
            f"cannot read {path}: {error.strerror}. Check the name and the permissions"
        ) from error
    if size == 0:
        raise UnreadableFile(f"{path} is empty (0 bytes). Copy it again")
    try:
        field, confidence = _read_flo(path) if path.suffix.lower() == ".flo" else _read_exr(path)
    except UnicodeDecodeError as error:  # OpenImageIO decodes the bytes of a damaged header as text
        raise UnreadableFile(f"{path} is damaged: its header is not text. Copy it again") from error
    bad = int(np.count_nonzero(~np.isfinite(field)) + np.count_nonzero(~np.isfinite(confidence)))
    if bad:
        raise BadInput(
            f"{path} holds {bad} values that are not finite; expected none. Write {UNKNOWN_PX:g} where flow is unknown"
        )
    low, high = float(confidence.min()), float(confidence.max())
    if low < 0 or high > 1:
        raise BadInput(f"{path} has a confidence from {low:.4g} to {high:.4g}; expected 0 to 1. Rescale it")
    known = np.logical_and(*np.moveaxis(np.abs(field) <= UNKNOWN_ABOVE_PX, -1, 0))
    field[~known] = 0
    return StoredFlow(field, np.where(known, confidence, np.float32(0)), known)


def write_flows(fields: Mapping[Path, tuple[Displacement, Mask]]) -> None:
    """Write flow fields that belong together: all or none. Equal fields give equal bytes.

    Parameters
    ----------
    fields : mapping of path to (displacement (h, w, 2) px, confidence (h, w) in [0, 1])
        The suffix chooses the format. A `.flo` does not store the confidence.

    Raises
    ------
    BadInput
        If a suffix is another, shapes disagree, or a value is not finite or so large that it means unknown flow.
    UnwritableFile
        If the folder or disk refuses a file.

    Examples
    --------
    >>> import numpy as np
    >>> field, sure = np.ones((2, 3, 2), np.float32), np.ones((2, 3), np.float32)
    >>> write_flows({Path("there.flo"): (field, sure), Path("back.flo"): (-field, sure)})
    >>> read_flow("back.flo").displacement[0, 0].tolist()
    [-1.0, -1.0]
    """
    with contextlib.ExitStack() as all_or_none:
        for path, parts in fields.items():
            check_field_name(path)
            field, confidence = _checked(path, *parts)
            temporary = all_or_none.enter_context(whole_file(path))
            _write_into(temporary, path, field, confidence)


def _checked(path: Path, displacement: Displacement, confidence: Mask) -> tuple[AnyArray, Mask]:
    """Return displacement and confidence as they are stored, in little-endian float32, or raise `BadInput`."""
    field = np.array(displacement, "<f4")
    confidence = np.array(confidence, "<f4")
    if field.ndim != 3 or field.shape[2] != 2 or field.size == 0 or confidence.shape != field.shape[:2]:
        raise BadInput(
            f"cannot write {path}: field and confidence have the shapes {field.shape} and {confidence.shape}; "
            "expected (h, w, 2) and (h, w). Take both from one flow"
        )
    if max(field.shape) > MOST_PX:
        raise BadInput(
            f"cannot write {path}: it has {field.shape[1]}x{field.shape[0]} px; expected at most {MOST_PX} a side. "
            "Reduce it"
        )
    bad = int(np.count_nonzero(~(np.abs(field) <= UNKNOWN_ABOVE_PX)))
    if bad:
        raise BadInput(
            f"cannot write {path}: {bad} of its values are not finite or beyond {UNKNOWN_ABOVE_PX:g} px; expected "
            "none"
        )
    if not ((confidence >= 0) & (confidence <= 1)).all():
        raise BadInput(f"cannot write {path}: its confidence leaves the range 0 to 1. Rescale it")
    return field, confidence


def _read_flo(path: Path) -> tuple[AnyArray, Mask]:
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(HEADER.size)
        if head[:4] != TAG[: len(head)]:
            raise UnreadableFile(
                f"{path} is not a .flo file: it starts with {head[:4]!r}; expected {TAG!r}. Check the file"
            )
        if len(head) < HEADER.size:
            raise UnreadableFile(
                f"{path} is cut short: {size} bytes; expected {HEADER.size} of header. Copy it again"
            )
        _, width, height = HEADER.unpack(head)
        if not (1 <= width <= MOST_PX and 1 <= height <= MOST_PX):
            raise UnreadableFile(
                f"{path} declares {width}x{height} px; expected 1 to {MOST_PX} a side. It is damaged or big-endian: "
                "write it again"
            )
        expected = HEADER.size + 8 * width * height
        if size != expected:
            fault = "cut short" if size < expected else "too long"
            raise UnreadableFile(
                f"{path} is {fault}: it has {size} bytes; expected {expected} for {width}x{height} px. Copy it again"
            )
        content = file.read()
    field = np.frombuffer(content, "<f4").reshape(height, width, 2).astype(np.float32)
    return field, np.ones((height, width), np.float32)


def _read_exr(path: Path) -> tuple[AnyArray, Mask]:
    source = oiio.ImageInput.open(str(path))
    if source is None or source.format_name() != "openexr":
        reason = first_line(oiio.geterror()) if source is None else f"it is a {source.format_name()} file"
        raise UnreadableFile(f"{path} is not a readable EXR file: {reason}. Write it again")
    try:
        spec = source.spec()
        names = [name.lower() for name in spec.channelnames]
        if sorted(names) not in (["u", "v"], sorted(CHANNELS)):
            raise BadInput(
                f"{path} has the channels {', '.join(spec.channelnames)}; expected {', '.join(CHANNELS)}. Rename them"
            )
        if (spec.width, spec.height) != (spec.full_width, spec.full_height):
            raise BadInput(
                f"{path} has a data window of {spec.width}x{spec.height} px; expected that of its display window, "
                f"{spec.full_width}x{spec.full_height}. Save it so"
            )
        stored = source.read_image(0, 0, 0, spec.nchannels, "float")
        if stored is None or source.has_error:
            raise UnreadableFile(
                f"{path} is damaged or cut short ({path.stat().st_size} bytes): {first_line(source.geterror())}. "
                "Copy it again"
            )
    finally:
        source.close()
    field = np.stack([stored[..., names.index(name)] for name in ("u", "v")], axis=-1)
    if "confidence" not in names:
        return field, np.ones(field.shape[:2], np.float32)
    return field, np.ascontiguousarray(stored[..., names.index("confidence")])


def _write_into(temporary: Path, path: Path, field: AnyArray, confidence: Mask) -> None:
    """Write a checked field to a temporary file, in the format of its final `path`."""
    height, width = field.shape[:2]
    if path.suffix.lower() == ".flo":
        temporary.write_bytes(HEADER.pack(TAG, width, height) + field.tobytes())
        return
    values = np.dstack([field, confidence])
    spec = oiio.ImageSpec(width, height, len(CHANNELS), "float")
    spec.channelnames = CHANNELS
    spec.attribute("DateTime", "")  # otherwise OpenImageIO writes the current time
    spec.attribute("compression", "zip")
    write_through(path, temporary, spec, values)
    _check_written(path, temporary, values)


def _check_written(path: Path, temporary: Path, values: AnyArray) -> None:
    """Read a new file back: OpenImageIO reports no error if the disk fills up with the last block."""
    try:
        field, confidence = _read_exr(temporary)
    except UnreadableFile as error:
        raise UnwritableFile(
            f"cannot write {path}: it cannot be read back. Check the space on the disk; nothing was changed"
        ) from error
    if not np.array_equal(np.dstack([field, confidence]), values):
        raise UnwritableFile(
            f"cannot write {path}: its values change when read back. Check the disk; nothing was changed"
        )
