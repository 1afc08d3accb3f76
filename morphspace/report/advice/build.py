"""Advice on a build: what was measured, and what to do about it.

Each rule is a function of the case and names its limit with the reason for it. The limits were tried on six real clips
of talking and grimacing heads and on drawn ones; where a rule guesses at a cause, its sentence says so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from morphspace.arrays import Affine, AnyArray
from morphspace.face.mesh import APERTURES, FEATURES, MAX_TURN_DEG
from morphspace.flow.baselines import LUMA
from morphspace.model.carried import HARDLY_MOVES
from morphspace.model.passes import Build
from morphspace.report.frames import FrameFigures

Level = Literal["mend", "consider"]
HEAD_SHIFT_SHARE = 0.08  # of the frame's side; more brings background in, and seldom comes without a turn
HEAD_TURN_DEG = 10.0  # in the picture's plane; the resampling is exact, but such a head also tilts in depth
HEAD_SCALE_SHARE = 0.10  # nearer or further by a tenth changes the perspective of the face
LOST_SCALE = 1.3  # times the median size, or one over it: no head comes so much nearer within a clip
HEAD_DEPTH_SHARE = 0.02  # of the frame's width, rms left in the rigid part: expressions alone stay below it
EXPOSURE_RANGE_STOPS = 0.25  # 8 % in coded values: as much as the shading of an expression
EXPOSURE_DRIFT_CORRELATION = 0.7  # of exposure with time: above it the light drifts, below it flickers
EYES_LEAST_SHARE = 0.18  # of the frame's width from eye to eye; frames cropped to the head have 0.23 to 0.30
MOUTH_REACH = 0.04  # of the mouth region's contrast over a clip; below it the mouth hardly opens
MOUTH_CLOSED = 0.12  # of that reach; on six clips two shut references lay below 0.05, the others above 0.14
MOUTH_SLIGHTLY_OPEN = (0.2, 0.6)  # of that reach; the paper asks for some teeth and a dark gap
FOLD_SHARE = 0.01  # of the cells inside the mask; folds this large are seen as smears
CONFIDENCE_LOW = 0.5  # mean inside the mask; below it more of the face is filled in than was found
# On eight `tune` people features that move by .02 eye distances or more leave over .03 to .5 and have slopes from .9,
# but for the brows of one (.79, .49). Openings have slopes from .81; .35 where an earlier field painted a wide mouth.
CARRIED_LEFT, CARRIED_SLOPE = 0.6, 0.6  # of a feature's motion; the warp then misses about half of it
PSNR_LOW_DB = 30.0  # below it a rebuilt frame visibly differs from the original
PSNR_MANY = 0.25  # of the frames; when so many are poor it is the model, not the frames
MASK_LEAST_SHARE = 0.05  # of the frame; a face in so small a part has too few pixels
MASK_MOST_SHARE = 0.95  # of the frame; then the background is part of the model
MASK_FLAT_SD = 0.01  # luma; without texture the flow has nothing to follow
FRAMES_FEW = 20  # frames; fewer show too few expressions for components that can be interpreted
SOURCE_LARGER = 1.5  # times in each direction; below it a larger model would show little more
NAMES_AT_MOST = 5  # in a sentence


@dataclass(frozen=True)
class Advice:
    """One piece of advice: the `rule` it comes from, its level, and the sentence.

    `mend` means that the model suffers; `consider` that it may be as intended.
    """

    rule: str
    level: Level
    text: str


@dataclass(frozen=True, eq=False)
class Case:
    """The input of the rules: the build, its figures, and the size (w, h) px of the sources if known."""

    build: Build
    figures: FrameFigures
    source_size: tuple[int, int] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The frames' names."""
        return self.build.model.training.frame_names

    def named(self, indices: Sequence[int] | AnyArray) -> str:
        """Give the names of some frames for a sentence, cut short where they are many."""
        shown = [self.names[int(index)] for index in indices[:NAMES_AT_MOST]]
        more = len(indices) - len(shown)
        return ", ".join(shown) + (f" and {more} more" if more > 0 else "")


@dataclass(frozen=True, eq=False)
class HeadPath:
    """The movement of the head relative to the reference: shift (n, 2) px of the frame's centre, turn, scale."""

    shift_px: AnyArray
    turn_deg: AnyArray
    scale: AnyArray


def head_path(registrations: Affine, size: tuple[int, int]) -> HeadPath:
    """Take registrations (n, 2, 3) apart; `size` (w, h) px. Right, down and clockwise are positive."""
    centre = (np.array(size) - 1) / 2
    linear = registrations[:, :, :2]
    shift = linear @ centre + registrations[:, :, 2] - centre
    turn = np.degrees(np.arctan2(linear[:, 1, 0] - linear[:, 0, 1], linear[:, 0, 0] + linear[:, 1, 1]))
    return HeadPath(shift, turn, np.sqrt(np.abs(np.linalg.det(linear))))


