"""Plain functions for a notebook: each takes objects and returns objects, and writes no file (ours).

Verbs write stimuli with sidecars. A result here is a `MorphModel`, `Loadings` or `Faces`, which a notebook draws.
"""

from __future__ import annotations

import functools
import inspect
import numbers
import os
import tempfile
import textwrap
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from morphspace.arrays import Image, LoadingTable, LoadingVector
from morphspace.avatar import blend_steps
from morphspace.avatar.pair import pair_model
from morphspace.avatar.settings import blend_settings
from morphspace.errors import BadInput
from morphspace.face.track import framed_points
from morphspace.flow.methods import DEFAULT
from morphspace.io.clips import open_clip
from morphspace.model.encode import encoded_frames, framed_for, joined
from morphspace.model.from_clip import ClipSettings, build_clip
from morphspace.model.loadings import Loadings
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import versions as package_versions
from morphspace.requests import CLIP_OPTIONS, Workers, clip_options, field_named, settings_in
from morphspace.sets.continuum import GIVEN, continuum_drawings, spaced_series
from morphspace.sets.mimicry import MimicSettings, drive_of
from morphspace.sets.outputs import check_work_folder
from morphspace.settings import WrongSetting, converted, field_of, shown
from morphspace.steps import Step, Steps, in_order, result_of, using_workers
from morphspace.stimuli.caricature import change_of
from morphspace.stimuli.continuum import Line, even_positions, given_positions
from morphspace.stimuli.drawing import Drawing
from morphspace.stimuli.drawn import draw
from morphspace.stimuli.faces import Faces
from morphspace.stimuli.operations import Motion, operations_of, worked
from morphspace.transfer.driver import UsedModel
from morphspace.verbs.blend_avatar import BlendAvatarRequest
from morphspace.verbs.build_model import BuildModelRequest
from morphspace.verbs.caricature import CaricatureRequest
from morphspace.verbs.continuum import ContinuumRequest
from morphspace.verbs.encode import EncodeRequest
from morphspace.verbs.mimic import MimicRequest
from morphspace.verbs.sweep import SweepRequest
from morphspace.verbs.trajectory import TrajectoryRequest

Result = TypeVar("Result")
FRAME_RATE_HZ = 25.0  # of a motion whose model does not state its rate
NOT_WRITTEN = Path("notebook")  # stands for the files that a verb reads or writes, in a request without any


def _with_settings(request: type, *names: str) -> Callable[[Callable[..., Result]], Callable[..., Result]]:
    """Give a function some settings of a verb's request as keywords, with their defaults and their help.

    The function takes them as `**settings`. A line `settings` of its docstring becomes one entry for each.
    """
    fields = [field_named(request, name) for name in names]

    def decorated(function: Callable[..., Result]) -> Callable[..., Result]:
        own = inspect.signature(function)
        *before, last = own.parameters.values()
        keywords = [
            inspect.Parameter(
                one.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty if one.required else one.default,
                annotation=one.kind,
            )
            for one in fields
        ]
        entries = "".join(
            f"    {one.name}\n{textwrap.indent(textwrap.fill(one.help, 108), ' ' * 8)}\n" for one in fields
        )
        documented = (function.__doc__ or "").replace(f"    {last.name}\n", entries)

        @functools.wraps(function)
        def checked(*given: Any, **settings: Any) -> Result:
            for name, value in settings.items():
                if isinstance(value, np.ndarray) and value.ndim == 1:
                    settings[name] = value.tolist()
                if name == "identity" and isinstance(value, numbers.Real):
                    raise WrongSetting(name, f"is {value}; expected a text")
                if name not in names and name not in own.parameters:
                    raise BadInput(
                        f"{name} is no setting of {function.__name__}; expected one of {', '.join(names)}"
                    )
            return function(*given, **settings)

        checked.__doc__ = documented
        checked.__signature__ = own.replace(parameters=[*before, *keywords])  # type: ignore[attr-defined]
        return checked

    return decorated


