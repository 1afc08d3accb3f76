"""How much of an expression the warp carries, by a judge's landmarks: what is left over, and the slope of measures.

The judge reads the aligned frames of a build (benchmarks/judges/face.py). Its landmarks are carried back to the
reference through each frame's field. What then still moves was not followed by the field: *left over* is the rms spread
of a group of landmarks on the reference over that in the frames, 0 if the field follows and 1 if it does not. The
median of the carried landmarks, carried forward through each field, is measured as a face is; its *slope* on the
measure of the frames is 1 if the warp alone makes the expression.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from clips import clip_frames
from judges import measures, reading
from tables import at_least, at_most, print_table, tell

from morphspace.arrays import AnyArray, Displacement
from morphspace.face.detector import Detector, load_detector
from morphspace.grid import warp
from morphspace.io.framing import FramedClip
from morphspace.io.images import write_image
from morphspace.model.passes import BuildSettings, build_steps
from morphspace.steps import result_of, spread

REPORTED = ("lp_d8", "vr_f4", "pf_single", "lx_v2", "ma_t3", "vr_f5", "lp_d3", "grid_lbax4n", "grid_lrwp9a")
FRAMES = 36  # of each clip, evenly spread
GROUPS = {
    "outer lips": (48, 60),
    "inner lips": (60, 68),
    "brows": (17, 27),
    "lids": (36, 48),
}  # of 68 landmarks
MEASURED = ("lip_height", "mouth_width", "brow_height", "mouth_opening", "eye_aperture")
MARKS = {"outer lips": 0.30, "inner lips": 0.42, "brows": 0.50, "lids": 0.60}
SLOPE_MARKS = dict(zip(MEASURED, (0.85, 0.85, 0.85, 0.6, 0.6), strict=True))
WAYS = ("none", "auto")


def carried(data: Path, work: Path, judge: str) -> None:
    """Print left over and slopes of each person, of builds without and with face points, and their means."""
    print(
        f"{FRAMES} frames of each person on whom no constant was chosen, models at 200 x 240, built with `--landmarks "
        "none` and `auto`. Judge: 68 landmarks of dlib, which no build uses. Left over: 0 if the field follows the "
        "feature. Slope: 1 if the warp alone makes the expression; where a person hardly moves a feature (sd, % of the "
        "eye distance) the judge's noise decides.\n"
    )
    detector = load_detector()
    rows: list[list[object]] = []
    found: dict[str, list[tuple[AnyArray, AnyArray]]] = {way: [] for way in WAYS}
    for name in REPORTED:
        for way in WAYS:
            left, slopes, sd = _judged(data, name, work, judge, detector if way == "auto" else None)
            found[way].append((left, slopes))
            shown = [f"{value:.2f}" for value in left]
            rows.append(
                [name, way, *shown, *(f"{s:.2f} ({100 * d:.1f})" for s, d in zip(slopes, sd, strict=True))]
            )
    for way in WAYS:
        left, slopes = (np.mean(kind, axis=0) for kind in zip(*found[way], strict=True))
        rows.append(["mean", way, *(f"{value:.2f}" for value in (*left, *slopes))])
        verdicts = [at_most(value, mark) for value, mark in zip(left, MARKS.values(), strict=True)]
        verdicts += [at_least(value, mark) for value, mark in zip(slopes, SLOPE_MARKS.values(), strict=True)]
        rows.append(["landing mark", way, *verdicts])
    heads = [f"left, {group}" for group in GROUPS] + [f"slope, {name.replace('_', ' ')}" for name in MEASURED]
    print_table(["person", "landmarks", *heads], rows)


def _judged(
    data: Path, name: str, work: Path, judge: str, detector: Detector | None
) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Build a model and judge its fields: left over (4,), slopes (5,) and the sd of the measures (5,)."""
    source = clip_frames(data, name)
    kept = spread(len(source.names), FRAMES)
    source = FramedClip(source.clip.subset(kept), source.framing)
    way = "none" if detector is None else "auto"
    tell(f"carried: {name}, {way}")
    folder = work / "carried" / f"{name}-{way}"
    build = result_of(
        build_steps(source, BuildSettings(detector=detector), folder / "build", {"identity": name})
    )
    frames = [build.frame(index) for index in range(len(kept))]
    for index, (frame, _) in enumerate(frames):
        write_image(folder / "aligned" / f"{index:04d}.png", frame.image)
    read = folder / "aligned.npz"
    reading.run(judge, reading.FACE, [str(folder / "aligned"), "-o", str(read)])
    marks = np.load(read)["landmarks"].astype(np.float64)
    seen = np.isfinite(marks).all(axis=(1, 2))
    fields = [flow.displacement for (_, flow), is_seen in zip(frames, seen, strict=True) if is_seen]
    return figures(fields, marks[seen])


def figures(fields: list[Displacement], marks: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Compute left over (4,), slopes (5,) and sd (5,) from fields and the landmarks (n, 68, 2) of their frames."""
    back = np.array(
        [warp.move_points(warp.invert(field), one) for field, one in zip(fields, marks, strict=True)]
    )
    left = [
        _spread_of(back[:, slice(*group)]) / _spread_of(marks[:, slice(*group)]) for group in GROUPS.values()
    ]
    middle = np.median(back, axis=0)
    places = [measures.MEASURES.index(name) for name in MEASURED]
    true = measures.expression(marks)[:, places]
    made = measures.expression(np.array([warp.move_points(field, middle) for field in fields]))[:, places]
    true, made = true - true.mean(axis=0), made - made.mean(axis=0)
    return np.array(left), (true * made).sum(axis=0) / (true**2).sum(axis=0), true.std(axis=0)


def _spread_of(points: AnyArray) -> float:
    return float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=-1).mean()))
