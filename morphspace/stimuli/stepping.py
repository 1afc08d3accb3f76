"""Differences between neighbouring faces of a continuum (warp, colour, image), and the equalisation of its steps.

CIEDE2000 is the colour difference of CIE 142 (Luo, Cui and Rigg, Color Research and Application 26, 2001), for sRGB
under D65, per pixel and averaged over the mask. SSIM is that of Wang et al. (2004).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from morphspace.arrays import AnyArray, Displacement, Image, Mask
from morphspace.errors import BadInput
from morphspace.grid import warp
from morphspace.linear import quality

CODES = 255  # of an 8-bit file
EVEN = 0.005  # relative deviation at which to stop; 0.03 is required
ROUNDS = 30  # at most; 4 to 8 are usual
PATIENCE = 5  # rounds without improvement; the 8-bit codes limit further equality


@dataclass(frozen=True, eq=False)
class Equalised:
    """Positions (n,) and the sizes (n - 1,) of the steps between them."""

    positions: AnyArray
    sizes: AnyArray

    @property
    def unevenness(self) -> float:
        """The largest deviation of a step from the mean size, as a share of the mean."""
        return unevenness(self.sizes)


@dataclass(frozen=True)
class Change:
    """The change in one step, inside the mask.

    Attributes
    ----------
    warp_rms_px : float, px
        The rms movement of the points of the face.
    texture_rms_codes : float, 8-bit codes
        The rms change of their colours.
    ciede2000, ssim : float
        The difference and similarity of the two images; SSIM is 1 for equal images.
    shape_ciede2000, shape_ssim : float
        The same if only the shape changes; the colours are those of the middle of the step.
    colour_ciede2000, colour_ssim : float
        The same if only the colours change; the shape is that of the middle of the step.
    """

    warp_rms_px: float
    texture_rms_codes: float
    ciede2000: float
    ssim: float
    shape_ciede2000: float
    shape_ssim: float
    colour_ciede2000: float
    colour_ssim: float


class Path(Protocol):
    """Faces along a path: texture (h, w, 3) and displacement (h, w, 2) px of the mean face at each position."""

    def texture(self, position: float) -> Image:
        """Return the texture at a position."""

    def displacement(self, position: float) -> Displacement:
        """Return the displacement at a position."""


def as_shown(image: Image) -> Image:
    """Round an image (h, w, 3) to the colours of an 8-bit file: clipped to [0, 1], in steps of 1/255.

    Examples
    --------
    >>> import numpy as np
    >>> (255 * as_shown(np.array([[[-0.1, 0.5, 1.2]]]))).round(3).tolist()
    [[[0.0, 128.0, 255.0]]]
    """
    return (np.rint(np.clip(image, 0, 1) * np.float32(CODES)) / np.float32(CODES)).astype(np.float32)


def ciede2000(one: Image, other: Image, mask: Mask) -> float:
    """Return the mean colour difference CIEDE2000 of two images (h, w, 3) over the mask (h, w).

    References
    ----------
    Luo, Cui and Rigg, Color Research and Application 26, 2001.

    Examples
    --------
    >>> import numpy as np
    >>> grey, mask = np.full((2, 2, 3), 0.5), np.ones((2, 2))
    >>> ciede2000(grey, grey, mask), round(ciede2000(grey, grey + 0.1, mask), 1)
    (0.0, 8.9)
    """
    from skimage.color import deltaE_ciede2000, rgb2lab

    lab = [rgb2lab(np.clip(picture, 0, 1).astype(np.float64)) for picture in (one, other)]
    return float((deltaE_ciede2000(*lab) * mask).sum() / max(float(mask.sum()), 1e-12))


def difference(one: Image, other: Image, mask: Mask, kind: str) -> float:
    """Return the difference of two images: mean "ciede2000", or 1 - "ssim"; 0 for equal images. Raises `BadInput`.

    Examples
    --------
    >>> import numpy as np
    >>> grey, mask = np.full((16, 16, 3), 0.5, np.float32), np.ones((16, 16), np.float32)
    >>> round(difference(grey, grey, mask, "ssim"), 6), round(difference(grey, grey + 0.1, mask, "ciede2000"), 1)
    (0.0, 8.9)
    """
    if kind == "ciede2000":
        return ciede2000(one, other, mask)
    if kind == "ssim":
        return max(0.0, 1.0 - quality.ssim(one, other, mask))
    raise BadInput(f"the measure is {kind!r}; expected ciede2000 or ssim. Choose one")


def change(path: Path, start: float, stop: float, mask: Mask) -> Change:
    """Measure the step between two positions of a path."""
    middle = (start + stop) / 2
    textures = [path.texture(at) for at in (start, middle, stop)]
    fields = [path.displacement(at) for at in (start, middle, stop)]

    def shown(texture: int, field: int) -> Image:
        return as_shown(warp.render(textures[texture], fields[field]))

    whole = shown(0, 0), shown(2, 2)
    shape = shown(1, 0), shown(1, 2)
    colour = shown(0, 1), shown(2, 1)
    return Change(
        warp_rms_px=quality.rms_px(fields[2] - fields[0], mask),
        texture_rms_codes=quality.photometric_rmse(textures[2], textures[0], mask),
        ciede2000=ciede2000(*whole, mask),
        ssim=quality.ssim(*whole, mask),
        shape_ciede2000=ciede2000(*shape, mask),
        shape_ssim=quality.ssim(*shape, mask),
        colour_ciede2000=ciede2000(*colour, mask),
        colour_ssim=quality.ssim(*colour, mask),
    )


def unevenness(sizes: AnyArray) -> float:
    """Return the largest deviation of a size from the mean, as a share of the mean; 0 if all are 0.

    Examples
    --------
    >>> import numpy as np
    >>> unevenness(np.array([1.0, 1.5, 0.5]))
    0.5
    """
    mean = float(np.mean(sizes))
    return float(np.abs(sizes - mean).max() / mean) if mean > 0 else 0.0


def equalised(
    sizes_of: Callable[[AnyArray], AnyArray], positions: AnyArray, power: float = 1.0, *, even: float = EVEN
) -> Equalised:
    """Move positions between their fixed ends until the steps between them have equal sizes.

    Each round places the positions evenly along the cumulative step length that the last round measured.

    Parameters
    ----------
    sizes_of : function
        Returns the sizes (n - 1,) of the steps between rising positions (n,).
    positions : array (n,)
    power : float
        The size of a small step grows with this power of its length.
    even : float
        The unevenness at which to stop.

    Returns
    -------
    Equalised
        The best round.

    Raises
    ------
    BadInput
        If all steps have size 0.

    Examples
    --------
    >>> import numpy as np
    >>> found = equalised(lambda p: np.diff(p**2), np.linspace(0, 1, 3))
    >>> found.positions.round(2).tolist()
    [0.0, 0.71, 1.0]
    """
    best: Equalised | None = None
    waited = 0
    for _ in range(ROUNDS):
        found = Equalised(positions, np.asarray(sizes_of(positions), np.float64))
        if not found.sizes.any():
            raise BadInput(
                "the images of all steps are equal in 8-bit codes. Use fewer steps, or ends that differ more"
            )
        waited += 1
        if best is None or found.unevenness < best.unevenness:
            best, waited = found, 0
        if best.unevenness <= even or waited == PATIENCE:
            break
        run = np.concatenate([[0.0], np.cumsum(found.sizes ** (1 / power))])
        moved = np.interp(np.linspace(0, run[-1], len(run)), run, positions)
        positions = np.concatenate([positions[:1], moved[1:-1], positions[-1:]])
    if best is None:
        raise BadInput("the number of rounds is 0; expected at least 1. Raise ROUNDS")
    return best
