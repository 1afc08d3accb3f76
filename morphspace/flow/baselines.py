"""Flow estimators of OpenCV and scikit-image as flow methods, for comparison.

The settings of `dis` were chosen on real clips (benchmarks/results/defaults.md); the others are the libraries'
defaults. All estimators read grey images.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Displacement, Image
from morphspace.errors import BadInput
from morphspace.flow import Flow, FlowFunction, FlowMethod
from morphspace.flow.pairs import checked_frame, checked_picture, checked_start, is_featureless, unknown_flow

SMOOTHING = 0.02  # SD as a share of the image's width; for registration and the search for the reference
DIS_LEAST_PX = 17  # px a side; OpenCV fails below it with the patches of `dis`
LUMA = np.array([0.299, 0.587, 0.114], np.float32)  # ITU-R BT.601


def grey_codes(image: Image) -> AnyArray:
    """Return the luma of an image (h, w, 3) as (h, w) uint8, the input of OpenCV's estimators.

    Examples
    --------
    >>> import numpy as np
    >>> grey_codes(np.full((1, 2, 3), 0.5, np.float32)).tolist()
    [[128, 128]]
    """
    return np.clip(image @ LUMA * 255 + 0.5, 0, 255).astype(np.uint8)


def deepflow(reference: Image, frame: Image, start: Displacement | None = None) -> Displacement:
    """Estimate the flow by OpenCV's DeepFlow; the start is ignored.

    References
    ----------
    Weinzaepfel, Revaud, Harchaoui and Schmid, DeepFlow: large displacement optical flow with deep matching, ICCV 2013.
    """
    estimator = cv2.optflow.createOptFlow_DeepFlow()
    field: Displacement = estimator.calc(grey_codes(reference), grey_codes(frame), None)
    return field


def dis(reference: Image, frame: Image, start: Displacement | None = None) -> Displacement:
    """Estimate the flow by dense inverse search at full size with 50 descents.

    Raises `BadInput` if a side of the pictures is below `DIS_LEAST_PX`.

    References
    ----------
    Kroeger, Timofte, Dai and Van Gool, Fast optical flow using dense inverse search, ECCV 2016.

    Examples
    --------
    >>> import numpy as np
    >>> picture = np.random.default_rng(1).random((40, 40, 3)).astype(np.float32)
    >>> bool(np.abs(dis(picture, picture)).max() < 0.1)
    True
    """
    height, width = reference.shape[:2]
    if min(height, width) < DIS_LEAST_PX:
        raise BadInput(
            f"the pictures are {width}x{height} px; expected at least {DIS_LEAST_PX} px a side for dis. Choose fast"
        )
    estimator = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    estimator.setFinestScale(0)
    estimator.setPatchSize(12)
    estimator.setPatchStride(3)
    estimator.setGradientDescentIterations(50)
    estimator.setVariationalRefinementIterations(20)
    estimator.setVariationalRefinementAlpha(60.0)  # three times the stock smoothness: flat skin
    return _searched(estimator, reference, frame, start)


def dis_medium(reference: Image, frame: Image, start: Displacement | None = None) -> Displacement:
    """Estimate the flow by dense inverse search with OpenCV's preset "medium".

    Registration, the search for the reference and the benchmarks use it; `--flow` does not offer it.

    References
    ----------
    Kroeger, Timofte, Dai and Van Gool, Fast optical flow using dense inverse search, ECCV 2016.

    Examples
    --------
    >>> import numpy as np
    >>> picture = np.random.default_rng(1).random((40, 40, 3)).astype(np.float32)
    >>> bool(np.abs(dis_medium(picture, picture)).max() < 0.1)
    True
    """
    estimator = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    return _searched(estimator, reference, frame, start)


def _searched(estimator: object, reference: Image, frame: Image, start: Displacement | None) -> Displacement:
    begin = None if start is None else np.array(start, np.float32)
    field: Displacement = estimator.calc(grey_codes(reference), grey_codes(frame), begin)  # type: ignore[attr-defined]
    return field


def tvl1(reference: Image, frame: Image, start: Displacement | None = None) -> Displacement:
    """Estimate the flow by scikit-image's TV-L1; the start is ignored.

    References
    ----------
    Zach, Pock and Bischof, A duality based approach for realtime TV-L1 optical flow, DAGM 2007.
    """
    from skimage.registration import optical_flow_tvl1

    down, right = optical_flow_tvl1(reference @ LUMA, frame @ LUMA, dtype=np.float32)
    return np.stack([right, down], axis=-1)


def smoothed(field: Displacement) -> Displacement:
    """Smooth a field (h, w, 2) px by a Gaussian of `SMOOTHING` times its width, mirrored at the edge.

    Examples
    --------
    >>> import numpy as np
    >>> spike = np.zeros((100, 100, 2), np.float32)
    >>> spike[50, 50] = 1
    >>> round(smoothed(spike)[..., 0].sum().item(), 3), smoothed(spike).max().item() < 0.1
    (1.0, True)
    """
    sd_px = SMOOTHING * field.shape[1]
    out: Displacement = cv2.GaussianBlur(field, (0, 0), sd_px, borderType=cv2.BORDER_REFLECT_101)
    return out


def stock(estimate: Callable[[Image, Image, Displacement | None], Displacement]) -> FlowMethod:
    """Wrap an estimator as a flow method; its confidence is 1 everywhere, and it shares nothing between frames.

    Pictures are checked as for our own methods (`pairs`). The flow of a picture of one colour is zero with zero
    confidence.
    """

    def for_reference(reference: Image) -> FlowFunction:
        reference = checked_picture(reference, "the reference")

        def to_frame(frame: Image, start: Displacement | None = None) -> Flow:
            frame = checked_frame(reference, frame)
            height, width = reference.shape[:2]
            if is_featureless(reference) or is_featureless(frame):
                return unknown_flow(height, width)
            begin = None if start is None else checked_start(start, height, width)
            field = estimate(reference, frame, begin)
            return Flow(field, np.ones(field.shape[:2], np.float32))

        return to_frame

    return for_reference
