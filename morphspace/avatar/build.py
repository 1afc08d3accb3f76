"""Build an avatar: blend every expression into a picture, and build a model of the pictures (Nagle section 4).

A blended picture is kept in the work folder under a digest of everything it depends on. It is kept unsharpened, since
the amount of sharpening follows from all pictures.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Image, Mask
from morphspace.avatar.blend import Mixer
from morphspace.avatar.common_grid import version_picture
from morphspace.avatar.notes import notes_on
from morphspace.avatar.settings import FLAT, MOST_SHARPEN, AvatarSettings, Expression
from morphspace.avatar.sharpness import WELL_INSIDE, Curve, curve, mean_curve, sharpened, sharpness
from morphspace.avatar.studio import Studio, studio_of
from morphspace.cache import is_finished, read_result, result_file, write_result
from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame, RegistrationKind
from morphspace.grid.warp import move_points
from morphspace.model.keypoints import affine_between, lip_of, reference_to_mean, required_faceframe
from morphspace.model.model import MorphModel
from morphspace.model.passes import Build, BuildSettings, build_steps
from morphspace.model.work_frames import FLOW_VERSION
from morphspace.steps import Step, Steps, in_order, spread
from morphspace.storage import digest_of_json

BLEND_FORMAT = "morphspace-blend-1"
BLEND_VERSION = 5  # raise it when blends come out otherwise: kept pictures are then made again
PIXEL_AVERAGES = 16  # expressions, evenly spread, of which the pixel average is made for comparison
LEAST_EXPRESSIONS = 3  # expressions; a build needs as many frames
KEPT = 0.77  # of the pictures' sharpness comes back from the finished model; measured on two groups of four people
NEAR = (0.93, 1.10)  # of what is wanted: further off, the model is built once more with another amount
DRAWN = 24  # expressions, evenly spread, of which the finished model's sharpness is the mean
TINY = 1e-9  # squared 8-bit codes; keeps the ratio of two sharpnesses finite
REGISTRATION: RegistrationKind = "similarity"  # of pictures the finished model is given


@dataclass(frozen=True, eq=False)
class BlendedFrames:
    """The blended pictures as a `FrameSource`: kept in `files`, sharpened by `amount` inside `masks`."""

    names: tuple[str, ...]
    files: tuple[Path, ...]
    masks: tuple[Mask, ...]
    amount: float

    @property
    def digests(self) -> tuple[str, ...]:
        """A digest of everything each picture depends on."""
        return tuple(digest_of_json([file.stem, self.amount]) for file in self.files)

    def images(self, indices: list[int]) -> Iterator[Image]:
        """Yield the pictures (h, w, 3) in [0, 1] at these indices."""
        for index in indices:
            plain = np.array(read_result(self.files[index])[0]["image"])
            yield np.clip(sharpened(plain, self.masks[index], self.amount), 0, 1)


@dataclass(frozen=True, eq=False)
class Avatar:
    """A blended identity.

    Attributes
    ----------
    model : MorphModel
    identities : tuple of k str
        Their names, made unique, in the order given.
    weights : array (k,), sum 1
    expressions : sequence of Expression
        One for each training frame of the model.
    reference : int
        The expression on which the model was built.
    reference_identity, surround : int or None
        Places in `identities`; a `surround` of None is flat grey.
    sharpen : float
        The amount of the unsharp mask.
    sharpness : dict
        Of the skin that all identities share: "sources" (k,), "blend" as the model draws it, "pictures" it was built
        from, "unsharpened" pictures, and the "pixel average".
    notes : tuple of str
    build : Build
    """

    model: MorphModel
    identities: tuple[str, ...]
    weights: AnyArray
    expressions: tuple[Expression, ...]
    reference: int
    reference_identity: int
    surround: int | None
    sharpen: float
    sharpness: Mapping[str, Any]
    notes: tuple[str, ...]
    build: Build = field(repr=False)
    studio: Studio = field(repr=False)
    chosen: Sequence[tuple[int, int]] = field(repr=False)
    frames: BlendedFrames = field(repr=False)

    @property
    def judged(self) -> AnyArray:
        """The pixels (h, w), bool, of the mean face that are skin of all identities."""
        return self.studio.mixer(self.studio.reference).judged_picture > WELL_INSIDE

    @property
    def figures(self) -> dict[str, Any]:
        """Return the settings of the blend and its figures, as plain JSON."""
        model, sharpness = self.model, self.sharpness
        left_out = sum((one.weights[self.weights > 0] == 0).any() for one in self.expressions)
        return {
            "model_id": model.model_id,
            "identity": model.identity,
            "identities": list(self.identities),
            "weights": [float(weight) for weight in self.weights],
            "expressions": len(self.expressions),
            "expressions_with_one_left_out": int(left_out),
            "components": model.rank,
            "reference_identity": self.identities[self.reference_identity],
            "surround": FLAT if self.surround is None else self.identities[self.surround],
            "method": model.provenance["blend"]["method"],
            "sharpen": self.sharpen,
            "sharpness": {
                "sources": [float(value) for value in sharpness["sources"]],
                **{name: float(value) for name, value in sharpness.items() if name != "sources"},
            },
            "keypoints": None if model.faceframe is None else model.faceframe.points.tolist(),
        }

    def versions(self, index: int) -> list[Image]:
        """Return the k aligned versions (h, w, 3) of an expression; the mean face of an identity without a part."""
        source, frame = self.chosen[index]
        return self.studio.pictures(source, self.studio.versions(source, frame))

    def blend(self, index: int) -> Image:
        """Return the blended picture (h, w, 3) of an expression, from which the model was built."""
        return next(self.frames.images([index]))

    def pixel_average(self, index: int) -> Image:
        """Return Galton's average of an expression (h, w, 3): the weighted mean of the versions, pixel by pixel."""
        return _pixel_average(self.versions(index), self.weights)


