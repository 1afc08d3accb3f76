"""The face model: mean morph, components, variances (Nagle section 2), and what is needed to use them again.

A model knows the reference and how frames were brought to it, so that a new image of the same person can be encoded,
and it carries where it came from, so that a stimulus can be traced to its input files.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from morphspace.arrays import (
    Affine,
    AnyArray,
    Displacement,
    Image,
    LoadingTable,
    LoadingVector,
    Mask,
    read_only,
)
from morphspace.errors import BadInput, ReferenceMismatch
from morphspace.face.anchor import FaceAnchor, anchor_of_build, was_anchored
from morphspace.face.detector import MissingModels
from morphspace.face.faceframe import FaceFrame, Frame, RegistrationKind, aligned
from morphspace.face.mesh import FacePoints
from morphspace.face.regions import rigid_region
from morphspace.face.registration import Registration
from morphspace.flow import FlowFunction, methods
from morphspace.grid import warp
from morphspace.linear.pca import Basis
from morphspace.model import display
from morphspace.model.file import FORMAT, FORMAT_VERSION, content_digest, read_model_file
from morphspace.model.fit import Fitter
from morphspace.model.landmarks import LandmarkRegression
from morphspace.model.morph import (
    Morph,
    MorphOffset,
    displacement_columns,
    morph_of,
    resource,
    texture_columns,
)
from morphspace.storage import digest_of_array, digest_of_json, write_container

Unit = Literal["raw", "sd"]


@dataclass(frozen=True, eq=False)
class Loadings:
    """Faces as coordinates on the components of a model, one row a frame.

    Parameters
    ----------
    values : (n, k)
        Kept read-only.
    frame_names : tuple of n str
    model_id : str
        The model they belong to.
    unit : {"raw", "sd"}
        Raw loadings are in units of the model's inner product: R = P l holds of them. Tables, sidecars and whatever a
        person reads are in SD of each component over the training faces.

    Raises
    ------
    BadInput
        Where the rows do not fit the names.
    """

    values: LoadingTable
    frame_names: tuple[str, ...]
    model_id: str
    unit: Unit = "raw"

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or len(self.values) != len(self.frame_names):
            raise BadInput(
                f"loadings of shape {self.values.shape} do not fit {len(self.frame_names)} frame names: one row a frame"
            )
        object.__setattr__(self, "values", read_only(self.values))

    def __getitem__(self, rows: int | slice) -> Loadings:
        """Return one face, or a slice of them, as loadings of their own."""
        if isinstance(rows, int):
            place = range(len(self.frame_names))[rows]
            rows = slice(place, place + 1)
        return Loadings(self.values[rows], self.frame_names[rows], self.model_id, self.unit)

    def __len__(self) -> int:
        return len(self.frame_names)

    def __repr__(self) -> str:
        count, components = self.values.shape
        return f"Loadings({count} frames x {components} components, {self.unit}, model {self.model_id})"

    def _repr_html_(self) -> str:
        return display.loadings_card(self)

    def plot(self, components: int = 6) -> Any:
        """Draw the first loadings over the frames; return a matplotlib figure."""
        return display.plot_loadings(self, components)

    def to_pandas(self) -> Any:
        """Return a pandas DataFrame: one row a frame, one column a component (pc001, ...), in this unit."""
        import pandas

        columns = [f"pc{place + 1:03d}" for place in range(self.values.shape[1])]
        return pandas.DataFrame(np.array(self.values), index=list(self.frame_names), columns=columns)

    def in_sd(self, model: MorphModel) -> Loadings:
        """Give the same faces in SD of each component. Raises `ReferenceMismatch` for another model."""
        self._check_model(model)
        return self if self.unit == "sd" else self._as("sd", self.values / self._sd(model))

    def in_raw(self, model: MorphModel) -> Loadings:
        """Give the same faces in raw loadings. Raises `ReferenceMismatch` for another model."""
        self._check_model(model)
        return self if self.unit == "raw" else self._as("raw", self.values * self._sd(model))

    def _sd(self, model: MorphModel) -> AnyArray:
        return model.sd[: self.values.shape[1]]

    def _as(self, unit: Unit, values: LoadingTable) -> Loadings:
        return Loadings(values, self.frame_names, self.model_id, unit)

    def _check_model(self, model: MorphModel) -> None:
        if self.model_id != model.model_id:
            raise ReferenceMismatch(
                f"these loadings belong to model {self.model_id}, this is model {model.model_id}: encode the "
                "images with this model"
            )


@dataclass(frozen=True, eq=False)
class MorphModel:
    """A controllable face.

    `mean` Morph | `basis` on vectors (5 h w,) in the order of `Morph.vector` | `warp_weight` s, colour per px |
    `mask` (h, w) | `reference` (h, w, 3), the image all flow starts from | `mean_inverse` (h, w, 2) px, from the mean
    face to the reference | `faceframe` on the mean face, or None | `training` Loadings | `registration` and `flow`, by
    name, as the build used them | `provenance`, a JSON document: identity, settings, versions, digests, consent |
    `landmarks`, where the face's landmarks lie for given loadings, or None | `reading`, how pictures are read: as the
    build read its frames, or by flow alone (`by_flow_alone`).
    """

    mean: Morph
    basis: Basis
    warp_weight: float
    mask: Mask
    reference: Image
    mean_inverse: Displacement
    faceframe: FaceFrame | None
    reference_faceframe: FaceFrame | None
    training: Loadings
    registration: RegistrationKind
    flow: str
    provenance: Mapping[str, Any]
    landmarks: LandmarkRegression | None = None
    reading: Literal["as built", "flow alone"] = "as built"

    def __post_init__(self) -> None:
        if self.training.unit != "raw":
            raise BadInput(
                "the training loadings of a model are in SD; expected raw ones. Give loadings.in_raw(model)"
            )
        for name in ("mask", "reference", "mean_inverse"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def __repr__(self) -> str:
        width, height = self.size
        return f"MorphModel({self.identity}, {self.rank} components, {width} x {height} px, {self.model_id})"

    def _repr_html_(self) -> str:
        return display.model_card(self)

    def plot_components(self, components: int = 3, amount_sd: float = 2.0) -> Any:
        """Draw the first components from minus to plus `amount_sd`; return a matplotlib figure."""
        return display.plot_components(self, components, amount_sd)

    @property
    def model_id(self) -> str:
        """The digest that names this model's components; tables of loadings refer to it."""
        return self.training.model_id

    @property
    def identity(self) -> str:
        """Who the model shows."""
        return str(self.provenance["identity"])

    @property
    def rank(self) -> int:
        """The number of components."""
        return self.basis.rank

    @property
    def size(self) -> tuple[int, int]:
        """The size (w, h) px of its frames."""
        return self.mask.shape[1], self.mask.shape[0]

    @property
    def sd(self) -> AnyArray:
        """The standard deviation (k,) of the training faces along each component."""
        return np.sqrt(self.basis.variances)

    @property
    def component_textures(self) -> AnyArray:
        """The change of colour (k, h, w, 3) that one unit of each component makes, a view."""
        columns = texture_columns(self.mean.shape)
        return self.basis.components[:, columns].reshape(self.rank, *self.mean.shape, 3)

    @property
    def component_displacements(self) -> AnyArray:
        """The displacement (k, h, w, 2) px that one unit of each component makes, a view."""
        columns = displacement_columns(self.mean.shape)
        return self.basis.components[:, columns].reshape(self.rank, *self.mean.shape, 2)

    @cached_property
    def flow_from_reference(self) -> FlowFunction:
        """The flow by the build's method, its reference prepared on first use and kept: the costly half is shared."""
        find = methods.for_morphs(self.flow)(self.reference)
        if not was_anchored(self.provenance) or self.anchor is None:
            return find
        return self.anchor.anchored(find, *self.mask.shape)

    @cached_property
    def anchor(self) -> FaceAnchor | None:
        """The face in the reference and its detector, where the build used them; None where pictures are read without.

        Raises `MissingModels` where they are needed and the detector's networks are missing.
        """
        if self.reading == "flow alone" or (
            self.registration == "none" and not was_anchored(self.provenance)
        ):
            return None
        try:
            return anchor_of_build(self.reference, self.provenance)
        except MissingModels as error:
            raise MissingModels(
                f"{self.identity} was built with face points and reads pictures with them; {error}"
            ) from error

    def by_flow_alone(self) -> MorphModel:
        """Give the model that reads pictures without face points, which needs no networks.

        Where the build used the points it reads them less exactly: its loadings are not those of the model itself.
        """
        return replace(self, reading="flow alone")

    @cached_property
    def _head(self) -> Registration:
        region = rigid_region(self.size[1], self.size[0], self.reference_faceframe)
        return Registration(self.reference, self.registration, region)

    def align(self, image: Image, name: str = "image", found: FacePoints | None = None) -> Frame:
        """Bring an image (h, w, 3) of the model's size to the reference, as the build did with its frames.

        `found` is what the `anchor`'s detector found in the image, where it has been asked already. Raises
        `MissingModels` where the build used face points and the detector's networks are missing; `by_flow_alone` gives
        a model that needs none.
        """
        self._check_size(image, name)
        anchor = None if self.registration == "none" else self.anchor
        start = None if anchor is None else anchor.movement(image, found)
        return aligned(image, name, self._head.of(image, start))

    def morph_of(self, image: Image, flow: FlowFunction | None = None) -> Morph:
        """Take an aligned image apart on the mean face: flow from the reference, re-sourced, then its texture."""
        self._check_size(image, "image")
        field = (flow or self.flow_from_reference)(image, None).displacement
        return morph_of(image, resource(field, self.mean_inverse), self.mean.reference_id)

    def project(self, morph: Morph) -> LoadingVector:
        """Give the loadings (k,) of a morph: inner products of its offset with the components (Nagle section 3.3)."""
        return self.basis.project((morph - self.mean).vector)

    def encode(self, image: Image, *, name: str = "image") -> Loadings:
        """Give the loadings of an image (h, w, 3) of the model's size: align, project, fit to the picture."""
        return self.encode_aligned(self.align(image, name))

    def encode_aligned(self, frame: Frame) -> Loadings:
        """Give the loadings of a frame that is aligned already."""
        return self.fit(frame, self.morph_of(frame.image))

    def fit(self, frame: Frame, morph: Morph) -> Loadings:
        """Give the loadings of an aligned frame and its morph: the projection, refined by `fit.Fitter`."""
        fitted = self._fitter.fit(frame.image, self.project(morph))
        return Loadings(fitted[None], (frame.name,), self.model_id)

    @cached_property
    def _fitter(self) -> Fitter:
        return Fitter(self.mean, self.basis, self.mask)

    def expand(self, loadings: AnyArray | Loadings) -> Morph:
        """Give the morph of raw loadings (k,), or of the first so many: mean + P l (Nagle section 2, steps 1 and 2).

        Where `Loadings` of one face are given, their unit is heeded. Raises `BadInput` and `ReferenceMismatch`.
        """
        return self.mean + self.offset(loadings)

    def offset(self, loadings: AnyArray | Loadings) -> MorphOffset:
        """Give the difference from the mean of loadings (k,), or of the first so many: P l. Raises `BadInput`."""
        basis, values = self._shown_by(loadings)
        return MorphOffset(basis.expand(values), self.mean.shape, self.mean.reference_id)

    def texture_offset(self, loadings: AnyArray | Loadings) -> Image:
        """Give the texture (h, w, 3) of `offset` alone."""
        basis, values = self._shown_by(loadings)
        return basis.expand(values, texture_columns(self.mean.shape)).reshape(*self.mean.shape, 3)

    def displacement_offset(self, loadings: AnyArray | Loadings) -> Displacement:
        """Give the displacement (h, w, 2) px of `offset` alone."""
        basis, values = self._shown_by(loadings)
        return basis.expand(values, displacement_columns(self.mean.shape)).reshape(*self.mean.shape, 2)

    def _shown_by(self, loadings: AnyArray | Loadings) -> tuple[Basis, LoadingVector]:
        """Give raw loadings (k,) that were checked, and the basis cut to as many components."""
        if isinstance(loadings, Loadings):
            if len(loadings.values) != 1:
                raise BadInput(
                    f"{len(loadings.values)} faces were given; expected one. Draw them one after the other"
                )
            loadings = loadings.in_raw(self).values
        values = np.asarray(loadings, np.float64).reshape(-1)
        if len(values) > self.rank or not np.isfinite(values).all():
            raise BadInput(
                f"{len(values)} loadings do not fit a model of {self.rank} components, or are not finite numbers"
            )
        return (self.basis if len(values) == self.rank else self.basis.truncate(len(values))), values

    def render(self, loadings: AnyArray | Loadings) -> Image:
        """Give the image (h, w, 3) of loadings (k,), or of the first so many; zeros give the mean face."""
        return self.expand(loadings).render()

    def sample(self, rng: np.random.Generator, count: int) -> Loadings:
        """Draw faces from the normal distribution of the training faces: loadings (count, k)."""
        values = rng.standard_normal((count, self.rank)) * self.sd
        return Loadings(values, tuple(f"sample_{i:04d}" for i in range(count)), self.model_id)

    def truncate(self, components: int) -> MorphModel:
        """Give the model of the first `components` only. Its loadings are the first ones of this model."""
        basis = self.basis.truncate(components)
        model_id = digest_of_json([self.model_id, components])[:16]
        training = Loadings(self.training.values[:, :components], self.training.frame_names, model_id)
        landmarks = self.landmarks and self.landmarks.truncate(components, self.training.values)
        return replace(self, basis=basis, training=training, landmarks=landmarks)

    def with_faceframe(self, faceframe: FaceFrame, origin: Mapping[str, Any] | None = None) -> MorphModel:
        """Give the model with this faceframe on its mean face; its loadings and its `model_id` stay.

        `origin` says where the points came from; it is kept in the provenance as `keypoints`, and what was there goes.
        """
        provenance = {key: value for key, value in self.provenance.items() if key != "keypoints"}
        if origin is not None:
            provenance["keypoints"] = dict(origin)
        return replace(self, faceframe=faceframe, provenance=provenance)

    def with_landmarks(self, landmarks: LandmarkRegression | None) -> MorphModel:
        """Give the model with this regression from loadings to landmarks; its loadings and its `model_id` stay."""
        return replace(self, landmarks=landmarks)

    def placed(self, rendered: Image, original: Image, registration: Affine) -> Image:
        """Put a rendered face back into the original image (H, W, 3), inside the mask, softly.

        `registration` maps the rendered image's points to the original's; hair, background and size stay.
        """
        height, width = original.shape[:2]
        back = warp.affine_displacement(warp.inverse_affine(registration), height, width)
        face = warp.sample(rendered, back)
        inside = warp.sample_field(self.mask, back)
        x, y = warp.positions(back)
        w, h = self.size
        inside = np.where((x >= 0) & (x <= w - 1) & (y >= 0) & (y <= h - 1), inside, 0)[..., None]
        out: Image = (original + inside * (face - original)).astype(np.float32)
        return out

    def _check_size(self, image: Image, name: str) -> None:
        if image.shape != self.reference.shape:
            raise BadInput(
                f"{name} is {image.shape[1]}x{image.shape[0]}, the model's frames are {self.size[0]}x{self.size[1]}: "
                "scale or crop it first"
            )
        if image.dtype != np.float32 or not np.isfinite(image).all():
            raise BadInput(
                f"{name} is {image.dtype} or not finite everywhere: give float32 in [0, 1], as `read_image` does"
            )

    def save(self, path: Path | str) -> None:
        """Write the model as a `.morph` file, whole or not at all (data_spec/model-file.md)."""
        arrays, document = self._arrays(), self._document()
        write_container(Path(path), arrays, {**document, "content_sha256": content_digest(arrays, document)})

    def _arrays(self) -> dict[str, AnyArray]:
        return {
            "components": self.basis.components,
            "variances": self.basis.variances,
            "mean_texture": self.mean.texture,
            "mean_displacement": self.mean.displacement,
            "mean_inverse": self.mean_inverse,
            "mask": self.mask,
            "reference": self.reference,
            "training_loadings": self.training.values,
            **self._landmark_arrays(),
        }

    def _landmark_arrays(self) -> dict[str, AnyArray]:
        if self.landmarks is None:
            return {}
        learned = self.landmarks
        arrays = {
            "landmark_mean": learned.mean,
            "landmark_weights": learned.weights,
            "landmark_error": learned.error_px,
        }
        return {name: np.ascontiguousarray(array, np.float64) for name, array in arrays.items()}

    def _document(self) -> dict[str, Any]:
        return {
            "format": FORMAT,
            "version": FORMAT_VERSION,
            "model_id": self.model_id,
            "reference_id": self.mean.reference_id,
            "warp_weight": self.warp_weight,
            "discarded_variance": self.basis.discarded_variance,
            "faceframe": points_document(self.faceframe),
            "reference_faceframe": points_document(self.reference_faceframe),
            "training_frames": list(self.training.frame_names),
            "registration": self.registration,
            "flow": self.flow,
            "provenance": dict(self.provenance),
            **({} if self.landmarks is None else {"landmarks": self.landmarks.document()}),
        }


