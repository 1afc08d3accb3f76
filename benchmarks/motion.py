"""Continua whose steps are equal, motion that keeps its path, loops without a jump: on real models and a drawn one.

Pictures are judged as they lie on the disk: written by the command's own function and read again.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import mimicry
import numpy as np
from tables import at_least, at_most, print_table, tell

from morphspace.arrays import AnyArray, LoadingTable
from morphspace.grid import warp
from morphspace.imitation.shape import centred
from morphspace.io.images import read_image
from morphspace.io.tables import read_loadings_table, read_metrics_table
from morphspace.linear import quality
from morphspace.model.loadings import Loadings
from morphspace.model.model import MorphModel, load_model
from morphspace.notebook import build
from morphspace.steps import result_of
from morphspace.stimuli import stepping, timing, trajectory
from morphspace.stimuli.continuum import Line
from morphspace.synthetic.clips import make_actors
from morphspace.verbs import continuum as verb
from morphspace.verbs.encode import write_loadings

CLIPS = ("lp_d18", "lp_d6", "lp_d13", "lp_d0", "grid_pwij3p")
PAIRS = (("lp_d18", "lp_d6"), ("lp_d13", "lp_d18"), ("lp_d0", "grid_pwij3p"))
DRAWN, DRAWN_SEED, DRAWN_FRAMES = "drawn", 31, 60
COMPONENTS = 50
STEPS = (5, 10, 30)
GOAL_EVEN = 3.0  # %
SPEEDS = (0.3, 0.5, 1.5, 2.7)
RATE_HZ, SHOWN_HZ = 25.0, 60.0
BENT = 1.3  # the other timing: time to this power
GOAL_PATH = 1e-6  # median steps
SEEDS = 20
GOAL_ENDS_DB = 40.0


def motion(data: Path, work: Path) -> None:
    """Print how equal the steps of continua are, how far retimed motion leaves its path, and how loops close."""
    models = dict(_models(data, work))
    with tempfile.TemporaryDirectory() as folder:
        _continua(models, work, Path(folder))
        _pairs(work, Path(folder))
    _retiming(models)
    _loops(models)
    _scrambles(models)


def _models(data: Path, work: Path) -> Iterator[tuple[str, MorphModel]]:
    for name in CLIPS:
        yield name, mimicry.keyed_model(data, name, work)
    folder, path = work / "motion-drawn", _path(DRAWN, work)
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        for piece in make_actors(folder, identities=1, frames=DRAWN_FRAMES, seed=DRAWN_SEED):
            if piece.truth is not None:
                tell(f"motion: drew {piece.actor}")
        build(folder / "actor_01", components=COMPONENTS).save(path)
    yield DRAWN, load_model(path)


def _path(name: str, work: Path) -> Path:
    return work / "mimicry" / f"{name}.morph"


def _motion(model: MorphModel) -> LoadingTable:
    """Give the recorded motion of a model's clip, SD."""
    return np.asarray(model.training.values / model.sd)


def _furthest(model: MorphModel) -> tuple[int, int]:
    values = np.asarray(model.training.values)
    apart = ((values[:, None] - values) ** 2).sum(axis=2)
    first, last = np.unravel_index(int(apart.argmax()), apart.shape)
    return int(first), int(last)