@_with_settings(
    BuildModelRequest,
    *("components", "size", "crop", "landmarks", "mask", "reference", "registration"),
    *("flow", "start", "warp_weight", "work_folder", "identity", *CLIP_OPTIONS),
)
def build(
    *sources: str | Path | Sequence[str | Path],
    workers: int | Executor | None = None,
    progress: bool = False,
    **settings: Any,
) -> MorphModel:
    """Build a model of one person from a folder, a quoted glob, a video, or image files (Nagle section 2).

    Parameters
    ----------
    sources
        What shows the person; a list stands for its members.
    workers
        How many frames to process in parallel, or the executor that does; None for one per core.
    progress
        Draw a progress bar.
    settings

    Returns
    -------
    MorphModel

    Raises
    ------
    BadInput
        If the clip cannot be read, has fewer than three frames, or a setting cannot be used.

    References
    ----------
    Nagle et al., section 2.

    Examples
    --------
    >>> import morphspace as ms
    >>> ms.build("anna", landmarks="none", components=3, identity="Anna")
    MorphModel(Anna, 3 components, 60 x 72 px, ...)
    """
    request = BuildModelRequest(sources=_sources(sources), **settings)
    clip, asked = open_clip(request.sources, clip_options(request)), settings_in(request, ClipSettings)
    with _work_folder(request.work_folder) as folder:
        return _run(build_clip(clip, asked, Path(folder)), progress, workers)[0].model


def load(path: Path | str) -> MorphModel:
    """Open a `.morph` file; its arrays are read from the disk when they are used.

    Raises
    ------
    BadInput
        If there is no such file.
    ModelFileError
        If the file is cut short, of another version, or its parts do not fit each other.

    References
    ----------
    The format is ours: `data_spec/model-file.md`.

    Examples
    --------
    >>> import morphspace as ms
    >>> anna = ms.load("anna.morph")
    >>> anna.identity, anna.size
    ('anna', (60, 72))
    """
    return load_model(converted(field_named(EncodeRequest, "model"), path))


@_with_settings(EncodeRequest, "crop", "landmarks", *CLIP_OPTIONS)
def encode(
    model: MorphModel,
    *sources: str | Path | Sequence[str | Path],
    workers: int | Executor | None = None,
    progress: bool = False,
    **settings: Any,
) -> Loadings:
    """Encode images of the model's person as loadings, one row a frame (Nagle section 3, step 1).

    Parameters
    ----------
    model
    sources
        A folder, a quoted glob, a video, or image files; a list stands for its members.
    workers
        How many frames to process in parallel, or the executor that does; None for one per core.
    progress
        Draw a progress bar.
    settings

    Raises
    ------
    BadInput
        If the images cannot be read or are too small to read a face from.

    References
    ----------
    Nagle et al., section 3, step 1.

    Examples
    --------
    >>> import morphspace as ms
    >>> faces = ms.encode(ms.load("anna.morph"), "anna")
    >>> faces.frame_names[:2]
    ('frame_000', 'frame_001')
    """
    _check_models(model=model)
    request = EncodeRequest(model=NOT_WRITTEN, sources=_sources(sources), output=NOT_WRITTEN, **settings)
    source = framed_for(model, request.sources, request.crop, clip_options(request))

    def steps() -> Steps[Loadings]:
        parts = []
        for encoded in encoded_frames(model, source, given=framed_points(request.landmarks, source)):
            parts.append(encoded.loadings)
            yield Step("encode", len(parts), len(source.names))
        return joined(model, parts)

    return _run(steps(), progress, workers)


