"""What the independent judge measures: a face's expression from 68 landmarks, mimicry and identity from many faces.

The landmarks and embeddings come from benchmarks/judges/face.py, which wants an environment of its own; this file wants
numpy alone:

    python benchmarks/judges/measures.py mimicry SOURCE.npz MADE.npz [--target B.npz --source A.npz]
    python benchmarks/judges/measures.py identity A.npz B.npz MADE.npz
    python benchmarks/judges/measures.py table FRAMES.npz -o measures.csv

`mimicry` pairs frames by file name without suffix and prints, for each measure, Pearson's r and the least-squares slope
of what was made on the source, then their means; r is 1 and the slope 1 where the made face does what the source did.
Every measure is divided by the distance between the eyes of its own frame, so size, place and tilt of the head and the
distance to the camera drop out. With --target and --source the identity distances to both people follow.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

try:
    import numpy as np
except ImportError:
    print("measures: numpy is missing; run with a python that holds it", file=sys.stderr)
    sys.exit(2)

MEASURES = ("mouth_opening", "mouth_width", "lip_height", "brow_height", "eye_aperture", "jaw")
POINT_COUNT = 68
EMBEDDING_LENGTH = 128
LEAST_FRAMES = 3  # two points always lie on a line
LEAST_SD = 0.002  # of the eye distance, a tenth of a pixel on these faces: below it nothing moved

# Indices of the 68-point template (iBUG 300-W), from 0. "Right" is the subject's right, image left.
RIGHT_EYE = tuple(range(36, 42))
LEFT_EYE = tuple(range(42, 48))
RIGHT_EYE_CORNERS, LEFT_EYE_CORNERS = (36, 39), (42, 45)
RIGHT_LIDS, LEFT_LIDS = ((37, 41), (38, 40)), ((43, 47), (44, 46))  # upper, lower
RIGHT_BROW, LEFT_BROW = tuple(range(17, 22)), tuple(range(22, 27))
MOUTH_CORNERS = (48, 54)
OUTER_LIPS = ((50, 58), (51, 57), (52, 56))  # upper, lower
INNER_LIPS = ((61, 67), (62, 66), (63, 65))  # upper, lower
CHIN = (7, 8, 9)


@dataclass(frozen=True)
class Template:
    """Indices of the points that `expression` reads, of one detector; pairs of lids and lips are (upper, lower)."""

    right_eye_corners: tuple[int, ...]
    left_eye_corners: tuple[int, ...]
    right_lids: tuple[tuple[int, int], ...]
    left_lids: tuple[tuple[int, int], ...]
    right_brow: tuple[int, ...]
    left_brow: tuple[int, ...]
    mouth_corners: tuple[int, int]
    outer_lips: tuple[tuple[int, int], ...]
    inner_lips: tuple[tuple[int, int], ...]
    chin: tuple[int, ...]


IBUG = Template(
    RIGHT_EYE_CORNERS,
    LEFT_EYE_CORNERS,
    RIGHT_LIDS,
    LEFT_LIDS,
    RIGHT_BROW,
    LEFT_BROW,
    MOUTH_CORNERS,
    OUTER_LIPS,
    INNER_LIPS,
    CHIN,
)
MESH = Template(  # of the 478-point face mesh, the same places
    (33, 133),
    (362, 263),
    ((160, 144), (158, 153)),
    ((385, 380), (387, 373)),
    (70, 63, 105, 66, 107),
    (336, 296, 334, 293, 300),
    (61, 291),
    ((37, 84), (0, 17), (267, 314)),
    ((82, 87), (13, 14), (312, 317)),
    (148, 152, 377),
)


class Refusal(Exception):
    """Say what is wrong with the input and what to do next, in one line; `main` prints it and returns 2."""


@dataclass(frozen=True, eq=False)
class Readings:
    """What the judge read in n pictures.

    `names` without suffix | `found` (n,) | `landmarks` (n, 68, 2) px | `embeddings` (n, 128). Rows where no face was
    found are nan.
    """

    names: tuple[str, ...]
    found: np.ndarray
    landmarks: np.ndarray
    embeddings: np.ndarray


def expression(landmarks: np.ndarray, template: Template = IBUG) -> np.ndarray:
    """Return the measures named in MEASURES, (n, 6), of landmarks (n, m, 2), in eye distances (ours).

    `template` says which of the m points they are; the usual are the 68 of iBUG.

    The corners of both eyes give the line through the eyes and their distance; "down" is at right angles to it. Gaps
    are signed, lower minus upper, so the noise of a closed mouth does not add up to an opening. `lip_height` is from
    the upper lip's upper edge to the lower lip's lower edge, `brow_height` from the eye's corners up to its brow, `jaw`
    from the eyes down to the chin. Rows that are nan stay nan.
    """
    right = landmarks[:, list(template.right_eye_corners)].mean(axis=1)
    left = landmarks[:, list(template.left_eye_corners)].mean(axis=1)
    across = left - right
    eyes = np.hypot(across[:, 0], across[:, 1])[:, None]
    along = across / eyes
    down = np.column_stack([-along[:, 1], along[:, 0]])

    def below(origin: np.ndarray, points: np.ndarray) -> np.ndarray:
        return np.einsum("nd,nd->n", points - origin, down)

    def middle(places: Sequence[int]) -> np.ndarray:
        return landmarks[:, list(places)].mean(axis=1)

    def gap(pairs: Sequence[tuple[int, int]]) -> np.ndarray:
        upper, lower = zip(*pairs, strict=True)
        return below(middle(upper), middle(lower))

    corners = landmarks[:, template.mouth_corners[1]] - landmarks[:, template.mouth_corners[0]]
    columns = (
        gap(template.inner_lips),
        np.hypot(corners[:, 0], corners[:, 1]),
        gap(template.outer_lips),
        (below(middle(template.right_brow), right) + below(middle(template.left_brow), left)) / 2,
        (gap(template.right_lids) + gap(template.left_lids)) / 2,
        below((right + left) / 2, middle(template.chin)),
    )
    return np.column_stack(columns) / eyes


def mimicry(source: np.ndarray, made: np.ndarray) -> np.ndarray:
    """Give Pearson's r and the least-squares slope of `made` on `source`, (m, 2), of measures (n, m) in one order.

    Rows with a nan in either are left out. A measure that does not move in the source has neither r nor slope (nan: not
    judged); one that moves there and not in `made` has r 0. Raises Refusal for fewer than three rows.
    """
    both = np.isfinite(source).all(axis=1) & np.isfinite(made).all(axis=1)
    if both.sum() < LEAST_FRAMES:
        raise Refusal(f"a face was found in {both.sum()} frames of both; {LEAST_FRAMES} are needed")
    x, y = source[both] - source[both].mean(axis=0), made[both] - made[both].mean(axis=0)
    power_x, power_y, shared = (x * x).mean(axis=0), (y * y).mean(axis=0), (x * y).mean(axis=0)
    moves = np.sqrt(power_x) >= LEAST_SD
    r = np.where(power_y > 0, shared / np.sqrt(np.maximum(power_x * power_y, np.finfo(float).tiny)), 0.0)
    slope = shared / np.maximum(power_x, np.finfo(float).tiny)
    return np.where(moves[:, None], np.column_stack([r, slope]), np.nan)


def identity_distance(made: np.ndarray, person: np.ndarray) -> float:
    """Give how far the faces `made` (n, 128) are from a `person` (m, 128).

    That is their mean distance from the person's mean embedding. Rows that are nan are left out; nan where none is
    left.
    """
    ours, theirs = _found_rows(made), _found_rows(person)
    if not (len(ours) and len(theirs)):
        return float("nan")
    return float(np.linalg.norm(ours - theirs.mean(axis=0), axis=1).mean())


def pair_distance(made: np.ndarray, person: np.ndarray) -> float:
    """Give the mean distance between every face of `made` (n, 128) and every one of `person` (m, 128).

    This is the distance that the embedding was trained on: two pictures of one person are nearer than 0.6. For a set
    with itself a picture is not paired with itself.
    """
    ours, theirs = _found_rows(made), _found_rows(person)
    distances = np.linalg.norm(ours[:, None] - theirs[None], axis=-1)
    if made is person:
        distances = distances[~np.eye(len(ours), dtype=bool)]
    return float(distances.mean()) if distances.size else float("nan")


def _found_rows(embeddings: np.ndarray) -> np.ndarray:
    return embeddings[np.isfinite(embeddings).all(axis=1)]


def paired(source: Readings, made: Readings) -> tuple[np.ndarray, np.ndarray]:
    """Give the rows of `source` and of `made` that share a name, in the order of `source`. Raises Refusal for none."""
    place = {name: row for row, name in enumerate(made.names)}
    pairs = [(row, place[name]) for row, name in enumerate(source.names) if name in place]
    if not pairs:
        raise Refusal(
            f"no name is in both: the source has {source.names[0]}, what was made has {made.names[0]}; call them alike"
        )
    ours, theirs = zip(*pairs, strict=True)
    return np.array(ours), np.array(theirs)


def read_readings(path: Path) -> Readings:
    """Read a file that face.py wrote. Raises Refusal."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            parts = {name: stored[name] for name in ("names", "found", "landmarks", "embeddings")}
    except (OSError, ValueError, KeyError) as error:
        raise Refusal(f"{path} is not a file of readings ({error}); write it with face.py -o") from error
    count = len(parts["names"])
    shapes = {
        "found": (count,),
        "landmarks": (count, POINT_COUNT, 2),
        "embeddings": (count, EMBEDDING_LENGTH),
    }
    for name, shape in shapes.items():
        if parts[name].shape != shape:
            raise Refusal(
                f"{path}: {name} has the shape {parts[name].shape}, {shape} was expected; write it again"
            )
    names = tuple(Path(str(name)).stem for name in parts["names"])
    return Readings(names, parts["found"].astype(bool), parts["landmarks"], parts["embeddings"])