def _continua(models: dict[str, MorphModel], work: Path, folder: Path) -> None:
    print("## Continua\n")
    print(
        "Between the two training faces of each model that lie furthest apart. How far the step furthest from the mean "
        "step is from it, %: in the measure the steps were made equal in, measured on the PNGs read back from the "
        "disk (warp: on the fields); beside it the same for the linear morph in as many steps, its control. A step: "
        "its mean size, for ssim 1 - SSIM. Seconds of processor time for the whole set: spacing, measuring, control, "
        "pictures, statistics.\n"
    )
    rows = []
    for name, model in models.items():
        tell(f"motion: continua of {name}")
        table = folder / f"{name}.csv"
        write_loadings(table, Loadings(*_training(model)), model, _path(name, work), {})
        ends = [model.training.frame_names[index] for index in _furthest(model)]
        for spacing in ("ciede2000", "ssim", "warp"):
            for steps in STEPS if spacing != "warp" else STEPS[:1]:
                out = folder / f"{name}-{spacing}-{steps}"
                start = time.process_time()
                words = (f"{table}:{ends[0]}", f"{table}:{ends[1]}")
                request = verb.ContinuumRequest(
                    *words, out, model=_path(name, work), steps=steps, spacing=spacing
                )
                result_of(verb.run(request))
                seconds = time.process_time() - start
                sizes, linear = (_sizes(out, stem, model, spacing) for stem in ("step", "linear"))
                off = 100 * stepping.unevenness(sizes)
                control = "" if linear is None else f"{100 * stepping.unevenness(linear):.1f}"
                cells = [
                    f"{sizes.mean():.4f}",
                    f"{off:.2f}",
                    at_most(off, GOAL_EVEN),
                    control,
                    f"{seconds:.1f}",
                ]
                rows.append([name, spacing, str(steps), *cells])
    heads = [
        "model",
        "equal in",
        "steps",
        "a step",
        "off by %",
        f"<= {GOAL_EVEN:g} %",
        "linear morph, %",
        "s",
    ]
    print_table(heads, rows)


def _training(model: MorphModel) -> tuple[LoadingTable, tuple[str, ...], str]:
    return np.asarray(model.training.values), model.training.frame_names, model.model_id


def _sizes(folder: Path, stem: str, model: MorphModel, spacing: str) -> AnyArray | None:
    """Measure the steps of a set from its files; None where it has none of that name."""
    pictures = [read_image(path) for path in sorted(folder.glob(f"{stem}_*.png"))]
    if not pictures:
        return None
    if spacing == "warp":
        table = read_loadings_table(folder / "loadings.csv")
        own = [
            row
            for name, row in zip(table.frame_names, table.loadings_sd, strict=True)
            if name.startswith(stem)
        ]
        fields = [model.expand(row * model.sd[: len(row)]).displacement for row in own]
        return np.array([quality.rms_px(other - one, model.mask) for one, other in pairwise(fields)])
    return np.array(
        [stepping.difference(one, other, model.mask, spacing) for one, other in pairwise(pictures)]
    )


def _pairs(work: Path, folder: Path) -> None:
    print("## Between two people\n")
    print(
        "Ten steps, equal in CIEDE2000, between the mean faces of two models, on a model of the pair. Ends: PSNR in "
        "the mask of the first and the last picture against the mean faces as their own models draw them, the second "
        "laid on the first. Folds: of the face halfway. Cross-fade: the step of fading one picture out and the other "
        "in, and the sharpness (variance of the Laplacian) halfway, as a share of the mean of the two ends', of the "
        "morph and of the cross-fade. Seconds of processor time for the whole set.\n"
    )
    rows = []
    for names in PAIRS:
        tell(f"motion: {names[0]} to {names[1]}")
        paths = [_path(name, work) for name in names]
        out = folder / "-".join(names)
        start = time.process_time()
        result_of(verb.run(verb.ContinuumRequest(str(paths[0]), str(paths[1]), out, steps=10)))
        seconds = time.process_time() - start
        pair = load_model(out / f"{paths[0].stem}-{paths[1].stem}.morph")
        line = Line(pair, *np.asarray(pair.training.values))
        place = np.array(pair.provenance["pair"]["placed"])
        height, width = pair.mask.shape
        onto = warp.affine_displacement(warp.inverse_affine(place), height, width)
        own = [load_model(path).mean.render() for path in paths]
        own[1] = warp.sample(own[1], onto)
        steps = [read_image(path) for path in sorted(out.glob("step_*.png"))]
        ends = [quality.psnr_db(steps[end], own[end], pair.mask) for end in (0, -1)]
        sizes = _sizes(out, "step", pair, "ciede2000")
        off = 100 * stepping.unevenness(sizes)
        table = read_metrics_table(out / "steps.csv")
        faded = np.mean(
            [
                value
                for value, series in zip(table["crossfade_ciede2000"], table["series"], strict=True)
                if series == "continuum"
            ]
        )
        sharp = [_sharpness(picture, pair) for picture in (line.picture(0.5), line.crossfade(0.5))]
        whole = np.mean([_sharpness(line.picture(end), pair) for end in (0.0, 1.0)])
        least = min(ends)
        rows.append(
            [
                " to ".join(names),
                f"{ends[0]:.1f} / {ends[1]:.1f}",
                at_least(least, GOAL_ENDS_DB),
                f"{100 * warp.fold_fraction(line.displacement(0.5), pair.mask):.2f}",
                f"{sizes.mean():.2f}",
                f"{off:.2f}",
                at_most(off, GOAL_EVEN),
                f"{faded:.2f}",
                f"{sharp[0] / whole:.2f} / {sharp[1] / whole:.2f}",
                f"{seconds:.1f}",
            ]
        )
    heads = [
        "pair",
        "ends, dB",
        f">= {GOAL_ENDS_DB:g}",
        "folds %",
        "a step",
        "off by %",
        f"<= {GOAL_EVEN:g} %",
    ]
    print_table([*heads, "cross-fade", "sharpness halfway, morph / cross-fade", "s"], rows)


