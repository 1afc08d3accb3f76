"""The estimators of the flow's benchmark, ours and those people use, and what is measured of each.

The peers get what they take, grey 8-bit pictures, and run with the settings stated in `PEER_SETTINGS`; nothing is
smoothed afterwards. Our presets get colour, and those that use it once more the grey picture in three channels.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np
from flow_truth import RealPair
from skimage.registration import optical_flow_ilk, optical_flow_tvl1
from threadpoolctl import threadpool_limits

from morphspace.arrays import AnyArray, Displacement, Image
from morphspace.flow import baselines, presets
from morphspace.flow.baselines import LUMA, grey_codes
from morphspace.flow.methods import METHODS
from morphspace.grid import warp
from morphspace.linear.quality import FlowErrors, flow_errors, forward_backward_px, photometric_rmse
from morphspace.synthetic.warped import FlowPair

PRESETS = (*presets.PRESETS, "paper")
COLOUR_PRESETS = tuple(name for name, preset in presets.PRESETS.items() if preset.colours == "rgb")
BIAS = 0.05  # added to all of the frame, about 13 of 255 codes

Prepared = Callable[[], Displacement]
Prepare = Callable[[Image, Image], Prepared]
"""(reference, frame) -> what is timed: the call that gives the field."""


@dataclass(frozen=True, eq=False)
class Real:
    """What can be said of a flow between real pictures: grey levels, px, % of the cells; all inside the face mask."""

    name: str
    rmse: float
    forward_backward_px: float
    folded_percent: float


def of_codes(estimate: Callable[[AnyArray, AnyArray], Displacement]) -> Prepare:
    """Give an estimator of grey 8-bit pictures; making them grey is not on its clock."""

    def prepare(reference: Image, frame: Image) -> Prepared:
        one, other = grey_codes(reference), grey_codes(frame)
        return lambda: estimate(one, other)

    return prepare


def of_shares(estimate: Callable[[AnyArray, AnyArray], tuple[AnyArray, AnyArray]]) -> Prepare:
    """Give an estimator of scikit-image, of grey float32 pictures in [0, 1], whose field is (rows, columns)."""

    def prepare(reference: Image, frame: Image) -> Prepared:
        one, other = (grey_codes(image).astype(np.float32) / 255 for image in (reference, frame))

        def run() -> Displacement:
            down, right = estimate(one, other)
            return np.stack([right, down], axis=-1)

        return run

    return prepare


def _farneback(one: AnyArray, other: AnyArray) -> Displacement:
    return cv2.calcOpticalFlowFarneback(one, other, None, 0.5, 3, 15, 3, 5, 1.2, 0)


def _dis_medium(one: AnyArray, other: AnyArray) -> Displacement:
    return cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(one, other, None)


def _deepflow(one: AnyArray, other: AnyArray) -> Displacement:
    return cv2.optflow.createOptFlow_DeepFlow().calc(one, other, None)


def _tvl1(one: AnyArray, other: AnyArray) -> Displacement:
    return cv2.optflow.DualTVL1OpticalFlow_create().calc(one, other, None)


DIS, DEEPFLOW = "OpenCV DIS medium", "OpenCV DeepFlow"
PEERS: dict[str, Prepare] = {
    DIS: of_codes(_dis_medium),
    "OpenCV DIS hard": lambda reference, frame: lambda: baselines.dis(reference, frame),
    DEEPFLOW: of_codes(_deepflow),
    "OpenCV TV-L1": of_codes(_tvl1),
    "OpenCV Farneback": of_codes(_farneback),
    "scikit-image TV-L1": of_shares(lambda one, other: optical_flow_tvl1(one, other, dtype=np.float32)),
    "scikit-image ILK": of_shares(lambda one, other: optical_flow_ilk(one, other, dtype=np.float32)),
}
PEER_SETTINGS = (
    "DIS: preset medium; hard: medium with finest scale 0, patch 12, stride 3, 50 descents, 20 refinements of alpha 60 "
    "(`--flow dis`). DeepFlow, both TV-L1 and ILK: defaults. Farneback: pyramid 0.5, 3 levels, window 15, "
    "3 iterations, polynomials 5 / 1.2, as in OpenCV's own samples."
)
SLOW = ("OpenCV TV-L1", "scikit-image TV-L1", "scikit-image ILK")


def ours(name: str) -> Prepare:
    """Give a preset on colour, from scratch: preparing the reference is on its clock."""
    return lambda reference, frame: lambda: METHODS[name](reference)(frame, None).displacement


def ours_grey(name: str) -> Prepare:
    """Give a preset on the grey picture, repeated in three channels."""

    def prepare(reference: Image, frame: Image) -> Prepared:
        return ours(name)(*(grey_of_three(image) for image in (reference, frame)))

    return prepare


def ours_further(name: str) -> Prepare:
    """Give a preset on colour that has had a frame: what each further frame of a batch takes."""

    def prepare(reference: Image, frame: Image) -> Prepared:
        to_frame = METHODS[name](reference)
        to_frame(frame, None)  # some of what is kept is made when first needed
        return lambda: to_frame(frame, None).displacement

    return prepare


def grey_of_three(image: Image) -> Image:
    """Give the 8-bit luma of an image (h, w, 3) in each of three channels."""
    return np.repeat(grey_codes(image)[..., None].astype(np.float32) / 255, 3, axis=2)


def in_grey(name: str) -> str:
    """Name a preset's row for grey pictures."""
    return f"{name}, grey"


@contextmanager
def one_thread() -> Iterator[None]:
    """Let OpenCV and numpy work on one thread for a while, on one core where the system can say so."""
    threads = cv2.getNumThreads()
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    cv2.setNumThreads(1)
    if cores:
        os.sched_setaffinity(0, {max(cores)})
    try:
        with threadpool_limits(limits=1):
            yield
    finally:
        cv2.setNumThreads(threads)
        if cores:
            os.sched_setaffinity(0, cores)


def errors_of(prepare: Prepare, pairs: Sequence[FlowPair]) -> list[FlowErrors]:
    """Measure an estimator on pairs with truth, over all pixels that are visible in the frame."""
    return [
        flow_errors(
            prepare(pair.reference, pair.frame)(), np.where(pair.visible[..., None], pair.truth, np.float32(np.inf))
        )
        for pair in pairs
    ]  # fmt: skip


def real_of(prepare: Prepare, pair: RealPair) -> Real:
    """Measure an estimator on a real pair; the way back is the same estimator with the pictures exchanged."""
    there, back = prepare(pair.reference, pair.frame)(), prepare(pair.frame, pair.reference)()
    weight = float(pair.mask.sum(dtype=np.float64))
    return Real(
        name=pair.name,
        rmse=photometric_rmse(warp.sample(pair.frame, there) @ LUMA, pair.reference @ LUMA, pair.mask),
        forward_backward_px=float((forward_backward_px(there, back) * pair.mask).sum()) / weight,
        folded_percent=100 * warp.fold_fraction(there, pair.mask),
    )


def bias_change(prepare: Prepare, pair: FlowPair) -> float:
    """Give by how much a field changes, mean px, when `BIAS` is added to the whole frame."""
    plain = prepare(pair.reference, pair.frame)()
    brighter = prepare(pair.reference, pair.frame + np.float32(BIAS))()
    return float(np.hypot(*np.moveaxis(brighter - plain, -1, 0)).mean())
