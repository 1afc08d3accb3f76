"""Whether a video file is as long as it says it is (ours).

Decoders stop at the end of a file that was cut short as if the clip ended there, and a clip that lost its
last expressions would be modelled without a word. Matroska, MP4/MOV and AVI write the lengths of their parts
into the file; only those lengths are read here. An MPEG stream holds no such length and passes unchecked.
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from morphspace.errors import UnreadableFile

EBML_HEADER, SEGMENT = 0x1A45DFA3, 0x18538067  # Matroska element numbers (RFC 8794, RFC 9559)
MP4_FIRST_BOXES = (b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide")


def check_length(path: Path) -> None:
    """Raise `UnreadableFile` where a Matroska, MP4, MOV or AVI file is shorter than its own lengths add up
    to.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(12)
            file.seek(0)
            if head[:4] == EBML_HEADER.to_bytes(4, "big"):
                needed = _matroska_end(file)
            elif head[4:8] in MP4_FIRST_BOXES:
                needed = _boxes_end(file, size)
            elif head[:4] == b"RIFF":
                needed = _riff_end(file, size)
            else:
                needed = size
    except OSError as error:
        raise UnreadableFile(
            f"cannot read {path}: {error.strerror}; check the name and the permissions"
        ) from error
    if size == 0:
        raise UnreadableFile(f"{path} is empty (0 bytes): copy it again")
    if needed > size:
        raise UnreadableFile(f"{path} is cut short: {needed} bytes expected, {size} found; copy it again")


def _matroska_end(file: BinaryIO) -> int:
    """Give where the segment ends; a live recording of unknown length counts as whole."""
    _read_number(file)
    _, header_length, _ = _read_number(file)
    file.seek(header_length, 1)
    kind, _, _ = _read_number(file)
    _, length, width = _read_number(file)
    is_unknown = length == (1 << 7 * width) - 1
    return 0 if kind != SEGMENT or is_unknown else file.tell() + length


def _read_number(file: BinaryIO) -> tuple[int, int, int]:
    """Read an EBML number: as it stands (an element's name), without its width marker (a length), its width
    in bytes.
    """
    first = file.read(1)
    if not first or first[0] == 0:
        return 0, 0, 0
    width = 9 - first[0].bit_length()  # the leading zeros of the first byte tell how many bytes follow
    number = int.from_bytes(first + file.read(width - 1), "big")
    return number, number & ((1 << 7 * width) - 1), width


def _boxes_end(file: BinaryIO, size: int) -> int:
    """Walk the top-level boxes of an MP4 or MOV file; give where the last one ends."""
    place = 0
    while place + 8 <= size:
        file.seek(place)
        head = file.read(16)
        length = int.from_bytes(head[:4], "big")
        if length == 1:
            length = int.from_bytes(head[8:16], "big")
        if length < 8:  # 0: the last box reaches to the end of the file; 1 to 7: padding
            return size
        place += length
    return place


def _riff_end(file: BinaryIO, size: int) -> int:
    """Walk the RIFF chunks of an AVI file; give where the last one ends."""
    place = 0
    while place + 8 <= size:
        file.seek(place)
        head = file.read(8)
        if head[:4] != b"RIFF":
            return size
        place += 8 + int.from_bytes(head[4:], "little")
    return place
