"""Make the picture strip of the README from drawn people and scikit-image's public-domain portrait.

    python examples/picture_strip.py docs/strip.png

From left to right: a frame of a drawn person; a weaker and a stronger version of that expression; another drawn person
with the same expression; a blend of the two, which shows nobody; and an animated photograph.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import cv2
import numpy as np

import morphspace as ms
from morphspace.synthetic import make_actors

SIZE = (160, 192)  # px
FRAMES, SEED = 30, 1
GAINS = (0.4, 1.7)
CAPTIONS = ("a frame", f"gain {GAINS[0]:g}", f"gain {GAINS[1]:g}", "mimicry", "a blend", "a photograph")


def most_expressive(faces: ms.Loadings) -> int:
    """Return the frame furthest from the mean face."""
    return int(np.abs(faces.values).sum(axis=1).argmax())


def captioned(image: np.ndarray, words: str) -> np.ndarray:
    """Return an image (h, w, 3) in [0, 1] over a white line with words."""
    line = np.full((22, image.shape[1], 3), 255, np.uint8)
    cv2.putText(line, words, (6, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (50, 50, 50), 1, cv2.LINE_AA)
    return np.vstack([image, line.astype(np.float32) / 255])


def strip(folder: Path) -> np.ndarray:
    """Return the strip (h, w, 3) in [0, 1]; `folder` holds the clips meanwhile."""
    for _ in make_actors(folder, identities=2, portrait=1, frames=FRAMES, size=SIZE, seed=SEED):
        pass
    clips = sorted(path for path in folder.iterdir() if path.is_dir() and path.name != "truth")
    anna, ben, portrait = (ms.build(clip, landmarks="none") for clip in clips)
    face = most_expressive(anna.training)
    one = anna.training[face]
    weaker, stronger = ms.caricature(anna, one, gains=GAINS)
    nobody = ms.blend(anna, ben, expressions=12, surround=ben.identity)
    faces = (
        anna.render(one),
        weaker,
        stronger,
        ms.mimic(anna, ben, one)[0],
        ms.mimic(anna, nobody, one)[0],
        portrait.render(portrait.training[most_expressive(portrait.training)]),
    )
    return np.hstack(
        [captioned(np.clip(face, 0, 1), words) for face, words in zip(faces, CAPTIONS, strict=True)]
    )


def main() -> None:
    """Write the strip."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("output", type=Path)
    words = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        ms.write_image(words.output, strip(Path(folder)))


if __name__ == "__main__":
    main()
