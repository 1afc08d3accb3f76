"""Errors of pictures and flows: the figures of metrics tables and reports.

Images are compared as files store them, clipped to [0, 1], and weighted by the mask of the face. The flow errors are
those of the Middlebury benchmark (Baker et al., A database and evaluation methodology for optical flow, IJCV 92,
2011, section 4.1). Each returns a map, which a caller can mask, average or draw.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, Displacement, Image, Mask
from morphspace.errors import SizeMismatch
from morphspace.grid import warp

LEAST_MSE = 1e-12  # of the range [0, 1], squared; equal pictures have 120 dB, not infinity
UNKNOWN_FLOW_PX = 1e6  # px; a larger component marks an unknown flow (Middlebury writes about 1.7e9)
OUTLIER_PX = 1.0  # px, of R1.0


@dataclass(frozen=True)
class FlowErrors:
    """Errors of a flow against the true flow.

    Attributes
    ----------
    aee_px : float
        Average end-point error.
    aae_deg : float
        Average angular error.
    r1_percent : float
        Share of end points with an error above `OUTLIER_PX`.
    """

    aee_px: float
    aae_deg: float
    r1_percent: float


def psnr_db(image: Image, truth: Image, mask: Mask) -> float:
    """Compute the peak signal-to-noise ratio (dB, peak 1) of an image inside a mask.

    Parameters
    ----------
    image, truth : array (h, w, 3)
    mask : array (h, w)

    Examples
    --------
    >>> import numpy as np
    >>> black, grey = np.zeros((4, 4, 3), np.float32), np.full((4, 4, 3), 0.1, np.float32)
    >>> round(psnr_db(grey, black, np.ones((4, 4), np.float32)), 3)
    20.0
    """
    error = np.clip(image, 0, 1) - np.clip(truth, 0, 1)
    square = (error * error).mean(axis=2, dtype=np.float64)
    total = max(float(mask.sum(dtype=np.float64)), 1e-12)
    return float(-10 * np.log10(max(float((square * mask).sum() / total), LEAST_MSE)))


def ssim(image: Image, truth: Image, mask: Mask) -> float:
    """Compute the structural similarity of two images (h, w, 3), averaged over the mask (h, w).

    The window is a Gaussian with an SD of 1.5 px.

    References
    ----------
    Wang, Bovik, Sheikh and Simoncelli, IEEE Transactions on Image Processing 13, 2004.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.random.default_rng(1).random((16, 16, 3)).astype(np.float32)
    >>> ssim(image, image, np.ones((16, 16))), ssim(image, 1 - image, np.ones((16, 16))) < 0
    (1.0, True)
    """
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
    """Compute the root mean square length (px) of a displacement difference (h, w, 2) inside the mask (h, w).

    Examples
    --------
    >>> import numpy as np
    >>> rms_px(np.full((2, 2, 2), [3.0, 4.0]), np.ones((2, 2)))
    5.0
    """
    square = (difference * difference).sum(axis=2, dtype=np.float64)
    return float(np.sqrt((square * mask).sum() / max(float(mask.sum()), 1e-12)))


def photometric_rmse(image: AnyArray, truth: AnyArray, mask: Mask) -> float:
    """Compute the root mean square difference of two pictures, (h, w) or (h, w, c), inside the mask, in 8-bit codes.

    Examples
    --------
    >>> import numpy as np
    >>> round(photometric_rmse(np.full((2, 2), 0.6), np.full((2, 2), 0.5), np.ones((2, 2))), 6)
    25.5
    """
    error = 255 * (np.clip(image, 0, 1) - np.clip(truth, 0, 1)).astype(np.float64)
    square = error * error if error.ndim == 2 else (error * error).mean(axis=2)
    return float(np.sqrt((square * mask).sum() / max(float(mask.sum(dtype=np.float64)), 1e-12)))


def endpoint_error(displacement: Displacement, truth: Displacement) -> AnyArray:
    """Compute the distance between the end points of two flows.

    Parameters
    ----------
    displacement, truth : array (h, w, 2), px

    Returns
    -------
    array (h, w) float64, px

    Raises
    ------
    SizeMismatch
        If their sizes differ.

    References
    ----------
    Otte and Nagel, ECCV 1994; Baker et al. 2011, section 4.1.

    Examples
    --------
    >>> import numpy as np
    >>> endpoint_error(np.array([[[3.0, 4.0]]]), np.zeros((1, 1, 2))).tolist()
    [[5.0]]
    """
    difference = _pair(displacement, truth)
    return np.hypot(difference[..., 0], difference[..., 1])


def angular_error_deg(displacement: Displacement, truth: Displacement) -> AnyArray:
    """Compute the angle between (u, v, 1) of a flow and of the true flow.

    The angle comes from sine and cosine together: the arc cosine alone loses small angles.

    Parameters
    ----------
    displacement, truth : array (h, w, 2), px

    Returns
    -------
    array (h, w) float64, degrees

    Raises
    ------
    SizeMismatch
        If their sizes differ.

    References
    ----------
    Barron, Fleet and Beauchemin, IJCV 12, 1994; Baker et al. 2011, section 4.1.

    Examples
    --------
    >>> import numpy as np
    >>> angular_error_deg(np.zeros((1, 1, 2)), np.array([[[1.0, 0.0]]])).round(1).tolist()
    [[45.0]]
    """
    du, dv = np.moveaxis(_pair(displacement, truth), -1, 0)
    u, v = np.moveaxis(displacement.astype(np.float64), -1, 0)
    true_u, true_v = np.moveaxis(truth.astype(np.float64), -1, 0)
    sine = np.sqrt(du * du + dv * dv + (u * true_v - v * true_u) ** 2)
    return np.degrees(np.arctan2(sine, u * true_u + v * true_v + 1))


def forward_backward_px(forward: Displacement, backward: Displacement) -> AnyArray:
    """Compute the forward-backward error |u(p) + v(p + u(p))| of two flows.

    v is read linearly, with its edge values continued outside: where `stays_inside` is False the error means little.

    Parameters
    ----------
    forward : array (h, w, 2), px
        u on the first picture.
    backward : array (H, W, 2), px
        v on the second picture.

    Returns
    -------
    array (h, w) float64, px

    References
    ----------
    Sundaram, Brox and Keutzer, ECCV 2010; their threshold is not applied.

    Examples
    --------
    >>> import numpy as np
    >>> forward = np.full((3, 3, 2), [1.0, 0.0], np.float32)
    >>> float(forward_backward_px(forward, -forward).max()), float(forward_backward_px(forward, forward).max())
    (0.0, 2.0)
    """
    there_and_back = warp.compose(backward, forward).astype(np.float64)
    return np.hypot(there_and_back[..., 0], there_and_back[..., 1])


def stays_inside(displacement: Displacement, height: int, width: int) -> AnyArray:
    """Return where p + u(p) lies on a second picture of (height, width) px, (h, w) bool.

    Examples
    --------
    >>> import numpy as np
    >>> stays_inside(np.full((1, 3, 2), [1.0, 0.0]), 1, 3).tolist()
    [[True, True, False]]
    """
    x, y = warp.positions(displacement)
    return (x >= -0.5) & (x <= width - 0.5) & (y >= -0.5) & (y <= height - 0.5)


def flow_errors(displacement: Displacement, truth: Displacement) -> FlowErrors:
    """Compare a flow with the true flow where that is known.

    Parameters
    ----------
    displacement, truth : array (h, w, 2), px

    Returns
    -------
    FlowErrors
        NaN if the true flow is unknown everywhere.

    Raises
    ------
    SizeMismatch
        If their sizes differ.

    Examples
    --------
    >>> import numpy as np
    >>> flow_errors(np.zeros((2, 2, 2)), np.full((2, 2, 2), [0.0, 2.0])).aee_px
    2.0
    """
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
    """Return where a true flow (h, w, 2) is known, (h, w) bool: finite and within `UNKNOWN_FLOW_PX`.

    Examples
    --------
    >>> import numpy as np
    >>> known_flow(np.array([[[0.0, 1.0], [np.nan, 0.0]]])).tolist()
    [[True, False]]
    """
    return np.logical_and(*np.moveaxis(np.abs(truth) <= UNKNOWN_FLOW_PX, -1, 0))


def _pair(displacement: Displacement, truth: Displacement) -> AnyArray:
    """Check that two fields have one size, and return their difference in float64."""
    if displacement.shape != truth.shape:
        raise SizeMismatch(
            f"the flow has {displacement.shape[1]}x{displacement.shape[0]} px; expected {truth.shape[1]}x"
            f"{truth.shape[0]} px, as the true flow. Compute it on the same pictures"
        )
    return displacement.astype(np.float64) - truth.astype(np.float64)
