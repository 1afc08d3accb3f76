"""Draw one stimulus, a picture or a video, and write the sidecar from which it can be drawn again (ours).

A complete stimulus is kept: the sidecar holds the digest of all its sources and of the stimulus file. The stimulus is
written first, so a sidecar implies a complete stimulus.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from morphspace.arrays import AnyArray, Image
from morphspace.errors import BadInput, UnreadableFile
from morphspace.grid import warp
from morphspace.io.clips import Clip, open_clip
from morphspace.io.colour import check_image, codes_of
from morphspace.io.png import png_with_texts
from morphspace.io.stimulus_sidecars import file_texts, read_stimulus_sidecar, sidecar_text
from morphspace.model.model import MorphModel
from morphspace.requests import ClipOptions, recorded_path
from morphspace.steps import single_threads
from morphspace.stimuli.drawing import Drawing
from morphspace.stimuli.drawn import morphs_and_images
from morphspace.stimuli.image_statistics import image_statistics
from morphspace.stimuli.plausibility import plausibility, plausible_limits_sd
from morphspace.storage import digest_of_bytes, digest_of_file, digest_of_json, whole_file, write_text

PERCENT_DIGITS = 6  # decimals in a sidecar
DECIDING = (  # sidecar entries that, with the drawing, determine the bytes of a stimulus
    *("format", "version", "verb", "request", "model", "inputs", "units", "consent", "licence", "versions"),
)


@dataclass(frozen=True, eq=False)
class Drawn:
    """Result of drawing a file: frames, size (w, h) px, clipped values, folded share and image statistics."""

    frames: int
    size: tuple[int, int]
    clipped_values: int
    folded_share: float
    statistics: Mapping[str, Mapping[str, float | None]]


def make_stimulus(
    model: MorphModel,
    drawing: Drawing,
    head: Mapping[str, Any],
    folder: Path,
    workers: int = 1,
    files: tuple[Path, Path] | None = None,
) -> dict[str, Any]:
    """Draw a stimulus and its sidecar into a folder, or keep complete ones; return the manifest row.

    The same model, drawing and head give the same bytes.

    Parameters
    ----------
    head
        Entries that all sidecars of a set share (`PlannedSet.sidecar_head`).
    workers
        Number of video frames to draw in parallel.
    files
        Paths of stimulus and sidecar; None for their usual names in `folder`.

    Raises
    ------
    UnwritableFile
        If one of the files cannot be written.
    """
    path, sidecar = files or (folder / drawing.file_name, folder / f"{drawing.name}.json")
    document = {key: value for key, value in head.items() if key != "request_sha256"}
    document |= {"inputs": _inputs_of(drawing, head["inputs"]), "drawing": _as_json(drawing)}
    document["made_from_sha256"] = made_from_of(document)
    kept = _kept(path, sidecar, drawing, document["made_from_sha256"])
    if kept is not None:
        return kept
    with single_threads():
        drawn = draw_file(model, drawing, head, path, workers)
    document["statistics"] = drawn.statistics
    document["quality"] = quality_of(model, drawing, drawn)
    document["output"] = {
        "file": path.name,
        "sha256": digest_of_file(path),
        "bytes": path.stat().st_size,
        "frames": drawn.frames,
        "frame_rate_hz": drawing.frame_rate_hz,
        "size": list(drawn.size),
    }
    text = sidecar_text(document)
    write_text(sidecar, text)
    return _row(drawing, document, digest_of_bytes(text.encode()))


def made_from_of(document: Mapping[str, Any]) -> str:
    """Compute the digest of all sidecar entries that determine the bytes of the stimulus."""
    head = {key: document.get(key) for key in DECIDING}
    head["request_sha256"] = digest_of_json(head["request"])
    drawing = digest_of_bytes(sidecar_text(document["drawing"]).encode())
    return digest_of_json([digest_of_json(head), drawing])


def _inputs_of(drawing: Drawing, inputs: Mapping[str, str]) -> dict[str, str]:
    """Return the inputs of one stimulus; of a clip, only the frame that the stimulus shows.

    The record of the set lists all frames of the clip.
    """
    own = {
        f"clip/{drawing.variables[key]}" for key in ("frame", "original") if key in drawing.variables
    } & set(inputs)
    return {
        name: digest
        for name, digest in inputs.items()
        if not own or name in own or not name.startswith("clip/")
    }


def _as_json(drawing: Drawing) -> dict[str, Any]:
    """Return the drawing as JSON for its sidecar, without the clip's path on this disk."""
    document = drawing.document()
    if drawing.placing is not None:
        words = [recorded_path(Path(source)) for source in drawing.placing.sources]
        document["placing"] = {**document["placing"], "sources": words}
    return document


def draw_file(
    model: MorphModel, drawing: Drawing, head: Mapping[str, Any], path: Path, workers: int = 1
) -> Drawn:
    """Draw a stimulus into the file `path`, embed the essentials of `head`, and measure it."""
    folded = [0.0]

    def images() -> Iterator[Image]:
        for morph, image in morphs_and_images(model, drawing, originals_of(drawing), workers):
            folded[0] = max(folded[0], warp.fold_fraction(morph.displacement, model.mask))
            yield image

    texts = file_texts(head, drawing.variables, drawing.suffix)
    if drawing.frame_rate_hz is None:
        image = next(iter(images()))
        check_image(image, str(path))
        codes, clipped = codes_of(image, 8)
        content = png_with_texts(codes, texts)
        with whole_file(path) as temporary:
            temporary.write_bytes(content)
        return Drawn(1, (codes.shape[1], codes.shape[0]), clipped, folded[0], image_statistics([codes]))
    from morphspace.io.video import write_video  # loads libav, which stills do not need

    encoding: Literal["lossless", "people"] = "lossless" if drawing.suffix == ".mkv" else "people"
    rate = drawing.frame_rate_hz
    clipped = write_video(path, images(), frame_rate_hz=rate, encoding=encoding, metadata=texts)
    video = _DecodedVideo(path)
    statistics = image_statistics(video.codes())
    return Drawn(len(drawing.loadings_sd), video.size, clipped, folded[0], statistics)