def _sharpness(picture: AnyArray, model: MorphModel) -> float:
    luma = picture.mean(axis=2).astype(np.float64)
    second = luma[1:-1, :-2] + luma[1:-1, 2:] + luma[:-2, 1:-1] + luma[2:, 1:-1] - 4 * luma[1:-1, 1:-1]
    weight = model.mask[1:-1, 1:-1]
    return float((second**2 * weight).sum() / weight.sum())


def distance_from_path(points: AnyArray, path: AnyArray) -> AnyArray:
    """Give how far each of points (m, k) lies from the polyline through path (n, k), (m,): of all pieces."""
    starts, pieces = path[:-1], np.diff(path, axis=0)
    lengths = np.maximum((pieces**2).sum(axis=1), 1e-300)
    found = np.empty(len(points))
    for index, point in enumerate(points):
        share = np.clip(((point - starts) * pieces).sum(axis=1) / lengths, 0, 1)
        found[index] = np.sqrt(((starts + share[:, None] * pieces - point) ** 2).sum(axis=1)).min()
    return found


def _retiming(models: dict[str, MorphModel]) -> None:
    print("## Retiming\n")
    print(
        "The recorded motion of each model's clip, played at other speeds, brought from "
        f"{RATE_HZ:g} to {SHOWN_HZ:g} Hz, and given the timing of another motion: of itself, played with time to the "
        f"power {BENT:g}. Off the path: the largest distance of any new frame from the recorded path (frames joined by "
        "straight lines), in median steps; goal: none but rounding. Spline: the same at half speed, if a cubic spline "
        "were drawn through the frames. From the guide: median distance of each frame from the guide's at that "
        "moment, in median steps, with the timing taken on and without.\n"
    )
    rows = []
    for name, model in models.items():
        table, weights = _motion(model), model.sd
        path = table * weights
        step = float(np.median(trajectory.step_lengths(table, weights)))
        cells = []
        worst = 0.0
        for speed in (*SPEEDS, RATE_HZ / SHOWN_HZ):
            off = distance_from_path(timing.retimed(table, speed) * weights, path).max() / step
            worst = max(worst, off)
            cells.append(f"{off:.0e}")
        last = len(table) - 1
        guide = timing.at_positions(table, last * (np.arange(len(table)) / last) ** BENT)
        found = timing.timed_like(table, guide, weights)
        off = distance_from_path(found * weights, path).max() / step
        worst = max(worst, off)
        apart = [
            np.median(np.sqrt((((one - guide) * weights) ** 2).sum(axis=1))) / step for one in (found, table)
        ]
        spline = distance_from_path(_splined(path, np.arange(0, last + 0.1, 0.5)), path).max() / step
        rows.append(
            [
                name,
                *cells,
                f"{off:.0e}",
                at_most(worst, GOAL_PATH),
                f"{spline:.2f}",
                f"{apart[0]:.2f} / {apart[1]:.2f}",
            ]
        )
    speeds = [f"speed {speed:g}" for speed in SPEEDS]
    heads = [
        "model",
        *speeds,
        f"to {SHOWN_HZ:g} Hz",
        "timing",
        "on the path",
        "spline",
        "from the guide, with / without",
    ]
    print_table(heads, rows)


