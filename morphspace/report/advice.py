"""Plain advice where a build is off: what was seen, and what to do about it.

Each rule is a function of the case and names its threshold with the reason for it. The numbers were tried on six real
clips of talking and grimacing heads and on drawn ones; where a rule guesses at a cause, its sentence says so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from morphspace.arrays import Affine, AnyArray
from morphspace.flow.baselines import LUMA
from morphspace.model.passes import Build
from morphspace.report.frames import FrameFigures

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
MOUTH_SLIGHTLY_OPEN = (0.2, 0.6)  # of that reach: what the paper asks for, some teeth and some dark
FOLD_SHARE = 0.01  # of the cells inside the mask; folds this large are seen as smears
CONFIDENCE_LOW = 0.5  # mean inside the mask; below it more of the face is filled in than was found
PSNR_LOW_DB = 30.0  # below it a rebuilt frame can be told from the original at a glance
PSNR_MANY = 0.25  # of the frames; when so many are poor it is the model, not the frames
MASK_LEAST_SHARE = 0.05  # of the frame; a face in so small a part has too few pixels
MASK_MOST_SHARE = 0.95  # of the frame; then the background is part of the model
MASK_FLAT_SD = 0.01  # luma; without texture the flow has nothing to follow
FRAMES_FEW = 20  # a clip of so few frames shows too few expressions for components that mean something
SOURCE_LARGER = 1.5  # times in each direction; below it a larger model would show little more
NAMES_AT_MOST = 5  # in a sentence


@dataclass(frozen=True)
class Advice:
    """One piece of advice: the `rule` it comes from, how grave, and the sentence.

    `mend` means that the model suffers; `consider` that it may be as it was meant.
    """

    rule: str
    level: Literal["mend", "consider"]
    text: str


@dataclass(frozen=True, eq=False)
class Case:
    """What the rules look at: the build, its figures, and the size (w, h) px of the sources where it is known."""

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
    """How the head moved, per frame against the reference: shift (n, 2) px of the frame's centre, turn, scale."""

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
    """Give all advice on a build, what should be mended first. Ours."""
    found = [advice for rule in RULES for advice in rule(case)]
    return tuple(sorted(found, key=lambda advice: advice.level == "consider"))


def told_by_the_build(case: Case) -> Iterator[Advice]:
    """Pass on what the build itself warned of: duplicated frames, frames that do not differ."""
    for warning in case.build.warnings:
        yield Advice("build", "mend", warning[:1].upper() + warning[1:] + ".")


def head_moved(case: Case) -> Iterator[Advice]:
    """Fire where registration had to move, turn or scale the frames far."""
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
        yield Advice(
            "head_moved",
            "mend",
            f"The head moved a lot: it {_listed(ways)}. Registration takes this out, but not the change of view that "
            "comes with it. Film with the head at rest (a chin or head rest), or leave out the frames at the ends of "
            "the path under Head movement and light.",
        )


def registration_lost(case: Case) -> Iterator[Advice]:
    """Fire where registration gave a frame a size that no head can have."""
    lost = np.flatnonzero(_lost(head_path(case.build.registrations, case.build.model.size)))
    if len(lost):
        yield Advice(
            "registration",
            "mend",
            f"Registration failed in {_frames(len(lost))} ({case.named(lost)}): it made the face larger or smaller "
            f"by more than a factor of {LOST_SCALE:g}. Look at them in the clip, and leave them out or crop the clip "
            "closer to the face.",
        )


def head_turned(case: Case) -> Iterator[Advice]:
    """Fire where brow and nose still move after registration: the head turned in depth, or registration failed."""
    model = case.build.model
    limit = HEAD_DEPTH_SHARE * model.size[0]
    over = _worst_first(case.figures.rigid_motion_px, case.figures.rigid_motion_px > limit)
    if len(over):
        yield Advice(
            "head_turned",
            "mend",
            f"In {_frames(len(over))} brow and nose still move by more than {limit:.1f} px (rms) after registration, "
            f"the most in {case.named(over)}. Most likely the head turned away or nodded, and the model takes that "
            "for expression. Leave these frames out, or film with the head facing the camera throughout.",
        )


