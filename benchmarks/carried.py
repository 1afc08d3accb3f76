"""How much of an expression the warp carries, by a judge's landmarks: what is left over, and the slope of measures.

The judge reads the aligned frames of a build (benchmarks/judges/face.py). Its landmarks are carried back to the
reference through each frame's field. What then still moves was not followed by the field: *left over* is the rms spread
of a group of landmarks on the reference over that in the frames, 0 if the field follows and 1 if it does not. The
median of the carried landmarks, carried forward through each field, is measured as a face is; its *slope* on the
measure of the frames is 1 if the warp alone makes the expression. Left over *forward* is what the landmarks carried
forward miss in the frames, over the same spread: through closed lips, a tenth of a pixel carried back is a pixel.

A measure counts where the judge and the face mesh agree on the person's frames; so does the group that it stands for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from clips import SIZE, clip_frames
from judges import measures, reading
from tables import at_least, at_most, print_table, tell

from morphspace.arrays import AnyArray, Displacement, Image
from morphspace.face.detector import Detector, load_detector
from morphspace.face.mesh import POINT_COUNT
from morphspace.grid import warp
from morphspace.io.clips import open_clip
from morphspace.io.framing import FramedClip, Framing
from morphspace.io.images import write_image
from morphspace.model.carried import Carried
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
READ = 0.85  # r of the judge and the face mesh, which share nothing, on a person's own frames
MEASURE_OF_GROUP = dict(
    zip(GROUPS, ("lip_height", "mouth_opening", "brow_height", "eye_aperture"), strict=True)
)
SLOPE_MARKS = dict(zip(MEASURED, (0.85, 0.85, 0.85, 0.6, 0.6), strict=True))
WAYS = ("none", "auto")
ACTORS, ACTOR_FRAMES, ACTOR_SEED = 3, 30, 5
SHOWN = ("skin", "eye", "mouth")  # areas of a drawn face; eye and mouth are what shows between lids and lips
LEAST_SEEN = 3  # pixels


@dataclass(frozen=True, eq=False)
class Figures:
    """Left over of the `GROUPS`, carried back and forward (4,), and slopes and sd of the `MEASURED` (5,).

    `own` are the figures that the build itself estimated, None if it did not.
    """

    back: AnyArray
    forward: AnyArray
    slopes: AnyArray
    sd: AnyArray
    own: Carried | None = None


def carried(data: Path, work: Path, judge: str) -> None:
    """Print left over and slopes of each person, of builds without and with face points, and their means."""
    print(
        f"{FRAMES} frames of each person on whom no constant was chosen, models at 200 x 240, built with `--landmarks "
        "none` and `auto`. Judge: 68 landmarks of dlib, which no build uses. Left over, carried back / forward: 0 if "
        "the field follows the feature. Slope: 1 if the warp alone makes the expression; in brackets the sd of the "
        "measure, % of the eye distance. What dlib and the face mesh do not agree on in a person's frames (r below "
        f"{READ}) is unread: it stands in parentheses (r behind it), and the means leave it out. Own estimate: "
        "what the build itself reports, from points of its own detector that did not hold the flow.\n"
    )
    detector = load_detector()
    rows: list[list[object]] = []
    found: dict[str, list[Figures]] = {way: [] for way in WAYS}
    agreements = []
    for name in REPORTED:
        for way in reversed(WAYS):  # what can be read is asked of the frames of `auto`
            one, agreement = _judged(data, name, work, judge, detector if way == "auto" else None)
            found[way].append(one)
            if agreement is not None:
                agreements.append(agreement)
            rows.append([name, way, *_cells(one, agreements[-1])])
            if one.own is not None:
                rows.append([name, "own estimate", *_own_cells(one.own)])
    is_read = np.array(agreements) >= READ
    of_group = is_read[:, [MEASURED.index(name) for name in MEASURE_OF_GROUP.values()]]
    for way in WAYS:
        back, forward, slopes = (
            _mean_of_read([getattr(one, kind) for one in found[way]], read)
            for kind, read in (("back", of_group), ("forward", of_group), ("slopes", is_read))
        )
        left = [f"{one:.2f} / {other:.2f}" for one, other in zip(back, forward, strict=True)]
        rows.append(["mean of the read", way, *left, *(f"{value:.2f}" for value in slopes)])
        verdicts = [at_most(value, mark) for value, mark in zip(back, MARKS.values(), strict=True)]
        verdicts += [at_least(value, mark) for value, mark in zip(slopes, SLOPE_MARKS.values(), strict=True)]
        rows.append(["landing mark", way, *verdicts])
        every = [np.mean([getattr(one, kind) for one in found[way]], axis=0) for kind in ("back", "slopes")]
        rows.append(["mean of all", way, *(f"{value:.2f}" for value in np.concatenate(every))])
    heads = [f"left, {group}" for group in GROUPS] + [f"slope, {name.replace('_', ' ')}" for name in MEASURED]
    print_table(["person", "landmarks", *heads], rows)


def _cells(one: Figures, agreement: AnyArray) -> list[str]:
    """Write the figures of a person; what is unread in parentheses."""
    of_group = agreement[[MEASURED.index(name) for name in MEASURE_OF_GROUP.values()]]
    left = [f"{back:.2f} / {forward:.2f}" for back, forward in zip(one.back, one.forward, strict=True)]
    slopes = [f"{slope:.2f} [{100 * sd:.1f}]" for slope, sd in zip(one.slopes, one.sd, strict=True)]
    read = zip([*left, *slopes], [*of_group, *agreement], strict=True)
    return [cell if r >= READ else f"({cell}) r {r:.2f}" for cell, r in read]


def _own_cells(own: Carried) -> list[str]:
    """Write a build's own estimate: left over of the `GROUPS`, and the slope of the group behind each measure."""
    slopes = dict(zip(MEASURE_OF_GROUP.values(), own.slopes, strict=True))
    left = [f"{value:.2f}" for value in own.left_over]
    return [*left, *(f"{slopes[name]:.2f}" if name in slopes else "" for name in MEASURED)]