def advice_for(case: Case) -> tuple[Advice, ...]:
    """Return all advice on a build; the level `mend` comes first. Ours."""
    found = [Advice(rule, level, words) for rule, level, say in RULES for words in say(case)]
    return tuple(sorted(found, key=lambda advice: advice.level == "consider"))


def _warnings_of_the_build(case: Case) -> Iterator[str]:
    for warning in case.build.warnings:
        yield warning[:1].upper() + warning[1:] + "."


def _registration_lost(case: Case) -> Iterator[str]:
    """Advise if registration gave a frame a size that no head can have."""
    lost = np.flatnonzero(_lost(head_path(case.build.registrations, case.build.model.size)))
    if len(lost):
        yield (
            f"Registration failed in {_frames(len(lost))} ({case.named(lost)}): it made the face larger or smaller "
            f"by more than a factor of {LOST_SCALE:g}. Look at these frames; leave them out, or crop the clip closer "
            "to the face."
        )


def _head_moved(case: Case) -> Iterator[str]:
    """Advise if registration had to move, turn or scale the frames far."""
    size = case.build.model.size
    path = head_path(case.build.registrations, size)
    kept = ~_lost(path)
    shift, turn = np.ptp(path.shift_px[kept], axis=0), np.ptp(path.turn_deg[kept])
    scale = np.ptp(path.scale[kept])
    ways = []
    if (shift / size).max() > HEAD_SHIFT_SHARE:
        ways.append(
            f"shifts over {shift[0]:.0f} px across and {shift[1]:.0f} px down in frames of {size[0]} x {size[1]} px"
        )
    if turn > HEAD_TURN_DEG:
        ways.append(f"tilts over {turn:.0f} degrees")
    if scale > HEAD_SCALE_SHARE:
        ways.append(f"changes its size by {100 * scale:.0f} %")
    if ways:
        listed = " and ".join(filter(None, (", ".join(ways[:-1]), ways[-1])))
        yield (
            f"The head moved a lot: it {listed}. Registration removes this, but not the change of view that comes "
            "with it. Film with the head at rest (a chin or head rest), or leave out the frames at the ends of the "
            "path under Head movement and light."
        )


def _head_turned(case: Case) -> Iterator[str]:
    """Advise if brow and nose still move after registration: the head turned in depth, or registration failed."""
    limit = HEAD_DEPTH_SHARE * case.build.model.size[0]
    over = _worst_first(case.figures.rigid_motion_px, case.figures.rigid_motion_px > limit)
    if len(over):
        yield (
            f"In {_frames(len(over))} brow and nose still move by more than {limit:.1f} px (rms) after registration, "
            f"the most in {case.named(over)}. Most likely the head turned or nodded, and the model takes that for "
            "expression. Leave these frames out, or film with the head facing the camera throughout."
        )


def _exposure_changed(case: Case) -> Iterator[str]:
    """Advise if the light on the rigid part of the face changes over the clip."""
    stops = case.figures.exposure_stops
    low, high = np.percentile(stops, [5, 95])
    if high - low > EXPOSURE_RANGE_STOPS:
        is_steady = abs(np.corrcoef(np.arange(len(stops)), stops)[0, 1]) > EXPOSURE_DRIFT_CORRELATION
        yield (
            f"The exposure {'drifts' if is_steady else 'goes up and down'} by {high - low:.2f} stops over the clip, "
            "so some components will show light rather than expression. Film with exposure and white balance locked, "
            "away from daylight and flickering lamps, or give the frames equal brightness before building."
        )


def _face_not_found(case: Case) -> Iterator[str]:
    if case.build.track is None or case.build.track.known.all():
        return
    missing = np.flatnonzero(~case.build.track.known)
    if len(missing) == len(case.names):
        yield (
            "The detector found a face in no frame, so this build uses no face points. If the clip shows a face, crop "
            "it closer (--crop auto, or a box)."
        )
        return
    yield (
        f"The detector found no face in {_frames(len(missing))} ({case.named(missing)}), whose flow is not held. Leave "
        "out frames in which a hand covers the face or the head is turned away, or give their points (`morphspace "
        "track`)."
    )


