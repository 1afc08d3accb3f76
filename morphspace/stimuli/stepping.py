"""How much one face differs from the next: in the warp, in colour, for a measure of pictures; and steps made equal.

CIEDE2000 is the colour difference of CIE 142 (Luo, Cui and Rigg, Color Research and Application 26, 2001), here of sRGB
under D65, pixel by pixel, averaged over the mask. SSIM is that of Wang et al. (2004).
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
EVEN = 0.005  # steps that differ from their mean by less are equal; the goal is 0.03
ROUNDS = 30  # at most; 4 to 8 are usual
PATIENCE = 5  # rounds that bring nothing, after which the codes of a file let it be no more even


@dataclass(frozen=True, eq=False)
class Equalised:
    """Positions (n,) and the sizes (n - 1,) of the steps between them."""

    positions: AnyArray
    sizes: AnyArray

    @property
    def unevenness(self) -> float:
        """How far the step furthest from the mean size is from it, as a share of that."""
        return unevenness(self.sizes)


@dataclass(frozen=True)
class Change:
    """What a step changes, inside the mask.

    `warp_rms_px` how far points of the face move, `texture_rms_codes` how much their colours change, in 8-bit codes |
    of the two pictures: `ciede2000`, and `ssim`, 1 where they are equal | the same where only the shape changes, and
    the colours are those of the middle of the step; and where only the colours change, on the shape of its middle.
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
    """Faces along a way: texture (h, w, 3) and displacement (h, w, 2) px of the mean face at each position."""

    def texture(self, position: float) -> Image:
        """Give the texture at a position."""

    def displacement(self, position: float) -> Displacement:
        """Give the displacement at a position."""


def as_shown(image: Image) -> Image:
    """Give an image (h, w, 3) with the colours an 8-bit file holds: clipped to [0, 1] and rounded to a 255th."""
    return (np.rint(np.clip(image, 0, 1) * np.float32(CODES)) / np.float32(CODES)).astype(np.float32)


def ciede2000(one: Image, other: Image, mask: Mask) -> float:
    """Give the colour difference CIEDE2000 of two pictures (h, w, 3), averaged over the mask (h, w)."""
    from skimage.color import deltaE_ciede2000, rgb2lab

    lab = [rgb2lab(np.clip(picture, 0, 1).astype(np.float64)) for picture in (one, other)]
    return float((deltaE_ciede2000(*lab) * mask).sum() / max(float(mask.sum()), 1e-12))


def difference(one: Image, other: Image, mask: Mask, kind: str) -> float:
    """Give how much two pictures differ: mean "ciede2000", or 1 - "ssim"; 0 for equal pictures."""
    if kind == "ciede2000":
        return ciede2000(one, other, mask)
    if kind == "ssim":
        return max(0.0, 1.0 - quality.ssim(one, other, mask))
    raise BadInput(f"pictures cannot be compared by {kind!r}: choose ciede2000 or ssim")


def change(path: Path, start: float, stop: float, mask: Mask) -> Change:
    """Measure the step from one position of a path to another."""
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
    """Give how far the size furthest from the mean is from it, as a share of that; 0 where all are 0."""
    mean = float(np.mean(sizes))
    return float(np.abs(sizes - mean).max() / mean) if mean > 0 else 0.0


def equalised(
    sizes_of: Callable[[AnyArray], AnyArray], positions: AnyArray, power: float = 1.0, *, even: float = EVEN
) -> Equalised:
    """Move positions (n,) between their ends, which stay, until the steps between them are of equal size.

    Parameters: sizes_of, gives the sizes (n - 1,) of the steps between positions in rising order; power, how a step's
    size grows with its length while both are small; even, when to stop. Each round spreads the positions over the
    running sum of the steps' lengths as the last round measured them; the best round is given. Raises `BadInput` where
    no step has any size.
    """
    best: Equalised | None = None
    waited = 0
    for _ in range(ROUNDS):
        found = Equalised(positions, np.asarray(sizes_of(positions), np.float64))
        if not found.sizes.any():
            raise BadInput(
                "nothing that the files could show changes between the two ends: take fewer steps, or ends that differ"
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
        raise BadInput("there are no rounds to space the steps in")
    return best
