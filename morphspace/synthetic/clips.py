"""Clip folders of actors, with the truth beside them: what `make-actors` writes and the tests read. Ours."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray
from morphspace.errors import BadInput, UnreadableFile
from morphspace.io.images import write_image
from morphspace.io.sidecars import MarkedFaceframe, Sidecar, write_sidecar
from morphspace.storage import read_container, write_container
from morphspace.synthetic.actor import Actor, ActorFrame
from morphspace.synthetic.drawn import DEFAULT_SIZE, drawn_actor
from morphspace.synthetic.painting import LABELS
from morphspace.synthetic.parameters import Identity
from morphspace.synthetic.performance import capture_sequence, expression_sequence
from morphspace.synthetic.portrait import portrait_actor

TRUTH_FORMAT = "morphspace-truth"
TRUTH_VERSION = 1
FRAME_RATE_HZ = 25.0  # Hz, written in clip.json
PORTRAIT_NAME = "portrait"


@dataclass(frozen=True, eq=False)
class ClipPiece:
    """One frame that was written; `truth` is the truth file, after an actor's last frame. Ours."""

    actor: str
    index: int
    frames: int
    path: Path
    truth: Path | None


@dataclass(frozen=True, eq=False)
class Truth:
    """The truth about a clip; arrays are read-only memory maps. Ours.

    `displacement` (n, h, w, 2) px from the first frame, `visibility` (n, h, w) uint8, `keypoints` (n, m, 2)
    px, `labels` (h, w) uint8 into `document["labels"]`, and the JSON document with names and parameters.
    """

    displacement: AnyArray
    visibility: AnyArray
    keypoints: AnyArray
    labels: AnyArray
    document: dict[str, Any]


def actor_names(identities: int, portraits: int = 0) -> tuple[str, ...]:
    """Return the names of drawn people and animated photographs. Raises `BadInput` unless there is one (ours).

    Examples
    --------
    >>> actor_names(2, 1)
    ('actor_01', 'actor_02', 'portrait')
    """
    if identities < 0 or portraits < 0 or identities + portraits < 1:
        raise BadInput(
            f"{identities} identities and {portraits} portraits were given; expected at least one. Give a number"
        )
    drawn = (f"actor_{k + 1:02d}" for k in range(identities))
    return (*drawn, *(PORTRAIT_NAME if k == 0 else f"{PORTRAIT_NAME}_{k + 1:02d}" for k in range(portraits)))


def make_actors(
    directory: Path,
    *,
    identities: int = 4,
    frames: int = 60,
    seed: int = 1,
    size: tuple[int, int] = DEFAULT_SIZE,
    head_motion_px: float = 0.0,
    light_change: float = 0.0,
    noise_sd: float = 0.0,
    portrait: int = 0,
) -> Iterator[ClipPiece]:
    """Write clip folders of drawn actors, `directory`/actor_01 and on, and their truth in `directory`/truth.

    `identities` drawn actors, then `portrait` performances of the portrait photograph, of `frames` frames
    each, the first at rest. `size` (width, height) px; `head_motion_px`, `light_change`, `noise_sd` as in
    `capture_sequence`. Gives a `ClipPiece` after each frame. The same arguments write the same bytes. Raises
    `BadInput` for counts that make no clip, `UnwritableFile` where the folder refuses. Ours.
    """
    names = actor_names(identities, portrait)
    if frames < 1:
        raise BadInput(f"{frames} frames were given; expected at least one. Give a number")
    directory = Path(directory)
    for k, name in enumerate(names):
        rng = np.random.default_rng([seed, k])
        if k < identities:
            actor = drawn_actor(Identity.random(rng), size)
        else:
            actor = portrait_actor(size)
        expressions = expression_sequence(frames, rng)
        captures = capture_sequence(
            frames, rng, head_motion_px=head_motion_px, light_change=light_change, noise_sd=noise_sd
        )
        drawn: list[ActorFrame] = []
        for index, (expression, capture) in enumerate(zip(expressions, captures, strict=True)):
            frame = actor.draw(expression, capture)
            path = directory / name / f"frame_{index:04d}.png"
            write_image(path, frame.image)
            drawn.append(replace(frame, image=frame.image[:0]))  # written; the truth needs the rest only
            truth = None
            if index == frames - 1:
                write_sidecar(directory / name / "clip.json", _sidecar(name, actor, drawn[0]))
                truth = directory / "truth" / f"{name}.truth"
                _write_truth(truth, name, actor, drawn, seed)
            yield ClipPiece(actor=name, index=index, frames=frames, path=path, truth=truth)


def read_truth(path: Path) -> Truth:
    """Open a truth file. Raises `UnreadableFile` where it is not one, or of a future version. Ours."""
    arrays, document = read_container(Path(path))
    if document.get("format") != TRUTH_FORMAT:
        raise UnreadableFile(
            f"{path} holds {document.get('format')!r}, not {TRUTH_FORMAT}: give a .truth file"
        )
    if document.get("version") != TRUTH_VERSION:
        raise UnreadableFile(
            f"{path} is of version {document.get('version')}, this program reads {TRUTH_VERSION}: "
            "update morphspace"
        )
    return Truth(
        displacement=arrays["displacement"],
        visibility=arrays["visibility"],
        keypoints=arrays["keypoints"],
        labels=arrays["labels"],
        document=document,
    )


def _sidecar(name: str, actor: Actor, first: ActorFrame) -> Sidecar:
    drawn = actor.identity is not None
    return Sidecar(
        identity=name,
        frame_rate_hz=FRAME_RATE_HZ,
        consent="drawn: no person" if drawn else "public-domain NASA portrait of Eileen Collins, animated",
        licence="CC0-1.0" if drawn else "public domain",
        faceframe=MarkedFaceframe(
            image="frame_0000.png", points=np.round(first.faceframe, 3), size=actor.size
        ),
        extra={"format": "morphspace-clip", "version": 1},
    )


def _write_truth(path: Path, name: str, actor: Actor, drawn: list[ActorFrame], seed: int) -> None:
    arrays: dict[str, AnyArray] = {
        "displacement": np.stack([frame.displacement for frame in drawn]),
        "keypoints": np.stack([frame.keypoints for frame in drawn]),
        "visibility": np.stack([frame.visibility for frame in drawn]).astype(np.uint8),
        "labels": actor.labels,
    }
    document = {
        "format": TRUTH_FORMAT,
        "version": TRUTH_VERSION,
        "actor": name,
        "seed": seed,
        "size": list(actor.size),
        "labels": list(LABELS),
        "keypoint_names": list(drawn[0].keypoint_names),
        "identity": None if actor.identity is None else actor.identity.as_dict(),
        "frames": [
            {
                "name": f"frame_{index:04d}.png",
                "expression": frame.expression.as_dict(),
                "capture": frame.capture.as_dict(),
                "head_motion": [[float(c) for c in row] for row in frame.head_motion],
                "faceframe": [[float(c) for c in row] for row in frame.faceframe],
            }
            for index, frame in enumerate(drawn)
        ],
    }
    write_container(path, arrays, document)
