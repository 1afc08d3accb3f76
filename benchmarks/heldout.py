"""How close a face comes back: without truncation, and held-out frames through k components."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from clips import PixelPCA, Trial, remembered_flow, trial
from tables import at_least, print_table, tell

from morphspace.arrays import Displacement, Image
from morphspace.face.detector import load_detector
from morphspace.face.faceframe import Frame
from morphspace.flow.starts import photometric_error
from morphspace.grid import warp
from morphspace.linear.quality import psnr_db
from morphspace.model.model import MorphModel
from morphspace.model.morph import Morph
from morphspace.report.advice.build import head_path

FIXED_POINT_STEPS = 20
ROUND_TRIP_TARGET = (46.0, 32.0)  # dB, median and 10th percentile
ROUND_TRIP_GOAL = (50.0, 38.0)
COMPONENTS = (10, 20, 40)
EXPRESSIVE = ("lp_d18", "lp_d13", "lp_d6")
GAIN_TARGET, GAIN_GOAL = 1.5, 3.0  # dB over pixel PCA, on the expressive clips
LEAST_TARGET, LEAST_GOAL = 0.0, 0.5  # dB over pixel PCA, on the others


def round_trip(data: Path, clips: tuple[str, ...], work: Path) -> None:
    """Print how frames come back when they are taken apart and rendered again, with no component left out."""
    print(
        "PSNR (dB) inside the face mask of render(morph_of(frame)) against the aligned frame, median / 10th "
        f"percentile. The peer differs only in the inversion: {FIXED_POINT_STEPS} fixed-point steps.\n"
    )
    rows = []
    for name in clips:
        with remembered_flow(work / "flow"):
            one = trial(data, name, work)
            found = np.array([_round_trip_of(one.model, frame) for frame in one.frames])
        exact, fixed = found[:, 0], found[:, 1]
        test = list(one.held_out)
        low, middle = np.percentile(exact, 10), np.median(exact)
        rows.append(
            [
                name,
                len(exact),
                _pair(exact),
                _pair(exact[test]),
                _pair(fixed),
                _pair(fixed[test]),
                f"{100 * found[:, 2].mean():.2f}",
                _pair_verdict(middle, low, ROUND_TRIP_TARGET),
                _pair_verdict(middle, low, ROUND_TRIP_GOAL),
            ]
        )
    heads = ["clip", "frames", "exact, all", "exact, held out", "fixed point, all", "fixed point, held out"]
    print_table([*heads, "folded cells %", ">= 46 / 32", ">= 50 / 38"], rows)


def _round_trip_of(model: MorphModel, frame: Frame) -> tuple[float, float, float]:
    morph = model.morph_of(frame)
    fixed = warp.sample(morph.texture, fixed_point_inverse(morph.displacement))
    return (
        psnr_db(morph.render(), frame.image, model.mask),
        psnr_db(fixed, frame.image, model.mask),
        warp.fold_fraction(morph.displacement, model.mask),
    )


def fixed_point_inverse(displacement: Displacement) -> Displacement:
    """Invert a field the usual way, by v <- -u(q + v): right where the field changes slowly, and nowhere else."""
    inverse = -displacement
    for _ in range(FIXED_POINT_STEPS):
        inverse = -warp.sample_field(displacement, inverse)
    return inverse


def _pair(values: np.ndarray) -> str:
    return f"{np.median(values):.1f} / {np.percentile(values, 10):.1f}"


def _pair_verdict(middle: float, low: float, target: tuple[float, float]) -> str:
    return " / ".join(at_least(value, wanted) for value, wanted in zip((middle, low), target, strict=True))


def held_out(data: Path, clips: tuple[str, ...], work: Path) -> None:
    """Print how held-out frames come back through k components, against pixel PCA of the same frames."""
    print(
        "PSNR (dB) inside the face mask of frames the model was not trained on, mean over frames; gain over pixel "
        "PCA with as many components, trained on the same aligned frames. Projection: inner products with the "
        "components. Fitted: `MorphModel.encode_aligned`. 'below' counts frames where the fitted face is worse "
        "than pixel PCA. The clips lp_d18, lp_d13 and lp_d6 have wide expressions, lp_d0 small ones, grid_pwij3p "
        "and obama_a speech; 200 x 240 px. Every fourth frame is held out: reference, mean shape, warp weight and "
        "components come from the others alone, and `MorphModel.align` registers the held-out frames. Pixel PCA is "
        "as good as it can be: float64, an exact singular value decomposition, least squares inside the mask. A "
        "clip with fewer than k + 1 training frames is shown at its rank, for both.\n"
    )
    rows = []
    for name in clips:
        with remembered_flow(work / "flow"):
            one = trial(data, name, work)
            rows += [_gain_row(one, k, scores) for k, scores in _held_out_scores(one).items()]
    heads = [
        "clip",
        "k",
        "trained",
        "held out",
        "pixel PCA",
        "projection",
        "gain",
        "fitted",
        "gain",
        "worst frame",
    ]
    print_table([*heads, "below %", "target", "goal"], rows)


def with_landmarks(data: Path, clips: tuple[str, ...], work: Path) -> None:
    """Print how held-out frames come back from models built without and with the points of the face, side by side."""
    print(
        "As above, fitted: PSNR (dB) of pixel PCA and gain over it, by models built with `--landmarks none` and "
        "`auto`. Each way has its own alignment and may have its own mask, so the PSNRs are not all of the same "
        "pixels; the gains are each over its own peer. Scale: smallest and largest registration gave a frame. Left: "
        "median / largest root mean square of what the flow leaves of the training frames, colour in 8-bit codes.\n"
    )
    rows: list[list[object]] = []
    detector = load_detector()
    for name in clips:
        columns = []
        for one_detector in (None, detector):
            with remembered_flow(work / "flow"):
                one = trial(data, name, work, one_detector)
                scores = _held_out_scores(one)
            columns.append((one, scores))
        for k in COMPONENTS:
            row: list[object] = [name, k]
            for _one, scores in columns:
                pixel, _, fitted = scores[k].T
                row += [
                    f"{pixel.mean():.2f}",
                    f"{(fitted - pixel).mean():+.2f}",
                    f"{(fitted - pixel).min():+.2f}",
                ]
            if k == COMPONENTS[0]:
                for one, _ in columns:
                    row += [one.build.choice.name, _scales(one), _left_over(one)]
            else:
                row += [""] * 6
            rows.append(row)
    ways = ("none", "auto")
    heads = [
        "clip",
        "k",
        *(f"{word}, {way}" for way in ways for word in ("pixel PCA", "gain", "worst frame")),
    ]
    print_table(
        [*heads, *(f"{word}, {way}" for way in ways for word in ("reference", "scale", "left"))], rows
    )


def _scales(one: Trial) -> str:
    scale = head_path(one.build.registrations, one.model.size).scale
    return f"{scale.min():.2f}-{scale.max():.2f}"


def _left_over(one: Trial) -> str:
    model, left = one.model, []
    for place in range(len(one.trained)):
        frame, flow = one.build.frame(place)
        left.append(photometric_error(model.reference, frame.image, flow.displacement, model.mask))
    return f"{255 * np.median(left):.1f} / {255 * max(left):.1f}"


def _held_out_scores(one: Trial) -> dict[int, np.ndarray]:
    """Give for each k the PSNR (held-out frames, 3) of pixel PCA, projection and fit."""
    pixel = PixelPCA([one.frames[index].image for index in one.trained], one.model.mask)
    scores: dict[int, list[list[float]]] = {k: [] for k in COMPONENTS}
    models = {k: one.model.truncate(min(k, one.model.rank)) for k in COMPONENTS}
    for number, index in enumerate(one.held_out):
        tell(f"{one.name}: held-out frame {number + 1} of {len(one.held_out)}")
        frame = one.frames[index]
        morph = one.model.morph_of(frame)
        for k, model in models.items():
            images = [pixel.reconstruct(frame.image, k), *reconstructions(model, frame, morph)]
            scores[k].append([psnr_db(image, frame.image, model.mask) for image in images])
    return {k: np.array(found) for k, found in scores.items()}


def reconstructions(model: MorphModel, frame: Frame, morph: Morph) -> tuple[Image, Image]:
    """Give an aligned frame as the model renders its projection and its fitted encoding."""
    fitted = model.encode_aligned(frame).values[0]
    return model.render(model.project(morph)), model.render(fitted)


def _gain_row(one: Trial, k: int, scores: np.ndarray) -> list[object]:
    pixel, projected, fitted = scores.T
    gain = float((fitted - pixel).mean())
    expressive = one.name in EXPRESSIVE
    target, goal = (GAIN_TARGET, GAIN_GOAL) if expressive else (LEAST_TARGET, LEAST_GOAL)
    return [
        one.name,
        k if k <= one.model.rank else f"{one.model.rank} (rank)",
        len(one.trained),
        len(one.held_out),
        f"{pixel.mean():.2f}",
        f"{projected.mean():.2f}",
        f"{(projected - pixel).mean():+.2f}",
        f"{fitted.mean():.2f}",
        f"{gain:+.2f}",
        f"{(fitted - pixel).min():+.2f}",
        f"{100 * (fitted < pixel).mean():.0f}",
        f">= {target:+.1f} {at_least(gain, target)}",
        f">= {goal:+.1f} {at_least(gain, goal)}",
    ]
