"""Plain functions for a notebook: each takes objects and returns objects, and writes no file (ours).

The verbs of the command line write sets of stimuli with a sidecar each; these functions are for looking and trying. A
result is a `MorphModel`, `Loadings`, or `Faces`, and a notebook draws it where it is the last line of a cell.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import Image, LoadingTable
from morphspace.avatar import AvatarSettings, blend_steps
from morphspace.avatar.pair import pair_model
from morphspace.errors import BadInput
from morphspace.flow.methods import DEFAULT
from morphspace.io.clips import open_clip
from morphspace.io.images import write_image
from morphspace.model.display import card, picture_tag
from morphspace.model.encode import encoded_frames, framed_for, joined
from morphspace.model.from_clip import ClipSettings, build_clip
from morphspace.model.loadings import Loadings
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import versions as package_versions
from morphspace.sets.continuum import continuum_drawings
from morphspace.steps import Step, Steps, result_of
from morphspace.stimuli.caricature import caricature_drawing, caricature_region, components_named
from morphspace.stimuli.continuum import Line, Spacing, spaced_positions
from morphspace.stimuli.drawing import Drawing, check_name
from morphspace.stimuli.drawn import draw
from morphspace.stimuli.operations import Motion, operations_of, worked
from morphspace.transfer.mimicry import MAX_SD, Method, Mimicry, auto_gain
from morphspace.transfer.mimicry import mimic as prepare_mimicry
from morphspace.transfer.neutral import neutral_of

SHEET_FACES = 12  # of a sequence on a card; a notebook is to stay small
FRAME_RATE_HZ = 25.0  # of a motion whose model does not state its rate


@dataclass(frozen=True, eq=False)
class Faces(Sequence[Image]):
    """Faces of one model, drawn when they are asked for.

    `faces[i]` is an image (h, w, 3) float32 in [0, 1]; a notebook shows the first as a contact sheet.

    Attributes
    ----------
    names : tuple of str, one a face
    loadings : Loadings
        The faces' loadings on the model that draws them.
    """

    names: tuple[str, ...]
    loadings: Loadings
    draw: Callable[[int], Image] = field(repr=False)

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[place] for place in range(len(self))[index]]
        place = range(len(self))[index]
        return np.clip(self.draw(place), 0, 1)

    def __iter__(self) -> Iterator[Image]:
        return (self[place] for place in range(len(self)))

    def save(self, folder: Path | str) -> list[Path]:
        """Write each face as NAME.png into a folder, and return the files.

        Stimuli for an experiment are better made by the verbs, which leave a sidecar beside each.

        Raises
        ------
        BadInput
            If a name cannot name a file.
        UnwritableFile
        """
        for name in self.names:
            check_name(name)
        files = [Path(folder) / f"{name}.png" for name in self.names]
        for file, image in zip(files, self, strict=True):
            file.parent.mkdir(parents=True, exist_ok=True)
            write_image(file, image)
        return files

    def __repr__(self) -> str:
        return f"Faces({len(self)} of model {self.loadings.model_id})"

    def _repr_html_(self) -> str:
        count = min(len(self), SHEET_FACES)
        tags = [picture_tag(self[place], self.names[place]) for place in range(count)]
        drawn = f"{count} of {len(self)}" if count < len(self) else str(count)
        return card(
            f"Faces: {drawn}",
            {"model id": self.loadings.model_id},
            [tags[at : at + 6] for at in range(0, count, 6)],
        )


def build(
    *sources: str | Path, work_folder: Path | None = None, progress: bool = False, **settings: Any
) -> MorphModel:
    """Build a model of one person from a folder, a quoted glob, a video, or image files (Nagle section 2).

    Parameters
    ----------
    sources
        What shows the person.
    work_folder
        The folder in which finished frames are kept, so that another build can reuse them; temporary if None.
    progress
        Draw a progress bar.
    settings
        The fields of `ClipSettings`, such as `components`, `size` (w, h) px, `crop` or `reference`.

    Returns
    -------
    MorphModel

    Raises
    ------
    BadInput
        If the clip cannot be read, has fewer than three frames, or a setting cannot be used.
    """
    asked, clip = ClipSettings(**settings), open_clip(tuple(map(str, sources)))
    if work_folder is not None:
        return _run(build_clip(clip, asked, Path(work_folder)), progress)[0].model
    with tempfile.TemporaryDirectory(prefix="morphspace-") as folder:
        return _run(build_clip(clip, asked, Path(folder)), progress)[0].model


def load(path: Path | str) -> MorphModel:
    """Open a `.morph` file; its arrays are read from the disk when they are used.

    Raises
    ------
    ModelFileError
        If the file is cut short, of another version, or its parts do not fit each other.
    """
    return load_model(path)


def encode(
    model: MorphModel,
    *sources: str | Path,
    crop: tuple[int, int, int, int] | None = None,
    progress: bool = False,
) -> Loadings:
    """Encode images of the model's person as loadings, one row a frame (Nagle section 3, step 1).

    Parameters
    ----------
    model
    sources
        A folder, a quoted glob, a video, or image files.
    crop
        A box (x, y, w, h) px of every frame; None for the whole, or for the model's own crop where the size agrees.
    progress
        Draw a progress bar.

    Raises
    ------
    BadInput
        If the images cannot be read or are too small to read a face from.
    """
    source = framed_for(model, tuple(map(str, sources)), crop)

    def steps() -> Steps[Loadings]:
        parts = []
        for encoded in encoded_frames(model, source):
            parts.append(encoded.loadings)
            yield Step("encode", len(parts), len(source.names))
        return joined(model, parts)

    return _run(steps(), progress)


def mimic(
    source: MorphModel,
    target: MorphModel,
    faces: Loadings | None = None,
    *,
    method: Method | None = None,
    gain: float | None = None,
    max_sd: float = MAX_SD,
) -> Faces:
    """Make one person's model show the expressions of another's (Nagle section 3).

    Parameters
    ----------
    source, target
        The model that drives and the model that is driven; both need keypoints.
    faces
        Loadings on the source; None for the faces it was built from.
    method
        `paper`, `map`, `transfer` or `guided`; None for `guided` where both models know their landmarks, else
        `transfer`.
    gain
        Factor on the loadings; None for the gain at which the target moves as far as the source (`guided`,
        `transfer`), and 1 for the others.
    max_sd
        The bound of each loading, SD of its component.

    Returns
    -------
    Faces
        The target's faces, one for each row.

    Raises
    ------
    BadInput
        If a model has no keypoints, or a setting cannot be used.
    ReferenceMismatch
        If the loadings belong to another model than the source.
    """
    rows = (source.training if faces is None else faces).in_raw(source)
    both = source.landmarks is not None and target.landmarks is not None
    chosen: Method = method or ("guided" if both else "transfer")
    neutral = neutral_of(source, target)
    if gain is None:
        gain = auto_gain(source, target, chosen, neutral=neutral) if chosen in ("guided", "transfer") else 1.0
    show = prepare_mimicry(source, target, chosen, gain=gain, max_sd=max_sd, neutral=neutral)

    def made(place: int) -> Mimicry:
        padded = np.zeros(source.rank)
        padded[: rows.values.shape[1]] = rows.values[place]
        return show(source.offset(padded), padded)

    loadings = Loadings(
        np.stack([made(place).loadings for place in range(len(rows.frame_names))]),
        rows.frame_names,
        target.model_id,
    )
    return Faces(rows.frame_names, loadings, lambda place: made(place).morph.render())


def blend(
    *models: MorphModel, progress: bool = False, work_folder: Path | None = None, **settings: Any
) -> MorphModel:
    """Blend several people into one model that shows nobody (Nagle section 4).

    Parameters
    ----------
    models
        At least two, of one size, with keypoints.
    progress
        Draw a progress bar.
    work_folder
        The folder in which finished expressions are kept; temporary if None.
    settings
        The fields of `AvatarSettings`, such as `weights`, `expressions` or `surround`.

    Raises
    ------
    BadInput
        If the models cannot be blended, or a setting does not fit them.
    """
    settings = {"provenance": {"versions": package_versions()}, **settings}
    if work_folder is not None:
        return _run(blend_steps(models, AvatarSettings(**settings), Path(work_folder)), progress).model
    with tempfile.TemporaryDirectory(prefix="morphspace-") as folder:
        return _run(blend_steps(models, AvatarSettings(**settings), Path(folder)), progress).model


def caricature(
    model: MorphModel,
    faces: Loadings,
    gains: Sequence[float] = (0.5, 1.0, 1.5, -1.0),
    *,
    warp_gain: float | None = None,
    texture_gain: float | None = None,
    components: str | None = None,
    region: str | None = None,
) -> Faces:
    """Draw faces at each gain: 1 is veridical, above 1 a caricature, below 0 an anti-face (Nagle section 5).

    Parameters
    ----------
    model
    faces
        Loadings on the model.
    gains
        Factors on the loadings.
    warp_gain, texture_gain
        Factors on the warp and the texture alone, in place of the gain; None for the gain.
    components
        The components that change, from 1, such as "1-5,8"; None for all.
    region
        The part of the face that changes: eyes, brows, mouth, nose, upper, lower, joined by "+", or the file
        of a grey image of the model's size; None for all.

    Raises
    ------
    BadInput
        If a gain is not finite, or components or region are not the model's.
    ReferenceMismatch
        If the loadings belong to another model.
    """
    rows = faces.in_sd(model).values
    if not len(gains):
        raise BadInput("0 gains were given; expected at least 1, such as 1.5.")
    places = None if components is None else components_named(components, rows.shape[1])
    mask, _ = caricature_region(region, model)
    one_gain = warp_gain is None and texture_gain is None
    versions = dict.fromkeys(
        (gain, gain) if one_gain else tuple(gain if own is None else own for own in (warp_gain, texture_gain))
        for gain in gains
    )
    drawings = [
        caricature_drawing(
            name,
            row[None],
            {"gain": warp} if one_gain else {"warp_gain": warp, "texture_gain": texture},
            components=places,
            region=region,
            mask=mask,
        )
        for name, row in zip(faces.frame_names, rows, strict=True)
        for warp, texture in versions
    ]
    return _faces(model, drawings)


def trajectory(
    model: MorphModel,
    *motions: Loadings,
    operations: Sequence[str],
    rate_hz: float | None = None,
    guide: Loadings | None = None,
    seed: int = 0,
) -> tuple[Loadings, ...]:
    """Change recorded motion: smooth, retime, loop, splice, average, caricature or scramble it.

    Parameters
    ----------
    model
    motions
        Loadings on the model, one row a frame.
    operations
        Words of `morphspace trajectory --op`, such as "smooth=6", "speed=1.5" or "loop", done in their order.
    rate_hz
        Frames a second of the motions; None for what the model states, else 25.
    guide
        The motion whose timing is taken, for the operation "timing".
    seed
        Fixes the random numbers of the operations that scramble.

    Returns
    -------
    tuple of Loadings
        One motion, or as many as were given.

    Raises
    ------
    BadInput
        If an operation is unknown or cannot be done to these motions.
    """
    rate = float(rate_hz or model.provenance.get("frame_rate_hz") or FRAME_RATE_HZ)
    given = [Motion(f"motion_{place}", one.in_sd(model).values, rate) for place, one in enumerate(motions)]
    if not given:
        raise BadInput("0 motions were given; expected at least 1. Give loadings of a motion.")
    led = None if guide is None else Motion("guide", guide.in_sd(model).values, rate)
    width = given[0].loadings_sd.shape[1]
    done = worked(given, operations_of(list(operations)), model.sd[:width], led, seed)
    return tuple(
        _of_sd(model, one.loadings_sd, [f"frame_{i:04d}" for i in range(len(one.loadings_sd))])
        for one in done
    )


def continuum(
    first: MorphModel | Loadings,
    last: MorphModel | Loadings,
    model: MorphModel | None = None,
    *,
    steps: int = 6,
    spacing: Spacing = "ciede2000",
) -> Faces:
    """Draw the faces on the straight line between two, in steps that are equal in `spacing`.

    Parameters
    ----------
    first, last
        Two models, whose mean faces are the ends; or two faces of one model, as loadings of one row.
    model
        The model of the two faces; None where the ends are models.
    steps
        The number of steps; there is one face more.
    spacing
        "loadings" or "warp" (the linear morph), "ciede2000" or "ssim" (equal for a measure of images).

    Raises
    ------
    BadInput
        If the ends are one face, or cannot be put in correspondence.
    """
    if isinstance(first, MorphModel) and isinstance(last, MorphModel):
        inputs = {"first": first.model_id, "last": last.model_id}
        pair = pair_model([first, last], flow=DEFAULT, inputs=inputs, versions=package_versions()).model
        line = Line(pair, *pair.training.values)
    elif model is not None and isinstance(first, Loadings) and isinstance(last, Loadings):
        ends = [one.in_sd(model).values for one in (first, last)]
        if any(len(one) != 1 for one in ends):
            raise BadInput(
                f"the ends have {len(ends[0])} and {len(ends[1])} rows; expected one face each. Give one row, "
                "such as `loadings[3]`."
            )
        line = Line(model, *(one[0] * model.sd[: one.shape[1]] for one in ends))
    else:
        raise BadInput(
            f"the ends are {type(first).__name__} and {type(last).__name__}; expected two models, or two loadings and "
            "the model they belong to. Give one of these."
        )
    positions = spaced_positions(line, steps, spacing).positions
    return _faces(line.model, continuum_drawings(line, "continuum", positions, spacing))


def plot(what: MorphModel | Loadings, **options: Any) -> Any:
    """Draw a model's components, or loadings over the frames, as a matplotlib figure."""
    return what.plot_components(**options) if isinstance(what, MorphModel) else what.plot(**options)


def _faces(model: MorphModel, drawings: Sequence[Drawing]) -> Faces:
    names = tuple(one.name for one in drawings)
    loadings = _of_sd(model, np.concatenate([one.loadings_sd for one in drawings]), names)
    return Faces(names, loadings, lambda place: next(draw(model, drawings[place])))


def _of_sd(model: MorphModel, values_sd: LoadingTable, names: Sequence[str]) -> Loadings:
    return Loadings(values_sd, tuple(names), model.model_id, "sd")


def _run(steps: Steps[Any], progress: bool) -> Any:
    """Run long work to its end, with a progress bar if one is wanted."""
    if not progress:
        return result_of(steps)
    from tqdm import tqdm

    with tqdm(leave=False) as bar:

        def on_step(step: Step) -> None:
            bar.set_description(step.stage)
            bar.total = step.total
            bar.n = step.done
            bar.refresh()

        return result_of(steps, on_step)
