"""Caricature: multiply loadings by a gain (Nagle section 5; the idea is that of Benson and Perrett 1991).

Gain 1 is veridical, above 1 a caricature, between 0 and 1 an anti-caricature, 0 the mean face, below 0 an anti-face.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable, Mask
from morphspace.errors import BadInput
from morphspace.face.regions import WHOLE
from morphspace.io.images import read_mask
from morphspace.model.keypoints import region_of
from morphspace.model.model import MorphModel
from morphspace.stimuli.drawing import Drawing
from morphspace.storage import digest_of_file

PICTURE_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".exr", ".bmp")  # of a region's mask
Change = Callable[..., list[Drawing]]
"""Plans the drawings of faces: from a name, loadings (n, k) in SD, and the frame rate of a video, Hz."""
SPAN = re.compile(r"([0-9]{1,5})(?:-([0-9]{1,5}))?")


def components_named(words: str, rank: int) -> tuple[int, ...]:
    """Convert components such as `1-5,8` to indices from 0. Raises `BadInput` if one is not in the model.

    Examples
    --------
    >>> components_named("1-3,8", rank=10)
    (0, 1, 2, 7)
    """
    places: set[int] = set()
    for part in words.split(","):
        found = SPAN.fullmatch(part.strip())
        if found is None:
            raise BadInput(
                f"the components are {words!r}; expected numbers and spans. Write, for example, 1-5,8"
            )
        first = int(found.group(1))
        last = int(found.group(2) or first)
        if not 1 <= first <= last <= rank:
            raise BadInput(
                f"the components are {part.strip()!r}; expected 1 to {rank} of the model. Change them"
            )
        places.update(range(first - 1, last))
    return tuple(sorted(places))


def caricatured(
    loadings_sd: LoadingTable, gain: float, components: tuple[int, ...] | None = None
) -> LoadingTable:
    """Multiply loadings (n, k) by the gain, in all components or only in these (from 0).

    Raises `BadInput` if the gain is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> caricatured(np.array([[1.0, -2.0]]), 1.5, components=(1,)).tolist()
    [[1.0, -3.0]]
    """
    if not np.isfinite(gain):
        raise BadInput(f"the gain is {gain}; expected a finite number. Enter 1 for veridical faces")
    factors: AnyArray = np.ones(loadings_sd.shape[1])
    factors[slice(None) if components is None else list(components)] = gain
    return np.asarray(loadings_sd * factors, np.float64)


def _caricature_drawing(
    name: str,
    veridical: LoadingTable,
    gains: Mapping[str, float],
    *,
    components: tuple[int, ...] | None = None,
    components_named_as: str | None = None,
    region: str | None = None,
    mask: Mask | None = None,
    frame_rate_hz: float | None = None,
    suffix: str = ".png",
) -> Drawing:
    """Return the drawing of faces at these gains.

    Parameters
    ----------
    name : str
        The name of the faces; the gains are appended.
    veridical : array (n, k), SD
    gains : mapping
        "gain" alone, or "warp_gain" and "texture_gain".
    components : tuple of int, from 0, or None for all
        The components that change.
    components_named_as : str or None
        The components as the user wrote them.
    region : str or None
        The part of the face that changes: its name, or the file of a mask.
    mask : array (h, w) or None
        The mask on the mean face, if `region` is a file.
    frame_rate_hz : float or None
        The rate of a video; None for images.

    Returns
    -------
    Drawing

    References
    ----------
    Nagle et al., section 5; Benson and Perrett, European Journal of Cognitive Psychology 3, 1991.
    """
    shape = caricatured(veridical, gains.get("gain", gains.get("warp_gain", 1.0)), components)
    colour = None if "gain" in gains else caricatured(veridical, gains["texture_gain"], components)
    variables: dict[str, Any] = {"frame": name, **gains}
    if components_named_as is not None:
        variables["components"] = components_named_as
    if region is not None:
        variables["region"] = Path(region).name if mask is not None else region
    ending = "_".join(
        f"{key.removesuffix('gain').rstrip('_')[:1] or 'g'}{gain:g}" for key, gain in gains.items()
    )
    whole = region is None or (mask is None and region == WHOLE)
    return Drawing(
        name=f"{name}_{ending}",
        loadings_sd=shape,
        colour_sd=colour,
        region=None if whole else variables["region"],
        outside_sd=None if whole else veridical,
        frame_rate_hz=frame_rate_hz,
        suffix=suffix,
        variables=variables,
        region_mask=mask,
    )


def _caricature_region(region: str | None, model: MorphModel) -> tuple[Mask | None, dict[str, str]]:
    """Return the mask (h, w) and digest of a region's file, or None and {} for a named region.

    Raises
    ------
    BadInput
        If the model does not have the region, or the mask does not have the size of its frames.
    """
    if region is None:
        return None, {}
    path = Path(region)
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        region_of(model, region)  # raises for unknown regions and models without keypoints
        return None, {}
    mask = read_mask(path)
    if mask.shape != model.mask.shape:
        raise BadInput(
            f"the region {region} is {mask.shape[1]}x{mask.shape[0]}; expected {model.size[0]}x{model.size[1]}, the "
            f"frames of {model.identity}. Paint it on a rendered mean face"
        )
    return mask, {"region": digest_of_file(path)}


def change_of(request: Any, model: MorphModel) -> tuple[Change, dict[str, str]]:
    """Check gains, components and region of a request of `caricature`; return its change, and the region's digest."""
    gains = crossed_gains(request.gains, request.warp_gains, request.texture_gains)
    components = None if request.components is None else components_named(request.components, model.rank)
    mask, inputs = _caricature_region(request.region, model)

    def drawings(name: str, veridical: LoadingTable, frame_rate_hz: float | None = None) -> list[Drawing]:
        return [
            _caricature_drawing(
                name,
                veridical,
                one,
                components=components,
                components_named_as=request.components,
                region=request.region,
                mask=mask,
                frame_rate_hz=frame_rate_hz,
                suffix=request.video or ".png",
            )
            for one in gains
        ]

    return drawings, inputs


def crossed_gains(
    gains: Sequence[float], warp_gains: Sequence[float] | None, texture_gains: Sequence[float] | None
) -> list[dict[str, float]]:
    """Return the gains of each version: one for all loadings, or those of warp and texture, crossed.

    Raises
    ------
    BadInput
        If a gain is given twice.

    Examples
    --------
    >>> crossed_gains((1.0, 2.0), None, (0.5,))
    [{'warp_gain': 1.0, 'texture_gain': 0.5}, {'warp_gain': 2.0, 'texture_gain': 0.5}]
    """
    for given, what in ((gains, "gain"), (warp_gains, "warp gain"), (texture_gains, "texture gain")):
        for gain in given or ():
            if (given or ()).count(gain) > 1:
                raise BadInput(f"the {what} {gain:g} was given twice. Give each once")
    if warp_gains is None and texture_gains is None:
        return [{"gain": gain} for gain in gains]
    warps = gains if warp_gains is None else warp_gains
    textures = gains if texture_gains is None else texture_gains
    return [{"warp_gain": one, "texture_gain": other} for one in warps for other in textures]
