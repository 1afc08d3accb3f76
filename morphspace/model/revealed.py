"""Colours of places that a warp hides or reveals: the mouth's inside, teeth, eyes (ours).

The mean texture shows what most frames show. Where most frames have closed lips, the place of teeth has the colour of
lips, and a warp that opens the mean mouth shows skin. So the colour of such a place follows how far the warp opens it.
It is regressed on the place's area in the training faces, at places that some of them press to a line; between the rims
of mouth and eyes alone, if the model has face points. Elsewhere a warp changes no colour.

A face whose texture and warp have the same loadings is not changed: its texture shows what its warp reveals. Drawings
with a warp of their own (`caricature --texture-gain 0`, `sweep --warp-only`) differ from it by the regression.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from morphspace.arrays import Displacement, Image, LoadingTable, LoadingVector, Mask, Points
from morphspace.face.regions import inside_openings
from morphspace.grid import warp
from morphspace.model.morph import Morph
from morphspace.steps import spread

# Chosen on lp_d18, lp_d13, lp_d6 by the colours inside opened lips and by the look of teeth and closed lips.
MOST_AREA = 4.0  # px^2 of a place of 1 px^2; with 2 wide mouths stay pale, with 8 they look as with 4
HIDDEN_AREA = (
    0.35  # px^2; places that no training face presses below it are skin, whose creases stay as they are
)
RIDGE = 0.02  # px^4, added to the variance of the area
EDGE_PX = 1.0  # px, SD of the soft edge of such places
AREA_SD_PX = (
    1.5  # px; areas are those of surroundings, since held fields have one area in each triangle of a mouth
)
FACES = 100  # training faces in the regression, evenly spread
LEAST_FACES = 8  # with fewer, as in pairs of people, area and colour go together by chance


@dataclass(frozen=True, eq=False)
class Revealed:
    """The regression of colour on area, at each place of a mean face.

    Attributes
    ----------
    slope : array (h, w, 3)
        Change of colour per px^2 of area, 0 where no face hides a place.
    least, most : array (h, w) px^2
        The areas among the training faces; beyond them colours do not change.
    """

    slope: Image
    least: Mask
    most: Mask

    def change(self, displacement: Displacement, usual: Displacement) -> Image:
        """Return the change of colour (h, w, 3) if a face is drawn with a warp that is not its usual one.

        Parameters
        ----------
        displacement, usual : array (h, w, 2) px
            The warp of the drawing, and the warp that belongs to its texture.

        Examples
        --------
        >>> import numpy as np
        >>> of_eyes = Revealed(np.ones((2, 2, 3)), np.zeros((2, 2)), np.ones((2, 2)))
        >>> shut = np.zeros((2, 2, 2)); shut[1, :, 1] = -0.5
        >>> of_eyes.change(shut, np.zeros((2, 2, 2)))[0, 0].tolist()
        [-0.5, -0.5, -0.5]
        """
        further = self._area(displacement) - self._area(usual)
        return (self.slope * further[..., None]).astype(np.float32)

    def _area(self, displacement: Displacement) -> Mask:
        return np.clip(_areas(displacement), self.least, self.most)


def learn_revealed(
    expand: Callable[[LoadingVector], Morph], training: LoadingTable, points: Points | None = None
) -> Revealed:
    """Regress the colours of a model's training faces on their areas; memory does not grow with the faces.

    Parameters
    ----------
    expand : function
        From raw loadings (k,) to the morph of a face.
    training : array (n, k)
        Raw loadings of the training faces.
    points : array (478, 2) px, optional
        The face on the mean face; None if unknown.

    Returns
    -------
    Revealed

    Examples
    --------
    >>> import morphspace as ms
    >>> model = ms.load("anna.morph")
    >>> learn_revealed(model.expand, model.training.values).slope.shape
    (72, 60, 3)
    """
    rows = training[spread(len(training), FACES)]
    height, width = expand(np.zeros(0)).shape
    area_sum, square_sum = np.zeros((height, width)), np.zeros((height, width))
    colour_sum, product_sum = np.zeros((height, width, 3)), np.zeros((height, width, 3))
    least, most = np.full((height, width), MOST_AREA, np.float32), np.zeros((height, width), np.float32)
    for row in rows:
        morph = expand(row)
        area = _areas(morph.displacement)
        least, most = np.minimum(least, area), np.maximum(most, area)
        area_sum += area
        square_sum += area * area
        colour_sum += morph.texture
        product_sum += area[..., None] * morph.texture
    count = len(rows)
    if count < LEAST_FACES:
        return Revealed(np.zeros((height, width, 3), np.float32), least, most)
    mean_area = area_sum / count
    covariance = product_sum / count - mean_area[..., None] * colour_sum / count
    variance = square_sum / count - mean_area**2 + RIDGE
    hides = np.clip(2 * (1 - least / HIDDEN_AREA), 0, 1).astype(np.float32)
    if points is not None:
        hides *= inside_openings(points, height, width)
    hides = cv2.GaussianBlur(hides, (0, 0), EDGE_PX, borderType=cv2.BORDER_REPLICATE)
    return Revealed((covariance * (hides / variance)[..., None]).astype(np.float32), least, most)


def _areas(displacement: Displacement) -> Mask:
    """Return the area (h, w) px^2 that each place of 1 px^2 takes in the frame, from 0 to `MOST_AREA`."""
    cells = np.clip(warp.determinants(displacement), 0, np.float32(MOST_AREA))
    areas = cv2.copyMakeBorder(cells, 0, 1, 0, 1, cv2.BORDER_REPLICATE)
    smooth: Mask = cv2.GaussianBlur(areas, (0, 0), AREA_SD_PX, borderType=cv2.BORDER_REPLICATE)
    return smooth