@_with_settings(MimicRequest, "method", "gain", "max_sd", "components", "neutral")
def mimic(
    source: MorphModel,
    target: MorphModel,
    faces: Loadings | None = None,
    *,
    workers: int | Executor | None = None,
    progress: bool = False,
    **settings: Any,
) -> Faces:
    """Make one person's model show the expressions of another's (Nagle section 3).

    Parameters
    ----------
    source, target
        The model that drives and the model that is driven; both need keypoints.
    faces
        Loadings on the source; None for the faces it was built from.
    workers
        How many faces to make in parallel, or the executor that does; None for one per core.
    progress
        Draw a progress bar.
    settings

    Returns
    -------
    Faces
        The target's faces, one for each row. They are drawn at once and stay in memory.

    Raises
    ------
    BadInput
        If a model has no keypoints, or a setting cannot be used.
    ReferenceMismatch
        If the loadings belong to another model than the source.

    References
    ----------
    Nagle et al., section 3.

    Examples
    --------
    >>> import morphspace as ms
    >>> anna, ben = ms.load("anna.morph"), ms.load("ben.morph")
    >>> faces = ms.mimic(anna, ben, anna.training[:2], method="paper")
    >>> faces[0].shape
    (72, 60, 3)
    """
    _check_models(source=source, target=target)
    rows = source.training if faces is None else faces
    _check_loadings(faces=rows)
    request = MimicRequest(source=source.identity, target=target.identity, output=NOT_WRITTEN, **settings)
    rows = rows.in_raw(source)
    used = [UsedModel(one, Path(f"{one.identity}.morph"), one.model_id) for one in (source, target)]
    drive = drive_of(used[0], used[1], settings_in(request, MimicSettings))

    def made(row: LoadingVector) -> tuple[LoadingVector, Image]:
        padded = np.zeros(source.rank)
        padded[: len(row)] = row
        face = drive.make(source.offset(padded), padded)
        return face.loadings, face.morph.render()

    def steps() -> Steps[list[tuple[LoadingVector, Image]]]:
        made(np.zeros(0))  # caches are filled here once, not in each thread
        found = []
        for one in in_order(made, rows.values):
            found.append(one)
            yield Step("mimic", len(found), len(rows))
        return found

    found = _run(steps(), progress, workers)
    values = np.array([loadings for loadings, _ in found]).reshape(len(rows), drive.target.rank)
    loadings = Loadings(values, rows.frame_names, target.model_id)
    return Faces(rows.frame_names, loadings, lambda place: found[place][1])


@_with_settings(
    BlendAvatarRequest,
    *("weights", "faceframe", "reference", "expressions", "method", "max_sd", "sharpen", "surround"),
    *("correspondence", "flow", "components", "clips", "landmarks", "identity", "work_folder", *CLIP_OPTIONS),
)
def blend(
    *models: MorphModel, workers: int | Executor | None = None, progress: bool = False, **settings: Any
) -> MorphModel:
    """Blend several people into one model that shows nobody (Nagle section 4). Notes of the blend are warnings.

    Parameters
    ----------
    models
        At least two, of one size, with keypoints.
    workers
        How many faces to blend in parallel, or the executor that does; None for one per core.
    progress
        Draw a progress bar.
    settings

    Raises
    ------
    BadInput
        If the models cannot be blended, or a setting does not fit them.

    References
    ----------
    Nagle et al., section 4.

    Examples
    --------
    >>> import morphspace as ms
    >>> anna, ben = ms.load("anna.morph"), ms.load("ben.morph")
    >>> ms.blend(anna, ben, correspondence="rest", landmarks="none").identity
    'avatar'
    """
    _check_models(**{f"model {place}": model for place, model in enumerate(models, 1)})
    names = tuple(model.identity for model in models)
    request = BlendAvatarRequest(models=names, output=NOT_WRITTEN, **settings)
    asked, notes = blend_settings(request, models)
    with _work_folder(request.work_folder) as folder:
        avatar = _run(blend_steps(models, asked, Path(folder)), progress, workers)
    for note in (*notes, *avatar.notes):
        warnings.warn(note, stacklevel=3)
    return avatar.model


@_with_settings(CaricatureRequest, "gains", "warp_gains", "texture_gains", "components", "region")
def caricature(model: MorphModel, faces: Loadings, **settings: Any) -> Faces:
    """Draw faces at each gain: 1 is veridical, above 1 a caricature, below 0 an anti-face (Nagle section 5).

    Parameters
    ----------
    model
    faces
        Loadings on the model.
    settings

    Raises
    ------
    BadInput
        If a gain is not finite, or components or region are not the model's.
    ReferenceMismatch
        If the loadings belong to another model.

    References
    ----------
    Nagle et al., section 5.

    Examples
    --------
    >>> import morphspace as ms
    >>> anna = ms.load("anna.morph")
    >>> ms.caricature(anna, anna.training[0], gains=(0.5, 1.5)).names
    ('frame_000_g0.5', 'frame_000_g1.5')
    """
    _check_models(model=model)
    _check_loadings(faces=faces)
    request = CaricatureRequest(model=NOT_WRITTEN, output=NOT_WRITTEN, **settings)
    change, _ = change_of(request, model)
    rows = faces.in_sd(model).values
    drawings = [
        drawing
        for name, row in zip(faces.frame_names, rows, strict=True)
        for drawing in change(name, row[None])
    ]
    return _faces("caricature", model, drawings)