def blend_steps(models: Sequence[MorphModel], settings: AvatarSettings, work_folder: Path) -> Steps[Avatar]:
    """Blend models into an avatar; a generator of steps that returns an `Avatar`.

    The order of the models changes nothing but the order of the results.

    Parameters
    ----------
    models : sequence of at least two MorphModel
        Of one size, with keypoints and components.
    settings : AvatarSettings
    work_folder : Path
        Where finished expressions are kept.

    Raises
    ------
    BadInput
        If the models cannot be blended, or the settings do not fit them.

    References
    ----------
    Nagle et al., section 4, steps 1 to 9.
    """
    studio, chosen = checked(models, settings)
    work_folder.mkdir(parents=True, exist_ok=True)
    files = yield from _blend_pass(studio, chosen, work_folder)
    told = [read_result(file)[1] for file in files]
    expressions = _expressions(studio, chosen, told)
    measured = _sharpness(studio, chosen, told)
    curves = mean_curve([Curve(*one["curve"]) for one in told])
    wanted = float(measured["sources"] @ studio.weights)
    masks = {source: studio.mixer(source).mask_picture for source in {source for source, _ in chosen}}
    names, all_masks = tuple(one.name for one in expressions), tuple(masks[source] for source, _ in chosen)
    amount = _amount(curves, wanted / KEPT) if settings.sharpen is None else settings.sharpen
    frames = BlendedFrames(names, tuple(files), all_masks, amount)
    build = yield from _build(studio, chosen, frames, work_folder, amount)
    drawn = _drawn_sharpness(studio, chosen, build.model)
    again = amount
    if settings.sharpen is None and not NEAR[0] <= drawn / max(wanted, TINY) <= NEAR[1]:
        again = _amount(curves, wanted * curves.at(amount) / max(drawn, TINY))
    if again != amount:
        amount = again
        frames = replace(frames, amount=amount)
        build = yield from _build(studio, chosen, frames, work_folder, amount)
        drawn = _drawn_sharpness(studio, chosen, build.model)
    measured["blend"], measured["pictures"], measured["unsharpened"] = drawn, curves.at(amount), curves.plain
    surround = None if studio.surround is None else studio.part[studio.surround]
    return Avatar(
        model=build.model,
        identities=studio.labels,
        weights=studio.weights,
        expressions=expressions,
        reference=build.choice.index,
        reference_identity=studio.part[studio.reference],
        surround=surround,
        sharpen=amount,
        sharpness=measured,
        notes=(*notes_on(studio, expressions, drawn / wanted if wanted > 0 else 1.0), *build.warnings),
        build=build,
        studio=studio,
        chosen=chosen,
        frames=frames,
    )


def checked(
    models: Sequence[MorphModel], settings: AvatarSettings
) -> tuple[Studio, Sequence[tuple[int, int]]]:
    """Check models and settings, and return the prepared blend and the chosen expressions; costs little.

    Raises `BadInput` as `studio_of` does, and if the chosen expressions are too few for a model.
    """
    studio = studio_of(models, settings)
    chosen = studio.chosen()
    if len(chosen) < LEAST_EXPRESSIONS:
        raise BadInput(
            f"{len(chosen)} expressions are too few for a model: ask for at least {LEAST_EXPRESSIONS}, or give models "
            "of more frames"
        )
    return studio, chosen