def run_mimicry(arguments: argparse.Namespace) -> None:
    """Print r and slope of each measure, their means, and the identity distances when asked."""
    source, made = read_readings(arguments.source_frames), read_readings(arguments.made)
    ours, theirs = paired(source, made)
    x, y = expression(source.landmarks[ours]), expression(made.landmarks[theirs])
    found = mimicry(x, y)
    print(f"{len(ours)} frames in both, a face in {source.found[ours].sum()} and {made.found[theirs].sum()}")
    print(f"{'measure':<16}{'r':>8}{'slope':>8}{'sd of source':>14}{'sd of made':>12}")
    for index, name in enumerate(MEASURES):
        sds = f"{np.nanstd(x[:, index]):>14.4f}{np.nanstd(y[:, index]):>12.4f}"
        print(f"{name:<16}{found[index, 0]:>8.3f}{found[index, 1]:>8.3f}{sds}")
    judged = np.isfinite(found[:, 0])
    if judged.any():
        mean_r, mean_slope = found[judged].mean(axis=0)
        print(f"{'mean of ' + str(judged.sum()):<16}{mean_r:>8.3f}{mean_slope:>8.3f}")
    for name, path in (("target", arguments.target), ("source", arguments.source)):
        if path is not None:
            print(
                f"identity to {name}: {identity_distance(made.embeddings, read_readings(path).embeddings):.3f}"
            )


