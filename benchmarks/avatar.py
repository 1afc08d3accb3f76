"""Whether a blend of several people is nobody, is of all of them, moves as they do and is as sharp, by a judge apart.

The judge runs in its own interpreter (benchmarks/judges/face.py says how to make it). Judged are the faces which the
blend's model draws from the loadings of its own training frames, beside the same expressions drawn by the model of the
person whose they are.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from judges import measures, reading
from mimicry import keyed_model
from tables import at_least, at_most, print_table, tell

from morphspace.arrays import AnyArray, Image, Mask
from morphspace.avatar import Avatar, AvatarSettings, blend_steps
from morphspace.face.detector import load_detector
from morphspace.face.regions import mouth_surroundings, rigid_region
from morphspace.face.registration import fitted_similarity
from morphspace.flow.baselines import LUMA
from morphspace.grid.warp import apply_affine
from morphspace.io.images import write_image
from morphspace.linear.quality import psnr_db
from morphspace.model.model import MorphModel
from morphspace.requests import settings_in
from morphspace.steps import result_of, spread
from morphspace.verbs.blend_avatar import BlendAvatarRequest

GROUPS = (("lp_d18", "lp_d13", "lp_d0", "lp_d9"), ("lp_d18", "lp_d13", "lp_d6", "lp_d9"))
JUDGED = 24  # expressions of each identity, evenly spread
VIEWS = 8  # copies of a picture the judge averages over
LAW_EXPRESSIONS = 10
COSTS = ((2, 20), (4, 20), (4, 60))  # identities, expressions of each
STILL = (27, 28, 29, 30, 36, 39, 42, 45)  # of the 68 points: nose bridge and corners of the eyes
GOAL_NOBODY, GOAL_RANGE, GOAL_SHARP, GOAL_SAME_DB, GOAL_MINUTES = 0.40, 0.80, (0.85, 1.20), 40.0, 10.0
BLEND, AVERAGE = "blend", "pixel average"


@dataclass(frozen=True, eq=False)
class Judged:
    """Faces read by the judge, and how sharp they are: variance of the Laplacian (n, 2), on the face and further in."""

    readings: measures.Readings
    sharpness: AnyArray


def avatar(data: Path, work: Path, judge: str) -> None:
    """Print identity distances, range, sharpness and weights of blends of four people, and of their pixel average."""
    print(
        f"Blends of four models with keypoints and landmarks (`keypoints --auto`), at the defaults of `blend-avatar`; "
        f"up to {JUDGED} expressions of each identity are judged. To a source: distance of the judge's embedding of "
        "what was made to the source's mean (one person: below .6); source to others: the mean of the same distance "
        "of the source's own faces to each of the other three. Goals: at least "
        f"{GOAL_NOBODY:.2f} from every source and nearer to each than it is to the others. Range: rms motion of the 68 "
        "landmarks about their mean over the expressions of one source, head motion taken out, as a share of that "
        f"source's; the goal, {GOAL_RANGE:.0%}, is for the mean. Sharpness: variance of the Laplacian of the "
        "faces as the models draw them, all aligned as the blend is, in one region of the face (inside its outline and "
        "all masks, nobody's hair), and on the rigid part and the mouth; "
        f"goal {GOAL_SHARP[0]:.0%} to {GOAL_SHARP[1]:.0%} of the sources' mean. Blended pictures: what the "
        "blend's model was built from. "
        "Mimicry: mean r / slope of the judge's measures of what was made on the source's. Pixel average: the same "
        "versions with the same weights, without a warp.\n"
    )
    for group in GROUPS:
        models = [keyed_model(data, name, work) for name in group]
        started = time.perf_counter()
        blend = _blend(
            models, replace(settings_of(), detector=load_detector()), work / "avatar" / "-".join(group)
        )
        tell(
            f"avatar: {', '.join(group)} took {time.perf_counter() - started:.0f} s (less where it was kept)"
        )
        _print_group(blend, models, group, work / "avatar" / ("-".join(group) + "-judged"), judge)


def settings_of(**changes: Any) -> AvatarSettings:
    """Give the settings of a blend as the verb has them, but for some."""
    return settings_in(BlendAvatarRequest(("a", "b"), Path("avatar.morph"), **changes), AvatarSettings)


def avatar_laws(data: Path, work: Path) -> None:
    """Print what must hold of every blend: with oneself, in any order, with weight 1 and 0."""
    print(
        f"lp_d18 and lp_d13, {LAW_EXPRESSIONS} expressions each, fast flow. PSNR inside the mask, lowest over "
        "expressions: of the blend against the face as its own model draws it (itself; weight 1, 0), and of one blend "
        "against the other (order).\n"
    )
    one, other = (keyed_model(data, name, work) for name in ("lp_d18", "lp_d13"))
    settings = settings_of(expressions=LAW_EXPRESSIONS, flow="fast", sharpen=0.0)
    folder = work / "avatar-laws"
    rows = []
    for name, models, weights in (("itself", [one, one], None), ("weight 1, 0", [one, other], (1.0, 0.0))):
        made = _blend(models, replace(settings, weights=weights), folder / name.replace(", ", "-"))
        decibels = []
        for index, expression in enumerate(made.expressions):
            owner = models[expression.source]
            if owner is one:
                decibels.append(psnr_db(made.blend(index), _own(owner, expression.frame), one.mask))
        rows.append(
            [name, f"{min(decibels):.1f}", f">= {GOAL_SAME_DB:g}", at_least(min(decibels), GOAL_SAME_DB)]
        )
    there = _blend([one, other], settings, folder / "there")
    back = _blend([other, one], settings, folder / "back")
    places = {expression.name: index for index, expression in enumerate(back.expressions)}
    same = [
        psnr_db(there.blend(index), back.blend(places[expression.name]), one.mask)
        for index, expression in enumerate(there.expressions)
    ]
    rows.append(["order", f"{min(same):.1f}", f">= {GOAL_SAME_DB:g}", at_least(min(same), GOAL_SAME_DB)])
    print_table(["law", "PSNR dB", "goal", "goal?"], rows)


def avatar_cost(data: Path, work: Path) -> None:
    """Print the time of a blend against the number of identities and expressions, from an empty work folder."""
    print(
        "Seconds of a whole blend with fast flow from an empty work folder, its model included, on a machine that "
        "others may use; CPU seconds beside them. Versions: expressions times identities. Goal: four identities of 60 "
        f"expressions in at most {GOAL_MINUTES:g} minutes, and cost that grows no faster than the versions.\n"
    )
    models = [keyed_model(data, name, work) for name in GROUPS[0]]
    rows, per_version = [], []
    for count, expressions in COSTS:
        folder = work / "avatar-cost"
        shutil.rmtree(folder, ignore_errors=True)
        tell(f"avatar-cost: {count} identities, {expressions} expressions each")
        wall, processor = time.perf_counter(), time.process_time()
        made = _blend(models[:count], settings_of(expressions=expressions, flow="fast"), folder)
        wall, processor = time.perf_counter() - wall, time.process_time() - processor
        versions = len(made.expressions) * count
        per_version.append(processor / versions)
        full = count == 4 and expressions == 60
        rows.append(
            [
                count,
                len(made.expressions),
                versions,
                f"{wall:.0f}",
                f"{processor:.0f}",
                f"{1000 * processor / versions:.0f}",
                f"<= {60 * GOAL_MINUTES:.0f} s" if full else "",
                at_most(wall, 60 * GOAL_MINUTES) if full else "",
            ]
        )
        shutil.rmtree(folder, ignore_errors=True)
    heads = ["identities", "expressions", "versions", "seconds", "CPU s", "CPU ms each", "goal", "goal?"]
    print_table(heads, rows)
    print(
        f"CPU time for each version, last row over first: {per_version[-1] / per_version[0]:.2f} "
        f"({at_most(per_version[-1] / per_version[0], 1.1)}, goal at most 1.1).\n",
        flush=True,
    )


def _blend(models: Sequence[MorphModel], settings: AvatarSettings, folder: Path) -> Avatar:
    tell(f"avatar: blending into {folder.name}")
    return result_of(blend_steps(models, settings, folder))


def _own(model: MorphModel, frame: str) -> Image:
    """Give a training frame as its own model draws it, as a file would hold it."""
    place = model.training.frame_names.index(frame)
    return np.clip(model.render(model.training.values[place]), 0, 1)


def _print_group(
    blend: Avatar, models: Sequence[MorphModel], group: Sequence[str], folder: Path, judge: str
) -> None:
    sources = np.array([expression.source for expression in blend.expressions])
    judged = {
        place: [int(mine[i]) for i in spread(len(mine), JUDGED)]
        for place in range(len(models))
        if len(mine := np.flatnonzero(sources == place))
    }
    chosen = [index for indices in judged.values() for index in indices]
    own = {
        place: _read(
            judge,
            folder / f"source-{place}",
            indices,
            lambda index, place=place: _own(models[place], blend.expressions[index].frame),
            lambda index, place=place: _sharpness(blend.versions(index)[place], blend),
        )
        for place, indices in judged.items()
    }
    rows_of_model = {name: row for row, name in enumerate(blend.model.training.frame_names)}

    def drawn(index: int) -> Image:
        row = rows_of_model[blend.expressions[index].name]
        return np.clip(blend.model.render(blend.model.training.values[row]), 0, 1)

    made = {
        BLEND: _read(judge, folder / "blend", chosen, drawn, lambda index: _sharpness(drawn(index), blend)),
        AVERAGE: _read(
            judge,
            folder / "average",
            chosen,
            blend.pixel_average,
            lambda index: _sharpness(blend.pixel_average(index), blend),
        ),
    }
    print(f"## {', '.join(group)}\n")
    _print_identity(made, own, group)
    _print_motion(made, own, group)
    pictures = np.array([_sharpness(blend.blend(index), blend) for index in chosen])
    _print_sharpness(made, own, group, blend, pictures)
    _print_weights(blend, group)


def _print_identity(made: dict[str, Judged], own: dict[int, Judged], group: Sequence[str]) -> None:
    rows = []
    for place, one in own.items():
        to_others = np.mean(
            [
                measures.identity_distance(one.readings.embeddings, other.readings.embeddings)
                for elsewhere, other in own.items()
                if elsewhere != place
            ]
        )
        to_blend, to_average = (
            measures.identity_distance(made[kind].readings.embeddings, one.readings.embeddings)
            for kind in (BLEND, AVERAGE)
        )
        nearer = "met" if to_blend <= to_others else "MISSED"
        rows.append(
            [
                group[place],
                f"{to_blend:.2f}",
                at_least(to_blend, GOAL_NOBODY),
                f"{to_others:.2f}",
                nearer,
                f"{to_average:.2f}",
            ]
        )
    heads = [
        "source",
        "blend to it",
        f">= {GOAL_NOBODY:.2f}",
        "it to the others",
        "blend nearer",
        "pixel average",
    ]
    print_table(heads, rows)


def _print_motion(made: dict[str, Judged], own: dict[int, Judged], group: Sequence[str]) -> None:
    rows = []
    shares: dict[str, list[float]] = {BLEND: [], AVERAGE: []}
    for place, one in own.items():
        row = [group[place], f"{100 * landmark_range(one.readings.landmarks):.2f}"]
        for kind, other in made.items():
            here, there = measures.paired(one.readings, other.readings)
            found = one.readings.found[here] & other.readings.found[there]
            theirs, ours = one.readings.landmarks[here][found], other.readings.landmarks[there][found]
            share = landmark_range(ours) / landmark_range(theirs)
            shares[kind].append(share)
            both = measures.mimicry(measures.expression(theirs), measures.expression(ours))
            r, slope = np.nanmean(both, axis=0)
            row += [f"{share:.0%}", f"{r:.2f} / {slope:.2f}", f"{found.sum()} of {len(found)}"]
        rows.append(row)
    means = {kind: float(np.mean(values)) for kind, values in shares.items()}
    rows.append(
        [
            "mean",
            "",
            f"{means[BLEND]:.0%}",
            at_least(means[BLEND], GOAL_RANGE),
            "",
            f"{means[AVERAGE]:.0%}",
            "",
            "",
        ]
    )
    heads = ["expressions of", "its range, % of eyes"]
    for kind in made:
        heads += [f"{kind}: range", "mimicry", "faces found"]
    print_table(heads, rows)


def landmark_range(landmarks: AnyArray) -> float:
    """Give the rms motion of landmarks (n, 68, 2) about their mean, in distances between the eyes, head motion out.

    Each face is laid on the first by the similarity that fits nose bridge and corners of the eyes best. Rows that are
    nan are left out; NaN where fewer than two are left.
    """
    found = landmarks[np.isfinite(landmarks).all(axis=(1, 2))]
    if len(found) < 2:
        return float("nan")
    still = list(STILL)
    rest = found.mean(axis=0)
    laid = np.array([apply_affine(fitted_similarity(face[still], rest[still]), face) for face in found])
    motion = np.sqrt(((laid - laid.mean(axis=0)) ** 2).sum(axis=-1).mean())
    right, left = (
        rest[list(corners)].mean(axis=0)
        for corners in (measures.RIGHT_EYE_CORNERS, measures.LEFT_EYE_CORNERS)
    )
    return float(motion / np.hypot(*(left - right)))


def _print_sharpness(
    made: dict[str, Judged], own: dict[int, Judged], group: Sequence[str], blend: Avatar, pictures: AnyArray
) -> None:
    mean = np.mean([one.sharpness.mean(axis=0) for one in own.values()], axis=0)
    faces = {
        **{group[place]: one.sharpness for place, one in own.items()},
        "blended pictures": pictures,
        **{kind: one.sharpness for kind, one in made.items()},
    }
    rows = []
    for name, values in faces.items():
        share = values.mean(axis=0) / mean
        verdict = "met" if GOAL_SHARP[0] <= share[0] <= GOAL_SHARP[1] else "MISSED"
        rows.append(
            [
                name,
                f"{values[:, 0].mean():.2f}",
                f"{share[0]:.0%}",
                verdict if name == BLEND else "",
                f"{values[:, 1].mean():.2f}",
                f"{share[1]:.0%}",
            ]
        )
    print_table(
        ["faces", "on the face", "of the sources", "85 to 120 %", "further in", "of the sources"], rows
    )
    told = float(blend.sharpness["sources"] @ blend.weights)
    print(
        f"Unsharp mask: amount {blend.sharpen:.2f}; by the report the blend is {blend.sharpness[BLEND] / told:.0%} as "
        f"sharp as the sources, its pictures {blend.sharpness['pictures'] / told:.0%}, the pixel average "
        f"{blend.sharpness[AVERAGE] / told:.0%}.\n",
        flush=True,
    )


def _print_weights(blend: Avatar, group: Sequence[str]) -> None:
    used = np.array([expression.weights for expression in blend.expressions])
    sources = np.array([expression.source for expression in blend.expressions])
    rows = []
    for place, name in enumerate(group):
        others = sources != place
        rows.append(
            [
                name,
                int((~others).sum()),
                f"{blend.weights[place]:.2f}",
                f"{used[:, place].mean():.2f}",
                f"{used[others, place].min():.2f}",
                f"{(used[others, place] == 0).sum()} of {others.sum()}",
            ]
        )
    heads = ["identity", "expressions", "weight asked", "used, mean", "least", "left out of the others'"]
    print_table(heads, rows)


def _read(
    judge: str,
    folder: Path,
    indices: Sequence[int],
    picture: Callable[[int], Image],
    sharp: Callable[[int], tuple[float, float]],
) -> Judged:
    """Write the pictures of these expressions as the judge wants them, and read them."""
    shutil.rmtree(folder, ignore_errors=True)
    for index in indices:
        write_image(folder / f"{index:04d}.png", np.clip(picture(index), 0, 1))
    tell(f"avatar: judging {folder.name}")
    return Judged(reading.read_faces(judge, folder, VIEWS), np.array([sharp(index) for index in indices]))


def _sharpness(image: Image, blend: Avatar) -> tuple[float, float]:
    """Give the variance, in 1e-3, of an aligned face in the region all share, and nearer the middle of it."""
    height, width = blend.model.mask.shape
    inner = np.maximum(
        *(part(height, width, blend.model.faceframe) for part in (rigid_region, mouth_surroundings))
    )
    region = blend.studio.mixer(0).judged_picture
    return 1e3 * laplacian_variance(image, region), 1e3 * laplacian_variance(image, inner)


def laplacian_variance(image: Image, mask: Mask) -> float:
    """Give the variance of the Laplacian of luma of an image (h, w, 3) where the mask (h, w) passes one half."""
    luma = (np.clip(image, 0, 1) @ LUMA).astype(np.float32)
    return float(cv2.Laplacian(luma, cv2.CV_32F)[mask > 0.5].var(dtype=np.float64))