def _splined(values: AnyArray, positions: AnyArray) -> AnyArray:
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(np.arange(len(values)), values)(positions))


def _loops(models: dict[str, MorphModel]) -> None:
    print("## Loops\n")
    print(
        "The recorded motion of each clip, as it is and smoothed at 6 Hz, closed to a loop. Cut: the jump from the "
        "last frame to the first, in median steps, if it is simply played again. Loop: the largest step of the way "
        "back, the last one included. Added: frames. Further out: by how much any loading goes beyond what it does in "
        "the motion, SD.\n"
    )
    rows = []
    for name, model in models.items():
        for what, table in (
            ("as it is", _motion(model)),
            ("smoothed", timing.smoothed(_motion(model), 6.0, RATE_HZ)),
        ):
            weights = model.sd
            step = float(np.median(trajectory.step_lengths(table, weights)))
            cut = float(trajectory.step_lengths(table[[-1, 0]], weights)[0]) / step
            loop = trajectory.looped(table, weights)
            back = trajectory.step_lengths(np.concatenate([loop[len(table) - 1 :], loop[:1]]), weights)
            largest = float(back.max()) / step
            beyond = max(
                float((loop - table.max(axis=0)).max()), float((table.min(axis=0) - loop).max()), 0.0
            )
            cells = [f"{cut:.2f}", f"{largest:.3f}", at_most(largest, 1 + 1e-6), str(len(loop) - len(table))]
            rows.append([name, what, *cells, f"{beyond:.3f}"])
    print_table(["model", "motion", "cut", "loop", "<= 1", "added", "further out"], rows)


def _scrambles(models: dict[str, MorphModel]) -> None:
    print("## Scrambled in phase\n")
    print(
        f"{SEEDS} seeds of each motion. Amplitudes and covariances: largest change of any component's amplitude at any "
        "frequency, and of any covariance of two components, relative to the largest. Alike: correlation with the "
        "motion itself over all components, highest of the seeds. Furthest out: rms SD of the frame furthest out, over "
        "that of the motion, median and highest of the seeds.\n"
    )
    rows = []
    for name, model in models.items():
        table = _motion(model)
        spectrum, covariance = np.abs(np.fft.rfft(table, axis=0)), np.cov(table.T)
        shape = centred(table * model.sd)
        changed, together, alike, far = [], [], [], []
        for seed in range(SEEDS):
            out = trajectory.scrambled_phase(table, np.random.default_rng([seed, 0]))
            changed.append(np.abs(np.abs(np.fft.rfft(out, axis=0)) - spectrum).max() / spectrum.max())
            together.append(np.abs(np.cov(out.T) - covariance).max() / np.abs(covariance).max())
            other = centred(out * model.sd)
            alike.append((shape * other).sum() / (shape**2).sum())
            far.append(np.sqrt((out**2).mean(axis=1)).max() / np.sqrt((table**2).mean(axis=1)).max())
        cells = [f"{max(changed):.0e}", f"{max(together):.0e}", f"{max(alike):.2f}"]
        rows.append([name, *cells, f"{np.median(far):.2f} / {max(far):.2f}"])
    print_table(["model", "amplitudes", "covariances", "alike", "furthest out"], rows)