def points_document(faceframe: FaceFrame | None) -> dict[str, list[float]] | None:
    """Give a faceframe as the three named points that files hold, or None."""
    if faceframe is None:
        return None
    names = ("right_eye", "left_eye", "philtrum")
    return {name: list(map(float, point)) for name, point in zip(names, faceframe.points, strict=True)}


def inner_product(mask: Mask, warp_weight: float) -> AnyArray:
    """Give the weights (5 h w,) of <a, b> = sum mask texture + s^2 sum mask displacement (methods 4)."""
    height, width = mask.shape
    column = mask[..., None]
    texture = np.broadcast_to(column, (height, width, 3))
    displacement = np.broadcast_to(column * np.float32(warp_weight**2), (height, width, 2))
    return MorphOffset.of(texture, displacement, "").vector


def model_digest(basis: Basis, mean: Morph, provenance: Mapping[str, Any]) -> str:
    """Give the name of a model: 16 hexadecimal digits of the SHA-256 of what defines its loadings."""
    parts = [digest_of_array(a) for a in (basis.variances, mean.texture, mean.displacement)]
    parts += [digest_of_array(np.ascontiguousarray(row)) for row in basis.components]
    return digest_of_json([parts, dict(provenance)])[:16]


def load_model(path: Path | str) -> MorphModel:
    """Open a `.morph` file; its arrays stay on the disk and are read when they are used.

    Raises `ModelFileError` where the file is cut short, of a future version, or its parts do not fit each other.
    """
    return _assembled(*read_model_file(Path(path)))