@_with_settings(TrajectoryRequest, "operations", "frame_rate_hz", "seed")
def trajectory(
    model: MorphModel, *motions: Loadings, guide: Loadings | None = None, **settings: Any
) -> tuple[Loadings, ...]:
    """Change recorded motion: smooth, retime, loop, splice, average, caricature or scramble it.

    Parameters
    ----------
    model
    motions
        Loadings on the model, one row a frame.
    guide
        The motion whose timing is taken, for the operation "timing", or with which one motion is compared, for
        "caricature". Operations are the words of `morphspace trajectory --op`, such as "smooth=6" or "loop".
    settings

    Returns
    -------
    tuple of Loadings
        One motion, or as many as were given.

    Raises
    ------
    BadInput
        If an operation is unknown or cannot be done to these motions.

    References
    ----------
    Ours; methods of others are named at the operations in `morphspace.stimuli.trajectory`.

    Examples
    --------
    >>> import morphspace as ms
    >>> anna = ms.load("anna.morph")
    >>> (slow,) = ms.trajectory(anna, anna.training, operations=["smooth=6", "speed=0.5"])
    >>> len(anna.training), len(slow)
    (12, 23)
    """
    _check_models(model=model)
    _check_loadings(**{f"motion {place}": one for place, one in enumerate(motions, 1)})
    if guide is not None:
        _check_loadings(guide=guide)
    request = TrajectoryRequest(model=NOT_WRITTEN, tables=(NOT_WRITTEN,), output=NOT_WRITTEN, **settings)
    rate = float(request.frame_rate_hz or model.provenance.get("frame_rate_hz") or FRAME_RATE_HZ)
    given = [Motion(f"motion_{place}", one.in_sd(model).values, rate) for place, one in enumerate(motions)]
    if not given:
        raise BadInput("0 motions were given; expected at least 1. Give loadings of a motion")
    led = None if guide is None else Motion("guide", guide.in_sd(model).values, rate)
    width = given[0].loadings_sd.shape[1]
    done = worked(given, operations_of(request.operations), model.sd[:width], led, request.seed)
    return tuple(
        _of_sd(model, one.loadings_sd, [f"frame_{i:04d}" for i in range(len(one.loadings_sd))])
        for one in done
    )


@_with_settings(ContinuumRequest, "steps", "spacing", "positions")
def continuum(
    first: MorphModel | Loadings,
    last: MorphModel | Loadings,
    model: MorphModel | None = None,
    **settings: Any,
) -> Faces:
    """Draw the faces on the straight line between two, in steps that are equal in `spacing`.

    Parameters
    ----------
    first, last
        Two models, whose mean faces are the ends; or two faces of one model, as loadings of one row.
    model
        The model of the two faces; None where the ends are models.
    settings

    Raises
    ------
    BadInput
        If the ends are one face, or cannot be put in correspondence.

    References
    ----------
    Ours.

    Examples
    --------
    >>> import morphspace as ms
    >>> anna = ms.load("anna.morph")
    >>> len(ms.continuum(anna.training[0], anna.training[1], anna, steps=4, spacing="loadings"))
    5
    """
    request = ContinuumRequest(first="first", last="last", output=NOT_WRITTEN, **settings)
    positions = (
        even_positions(request.steps) if request.positions is None else given_positions(request.positions)
    )
    line = _line(first, last, model)
    spacing = request.spacing if request.positions is None else None
    series = result_of(spaced_series(line, positions, spacing, linear=False))
    drawings = continuum_drawings(line, "continuum", series["continuum"], spacing or GIVEN)
    return _faces("continuum", line.model, drawings)