def _face_turned(case: Case) -> Iterator[str]:
    """Advise if the head is turned out of the picture further than a face can be compared."""
    track = case.build.track
    if track is None or not len(over := track.turned()):
        return
    yaw, pitch, _ = track.pose_deg[over[0]]
    yield (
        f"In {_frames(len(over))} ({case.named(over)}) the head is turned by more than {MAX_TURN_DEG:.0f} degrees, the "
        f"most in {case.named(over[:1])} (yaw {yaw:+.0f}, pitch {pitch:+.0f}): its far side is hidden, and no movement "
        "in the picture undoes a turn. Leave these frames out, or film with the head facing the camera."
    )


def _face_small(case: Case) -> Iterator[str]:
    """Advise if the eyes are so near to each other that the face fills little of the frame."""
    model = case.build.model
    if case.build.track is None or model.faceframe is None:
        return
    right, left, _ = model.faceframe.points
    share = float(np.hypot(*(left - right))) / model.size[0]
    if share < EYES_LEAST_SHARE and "crop_found" not in model.provenance["framing"]:
        yield (
            f"The face is small in the frame: the eyes are {100 * share:.0f} % of its width apart; in a frame cropped "
            "to the head they are 25 to 30 %. Build again with --crop auto."
        )


def _mouth_closed(case: Case) -> Iterator[str]:
    """Advise if frames open the mouth and the reference seems not to.

    A proxy without landmarks: teeth and the dark behind them raise the contrast of the mouth region.
    """
    contrast = case.figures.mouth_contrast
    low, high = np.percentile(contrast, [5, 95])
    reach = high - low
    reference = case.build.choice.index
    if reach <= MOUTH_REACH or contrast[reference] - low >= MOUTH_CLOSED * reach:
        return
    openness = (contrast - low) / reach
    fitting = np.flatnonzero((openness > MOUTH_SLIGHTLY_OPEN[0]) & (openness < MOUTH_SLIGHTLY_OPEN[1]))
    lengths = np.linalg.norm(case.build.model.training.values[fitting], axis=1)
    calm = fitting[np.argsort(lengths, kind="stable")]
    hint = f" Frames to try: {case.named(calm[:3])}." if len(calm) else ""
    yield (
        f"The mouth seems closed in the reference {case.build.choice.name}, while other frames open it (judged by the "
        "contrast of the mouth region, not by landmarks; look at the pictures). Teeth and the inside of the mouth then "
        "have no source. Choose as the reference a calm frame with the lips slightly apart, which shows a little of "
        f"the teeth and of the dark between them.{hint}"
    )


def _frames_fold(case: Case) -> Iterator[str]:
    over = _worst_first(case.figures.fold_fractions, case.figures.fold_fractions > FOLD_SHARE)
    if len(over):
        yield (
            f"In {_frames(len(over))} more than {100 * FOLD_SHARE:g} % of the face folds, most in {case.named(over)}. "
            "See the pictures under Folds. Around the mouth another reference helps; elsewhere leave the frames out."
        )


def _flow_unsure(case: Case) -> Iterator[str]:
    """Advise if the flow did not find most of the face in a frame."""
    low = _worst_first(-case.build.confidences, case.build.confidences < CONFIDENCE_LOW)
    if len(low):
        yield (
            f"In {_frames(len(low))} the flow's mean confidence is below {CONFIDENCE_LOW:g}, lowest in "
            f"{case.named(low)}: most of the face was filled in from its surroundings. Leave out frames in which a "
            "hand, hair, motion blur or a turned head hides the face. If there are many, the frames are too dark, "
            "blurred or small."
        )


def _painted_motion(case: Case) -> Iterator[str]:
    """Advise if the warp misses the motion of a feature, or an opening, which texture then paints."""
    carried = case.build.carried
    if carried is None:
        return
    moves = carried.motion >= HARDLY_MOVES
    missed = moves & (carried.left_over > CARRIED_LEFT) & (carried.slopes < CARRIED_SLOPE)
    words = [
        f"{FEATURES[row]} (left over {carried.left_over[row]:.2f}, slope {carried.slopes[row]:.2f})"
        for row in np.flatnonzero(missed)
    ]
    words += [
        f"{name} (slope {slope:.2f})"
        for (name, feature), slope in zip(APERTURES.items(), carried.openings, strict=True)
        if moves[FEATURES.index(feature)] and slope < CARRIED_SLOPE
    ]
    if words:
        yield (
            f"The warp misses much of the motion of {', '.join(words)}: it is painted by texture, and will not be "
            "driven or caricatured as motion. Choose a reference with parted lips and open eyes, leave out frames in "
            "which a hand or hair hides the face, or use larger frames."
        )