def _blend_pass(studio: Studio, chosen: Sequence[tuple[int, int]], work_folder: Path) -> Steps[list[Path]]:
    """Blend each expression, or find it in the work folder; return their files."""
    common = [BLEND_FORMAT, BLEND_VERSION, FLOW_VERSION, cv2.__version__, studio.identity()]
    compared = set(spread(len(chosen), PIXEL_AVERAGES))
    files = [result_file(work_folder, *common, *one, index in compared) for index, one in enumerate(chosen)]
    missing = [index for index, file in enumerate(files) if not is_finished(file)]
    finished = len(files) - len(missing)
    if finished:
        yield Step("blend", finished, len(files))
    for source in sorted({chosen[index][0] for index in missing}):
        mixer, shows = studio.mixer(source), studio.shows(source)
        _ = mixer.mean, mixer.near, mixer.usual, mixer.judged_picture  # before threads share them

        def make(index: int, source: int = source, mixer: Mixer = mixer, shows: Any = shows) -> None:
            versions = studio.cast.versions(source, shows, chosen[index][1])
            image = mixer.mixed(versions)
            grows = curve(image, mixer.judged_picture)
            own = sharpness(mixer.picture(source, versions[source]), mixer.judged_picture)
            document: dict[str, Any] = {
                "used": mixer.used(versions).tolist(),
                "plausibility": [version.plausibility for version in versions],
                "curve": [grows.plain, grows.shared, grows.added],
                "source_sharpness": own,
            }
            if index in compared:
                average = _pixel_average(
                    [mixer.picture(i, version) for i, version in enumerate(versions)], mixer.weights
                )
                document["pixel_average_sharpness"] = sharpness(average, mixer.judged_picture)
            write_result(files[index], {"image": image}, document)

        for _ in in_order(make, [index for index in missing if chosen[index][0] == source]):
            finished += 1
            yield Step("blend", finished, len(files))
    return files


def _pixel_average(pictures: Sequence[Image], weights: AnyArray) -> Image:
    total = np.zeros_like(pictures[0])
    for weight, picture in zip(weights, pictures, strict=True):
        total += np.float32(weight) * picture
    return total


def _expressions(
    studio: Studio, chosen: Sequence[tuple[int, int]], told: Sequence[Mapping[str, Any]]
) -> tuple[Expression, ...]:
    made = []
    for (source, frame), one in zip(chosen, told, strict=True):
        given = studio.part[source]
        name = str(studio.models[given].training.frame_names[frame])
        weights, plausibility = np.zeros(len(studio.models)), np.zeros(len(studio.models))
        weights[list(studio.part)] = one["used"]
        plausibility[list(studio.part)] = one["plausibility"]
        made.append(Expression(given, name, f"{studio.labels[given]}_{name}", weights, plausibility))
    return tuple(made)