def _line(first: MorphModel | Loadings, last: MorphModel | Loadings, model: MorphModel | None) -> Line:
    if isinstance(first, MorphModel) and isinstance(last, MorphModel):
        inputs = {"first": first.model_id, "last": last.model_id}
        pair = pair_model([first, last], flow=DEFAULT, inputs=inputs, versions=package_versions()).model
        return Line(pair, *pair.training.values)
    if model is None or not (isinstance(first, Loadings) and isinstance(last, Loadings)):
        raise BadInput(
            f"the ends are {type(first).__name__} and {type(last).__name__}; expected two models, or two loadings and "
            "the model they belong to. Give one of these"
        )
    _check_models(model=model)
    ends = [one.in_sd(model).values for one in (first, last)]
    if any(len(one) != 1 for one in ends):
        raise BadInput(
            f"the ends have {len(ends[0])} and {len(ends[1])} rows; expected one face each. Give one row, such as "
            "`loadings[3]`"
        )
    return Line(model, *(one[0] * model.sd[: one.shape[1]] for one in ends))


def plot(what: MorphModel | Loadings, components: int | None = None) -> Any:
    """Draw a model's first components, or loadings over the frames, as a matplotlib figure.

    Raises `BadInput` if it is neither, or the number of components is not one from 1 up.

    Examples
    --------
    >>> import morphspace as ms
    >>> figure = ms.plot(ms.load("anna.morph"), components=2)
    >>> len(figure.axes)
    10
    """
    if not isinstance(what, MorphModel | Loadings):
        raise BadInput(
            f"a plot of {shown(what)} was asked for; expected a model or loadings. Give one of these"
        )
    draw_components = what.plot_components if isinstance(what, MorphModel) else what.plot
    if components is None:
        return draw_components()
    return draw_components(converted(field_named(SweepRequest, "components"), components))


def _faces(what: str, model: MorphModel, drawings: Sequence[Drawing]) -> Faces:
    if not drawings:
        raise BadInput(f"{what} has nothing to draw. Give at least one frame, step or gain")
    names = tuple(one.name for one in drawings)
    loadings = _of_sd(model, np.concatenate([one.loadings_sd for one in drawings]), names)
    return Faces(names, loadings, lambda place: next(draw(model, drawings[place])))


def _of_sd(model: MorphModel, values_sd: LoadingTable, names: Sequence[str]) -> Loadings:
    return Loadings(values_sd, tuple(names), model.model_id, "sd")


def _sources(given: Sequence[Any]) -> tuple[str, ...]:
    """Return what shows a person as texts; one list stands for its members."""
    sources = given[0] if len(given) == 1 and isinstance(given[0], list | tuple) else given
    for one in sources:
        if not isinstance(one, str | os.PathLike) or not str(one).strip():
            raise BadInput(
                f"a source is {shown(one)}; expected a folder, a quoted glob, a video or image files. Give its name"
            )
    return tuple(map(str, sources))


def _check_models(**models: Any) -> None:
    for name, given in models.items():
        if not isinstance(given, MorphModel):
            raise BadInput(
                f"{name} is {shown(given)}; expected a model. Open one with `load`, or make one with `build`"
            )


def _check_loadings(**loadings: Any) -> None:
    for name, given in loadings.items():
        if not isinstance(given, Loadings):
            raise BadInput(
                f"{name} is {shown(given)}; expected loadings. Make them with `encode`, or use `model.training`"
            )


def _work_folder(asked: Path | None) -> AbstractContextManager[Path | str]:
    check_work_folder(asked)
    return tempfile.TemporaryDirectory(prefix="morphspace-") if asked is None else nullcontext(asked)


def _run(steps: Steps[Any], progress: bool, workers: int | Executor | None) -> Any:
    """Run long work to its end with these workers, and with a progress bar if one is wanted."""
    if not isinstance(workers, Executor):
        workers = converted(field_of("workers", Workers), workers)
    with using_workers(workers):
        return _with_bar(steps) if progress else result_of(steps)


def _with_bar(steps: Steps[Any]) -> Any:
    from tqdm import tqdm

    with tqdm(leave=False) as bar:

        def on_step(step: Step) -> None:
            bar.set_description(step.stage)
            bar.total = step.total
            bar.n = step.done
            bar.refresh()

        return result_of(steps, on_step)
