"""Image statistics of a stimulus, measured on its 8-bit codes, for reports of low-level differences.

Each statistic is given for linear light (sRGB decoded by IEC 61966-2-1, the output of a calibrated screen) and for
code values (measured by most published scripts), both 0 to 1. Luminance is the weighted sum of the channels of ITU-R
BT.709. RMS contrast is the standard deviation of luminance over its mean (Moulden, Kingdom and Gatley, Perception 19,
1990); times the mean it is the standard deviation of Peli (JOSA A 7, 1990). The spectral slope is that of log
amplitude on log spatial frequency (Field, JOSA A 4, 1987), near -1 for natural images.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

import cv2
import numpy as np

from morphspace.arrays import AnyArray
from morphspace.errors import BadInput

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of R, G, B: ITU-R BT.709
CODE_LIMIT = 0.04045  # of the sRGB curve: below it is a straight line
LOWEST_CYCLES = 2.0  # a picture's lower side: slower changes are the window's own
HIGHEST_SHARE = 0.5  # of the Nyquist frequency: beyond it files and resampling decide the spectrum
BANDS_AN_OCTAVE = 3  # bands of frequency in which amplitudes are averaged
LEAST_BANDS = 3  # to fit a line through
DIGITS = 6  # kept of each figure; the Fourier transform's own rounding lies below
SPACES = ("linear", "code")
FIGURES = ("luminance", "rms_contrast", "spectral_slope", "red", "green", "blue")
"""Of each space. Red, green, blue and luminance are means over the picture, from 0 to 1."""
DARK = 1e-6  # mean luminance below which contrast has no meaning


def image_statistics(frames: Iterable[AnyArray]) -> dict[str, dict[str, float | None]]:
    """Compute the statistics of one image, or their means over the frames of a video.

    Parameters
    ----------
    frames : iterable of arrays (h, w, 3) uint8

    Returns
    -------
    dict of dict
        `linear` and `code`, each with the `FIGURES`. None where a statistic is undefined: the contrast of a black
        image, the slope of a uniform or very small image.

    Raises
    ------
    BadInput
        If there are no frames or one is not (h, w, 3) uint8.

    References
    ----------
    Moulden, Kingdom and Gatley, Perception 19, 1990 (RMS contrast); Field, JOSA A 4, 1987 (spectral slope).

    Examples
    --------
    >>> import numpy as np
    >>> grey = image_statistics([np.full((4, 4, 3), 255, np.uint8)])["code"]
    >>> grey["luminance"], grey["rms_contrast"], grey["spectral_slope"]
    (1.0, 0.0, None)
    """
    kept: list[AnyArray] = []
    for codes in frames:
        if codes.dtype != np.uint8 or codes.ndim != 3 or codes.shape[2] != 3 or codes.size == 0:
            raise BadInput(
                f"the frame is {codes.dtype} {codes.shape}; expected 8-bit codes (h, w, 3). Convert it"
            )
        kept.append(np.array([_figures(_values(codes, space)) for space in SPACES]))
    if not kept:
        raise BadInput("there are no frames; expected at least one. Select frames")
    table = np.stack(kept)
    known = np.isfinite(table)
    means = np.where(known, table, 0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return {
        space: {
            name: _rounded(means[row, column]) if known[:, row, column].any() else None
            for column, name in enumerate(FIGURES)
        }
        for row, space in enumerate(SPACES)
    }


def spectral_slope(luminance: AnyArray) -> float:
    """Return the slope of log amplitude on log frequency of a plane (h, w) float32; NaN if it is undefined.

    The mean is removed and a Hann window applied. Power is averaged over directions and over bands of a third of an
    octave, from `LOWEST_CYCLES` per shorter side to half the Nyquist frequency. All bands have equal weight.

    References
    ----------
    Field, JOSA A 4, 1987; the bands are ours.

    Examples
    --------
    >>> import numpy as np
    >>> white = np.random.default_rng(1).normal(size=(128, 128))
    >>> frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(128), np.fft.fftfreq(128)))
    >>> pink = np.fft.ifft2(np.fft.fft2(white) / np.maximum(frequency, 1 / 128)).real
    >>> round(spectral_slope(np.float32(pink)) - spectral_slope(np.float32(white)))
    -1
    """
    window, band, counts, log_frequency = _spectrum_of(*luminance.shape)
    if len(counts) < LEAST_BANDS:
        return float("nan")
    plane = (luminance - luminance.mean(dtype=np.float64)).astype(np.float32)
    spectrum = cv2.dft(plane * window, flags=cv2.DFT_COMPLEX_OUTPUT)[:, : luminance.shape[1] // 2 + 1]
    power = spectrum[..., 0] ** 2 + spectrum[..., 1] ** 2
    sums = np.bincount(band.ravel(), power.ravel(), len(counts) + 1)[1:]
    mean = sums / counts
    if not (mean > 1e-12 * luminance.size).all():  # a plain surface: rounding is all there is
        return float("nan")
    log_amplitude = np.log(mean) / 2
    x = log_frequency - log_frequency.mean()
    return float(x @ log_amplitude / (x @ x))


@lru_cache(maxsize=8)
def _spectrum_of(height: int, width: int) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """Return the window (h, w), the band of each frequency (h, w // 2 + 1), their counts and mean log frequencies."""
    window = np.outer(np.hanning(height + 2)[1:-1], np.hanning(width + 2)[1:-1]).astype(np.float32)
    fy, fx = np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None]
    frequency = np.hypot(fy, fx)
    low, high = LOWEST_CYCLES / min(height, width), 0.5 * HIGHEST_SHARE
    with np.errstate(divide="ignore"):
        place = np.floor(np.log2(frequency / low) * BANDS_AN_OCTAVE + 1e-9)
    inside = (frequency >= low) & (frequency < high)
    band = np.where(inside, place + 1, 0).astype(np.int64)
    found = np.unique(band[inside])
    band = np.where(inside, np.searchsorted(found, band) + 1, 0) if len(found) else band * 0
    counts = np.bincount(band.ravel(), minlength=len(found) + 1)[1:]
    logs = np.where(inside, np.log(np.where(inside, frequency, 1)), 0)
    log_frequency = np.bincount(band.ravel(), logs.ravel(), len(found) + 1)[1:] / np.maximum(counts, 1)
    for array in (window, band, counts, log_frequency):
        array.setflags(write=False)
    return window, band, counts, log_frequency


def _table(space: str) -> AnyArray:
    """Return the value of each 8-bit code, (256,) float64 in [0, 1]."""
    coded = np.arange(256) / 255
    if space == "code":
        return coded
    return np.where(coded <= CODE_LIMIT, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


TABLES = {space: _table(space) for space in SPACES}
TABLES_32 = {space: table.astype(np.float32) for space, table in TABLES.items()}


def _values(codes: AnyArray, space: str) -> tuple[AnyArray, AnyArray]:
    """Return the luminance (h, w) float32 and the means of the channels (3,)."""
    table = TABLES[space]
    means = np.array([np.bincount(codes[..., c].ravel(), minlength=256) @ table for c in range(3)])
    values = cv2.LUT(np.ascontiguousarray(codes), TABLES_32[space])
    return (values @ LUMINANCE.astype(np.float32)), means / codes[..., 0].size


def _figures(of: tuple[AnyArray, AnyArray]) -> tuple[float, ...]:
    luminance, means = of
    mean = float(means @ LUMINANCE)
    deviation = float(luminance.std(dtype=np.float64))
    contrast = deviation / mean if mean > DARK else float("nan")
    return (mean, contrast, spectral_slope(luminance), *map(float, means))


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
