"""Measure faces with a landmark detector that shares no code with morphspace, to judge what the package made.

The detector wants its own environment, because it brings a build of OpenCV that would replace the one
morphspace uses. Make it once from the package index, with Python 3.11; the wheel holds the face model, so
nothing else is fetched:

    python3 -m venv judge
    judge/bin/python -m pip install mediapipe==0.10.21

Then, for frames and for what a model rendered of them under the same file names:

    judge/bin/python benchmarks/judges/mesh.py FRAMES_DIR -o frames.csv --points frames_points.csv
    judge/bin/python benchmarks/judges/mesh.py RENDERED_DIR -o rendered.csv
    judge/bin/python benchmarks/judges/mesh.py compare frames.csv rendered.csv
    judge/bin/python benchmarks/judges/mesh.py jitter FRAMES_DIR

`compare` needs numpy alone. `jitter` tells how far two readings of the same face disagree and, from that, the
highest correlation and slope `compare` can be expected to print for a perfect rendering.

Each image is read from several slightly scaled, turned and shifted copies of itself and the landmarks are
averaged. On 200 x 240 px frames this cuts the jitter to about a half; enlarging does not help there,
since the model resamples each face to 192 px, so it is left to the option --upscale.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

DETECTOR = "mediapipe==0.10.21"

try:
    import numpy as np
except ImportError:
    print(f"mesh: numpy is missing; run with the python that holds {DETECTOR}", file=sys.stderr)
    sys.exit(2)

POINT_COUNT = 478
IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp"})
MEASURES = ("interocular_px", "mouth_opening_px", "mouth_width_px", "brow_height_px", "eye_aperture_px")

# Indices of the 478-point face mesh. "Right" is the subject's right, image left.
RIGHT_EYE_CORNERS = (33, 133)
LEFT_EYE_CORNERS = (362, 263)
RIGHT_LIDS = ((160, 144), (159, 145), (158, 153))  # upper, lower
LEFT_LIDS = ((387, 373), (386, 374), (385, 380))
RIGHT_BROW = (70, 63, 105, 66, 107, 46, 53, 52, 65, 55)  # upper edge, then lower edge
LEFT_BROW = (300, 293, 334, 296, 336, 276, 283, 282, 295, 285)
INNER_LIPS = ((81, 178), (82, 87), (13, 14), (312, 317), (311, 402))  # upper, lower
MOUTH_CORNERS = (61, 291)

# The detector finds the face on a coarse grid: views must differ by several of its cells for their errors to
# be independent, and yet leave the face as easy to find.
VIEW_SCALE = 0.15  # each view is 1 +- this times the size
VIEW_TURN_DEG = 10.0
VIEW_SHIFT = 0.05  # of the canvas
CANVAS_MARGIN = 1.2  # the canvas is square, as the detector's geometry wants, and holds the turned image

JITTER_NOISE_SD = 3.0  # grey levels of 255: what a good camera or a codec leaves
JITTER_JPEG_QUALITY = (80, 95)
JITTER_SHIFT_PX = 0.5


class Refusal(Exception):
    """Say what is wrong with the input and what to do next, in one line; `main` prints it and returns 2."""


@dataclass(frozen=True, eq=False)
class Views:
    """Hold how many copies of an image are read and how much it is enlarged first (ours)."""

    count: int
    upscale: float

    def placements(self, width: int, height: int) -> Iterator[tuple[np.ndarray, int]]:
        """Yield the 2 x 3 map from image pixels to canvas pixels and the canvas side, once per view.

        The views follow the R4 low-discrepancy sequence in scale, turn and shift, so they are the same on
        every run and cover the range evenly for any count. One view alone is the image, centred.
        """
        side = round(CANVAS_MARGIN * self.upscale * max(width, height))
        golden = 1.1673039782614187  # root of x^5 = x + 1
        for index in range(self.count):
            quantile = (0.5 + (index + 1) * golden ** -np.arange(1.0, 5.0)) % 1.0
            scale, turn, right, down = 2.0 * quantile - 1.0 if self.count > 1 else np.zeros(4)
            angle = np.deg2rad(VIEW_TURN_DEG * turn)
            factor = self.upscale * (1.0 + VIEW_SCALE * scale)
            linear = factor * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            middle = (side - 1) / 2 + VIEW_SHIFT * side * np.array([right, down])
            shift = middle - linear @ np.array([(width - 1) / 2, (height - 1) / 2])
            yield np.column_stack([linear, shift]), side


@contextmanager
def quiet_native_log() -> Iterator[None]:
    """Hide what native code writes to standard error: start-up notices that are not for the user."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def load_detector(*, min_confidence: float) -> Callable[[np.ndarray], np.ndarray | None]:
    """Give a function from a square uint8 BGR image to its (478, 2) landmarks (x, y) in px, or None.

    Pixel centres lie at integers. Raises Refusal when the detector is not installed here or is another kind.
    """
    advice = f"make the judge environment with: python -m pip install {DETECTOR} (see the top of this file)"
    try:
        import cv2
        import mediapipe
    except ImportError as missing:
        raise Refusal(f"the landmark detector is missing ({missing.name}); {advice}") from missing
    if not hasattr(mediapipe, "solutions"):
        raise Refusal(f"mediapipe {mediapipe.__version__} no longer holds its face mesh; {advice}")
    with quiet_native_log():
        mesh = mediapipe.solutions.face_mesh.FaceMesh(
            static_image_mode=True,
            max_num_faces=1,
            refine_landmarks=True,
            min_detection_confidence=min_confidence,
        )
        mesh.process(np.zeros((64, 64, 3), np.uint8))  # the native code announces itself at the first image

    def detect(canvas: np.ndarray) -> np.ndarray | None:
        with quiet_native_log():
            answer = mesh.process(cv2.cvtColor(canvas, cv2.COLOR_BGR2RGB))
        if not answer.multi_face_landmarks:
            return None
        marks = answer.multi_face_landmarks[0].landmark
        # No half pixel is taken off: without one, faces enlarged 2 and 4 times keep their place to 0.03 px.
        points: np.ndarray = np.array([(mark.x, mark.y) for mark in marks]) * canvas.shape[0]
        return points

    return detect