def exposure_changed(case: Case) -> Iterator[Advice]:
    """Fire where the light on the rigid part of the face changes over the clip."""
    stops = case.figures.exposure_stops
    low, high = np.percentile(stops, [5, 95])
    if high - low <= EXPOSURE_RANGE_STOPS:
        return
    time = np.arange(len(stops))
    steady = abs(float(np.corrcoef(time, stops)[0, 1])) > EXPOSURE_DRIFT_CORRELATION
    way = "drifts" if steady else "goes up and down"
    yield Advice(
        "exposure",
        "mend",
        f"The exposure {way} by {high - low:.2f} stops over the clip, so that some components will be light, not "
        "expression. Film with exposure and white balance locked, away from daylight and flickering lamps, or give "
        "the frames equal brightness before building.",
    )


def face_not_found(case: Case) -> Iterator[Advice]:
    """Fire where the detector did not find a face in some frames."""
    found = case.build.faces_found
    if found is None or found.all():
        return
    missing = np.flatnonzero(~found)
    if not found.any():
        yield Advice(
            "face",
            "consider",
            "The face was found in no frame, so nothing of this build rests on it. If the clip shows a face, crop it "
            "closer (--crop auto, or a box).",
        )
        return
    yield Advice(
        "face",
        "consider",
        f"The face was not found in {_frames(len(missing))} ({case.named(missing)}), which went without its points. "
        "Look at them: a hand before the face or a head turned away does not belong in the model.",
    )


def face_small(case: Case) -> Iterator[Advice]:
    """Fire where the eyes are so near to each other that the face fills little of the frame."""
    model = case.build.model
    if (
        case.build.faces_found is None
        or model.faceframe is None
        or "crop_found" in model.provenance["framing"]
    ):
        return
    right, left, _ = model.faceframe.points
    share = float(np.hypot(*(left - right))) / model.size[0]
    if share < EYES_LEAST_SHARE:
        yield Advice(
            "face_small",
            "mend",
            f"The face is small in the frame: the eyes are {100 * share:.0f} % of its width apart, in a frame cropped "
            "to the head they are 25 to 30 %. Build again with --crop auto.",
        )


