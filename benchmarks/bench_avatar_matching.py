"""What a correspondence of its own gives each expression of a blend, and what each part of it is worth.

The judge runs in its own interpreter (benchmarks/face_judge.py says how to make it).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import face_judge_runner
import numpy as np
from bench_avatar import GROUPS, VIEWS
from bench_mimicry import keyed_model
from bench_tables import print_table, tell

from morphspace.arrays import AnyArray, Image, Mask
from morphspace.avatar.blend import Mixer
from morphspace.avatar.common_grid import Laid, version_picture
from morphspace.avatar.mouth import Landmarks, Matcher
from morphspace.avatar.prepared import Studio, studio_of
from morphspace.avatar.settings import REST, AvatarSettings
from morphspace.avatar.sharpness import sharpness
from morphspace.avatar.versions import Version, believed
from morphspace.face.anchor import HELD
from morphspace.face.faceframe import mouth_region
from morphspace.flow.baselines import LUMA
from morphspace.grid import warp
from morphspace.io.images import write_image
from morphspace.steps import spread

EXPRESSIONS = 12  # of each identity, evenly spread over those that are blended
LIPS = slice(48, 68)  # of the 68 points
BAND = (0.006, 0.030)  # sd of two Gaussians, of the width: edges of lips and teeth, no shading
BELIEVED_ENOUGH = 0.5  # of the reference identity's version, to be matched to


class ToTheReference(Matcher):
    """Matched to the reference identity's version, as published, where that is believed."""

    reference = 0

    def home(self, versions: Sequence[Version]) -> int:
        """Give the reference identity's place, or the source's where its own version is not believed."""
        known = believed(versions[self.reference]) > BELIEVED_ENOUGH
        return self.reference if known else super().home(versions)


class WholeFace(Matcher):
    """Matched everywhere, and held by all points."""

    holding = HELD

    def region(self, points: Landmarks, height: int, width: int) -> Mask:
        """Give ones (h, w)."""
        return np.ones((height, width), np.float32)


class WithoutLandmarks(Matcher):
    """Matched by flow alone, from the correspondence at rest."""

    def landmarks(self, i: int, version: Version) -> Landmarks | None:
        """Give landmarks so uncertain that they move nothing."""
        known = super().landmarks(i, version)
        return None if known is None else replace(known, error_px=np.full(len(known.points), 1e6))


VARIANTS: dict[str, type[Matcher] | None] = {
    "at rest, once": None,
    "each expression": Matcher,
    "to the reference's version": ToTheReference,
    "whole face": WholeFace,
    "without landmarks": WithoutLandmarks,
}


@dataclass(frozen=True, eq=False)
class Blended:
    """Blends of n expressions: `folder` of their pictures, and (n,) each of the other measures."""

    folder: Path
    agreement: AnyArray
    sharpness: AnyArray
    seconds: AnyArray


def avatar_correspondence(data: Path, work: Path, judge: str) -> None:
    """Print how well the mouths of several people lie on each other in a blend."""
    print("## Avatar: the correspondence between people\n")
    print(
        f"{EXPRESSIONS} expressions of each of four identities, blended and not sharpened. Lips off: rms distance of "
        "where the judge sees the 20 points of the lips in the blend from the mean of where it sees them in the "
        "versions, with the weights of the blend, over points and expressions; beside it the same without what is the "
        "same in all expressions. Mouths agree: correlation of the versions' luma as they lie on the blend, between "
        f"Gaussians of {100 * BAND[0]:g} % and {100 * BAND[1]:g} % of the width, in an ellipse over the mouth; mean "
        "over pairs and expressions (flow works to make it high). Sharpness: of the source's own version, before any "
        "mask. Seconds: of mixing one expression.\n"
    )
    for group in GROUPS:
        models = [keyed_model(data, name, work) for name in group]
        studio = studio_of(models, AvatarSettings(correspondence=REST))
        print(f"### {', '.join(group)}\n")
        _print_group(studio, work / "avatar-correspondence" / "-".join(group), judge)