def _sharpness(
    studio: Studio, chosen: Sequence[tuple[int, int]], told: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Compute the mean sharpness of each identity's own expressions (k,), and of the pixel averages."""
    measured: dict[str, list[float]] = {}
    for (source, _), one in zip(chosen, told, strict=True):
        measured.setdefault(studio.cast.keys[source], []).append(one["source_sharpness"])
    sources = [
        float(np.mean(measured[key])) if key in measured else _mean_sharpness(studio, model)
        for key, model in zip(studio.keys, studio.models, strict=True)
    ]
    averages = [one["pixel_average_sharpness"] for one in told if "pixel_average_sharpness" in one]
    return {"sources": np.array(sources), "pixel average": float(np.mean(averages))}


def _amount(curves: Curve, wanted: float) -> float:
    return min(curves.amount_for(wanted), MOST_SHARPEN)


def _drawn_sharpness(studio: Studio, chosen: Sequence[tuple[int, int]], model: MorphModel) -> float:
    """Compute the mean sharpness of the training faces as the finished model draws them."""
    some = spread(len(chosen), DRAWN)

    def look(index: int) -> float:
        picture = model.render(model.training.values[index])
        return sharpness(picture, studio.mixer(chosen[index][0]).judged_picture)

    for index in some:
        _ = studio.mixer(chosen[index][0]).judged_picture  # before threads share it
    return float(np.mean(list(in_order(look, some))))


def _mean_sharpness(studio: Studio, model: MorphModel) -> float:
    """Compute the sharpness of the mean face of an identity without a part."""
    onto = affine_between(required_faceframe(model), studio.faceframe(0))
    return sharpness(version_picture(model.mean, onto), studio.mixer(0).judged_picture)


def _build(
    studio: Studio,
    chosen: Sequence[tuple[int, int]],
    frames: BlendedFrames,
    work_folder: Path,
    amount: float,
) -> Steps[Build]:
    """Build the model of the blended pictures, with keypoints (Nagle section 4, step 9).

    The pictures lie on one faceframe already and are not registered again. Pictures that the model reads later may
    lie anywhere.
    """
    settings = studio.settings
    asked = BuildSettings(
        components=settings.components, flow=settings.flow, detector=settings.detector, registration="none"
    )
    if settings.detector is None:
        index = _nearest_to_rest(studio, chosen)
        source = chosen[index][0]
        points = _faceframe_in(studio, source, chosen[index][1])
        asked = replace(
            asked,
            faceframe=FaceFrame.at(points),
            faceframe_index=index,
        )
    build = yield from build_steps(frames, asked, work_folder, _provenance(studio, frames, amount))
    model = replace(build.model, registration=REGISTRATION)
    if model.faceframe is None:
        source, frame = chosen[build.choice.index]
        points = reference_to_mean(model, _faceframe_in(studio, source, frame))
        model = model.with_faceframe(FaceFrame.at(points))
    if not isinstance(model.provenance.get("keypoints"), Mapping) and model.faceframe is not None:
        origin = {"source": "blend", "lip": lip_of(studio.cast.models[0]), "on": "mean"}
        model = model.with_faceframe(model.faceframe, origin)
    return replace(build, model=model)


def _nearest_to_rest(studio: Studio, chosen: Sequence[tuple[int, int]]) -> int:
    """Return the expression whose own loadings are nearest to its model's mean, in SD."""
    far = []
    for source, frame in chosen:
        model = studio.cast.models[source]
        sd = np.where(model.sd > 0, model.sd, np.inf)
        far.append(float(np.mean((model.training.values[frame] / sd) ** 2)))
    return int(np.argmin(far))


def _faceframe_in(studio: Studio, source: int, frame: int) -> AnyArray:
    """Return the faceframe (3, 2) px in a blended picture: that of the alignment, moved by the expression."""
    blend = studio.mixer(source).blended(studio.versions(source, frame))
    return move_points(blend.displacement, required_faceframe(studio.cast.models[studio.reference]).points)


def _provenance(studio: Studio, frames: BlendedFrames, amount: float) -> dict[str, Any]:
    models = [studio.models[given] for given in studio.part]
    labels = [studio.labels[given] for given in studio.part]
    width, height = models[0].size
    settings = studio.settings
    return {
        "identity": "avatar",
        "versions": {},
        **settings.provenance,
        "consent": joint_entry(labels, [model.provenance.get("consent") for model in models]),
        "licence": joint_entry(labels, [model.provenance.get("licence") for model in models]),
        "frame_rate_hz": None,
        "framing": {"source_size": [width, height], "crop": None, "size": [width, height]},
        "inputs": dict(zip(frames.names, frames.digests, strict=True)),
        "blend": {
            "identities": labels,
            "model_ids": [model.model_id for model in models],
            "weights": [float(share) for share in studio.shares],
            "reference": labels[studio.reference],
            "surround": None if studio.surround is None else labels[studio.surround],
            "faceframe": settings.faceframe,
            "method": studio.cast.method,
            "max_sd": studio.cast.max_sd,
            "correspondence": settings.correspondence,
            "expressions": settings.expressions,
            "frames_of": "models" if settings.clips is None else "clips",
            "sharpen": amount,
        },
    }


def joint_entry(labels: Sequence[str], entries: Sequence[Any]) -> Any:
    """Return the entry that all share (None if none has one), or a text with the entry of each label.

    Examples
    --------
    >>> joint_entry(["anna", "ben"], ["CC0", "CC0"]), joint_entry(["anna", "ben"], ["CC0", None])
    ('CC0', 'anna: CC0; ben: not recorded')
    """
    if all(one == entries[0] for one in entries):
        return entries[0]
    return "; ".join(
        f"{label}: {'not recorded' if one is None else one}"
        for label, one in zip(labels, entries, strict=True)
    )
