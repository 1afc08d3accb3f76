"""How close a picture comes to another: the figures in metrics tables and reports.

Images are compared as files will show them, clipped to [0, 1]. The mask weighs the face; hair and background do not
count.
"""

from __future__ import annotations

import numpy as np

from morphspace.arrays import AnyArray, Image, Mask

LEAST_MSE = 1e-12  # equal pictures give 120 dB, not infinity


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