def _print_group(studio: Studio, folder: Path, judge: str) -> None:
    plain = studio.mixer(studio.reference)
    _ = plain.mean, plain.near, plain.usual, plain.judged_picture, plain.rest
    chosen = _spread(studio)
    used, own = [], []
    for i, model in enumerate(studio.cast.models):
        write_image(
            folder / "versions" / f"rest_{i}.png", np.clip(version_picture(model.mean, plain.places[i]), 0, 1)
        )
    for index, (source, frame) in enumerate(chosen):
        tell(f"avatar-correspondence: versions, {index + 1} of {len(chosen)}")
        versions = studio.versions(source, frame)
        used.append(plain.used(versions))
        own.append(sharpness(plain.picture(source, versions[source]), plain.judged_picture))
        for i, version in enumerate(versions):
            write_image(
                folder / "versions" / f"{index:03d}_{i}.png", np.clip(plain.picture(i, version), 0, 1)
            )
    seen = _landmarks(judge, folder / "versions")
    count = len(studio.part)
    at_rest = np.array([seen[f"rest_{i}"] for i in range(count)])
    expected = []
    for index, weights in enumerate(used):
        moved = np.array([seen[f"{index:03d}_{i}"] for i in range(count)]) - at_rest
        expected.append(
            np.tensordot(plain.weights, at_rest, 1)
            + np.tensordot(weights[weights > 0], moved[weights > 0], 1)
        )
    rows = []
    for name, kind in VARIANTS.items():
        tell(f"avatar-correspondence: {name}")
        made = _blended(studio, chosen, kind, folder / name.replace(", ", "-").replace(" ", "-"))
        points = _landmarks(judge, made.folder)
        off = np.array([points[f"{index:03d}"] for index in range(len(chosen))]) - np.array(expected)
        lips = off[:, LIPS]
        rows.append(
            [
                name,
                f"{_rms(lips):.2f}",
                f"{_rms(lips - np.nanmean(lips, axis=0)):.2f}",
                f"{np.nanmean(made.agreement):.3f}",
                f"{made.sharpness.mean() / np.mean(own):.0%}",
                f"{np.median(made.seconds):.2f}",
            ]
        )
    print_table(
        ["correspondence", "lips off, px", "what varies of it", "mouths agree", "sharpness", "seconds"], rows
    )


def _spread(studio: Studio) -> list[tuple[int, int]]:
    chosen = studio.chosen()
    picked = []
    for source in range(len(studio.part)):
        mine = [one for one in chosen if one[0] == source]
        picked += [mine[int(i)] for i in spread(len(mine), EXPRESSIONS)]
    return picked


def _blended(
    studio: Studio, chosen: Sequence[tuple[int, int]], kind: type[Matcher] | None, folder: Path
) -> Blended:
    plain = studio.mixer(studio.reference)
    mixer = plain
    if kind is not None:
        matcher = kind(studio.cast.models, studio.cast.keys, plain.places, studio.settings.flow)
        if isinstance(matcher, ToTheReference):
            object.__setattr__(matcher, "reference", studio.reference)
        mixer = replace(plain, match=matcher.matched)
        for name in ("rest", "mean", "near", "mask_picture", "judged_picture", "usual"):  # the same for all
            object.__setattr__(mixer, name, getattr(plain, name))
    agreement, sharp, seconds = [], [], []
    for index, (source, frame) in enumerate(chosen):
        versions = studio.versions(source, frame)
        started = time.perf_counter()
        image = mixer.mixed(versions)
        seconds.append(time.perf_counter() - started)
        write_image(folder / f"{index:03d}.png", np.clip(image, 0, 1))
        sharp.append(sharpness(image, plain.judged_picture))
        agreement.append(
            _agreement(mixer, versions, mouth_region(*image.shape[:2], studio.faceframe(source)) > 0.5)
        )
    return Blended(folder, np.array(agreement), np.array(sharp), np.array(seconds))


def _agreement(mixer: Mixer, versions: Sequence[Version], inside: AnyArray) -> float:
    """Give the mean correlation of the versions that are believed, as they lie on the blend; NaN for fewer than two."""
    laid: dict[int, Laid] = {
        i: mixer.common.laid(i, version.morph, mixer.places[i])
        for i, version in enumerate(versions)
        if believed(version) > 0
    }
    matched = laid if mixer.match is None else mixer.match(versions, laid)
    onto = warp.invert(mixer.blended(versions).displacement)
    bands = np.array([_band(warp.sample(one.texture, onto))[inside] for one in matched.values()])
    if len(bands) < 2:
        return float("nan")
    among = np.corrcoef(bands)
    return float(among[np.triu_indices(len(bands), 1)].mean())


def _band(image: Image) -> AnyArray:
    luma = (image @ LUMA).astype(np.float32)
    fine, coarse = (cv2.GaussianBlur(luma, (0, 0), part * luma.shape[1]) for part in BAND)
    return np.asarray(fine - coarse)


def _landmarks(judge: str, folder: Path) -> dict[str, AnyArray]:
    tell(f"avatar-correspondence: judging {folder.name}")
    readings = face_judge_runner.read(judge, folder, VIEWS)
    return dict(zip(readings.names, readings.landmarks, strict=True))


def _rms(vectors: AnyArray) -> float:
    return float(np.sqrt(np.nanmean((vectors**2).sum(axis=-1))))