def locate(
    image: np.ndarray, views: Views, detect: Callable[[np.ndarray], np.ndarray | None]
) -> np.ndarray | None:
    """Give the landmarks (478, 2) in px of `image`, averaged over the views, or None.

    None when the face is found in half of the views or fewer: such a reading is not to be trusted.
    """
    import cv2

    found = []
    for placement, side in views.placements(image.shape[1], image.shape[0]):
        canvas = cv2.warpAffine(
            image, placement, (side, side), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
        )
        points = detect(canvas)
        if points is not None:
            found.append((points - placement[:, 2]) @ np.linalg.inv(placement[:, :2]).T)
    return np.mean(found, axis=0) if 2 * len(found) > views.count else None


def measure(points: np.ndarray) -> np.ndarray:
    """Give the measures named in MEASURES, in px, of landmarks (478, 2) (ours).

    "Down" is at right angles to the line through both eye centres (midpoints of the corners), so a tilted
    head reads the same. Gaps are signed, lower minus upper, so the noise of a closed mouth or eye does not
    add up to an opening. Brow height is the mean distance of ten brow points above the line through the
    corners of the same eye, over both sides; the lids do not enter it.
    """
    right_eye = points[list(RIGHT_EYE_CORNERS)].mean(axis=0)
    left_eye = points[list(LEFT_EYE_CORNERS)].mean(axis=0)
    interocular = float(np.linalg.norm(left_eye - right_eye))
    along = (left_eye - right_eye) / interocular
    down = np.array([-along[1], along[0]])

    def gap(pairs: Sequence[tuple[int, int]]) -> float:
        upper, lower = np.array(pairs).T
        return float(np.mean((points[lower] - points[upper]) @ down))

    def height(brow: Sequence[int], corners: tuple[int, int]) -> float:
        first, second = points[list(corners)]
        line = (second - first) / np.linalg.norm(second - first)
        return float(np.mean((first - points[list(brow)]) @ np.array([-line[1], line[0]])))

    mouth_width = float(np.linalg.norm(points[MOUTH_CORNERS[1]] - points[MOUTH_CORNERS[0]]))
    brow = (height(RIGHT_BROW, RIGHT_EYE_CORNERS) + height(LEFT_BROW, LEFT_EYE_CORNERS)) / 2
    lids = (gap(RIGHT_LIDS) + gap(LEFT_LIDS)) / 2
    return np.array([interocular, gap(INNER_LIPS), mouth_width, brow, lids])


