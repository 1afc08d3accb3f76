"""How close a picture comes to another, and a flow to its truth: the figures in metrics tables and reports.

Images are compared as files will show them, clipped to [0, 1]. The mask weighs the face; hair and background do not
count. The measures of a flow are those of the Middlebury benchmark (Baker et al., A database and evaluation methodology
for optical flow, IJCV 92, 2011, section 4.1); each gives a map, so that a caller can mask it, average it or look at
it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, Displacement, Image, Mask
from morphspace.errors import SizeMismatch
from morphspace.grid import warp

LEAST_MSE = 1e-12  # equal pictures give 120 dB, not infinity
UNKNOWN_FLOW_PX = 1e6  # a truth with a component beyond it is unknown; Middlebury writes about 1.7e9
OUTLIER_PX = 1.0  # of R1.0


@dataclass(frozen=True)
class FlowErrors:
    """A flow against its truth: average end-point error, average angular error, share of end points off by > 1 px."""

    aee_px: float
    aae_deg: float
    r1_percent: float


def psnr_db(image: Image, truth: Image, mask: Mask) -> float:
    """Give the peak signal-to-noise ratio (dB, peak 1) of an image (h, w, 3) inside the mask (h, w)."""
    error = np.clip(image, 0, 1) - np.clip(truth, 0, 1)
    square = (error * error).mean(axis=2, dtype=np.float64)
    total = max(float(mask.sum(dtype=np.float64)), 1e-12)
    return float(-10 * np.log10(max(float((square * mask).sum() / total), LEAST_MSE)))


def ssim(image: Image, truth: Image, mask: Mask) -> float:
    """Give the structural similarity (Wang et al. 2004, Gaussian window, sd 1.5 px) averaged over the mask."""
    from skimage.metrics import structural_similarity

    _, local = structural_similarity(
        np.clip(truth, 0, 1),
        np.clip(image, 0, 1),
        data_range=1.0,
        channel_axis=2,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        full=True,
    )
    return float((local.mean(axis=2) * mask).sum() / max(float(mask.sum()), 1e-12))


def rms_px(difference: AnyArray, mask: Mask) -> float:
    """Give the root mean square length (px) of a displacement difference (h, w, 2) inside the mask."""
    square = (difference * difference).sum(axis=2, dtype=np.float64)
    return float(np.sqrt((square * mask).sum() / max(float(mask.sum()), 1e-12)))


def photometric_rmse(image: AnyArray, truth: AnyArray, mask: Mask) -> float:
    """Give the root mean square difference of two pictures, (h, w) or (h, w, c), inside the mask, in 8-bit codes."""
    error = 255 * (np.clip(image, 0, 1) - np.clip(truth, 0, 1)).astype(np.float64)
    square = error * error if error.ndim == 2 else (error * error).mean(axis=2)
    return float(np.sqrt((square * mask).sum() / max(float(mask.sum(dtype=np.float64)), 1e-12)))


def endpoint_error(displacement: Displacement, truth: Displacement) -> AnyArray:
    """Give how far each end point is from the true one, (h, w) float64 px, of two fields (h, w, 2).

    The end-point error of Otte and Nagel (ECCV 1994); Baker et al. 2011, section 4.1. Raises `SizeMismatch`.
    """
    difference = _pair(displacement, truth)
    return np.hypot(difference[..., 0], difference[..., 1])


def angular_error_deg(displacement: Displacement, truth: Displacement) -> AnyArray:
    """Give the angle between (u, v, 1) and the true (u, v, 1), (h, w) float64 degrees, of two fields (h, w, 2).

    Barron, Fleet and Beauchemin (IJCV 12, 1994); Baker et al. 2011, section 4.1. The angle is taken from sine and
    cosine together: the arc cosine alone loses small angles. Raises `SizeMismatch`.
    """
    du, dv = np.moveaxis(_pair(displacement, truth), -1, 0)
    u, v = np.moveaxis(displacement.astype(np.float64), -1, 0)
    true_u, true_v = np.moveaxis(truth.astype(np.float64), -1, 0)
    sine = np.sqrt(du * du + dv * dv + (u * true_v - v * true_u) ** 2)
    return np.degrees(np.arctan2(sine, u * true_u + v * true_v + 1))


def forward_backward_px(forward: Displacement, backward: Displacement) -> AnyArray:
    """Give how far each point lands from itself after going there and back, |u(p) + v(p + u(p))|, (h, w) float64 px.

    `forward` u (h, w, 2) lives on the first picture, `backward` v (H, W, 2) on the second. v is read linearly, its edge
    values continued outside: where `stays_inside` is False the figure says little. The check of Sundaram, Brox and
    Keutzer (ECCV 2010), without their threshold.
    """
    there_and_back = warp.compose(backward, forward).astype(np.float64)
    return np.hypot(there_and_back[..., 0], there_and_back[..., 1])


def stays_inside(displacement: Displacement, height: int, width: int) -> AnyArray:
    """Give where p + u(p) lies on a second picture of this size, (h, w) bool."""
    x, y = warp.positions(displacement)
    return (x >= -0.5) & (x <= width - 0.5) & (y >= -0.5) & (y <= height - 0.5)


def flow_errors(displacement: Displacement, truth: Displacement) -> FlowErrors:
    """Compare a flow with its truth (h, w, 2) where that is known; NaN where none of it is. Raises `SizeMismatch`."""
    known = known_flow(truth)
    if not known.any():
        return FlowErrors(float("nan"), float("nan"), float("nan"))
    truth = np.where(known[..., None], truth, 0)
    distance_px = endpoint_error(displacement, truth)[known]
    return FlowErrors(
        aee_px=float(distance_px.mean()),
        aae_deg=float(angular_error_deg(displacement, truth)[known].mean()),
        r1_percent=float(100 * (distance_px > OUTLIER_PX).mean()),
    )


def known_flow(truth: Displacement) -> AnyArray:
    """Give where a true field (h, w, 2) is known, (h, w) bool: finite, and no component beyond `UNKNOWN_FLOW_PX`."""
    return np.logical_and(*np.moveaxis(np.abs(truth) <= UNKNOWN_FLOW_PX, -1, 0))


def _pair(displacement: Displacement, truth: Displacement) -> AnyArray:
    """Give the difference of two fields in float64, or raise `SizeMismatch`."""
    if displacement.shape != truth.shape:
        raise SizeMismatch(
            f"a flow of {displacement.shape[1]}x{displacement.shape[0]} px cannot be compared with a truth of "
            f"{truth.shape[1]}x{truth.shape[0]} px"
        )
    return displacement.astype(np.float64) - truth.astype(np.float64)
