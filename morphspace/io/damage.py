"""Signs of damage that libav does not report: videos cut short, and slices of FFV1 with another checksum (ours)."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from morphspace.errors import UnreadableFile

EBML_HEADER, SEGMENT = 0x1A45DFA3, 0x18538067  # Matroska element identifiers (RFC 8794, RFC 9559)
MP4_FIRST_BOXES = (b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide")
FFV1_TRAILERS = (8, 3)  # bytes after a slice: its length (3), and with checksums a mark (1) and the CRC (4)
BIT_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def check_whole(path: Path) -> None:
    """Raise `UnreadableFile` if a file is empty, or shorter than the sum of the lengths that its parts declare.

    libav reports no error for a truncated Matroska or WebM file, nor for an AVI or an MP4 with leading index
    truncated between two frames. The clip would lose its last expressions. An MPEG stream declares no length.
    """
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(12)
            file.seek(0)
            needed = size
            if head[:4] == EBML_HEADER.to_bytes(4, "big"):
                needed = _matroska_end(file)
            elif head[4:8] in MP4_FIRST_BOXES:
                needed = _parts_end(file, size, _box_bytes)
            elif head[:4] == b"RIFF":
                needed = _parts_end(file, size, _riff_bytes)
    except OSError as error:
        raise UnreadableFile(
            f"cannot read {path}: {error.strerror}. Check the name and the permissions"
        ) from error
    if size == 0:
        raise UnreadableFile(f"{path} is empty (0 bytes). Copy it again")
    if needed > size:
        raise UnreadableFile(f"{path} is cut short: it has {size} bytes; expected {needed}. Copy it again")


def _parts_end(file: BinaryIO, size: int, bytes_of: Callable[[bytes], int]) -> int:
    """Return where the last part at the top level ends; `bytes_of` reads the length of a part from its first bytes."""
    place = 0
    while place + 8 <= size:
        file.seek(place)
        length = bytes_of(file.read(16))
        if length < 8:  # the part extends to the end of the file, or is padding
            return size
        place += length
    return place


def _box_bytes(head: bytes) -> int:
    length = int.from_bytes(head[:4], "big")
    return int.from_bytes(head[8:16], "big") if length == 1 else length


def _riff_bytes(head: bytes) -> int:
    return 8 + int.from_bytes(head[4:8], "little") if head[:4] == b"RIFF" else 0


def _matroska_end(file: BinaryIO) -> int:
    """Return where the segment ends; 0 for a live recording, whose length is unknown."""
    _read_number(file)
    _, header_length, _ = _read_number(file)
    file.seek(header_length, 1)
    kind, _, _ = _read_number(file)
    _, length, width = _read_number(file)
    is_unknown = length == (1 << 7 * width) - 1
    return 0 if kind != SEGMENT or is_unknown else file.tell() + length


def _read_number(file: BinaryIO) -> tuple[int, int, int]:
    """Read an EBML number: with its width marker (an identifier), without it (a length), and its width in bytes."""
    first = file.read(1)
    if not first or first[0] == 0:
        return 0, 0, 0
    width = 9 - first[0].bit_length()  # the leading zeros of the first byte give the number of bytes
    number = int.from_bytes(first + file.read(width - 1), "big")
    return number, number & ((1 << 7 * width) - 1), width


def is_whole_ffv1(packet: bytes) -> bool:
    """Return whether the slices of an FFV1 frame fill it and have the checksums that they carry (RFC 9043, 4.9).

    libav decodes a slice with another checksum and reports it in its log only. The CRC of RFC 9043 is zlib's with
    the order of the bits reversed, and starts from 0; that of a slice with its own CRC is 0.
    """
    for trailer in FFV1_TRAILERS:
        end = len(packet)
        matches = True
        while end >= trailer:
            start = end - trailer - int.from_bytes(packet[end - trailer : end - trailer + 3], "big")
            if start < 0:
                break
            if trailer > 3:
                whole = packet[start:end].translate(BIT_REVERSED)
                matches = matches and zlib.crc32(whole, 0xFFFFFFFF) == 0xFFFFFFFF
            end = start
        if end == 0:
            return matches
    return False