def image_files(inputs: Sequence[Path]) -> list[Path]:
    """Give the image files named by, or lying directly in, `inputs`, in the order of their names in each.

    Raises Refusal for a missing path, a folder without images, or two files of one name: rows are found
    again by the file name.
    """
    files: list[Path] = []
    for item in inputs:
        if item.is_dir():
            inside = sorted(path for path in item.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
            if not inside:
                raise Refusal(f"{item} holds no images; give a folder of frames")
            files.extend(inside)
        elif item.is_file():
            files.append(item)
        else:
            raise Refusal(f"{item} does not exist; give image files or folders of images")
    seen: dict[str, Path] = {}
    for path in files:
        if path.name in seen:
            raise Refusal(f"{seen[path.name]} and {path} share a file name; measure each folder on its own")
        seen[path.name] = path
    return files


def read_image(path: Path) -> np.ndarray:
    """Give the image as (h, w, 3) uint8 BGR; raise Refusal when it cannot be decoded."""
    import cv2

    image: np.ndarray | None = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise Refusal(f"{path} cannot be read as an image; remove it or write it again")
    return image


def write_rows(path: Path, header: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """Write a CSV file whole or not at all."""
    part = path.with_name(path.name + ".part")
    with part.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(header)
        table.writerows(rows)
    part.replace(path)


def read_measures(path: Path) -> dict[str, np.ndarray]:
    """Give the measures of each found face in a file written by `run_measure`, by file stem."""
    if not path.is_file():
        raise Refusal(f"{path} does not exist; write it with this script's -o")
    with path.open(newline="", encoding="utf-8") as stream:
        table = csv.DictReader(stream)
        if missing := [name for name in ("file", "found", *MEASURES) if name not in (table.fieldnames or ())]:
            raise Refusal(f"{path} has no column {missing[0]}; give a file this script wrote with -o")
        found = [row for row in table if row["found"] == "1"]
    return {Path(row["file"]).stem: np.array([float(row[name]) for name in MEASURES]) for row in found}


def run_measure(arguments: argparse.Namespace) -> None:
    """Read every image; write the measures and, when asked, the landmarks."""
    detect = load_detector(min_confidence=arguments.min_confidence)
    views = Views(arguments.views, arguments.upscale)
    files = image_files(arguments.inputs)
    measured: list[list[Any]] = []
    located: list[list[Any]] = []
    for path in files:
        points = locate(read_image(path), views, detect)
        values = [""] * len(MEASURES) if points is None else [f"{value:.4f}" for value in measure(points)]
        marks = [""] * (2 * POINT_COUNT) if points is None else [f"{value:.3f}" for value in points.ravel()]
        measured.append([path.name, int(points is not None), *values])
        located.append([path.name, *marks])
    write_rows(arguments.output, ["file", "found", *MEASURES], measured)
    if arguments.points:
        names = [f"{axis}{index}" for index in range(POINT_COUNT) for axis in "xy"]
        write_rows(arguments.points, ["file", *names], located)
    print(f"{sum(row[1] for row in measured)} of {len(files)} faces found")


def run_compare(arguments: argparse.Namespace) -> None:
    """Print Pearson's r and the least-squares slope of B on A for each measure; A holds the true frames."""
    true, made = read_measures(arguments.a), read_measures(arguments.b)
    shared = [name for name in true if name in made]
    if len(shared) < 3:
        raise Refusal(f"{arguments.a} and {arguments.b} share {len(shared)} found names; three are needed")
    a, b = np.array([true[name] for name in shared]), np.array([made[name] for name in shared])
    print(f"{len(shared)} faces in both; {len(true)} in A, {len(made)} in B")
    heads = ("r", "slope", "mean A", "mean B", "sd A", "sd B", "rms B-A")
    print(f"{'measure':<18}" + "".join(f"{head:>9}" for head in heads))
    for index, name in enumerate(MEASURES):
        x, y = a[:, index], b[:, index]
        deviation_x, deviation_y = x - x.mean(), y - y.mean()
        power_x, power_y = deviation_x @ deviation_x, deviation_y @ deviation_y
        shared_power = deviation_x @ deviation_y
        # A measure that never changes has neither correlation nor slope: nan, not a division by zero.
        r = shared_power / np.sqrt(power_x * power_y) if power_x * power_y > 0 else np.nan
        slope = shared_power / power_x if power_x > 0 else np.nan
        error = np.sqrt(np.mean((y - x) ** 2))
        values = (r, slope, x.mean(), y.mean(), x.std(ddof=1), y.std(ddof=1), error)
        print(f"{name:<18}" + "".join(f"{value:>9.3f}" for value in values))


def disturbed(image: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    """Give three copies of a uint8 image with the same expression: noisy, coded, shifted."""
    import cv2

    noisy = np.clip(np.rint(image + rng.normal(0.0, JITTER_NOISE_SD, image.shape)), 0, 255).astype(np.uint8)
    low, high = JITTER_JPEG_QUALITY
    coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(low, high + 1))])[1]
    right, down = rng.uniform(-JITTER_SHIFT_PX, JITTER_SHIFT_PX, 2)
    shift = np.array([[1.0, 0.0, right], [0.0, 1.0, down]])
    size = (image.shape[1], image.shape[0])
    moved = cv2.warpAffine(image, shift, size, flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
    return [noisy, cv2.imdecode(coded, cv2.IMREAD_COLOR), moved]


def run_jitter(arguments: argparse.Namespace) -> None:
    """Print each measure's sd over the frames, the jitter of one reading, and the ceiling they set.

    With reading noise of variance j^2 in both A and B and an observed variance s^2 over the frames, a perfect
    rendering is expected to give r = slope = 1 - j^2 / s^2 (attenuation; Spearman 1904).
    """
    detect = load_detector(min_confidence=arguments.min_confidence)
    views = Views(arguments.views, arguments.upscale)
    files = image_files(arguments.inputs)
    rng = np.random.default_rng(arguments.seed)
    plain, scatter = [], []
    for path in files[:: arguments.every]:
        image = read_image(path)
        copies = [image, *disturbed(image, rng)]
        readings = [measure(found) for copy in copies if (found := locate(copy, views, detect)) is not None]
        if len(readings) == len(copies):
            plain.append(readings[0])
            scatter.append(np.var(readings, axis=0, ddof=1))
    if len(plain) < 3:
        raise Refusal(f"the face was found in {len(plain)} frames; give a clip with three or more")
    spread = np.std(plain, axis=0, ddof=1)
    jitter = np.sqrt(np.mean(scatter, axis=0))
    # A clip in which nothing moves has no ceiling to speak of: 0, not a division by zero.
    ceiling = 1.0 - np.minimum(jitter / np.maximum(spread, np.finfo(np.float32).tiny), 1.0) ** 2
    print(f"{len(plain)} frames, each read plain, noisy, coded and shifted")
    print(f"{'measure':<18}{'sd':>8}{'jitter':>8}{'ceiling':>9}")
    for index, name in enumerate(MEASURES):
        print(f"{name:<18}{spread[index]:>8.3f}{jitter[index]:>8.3f}{ceiling[index]:>9.3f}")


def positive(text: str) -> int:
    """Give a whole number of one or more, for argparse."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is less than 1")
    return number


def enlargement(text: str) -> float:
    """Give a factor in [0.1, 10], for argparse."""
    factor = float(text)
    if not 0.1 <= factor <= 10.0:
        raise argparse.ArgumentTypeError(f"{factor} is outside 0.1 to 10")
    return factor


def detector_options(parser: argparse.ArgumentParser) -> None:
    """Add the inputs and the options of the reading itself."""
    parser.add_argument("inputs", nargs="+", type=Path, metavar="DIR_OR_IMAGE")
    parser.add_argument("--views", type=positive, default=9, help="copies averaged per image (default 9)")
    parser.add_argument("--upscale", type=enlargement, default=1.0, help="enlarge first (default 1)")
    parser.add_argument("--min-confidence", type=float, default=0.3, help="of the face finder (default 0.3)")


def main(words: Sequence[str]) -> int:
    """Run the mode named by the first word, or measure; return the exit status."""
    modes = {"compare": run_compare, "jitter": run_jitter}
    mode = words[0] if words and words[0] in modes else ""
    described = "start with 'compare' or 'jitter' for those modes; the environment: top of this file"
    parser = argparse.ArgumentParser(prog=f"mesh.py {mode}".rstrip(), description=described)
    if mode == "compare":
        parser.add_argument("a", type=Path, help="measures of the true frames")
        parser.add_argument("b", type=Path, help="measures of what was made of them")
    else:
        detector_options(parser)
    if mode == "jitter":
        parser.add_argument("--every", type=positive, default=1, help="take each n-th frame (default 1)")
        parser.add_argument("--seed", type=int, default=0, help="of the disturbances (default 0)")
    elif mode == "":
        parser.add_argument("-o", "--output", type=Path, required=True, help="CSV of the measures")
        parser.add_argument("--points", type=Path, help="CSV of all landmarks, x0 y0 x1 y1 ... in px")
    arguments = parser.parse_args(words[1:] if mode else words)
    try:
        modes.get(mode, run_measure)(arguments)
    except Refusal as refusal:
        print(f"mesh: {refusal}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