def mouth_closed(case: Case) -> Iterator[Advice]:
    """Fire where frames open the mouth and the reference seems not to.

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
    calm = fitting[
        np.argsort(np.linalg.norm(case.build.model.training.values[fitting], axis=1), kind="stable")
    ]
    hint = f" Frames to try: {case.named(calm[:3])}." if len(calm) else ""
    yield Advice(
        "mouth_closed",
        "mend",
        f"The mouth seems closed in the reference {case.build.choice.name} while other frames open it (judged by the "
        "contrast of the mouth region, not by landmarks; look at the pictures). Teeth and the inside of the mouth "
        "then have nothing to come from. Choose as the reference a calm frame with the lips slightly apart, a little "
        f"of the teeth and of the dark between them in sight.{hint}",
    )


def frames_fold(case: Case) -> Iterator[Advice]:
    """Fire where warps turn over more than a trace of the face."""
    over = _worst_first(case.figures.fold_fractions, case.figures.fold_fractions > FOLD_SHARE)
    if len(over):
        yield Advice(
            "folds",
            "mend",
            f"{_frames(len(over), capital=True)} fold more than {100 * FOLD_SHARE:g} % of the face, the most "
            f"{case.named(over)}. Look where under Folds: around the mouth, another reference helps; elsewhere leave "
            "the frames out.",
        )


def flow_unsure(case: Case) -> Iterator[Advice]:
    """Fire where the flow did not find most of the face in a frame."""
    confidences = case.build.confidences
    low = _worst_first(-confidences, confidences < CONFIDENCE_LOW)
    if len(low):
        yield Advice(
            "confidence",
            "mend",
            f"In {_frames(len(low))} the flow's mean confidence is below {CONFIDENCE_LOW:g}, the least in "
            f"{case.named(low)}: most of the face was filled in from around. Look at them: where a hand, hair, motion "
            "blur or a turned head hides the face, leave them out; where many are so, the frames are too dark, blurred "
            "or small.",
        )


def frames_come_back_poorly(case: Case) -> Iterator[Advice]:
    """Fire where frames drawn from all their loadings miss the original."""
    psnr = case.figures.psnr_db
    low = _worst_first(-psnr, psnr < PSNR_LOW_DB)
    if not len(low):
        return
    if len(low) > PSNR_MANY * len(psnr):
        yield Advice(
            "psnr",
            "mend",
            f"{len(low)} of {len(psnr)} frames come back from their loadings with less than {PSNR_LOW_DB:g} dB. Ask "
            "for more components; if that does not help, the clip moves or changes too much for one model.",
        )
        return
    yield Advice(
        "psnr",
        "mend",
        f"{_frames(len(low), capital=True)} come back from their loadings with less than {PSNR_LOW_DB:g} dB: "
        f"{case.named(low)}. Look at them: a hand before the face, motion blur or a turned head do not belong in the "
        "model; leave such frames out.",
    )


def mask_misses_the_face(case: Case) -> Iterator[Advice]:
    """Fire where the mask is nearly empty or nearly everything, or covers nothing that could be followed."""
    model = case.build.model
    mask = model.mask.astype(np.float64)
    share = float(mask.mean())
    if share < MASK_LEAST_SHARE:
        way = f"only {100 * share:.1f} % of the frame: crop the frames closer to the face, or draw a larger mask"
    elif share > MASK_MOST_SHARE:
        way = f"{100 * share:.0f} % of the frame, background and all: draw a mask that covers the face only"
    else:
        luma = (model.mean.texture @ LUMA).astype(np.float64)
        mean = (luma * mask).sum() / mask.sum()
        if np.sqrt(((luma - mean) ** 2 * mask).sum() / mask.sum()) >= MASK_FLAT_SD:
            return
        way = "a part without texture, which flow cannot follow: check that it lies on the face"
    yield Advice("mask", "mend", f"The mask covers {way}.")


def fewer_components(case: Case) -> Iterator[Advice]:
    """Fire where the model has fewer components than asked for; rank 0 is told by the build."""
    model = case.build.model
    asked = int(model.provenance.get("components_asked", model.rank))
    if not 0 < model.rank < asked:
        return
    most = len(case.names) - 1
    if model.rank == most:
        reason = f"{len(case.names)} frames cannot give more than {most}: add frames if you need more"
    else:
        reason = "the frames repeat each other beyond these: add frames that show something new"
    yield Advice(
        "rank", "consider", f"{asked} components were asked for, the model has {model.rank}; {reason}."
    )


def few_frames(case: Case) -> Iterator[Advice]:
    """Fire where the clip is so short that it can hold few expressions."""
    if len(case.names) < FRAMES_FEW:
        yield Advice(
            "few_frames",
            "consider",
            f"{len(case.names)} frames are few: the model can only show what they show. Take {FRAMES_FEW} or more "
            "that span the expressions you want.",
        )


def sources_differ_in_size(case: Case) -> Iterator[Advice]:
    """Fire where the frames were shrunk or enlarged to the model's size."""
    if case.source_size is None:
        return
    source, size = case.source_size, case.build.model.size
    sizes = f"from {source[0]} x {source[1]} to {size[0]} x {size[1]} px"
    ratio = min(source[0] / size[0], source[1] / size[1])
    if ratio > SOURCE_LARGER:
        yield Advice(
            "source_size",
            "consider",
            f"The frames were shrunk {sizes}. If your stimuli need finer detail, build again with a larger size.",
        )
    elif ratio < 1:
        yield Advice(
            "source_size",
            "consider",
            f"The frames were enlarged {sizes}, which adds no detail: build with a size the sources have.",
        )


def _lost(path: HeadPath) -> AnyArray:
    size = np.log(np.maximum(path.scale, np.finfo(float).tiny))
    lost: AnyArray = np.abs(size - np.median(size)) > np.log(LOST_SCALE)
    return lost


def _worst_first(values: AnyArray, over: AnyArray) -> AnyArray:
    indices = np.flatnonzero(over)
    return indices[np.argsort(-values[indices], kind="stable")]


def _frames(count: int, *, capital: bool = False) -> str:
    if count == 1:
        return "One frame" if capital else "one frame"
    return f"{count} frames"


def _listed(ways: list[str]) -> str:
    return ways[0] if len(ways) == 1 else ", ".join(ways[:-1]) + " and " + ways[-1]


RULES: tuple[Callable[[Case], Iterator[Advice]], ...] = (
    told_by_the_build,
    registration_lost,
    head_moved,
    head_turned,
    exposure_changed,
    face_not_found,
    face_small,
    mouth_closed,
    frames_fold,
    flow_unsure,
    frames_come_back_poorly,
    mask_misses_the_face,
    fewer_components,
    few_frames,
    sources_differ_in_size,
)