def run_identity(arguments: argparse.Namespace) -> None:
    """Print the identity distance of each set of faces (rows) to each (columns), then the distances by pairs."""
    sets = [read_readings(path) for path in arguments.readings]
    names = [path.stem[:14] for path in arguments.readings]
    for heading, measured in (("to the mean face", identity_distance), ("picture to picture", pair_distance)):
        print(f"{heading:<20}" + "".join(f"{name:>15}" for name in names))
        for name, one in zip(names, sets, strict=True):
            row = [measured(one.embeddings, other.embeddings) for other in sets]
            print(f"{name:<20}" + "".join(f"{value:>15.3f}" for value in row))


def run_table(arguments: argparse.Namespace) -> None:
    """Write the measures of each frame as CSV, in eye distances."""
    readings = read_readings(arguments.readings)
    values = expression(readings.landmarks)
    part = arguments.output.with_name(arguments.output.name + ".part")
    with part.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(["file", "found", *MEASURES])
        for name, found, row in zip(readings.names, readings.found, values, strict=True):
            table.writerow([name, int(found), *(f"{value:.5f}" if found else "" for value in row)])
    part.replace(arguments.output)


def main(words: Sequence[str]) -> int:
    """Run the mode named by the first word; return the exit status."""
    parser = argparse.ArgumentParser(prog="measures.py", description="see the top of this file")
    modes = parser.add_subparsers(dest="mode", required=True)
    one = modes.add_parser("mimicry", help="r and slope of what was made on the source")
    one.add_argument("source_frames", type=Path, help="readings of the driving frames")
    one.add_argument("made", type=Path, help="readings of what was made of them, under the same names")
    one.add_argument("--target", type=Path, help="readings of the person that should be seen")
    one.add_argument("--source", type=Path, help="readings of the person that should not")
    two = modes.add_parser("identity", help="distances between people")
    two.add_argument("readings", nargs="+", type=Path)
    three = modes.add_parser("table", help="the measures of each frame as CSV")
    three.add_argument("readings", type=Path)
    three.add_argument("-o", "--output", type=Path, required=True)
    arguments = parser.parse_args(words)
    try:
        {"mimicry": run_mimicry, "identity": run_identity, "table": run_table}[arguments.mode](arguments)
    except Refusal as refusal:
        print(f"measures: {refusal}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
