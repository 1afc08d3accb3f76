"""PNG files with embedded texts: the description of a stimulus stays with its image when the file is sent alone.

The texts are iTXt chunks (PNG, third edition, section 11.3.3.4): UTF-8, not compressed. Equal images and texts give
equal bytes.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np

from morphspace.arrays import AnyArray
from morphspace.errors import UnreadableFile
from morphspace.io.images import PNG_SIGNATURE

LEVEL = 4  # of compression, 0 to 9; on faces files are 5 % larger than with 6, in a third of the time
HEADER_END = 33  # bytes of the signature and IHDR
PERCEPTUAL = b"\0"  # rendering intent in the sRGB chunk, which declares the colours as sRGB
OPTIONS = [
    *(cv2.IMWRITE_PNG_COMPRESSION, LEVEL),
    *(cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_DEFAULT),
    *(cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_ALL_FILTERS),
]


def png_with_texts(codes: AnyArray, texts: Mapping[str, str]) -> bytes:
    """Encode 8-bit codes (h, w, 3) uint8 as a PNG with these texts, keyword to text.

    Examples
    --------
    >>> import numpy as np
    >>> b"iTXtComment" in png_with_texts(np.zeros((1, 1, 3), np.uint8), {"Comment": "mean face"})
    True
    """
    _, content = cv2.imencode(".png", np.ascontiguousarray(codes[..., ::-1]), OPTIONS)
    plain = content.tobytes()
    chunks = _chunk(b"sRGB", PERCEPTUAL)
    for keyword, words in texts.items():
        chunks += _chunk(b"iTXt", keyword.encode("latin-1") + b"\0\0\0\0\0" + words.encode())
    return plain[:HEADER_END] + chunks + plain[HEADER_END:]


def png_texts(path: Path) -> dict[str, str]:
    """Return the iTXt texts before the pixels of a PNG, keyword to text. Raises `UnreadableFile`."""
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise UnreadableFile(
            f"cannot read {path}: {error.strerror}. Check the name and the permissions"
        ) from error
    texts = {}
    for kind, data in _chunks(content):
        keyword, _, rest = data.partition(b"\0")
        if kind == b"iTXt" and rest[:2] == b"\0\0":
            words = rest[2:].split(b"\0", 2)[-1]
            texts[keyword.decode("latin-1")] = words.decode("utf-8", "replace")
    return texts


def _chunks(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield the type and data of each chunk before the pixels."""

    place = len(PNG_SIGNATURE)
    while content.startswith(PNG_SIGNATURE) and place + 12 <= len(content):
        length = int.from_bytes(content[place : place + 4], "big")
        kind = content[place + 4 : place + 8]
        if kind == b"IDAT":
            return
        yield kind, content[place + 8 : place + 8 + length]
        place += 12 + length


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