def _poor_reconstruction(case: Case) -> Iterator[str]:
    """Advise if frames drawn from all their loadings miss the original."""
    psnr = case.figures.psnr_db
    low = _worst_first(-psnr, psnr < PSNR_LOW_DB)
    if len(low) > PSNR_MANY * len(psnr):
        yield (
            f"{len(low)} of {len(psnr)} frames are reconstructed from their loadings with less than {PSNR_LOW_DB:g} "
            "dB. Build with more components. If that does not help, the face changes too much for one model."
        )
    elif len(low):
        yield (
            f"{_frames(len(low)).capitalize()} {'is' if len(low) == 1 else 'are'} reconstructed from the loadings with "
            f"less than {PSNR_LOW_DB:g} dB: {case.named(low)}. Leave out frames with a hand before the face, motion "
            "blur or a turned head."
        )


def _mask_misses_the_face(case: Case) -> Iterator[str]:
    """Advise if the mask is nearly empty or nearly everything, or covers nothing that could be followed."""
    model = case.build.model
    mask = model.mask.astype(np.float64)
    share = float(mask.mean())
    if share < MASK_LEAST_SHARE:
        way = f"only {100 * share:.1f} % of the frame: crop the frames closer to the face, or draw a larger mask"
    elif share > MASK_MOST_SHARE:
        way = f"{100 * share:.0f} % of the frame, with the background: draw a mask that covers the face only"
    else:
        luma = (model.mean.texture @ LUMA).astype(np.float64)
        mean = (luma * mask).sum() / mask.sum()
        if np.sqrt(((luma - mean) ** 2 * mask).sum() / mask.sum()) >= MASK_FLAT_SD:
            return
        way = "a part without texture, which flow cannot follow: check that the mask is on the face"
    yield f"The mask covers {way}."


def _fewer_components(case: Case) -> Iterator[str]:
    """Advise if the model has fewer components than asked for; the build itself warns of rank 0."""
    model = case.build.model
    asked = int(model.provenance.get("components_asked", model.rank))
    if not 0 < model.rank < asked:
        return
    most = len(case.names) - 1
    reason = "The frames show nothing else. Add frames that differ from them"
    if model.rank == most:
        reason = f"{len(case.names)} frames cannot give more than {most}. Add frames if you need more"
    yield f"{asked} components were requested; the model has {model.rank}. {reason}."


def _few_frames(case: Case) -> Iterator[str]:
    if len(case.names) < FRAMES_FEW:
        yield (
            f"The clip has {len(case.names)} frames; expected {FRAMES_FEW} or more. The model can show only what they "
            "show. Add frames that span the expressions you need."
        )


def _sources_differ_in_size(case: Case) -> Iterator[str]:
    """Advise if the frames were reduced or enlarged to the model's size."""
    size = case.build.model.size
    source = case.source_size or size
    sizes = f"from {source[0]} x {source[1]} to {size[0]} x {size[1]} px"
    ratio = min(source[0] / size[0], source[1] / size[1])
    if ratio > SOURCE_LARGER:
        yield f"The frames were reduced {sizes}. If your stimuli need finer detail, build again with a larger size."
    elif ratio < 1:
        yield f"The frames were enlarged {sizes}, which adds no detail. Build at the size of the sources."


def _lost(path: HeadPath) -> AnyArray:
    size = np.log(np.maximum(path.scale, np.finfo(float).tiny))
    lost: AnyArray = np.abs(size - np.median(size)) > np.log(LOST_SCALE)
    return lost


def _worst_first(values: AnyArray, over: AnyArray) -> AnyArray:
    indices = np.flatnonzero(over)
    return indices[np.argsort(-values[indices], kind="stable")]


def _frames(count: int) -> str:
    return "one frame" if count == 1 else f"{count} frames"


RULES: tuple[tuple[str, Level, Callable[[Case], Iterator[str]]], ...] = (
    ("build", "mend", _warnings_of_the_build),
    ("registration", "mend", _registration_lost),
    ("head_moved", "mend", _head_moved),
    ("head_turned", "mend", _head_turned),
    ("exposure", "mend", _exposure_changed),
    ("face", "mend", _face_not_found),
    ("face_turned", "mend", _face_turned),
    ("face_small", "mend", _face_small),
    ("mouth_closed", "mend", _mouth_closed),
    ("folds", "mend", _frames_fold),
    ("confidence", "mend", _flow_unsure),
    ("carried", "mend", _painted_motion),
    ("psnr", "mend", _poor_reconstruction),
    ("mask", "mend", _mask_misses_the_face),
    ("rank", "consider", _fewer_components),
    ("few_frames", "consider", _few_frames),
    ("source_size", "consider", _sources_differ_in_size),
)