def _mean_of_read(rows: list[AnyArray], is_read: AnyArray) -> AnyArray:
    """Average figures (n, m) over the people on whom they are read (n, m); nan where nobody is."""
    out: AnyArray = (np.array(rows) * is_read).sum(axis=0) / is_read.sum(axis=0)
    return out


def _judged(
    data: Path, name: str, work: Path, judge: str, detector: Detector | None
) -> tuple[Figures, AnyArray | None]:
    """Build a model and judge its fields; with a detector also r of judge and face mesh for the measures (5,)."""
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
    found = replace(figures(fields, marks[seen]), own=build.carried)
    return found, None if detector is None else _agreement(
        marks, [frame.image for frame, _ in frames], detector
    )


def _agreement(marks: AnyArray, images: list[Image], detector: Detector) -> AnyArray:
    """Correlate the `MEASURED` of the judge's landmarks (n, 68, 2) with those of the face mesh in n images: r (5,)."""
    faces = [detector(image) for image in images]
    nothing = np.full((POINT_COUNT, 2), np.nan)
    meshes = np.array([nothing if face is None else face.points for face in faces])
    both = measures.mimicry(measures.expression(marks), measures.expression(meshes, measures.MESH))
    out: AnyArray = np.nan_to_num(both[[measures.MEASURES.index(name) for name in MEASURED], 0])
    return out


def figures(fields: list[Displacement], marks: AnyArray) -> Figures:
    """Compute the figures of n fields from the landmarks (n, 68, 2) of their frames."""
    back = np.array(
        [warp.move_points(warp.invert(field), one) for field, one in zip(fields, marks, strict=True)]
    )
    middle = np.median(back, axis=0)
    forward = np.array([warp.move_points(field, middle) for field in fields])
    spans = [slice(*group) for group in GROUPS.values()]
    spread_px = np.array([_spread_of(marks[:, span]) for span in spans])
    places = [measures.MEASURES.index(name) for name in MEASURED]
    true, made = (measures.expression(points)[:, places] for points in (marks, forward))
    true, made = true - true.mean(axis=0), made - made.mean(axis=0)
    return Figures(
        np.array([_spread_of(back[:, span]) for span in spans]) / spread_px,
        np.array([_spread_of((marks - forward)[:, span]) for span in spans]) / spread_px,
        (true * made).sum(axis=0) / (true**2).sum(axis=0),
        true.std(axis=0),
    )


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
