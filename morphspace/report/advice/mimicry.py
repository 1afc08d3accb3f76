"""Advice on a mimicry: frames without a face, mean faces that differ, motion that was lost, and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray
from morphspace.face.detector import Detector, how_to_get_networks
from morphspace.face.expression import expression_of
from morphspace.face.mesh import FacePoints
from morphspace.model.encode import STRANGE
from morphspace.model.model import MorphModel
from morphspace.transfer.driver import Driver
from morphspace.transfer.neutral import Neutral
from morphspace.transfer.quality_table import BEYOND, FOLDS, NO_FACE, OUT_OF_RANGE, TURNED, FrameMade, rounded

LITTLE_KEPT = 0.3  # median share of the motion; below it the target hardly follows
WANTED_GAIN = 0.5  # away from 1; a gain this far from 1 changes the size of the motion on purpose
# Of the eye distance. Means of five clips differ by .01 to .09 in opening; in width, where people differ too, by .02 to
# .10 where both hold all kinds of faces, and by .15 to .26 where one holds a single smile.
MEANS_APART = {"opening": 0.08, "width": 0.18}
OFF_CENTRE_SD = 2.0  # mean loading of a whole clip; the source's own training frames come to 0


@dataclass(frozen=True, eq=False)
class Looks:
    """The detector of faces in driving frames, None without one; `means` are the face points of both mean faces."""

    detector: Detector | None
    means: tuple[FacePoints, FacePoints] | None
    notes: tuple[str, ...] = ()


def looks_for_faces(
    driver: Driver, source: MorphModel, target: MorphModel, detector: Detector | None
) -> Looks:
    """Decide whether faces are detected in the driving frames, detect both mean faces, and note what was not checked.

    A detector that finds no face in the source's mean, such as a drawn one, finds none in the frames either.
    """
    if detector is None:
        frames = "whether each driving frame shows a face, " if driver.is_pictures else ""
        words = (
            f"not checked without the networks: {frames}whether a head is turned, and whether the two mean faces "
            f"differ in expression. To check, {how_to_get_networks()}"
        )
        return Looks(None, None, (words,))
    found = [detector(np.clip(model.mean.render(), 0, 1)) for model in (source, target)]
    a, b = found
    means = (a, b) if a is not None and b is not None else None
    if a is None:
        words = (
            f"the detector finds no face in the mean of {source.identity}, so its frames were not checked for faces "
            "and turned heads"
        )
        return Looks(None, None, (words,) if driver.is_pictures else ())
    return Looks(detector, means)


def advice_of(
    source: MorphModel,
    target: MorphModel,
    made: Sequence[FrameMade],
    loadings_sd: AnyArray,
    looks: Looks,
    gain: float,
    neutral: Neutral,
) -> tuple[str, ...]:
    """Return the notes to read first, each with what to do about it."""
    strange = _strange_words(source, made)
    return (
        *strange,
        *(neutral.notes(source, target) or _means_words(source, target, looks)),
        *_kept_words(target, made, gain, loadings_sd.shape[1]),
        *(() if strange else _centre_words(source, target, loadings_sd, neutral)),
        *_flag_words(target, made),
    )


def _means_words(source: MorphModel, target: MorphModel, looks: Looks) -> tuple[str, ...]:
    if looks.means is None:
        return ()
    a, b = (
        {"opening": one.mouth_opening, "width": one.mouth_width} for one in map(expression_of, looks.means)
    )
    words = [
        f"the mouth's {name} is {a[name]:.0%} of the eye distance in {source.identity}, {b[name]:.0%} in "
        f"{target.identity}"
        for name, limit in MEANS_APART.items()
        if abs(a[name] - b[name]) > limit
    ]
    if not words:
        return ()
    return (
        f"the mean faces differ in expression: {' and '.join(words)}. Every face of {target.identity} contains this "
        "difference. Name a neutral frame of each with --neutral A_FRAME,B_FRAME, or build both models from frames of "
        "similar expressions",
    )


def _kept_words(
    target: MorphModel, made: Sequence[FrameMade], gain: float, components: int
) -> tuple[str, ...]:
    kept = float(np.median([rounded("warp_kept", one.quality.warp_kept) for one in made]))
    if kept >= LITTLE_KEPT or abs(gain - 1) > WANTED_GAIN:
        return ()
    shown = f"{target.identity} shows only {max(kept, 0):.0%} of the motion's energy (median over frames)"
    if components < target.rank:
        return (
            f"{shown}, with {components} of its {target.rank} components. Leave out -k, or give a larger number",
        )
    return (
        f"{shown}: its training frames show little of this motion. Build its model from frames with more and stronger "
        "expressions, or check the keypoints of both models",
    )


def _strange_words(source: MorphModel, made: Sequence[FrameMade]) -> tuple[str, ...]:
    """Note driving frames that evidently differ from the source in person, camera or light."""
    seen = [one.outside_source for one in made if one.outside_source is not None]
    outside = float(np.median(seen)) if seen else 0.0
    if outside <= STRANGE:
        return ()
    return (
        f"the driving frames are evidently of another person, day or camera than {source.identity}: their energy "
        f"outside the model's space (outside_source in quality.csv) is {outside:.1f} times the model's variance; "
        "expected about 0.2. The mimicry then shows the difference between the faces more than their motion. Give as "
        "--src a model of the person in the frames",
    )


def _centre_words(
    source: MorphModel, target: MorphModel, loadings_sd: AnyArray, neutral: Neutral
) -> tuple[str, ...]:
    if not neutral.is_means:
        return ()
    mean = loadings_sd.mean(axis=0)
    farthest = int(np.abs(mean).argmax())
    if abs(mean[farthest]) <= OFF_CENTRE_SD:
        return ()
    return (
        f"on average the frames drive {target.identity} to {mean[farthest]:+.1f} SD of pc{farthest + 1:03d}. Either "
        "the driving clip shows mostly one expression, or its light or pose differs from that of the frames that "
        f"{source.identity} was built from. In the second case every face contains this difference. Build the source's "
        "model from the driving clip",
    )


def _flag_words(target: MorphModel, made: Sequence[FrameMade]) -> tuple[str, ...]:
    meanings = {
        NO_FACE: "show no face that the detector finds: their mimicry is not meaningful",
        TURNED: "show a head turned by more than 20 degrees: its far side is hidden, and the motion is less certain",
        BEYOND: f"need more motion than {target.identity} shows in any training frame: at lids, brows and lips more "
        f"than {OUT_OF_RANGE:.0%} of the eye distance is missing (missing_motion), or the mouth would have to open "
        "wider (opening_beyond). Build its model from frames that show such expressions, or lower the gain",
        FOLDS: "fold in places: lower --gain or --max-sd",
    }
    words = []
    for flag, meaning in meanings.items():
        count = sum(flag in one.flags for one in made)
        if count:
            words.append(f"{count} of {len(made)} frames {meaning}; quality.csv marks them {flag}")
    return tuple(words)