def _assembled(arrays: Mapping[str, AnyArray], document: Mapping[str, Any]) -> MorphModel:
    """Build the model from a checked header; all arrays stay on the disk until they are used."""
    reference_id = str(document["reference_id"])
    warp_weight = float(document["warp_weight"])
    mask = arrays["mask"]
    basis = Basis(
        arrays["components"],
        arrays["variances"],
        inner_product(mask, warp_weight),
        float(document["discarded_variance"]),
    )
    return MorphModel(
        mean=Morph.of(arrays["mean_texture"], arrays["mean_displacement"], reference_id),
        basis=basis,
        warp_weight=warp_weight,
        mask=mask,
        reference=arrays["reference"],
        mean_inverse=arrays["mean_inverse"],
        faceframe=_faceframe(document["faceframe"]),
        reference_faceframe=_faceframe(document["reference_faceframe"]),
        training=Loadings(
            arrays["training_loadings"], tuple(document["training_frames"]), str(document["model_id"])
        ),
        registration=document["registration"],
        flow=str(document["flow"]),
        provenance=dict(document["provenance"]),
        landmarks=_landmarks(arrays, document.get("landmarks")),
    )


def _landmarks(arrays: Mapping[str, AnyArray], entry: Mapping[str, Any] | None) -> LandmarkRegression | None:
    if entry is None:
        return None
    return LandmarkRegression(
        np.array(arrays["landmark_mean"]),
        np.array(arrays["landmark_weights"]),
        np.array(arrays["landmark_error"]),
        faces=int(entry["faces"]),
        ridge=float(entry["ridge"]),
        follows_warp=entry.get("toward") == "warp",
    )


def _faceframe(entry: Mapping[str, Any] | None) -> FaceFrame | None:
    if entry is None:
        return None
    return FaceFrame.at(np.array([entry[name] for name in ("right_eye", "left_eye", "philtrum")]))
