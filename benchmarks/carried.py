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
from clips import SIZE, clip_frames
from judges import measures, reading
from tables import at_least, at_most, print_table, tell

from morphspace.arrays import AnyArray, Displacement
from morphspace.face.detector import Detector, load_detector
from morphspace.grid import warp
from morphspace.io.clips import open_clip
from morphspace.io.framing import FramedClip, Framing
from morphspace.io.images import write_image
from morphspace.model.passes import Build, BuildSettings, build_steps
from morphspace.steps import result_of, spread
from morphspace.synthetic.clips import Truth, make_actors, read_truth

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
ACTORS, ACTOR_FRAMES, ACTOR_SEED = 3, 30, 5
SHOWN = ("skin", "eye", "mouth")  # areas of a drawn face; eye and mouth are what shows between lids and lips
LEAST_SEEN = 3  # pixels


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


def carried_drawn(work: Path) -> None:
    """Print the error of fields on drawn actors, where the true field is known, without and with face points."""
    print(
        f"{ACTORS} drawn actors of {ACTOR_FRAMES} frames (seed {ACTOR_SEED}), models at {SIZE[0]} x {SIZE[1]}: "
        "distance of the field from the true one, px, mean over the pixels that reference and frame both show. On "
        "drawings the flow is nearly exact, and the detector, which learned photographs, is not.\n"
    )
    folder = work / "carried-drawn"
    for _ in make_actors(folder, identities=ACTORS, frames=ACTOR_FRAMES, seed=ACTOR_SEED, size=SIZE):
        pass
    detector = load_detector()
    rows: list[list[object]] = []
    for number in range(1, ACTORS + 1):
        name = f"actor_{number:02d}"
        truth = read_truth(folder / "truth" / f"{name}.truth")
        clip = open_clip([folder / name])
        for way in WAYS:
            tell(f"carried-drawn: {name}, {way}")
            settings = BuildSettings(detector=detector if way == "auto" else None)
            source = FramedClip(clip, Framing(clip.size, None, SIZE))
            place = folder / f"build-{name}-{way}"
            build = result_of(build_steps(source, settings, place, {"identity": name}))
            rows.append([name, way, *(f"{value:.2f}" for value in _missed_px(build, truth))])
    print_table(["actor", "landmarks", *SHOWN], rows)


def _missed_px(build: Build, truth: Truth) -> list[float]:
    """Compute the mean distance of a build's fields from the true ones in each area of `SHOWN`, px."""
    labels, reference = list(truth.document["labels"]), build.choice.index
    missed: dict[str, list[float]] = {name: [] for name in SHOWN}
    for index in range(len(truth.displacement)):
        frame, flow = build.frame(index)
        to_aligned = warp.inverse_affine(frame.registration)
        for name, found in missed.items():
            seen = (truth.labels == labels.index(name)) & (truth.visibility[[reference, index]] > 0.5).all(
                axis=0
            )
            rows, columns = np.nonzero(seen)
            if len(rows) < LEAST_SEEN:
                continue
            drawn = np.column_stack([columns, rows]).astype(np.float64)
            start = drawn + truth.displacement[reference][rows, columns]
            end = warp.apply_affine(to_aligned, drawn + truth.displacement[index][rows, columns])
            found.append(float(np.hypot(*(warp.move_points(flow.displacement, start) - end).T).mean()))
    return [float(np.mean(found)) for found in missed.values()]