class _DecodedVideo:
    """A video as a viewer sees it, read back from its file because a lossy encoder changes the pixels."""

    def __init__(self, path: Path) -> None:
        self.path, self.size = path, (0, 0)

    def codes(self) -> Iterator[AnyArray]:
        """Yield the frames as 8-bit codes (h, w, 3)."""
        from morphspace.io.video import read_frames

        for image in read_frames(self.path):
            self.size = image.shape[1], image.shape[0]
            yield codes_of(image, 8)[0]


def originals_of(drawing: Drawing) -> Iterator[Image] | None:
    """Return the original pictures for a drawing, one per frame; None if the face is not put back into pictures.

    Raises `BadInput` if a picture is missing from its clip or has changed.
    """
    if drawing.placing is None:
        return None
    clip = _opened(drawing.placing.sources, drawing.placing.options)
    places, digests = [], clip.digests()
    for name in drawing.placing.names:
        if name not in clip.frame_names:
            raise BadInput(f"{drawing.name} is put back into frame {name} of {clip.name}, which is missing")
        places.append(clip.frame_names.index(name))
    for name, digest, place in zip(drawing.placing.names, drawing.placing.digests, places, strict=True):
        found = digests[place]
        if found != digest:
            raise BadInput(
                f"{drawing.name} is put back into frame {name} of {clip.name}, which has changed: its digest is "
                f"{found[:16]}; expected {digest[:16]}"
            )
    return clip.images(places)


@lru_cache(maxsize=4)
def _opened(sources: tuple[str, ...], options: ClipOptions) -> Clip:
    """Open a clip once for all stimuli that use its frames; the pictures are checked at each use."""
    return open_clip(sources, options)


def _kept(path: Path, sidecar: Path, drawing: Drawing, made_from: str) -> dict[str, Any] | None:
    """Return the manifest row of a stimulus that is complete; None otherwise."""
    if not (sidecar.exists() and path.exists()):
        return None
    try:
        document = read_stimulus_sidecar(sidecar)
        recorded, sha256 = document["made_from_sha256"], document["output"]["sha256"]
        if made_from != recorded or made_from_of(document) != made_from or sha256 != digest_of_file(path):
            return None
        return _row(drawing, document, digest_of_file(sidecar))
    except UnreadableFile:
        return None  # incomplete or damaged


def is_as_written(sidecar: Path) -> bool:
    """Return whether a sidecar has the text and the digest of its entries with which `make_stimulus` writes it."""
    try:
        document = read_stimulus_sidecar(sidecar)
    except UnreadableFile:
        return False
    same_text = sidecar.read_text(encoding="utf-8") == sidecar_text(document)
    return same_text and made_from_of(document) == document["made_from_sha256"]


def quality_of(model: MorphModel, drawing: Drawing, drawn: Drawn) -> dict[str, Any]:
    """Return the sidecar's `quality`: clipped values, folds, and distance from the mean face."""
    tables = [
        table for table in (drawing.loadings_sd, drawing.colour_sd, drawing.outside_sd) if table is not None
    ]
    plausible = plausibility(plausible_limits_sd(model), tables)
    values = 3 * drawn.frames * drawn.size[0] * drawn.size[1]
    return {
        "clipped_values": drawn.clipped_values,
        "clipped_percent": round(100 * drawn.clipped_values / values, PERCENT_DIGITS),
        "folded_percent": round(100 * drawn.folded_share, PERCENT_DIGITS),
        "largest_sd": plausible.largest_sd,
        "largest_component": plausible.largest_component,
        "rms_sd": plausible.rms_sd,
        "beyond": list(plausible.beyond),
    }


def _row(drawing: Drawing, document: Mapping[str, Any], sidecar_sha256: str) -> dict[str, Any]:
    """Return the manifest row of a stimulus from its sidecar."""
    output, quality, model = document["output"], document["quality"], document["model"]
    row: dict[str, Any] = {
        "name": drawing.name,
        "file": drawing.file_name,
        "verb": document["verb"],
        "identity": model["identity"],
        "model_id": model["model_id"],
        **drawing.variables,
        "frames": output["frames"],
        "frame_rate_hz": output["frame_rate_hz"],
        "width_px": output["size"][0],
        "height_px": output["size"][1],
    }
    for space, figures in document["statistics"].items():
        row |= {f"{space}_{figure}": value for figure, value in figures.items()}
    row["clipped_percent"], row["folded_percent"] = quality["clipped_percent"], quality["folded_percent"]
    row["largest_sd"], row["largest_component"] = quality["largest_sd"], quality["largest_component"]
    row["rms_sd"] = quality["rms_sd"]
    row["beyond"] = " ".join(f"pc{component:03d}" for component in quality["beyond"])
    row |= {key: document[key] or "" for key in ("consent", "licence")}
    return {**row, "sha256": output["sha256"], "sidecar_sha256": sidecar_sha256}
