"""Cache what several jobs of a batch share: digests of unchanged files, and encoded clips."""

from __future__ import annotations

from collections import OrderedDict
from functools import lru_cache
from pathlib import Path

import numpy as np

from morphspace.arrays import AnyArray
from morphspace.errors import UnreadableFile
from morphspace.grid import warp
from morphspace.io.framing import FramedClip
from morphspace.model.encode import encoded_frames, joined
from morphspace.model.loadings import Loadings
from morphspace.model.model import MorphModel
from morphspace.steps import Step, Steps, in_order
from morphspace.storage import digest_of_file

CLIPS_KEPT = 8  # encoded clips kept in a process
Encoded = tuple[
    Loadings, AnyArray
]  # loadings (n, k), and registrations (n, 2, 3) to the source's own pictures


def digest_of_kept(path: Path) -> str:
    """Return the SHA-256 of a file; compute it again only if the file's size or time of change differs.

    Raises `UnreadableFile` if the file cannot be read.
    """
    try:
        found = path.stat()
    except OSError as error:
        raise UnreadableFile(f"cannot read {path}: {error.strerror or error}") from error
    return _digest(path.resolve(), found.st_size, found.st_mtime_ns)


@lru_cache(maxsize=256)
def _digest(path: Path, size: int, changed_ns: int) -> str:
    del size, changed_ns  # they only serve as the cache's key
    return digest_of_file(path)


_ENCODED: OrderedDict[tuple[object, ...], Encoded] = OrderedDict()


def encoded_clip(model: MorphModel, source: FramedClip) -> Steps[Encoded]:
    """Encode a clip, or reuse the result for the same pictures and model.

    Returns
    -------
    loadings
        n rows of k loadings.
    registrations
        (n, 2, 3), from points of the aligned picture to points of the original picture, px.
    """
    key = (model.model_id, source.digests, source.names)
    if key not in _ENCODED:
        parts, registrations = [], []
        for encoded in encoded_frames(model, source):
            parts.append(encoded.loadings)
            registrations.append(warp.chain_affine(source.to_source, encoded.frame.registration))
            yield Step("encode", len(parts), len(source.names))
        _ENCODED[key] = joined(model, parts), np.stack(registrations)
        while len(_ENCODED) > CLIPS_KEPT:
            _ENCODED.popitem(last=False)
    _ENCODED.move_to_end(key)
    return _ENCODED[key]


def aligned_clip(model: MorphModel, source: FramedClip) -> Steps[AnyArray]:
    """Return the positions of the faces in their frames, (n, 2, 3), without encoding their expressions."""
    model, registrations = model.for_person(source.person), list[AnyArray]()
    indices = list(range(len(source.names)))
    items = zip(source.names, source.images(indices), strict=True)
    for frame in in_order(lambda item: model.align(item[1], item[0]), items):
        registrations.append(warp.chain_affine(source.to_source, frame.registration))
        yield Step("align", len(registrations), len(indices))
    return np.stack(registrations)
