"""caricature: faces of a person further from, or nearer to, that person's mean face, and on its other side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import LoadingTable, Mask
from morphspace.errors import BadInput
from morphspace.face.regions import WHOLE
from morphspace.io.images import read_mask
from morphspace.model.keypoints import region_of
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import Outcome
from morphspace.requests import ClipText
from morphspace.sets.planned import PlannedSet, plan_of, write_set
from morphspace.sets.sources import Faces, faces_of
from morphspace.steps import Steps
from morphspace.stimuli.caricature import caricatured, components_named
from morphspace.stimuli.drawing import VIDEO_SUFFIXES, Drawing
from morphspace.storage import digest_of_file

PICTURE_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".exr", ".bmp")  # of a region that was painted


@dataclass(frozen=True)
class CaricatureRequest:
    """Draw the faces of `loadings` (a table) or `clip` with `model` at each of `gains`, into the folder `output`.

    `warp_gains` and `texture_gains` replace `gains` for the warp and the texture; lists are crossed. `components`
    ("1-5,8") are the ones that are changed, None for all; `region` a part of the face by name, several joined by "+",
    or a grey picture. `frames` names the rows to draw, none for all. `video` is .mp4 or .mkv where the faces are a
    motion to be shown at `frame_rate_hz`, None for pictures.
    """

    model: Path
    output: Path
    loadings: Path | None = None
    clip: tuple[ClipText, ...] = ()
    gains: tuple[float, ...] = (0.5, 1.0, 1.5, -1.0)
    warp_gains: tuple[float, ...] | None = None
    texture_gains: tuple[float, ...] | None = None
    components: str | None = None
    region: str | None = None
    frames: tuple[str, ...] = ()
    video: str | None = None
    frame_rate_hz: float | None = None
    crop: tuple[int, int, int, int] | None = None


def run(request: CaricatureRequest) -> Steps[Outcome]:
    """Write the set of stimuli. Returns an `Outcome`."""
    planned = yield from plan(request)
    return (yield from write_set(planned, request.output))


def plan(request: CaricatureRequest, model: MorphModel | None = None) -> Steps[PlannedSet]:
    """Read and check everything, draw nothing; `model` where it is open already. Returns a `PlannedSet`."""
    model = model or load_model(request.model)
    for gains, what in (
        (request.gains, "gain"),
        (request.warp_gains, "warp gain"),
        (request.texture_gains, "texture gain"),
    ):
        check_gains(gains, what)
    components = None if request.components is None else components_named(request.components, model.rank)
    mask, inputs = _region(request.region, model)
    faces = yield from faces_of(
        model, request.loadings, request.clip, request.frames, request.crop, request.frame_rate_hz
    )
    drawings = [
        _drawing(request, faces, rows, name, gains, components, mask)
        for name, rows in faces.stimuli(request.video)
        for gains in _gains(request)
    ]
    return plan_of(
        request, "caricature", model, drawings, inputs={**faces.inputs, **inputs}, notes=faces.notes
    )


def check_gains(gains: tuple[float, ...] | None, what: str) -> None:
    """Raise `BadInput` where a gain is not a number, or one is given twice."""
    for gain in gains or ():
        if not np.isfinite(gain):
            raise BadInput(f"a {what} of {gain} cannot be used: give a number, 1 for the faces as they are")
        if (gains or ()).count(gain) > 1:
            raise BadInput(f"the {what} {gain:g} was given twice: give each once")


def _gains(request: CaricatureRequest) -> list[dict[str, float]]:
    """Give the gains of each version: one for all, or one of the warp and one of the texture, crossed."""
    if request.warp_gains is None and request.texture_gains is None:
        return [{"gain": gain} for gain in request.gains]
    warps = request.warp_gains if request.warp_gains is not None else request.gains
    textures = request.texture_gains if request.texture_gains is not None else request.gains
    return [{"warp_gain": one, "texture_gain": other} for one in warps for other in textures]


def _drawing(
    request: CaricatureRequest,
    faces: Faces,
    rows: slice,
    name: str,
    gains: Mapping[str, float],
    components: tuple[int, ...] | None,
    mask: Mask | None,
) -> Drawing:
    veridical: LoadingTable = faces.loadings_sd[rows]
    shape = caricatured(veridical, gains.get("gain", gains.get("warp_gain", 1.0)), components)
    colour = None if "gain" in gains else caricatured(veridical, gains["texture_gain"], components)
    told: dict[str, Any] = {"frame": name, **gains}
    if request.components is not None:
        told["components"] = request.components
    if request.region is not None:
        told["region"] = Path(request.region).name if mask is not None else request.region
    ending = "_".join(
        f"{key.removesuffix('gain').rstrip('_')[:1] or 'g'}{gain:g}" for key, gain in gains.items()
    )
    whole = request.region is None or (mask is None and request.region == WHOLE)
    return Drawing(
        name=f"{name}_{ending}",
        loadings_sd=shape,
        colour_sd=colour,
        region=None if whole else told["region"],
        outside_sd=None if whole else veridical,
        frame_rate_hz=None if request.video is None else faces.frame_rate_hz,
        suffix=request.video or ".png",
        told=told,
        region_mask=mask,
    )


def _region(region: str | None, model: MorphModel) -> tuple[Mask | None, dict[str, str]]:
    """Give the mask that was painted, None where the region is a named one; refuse what cannot be one."""
    if region is None:
        return None, {}
    path = Path(region)
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        region_of(model, region)  # refuses names that are none, and models that do not know where
        return None, {}
    mask = read_mask(path)
    if mask.shape != model.mask.shape:
        raise BadInput(
            f"the region {region} is {mask.shape[1]}x{mask.shape[0]}, the frames of {model.identity} are "
            f"{model.size[0]}x{model.size[1]}: paint it on a rendered mean face"
        )
    return mask, {"region": digest_of_file(path)}


__all__ = ["VIDEO_SUFFIXES", "CaricatureRequest", "plan", "run"]
