"""The face model: mean morph, principal components and their variances (Nagle et al., section 2).

A model also holds its reference, registration and flow method, so that a new picture of the same person is encoded as
the training frames were. Its provenance names the input files, so that each stimulus can be traced to them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
    LoadingVector,
    Mask,
    read_only,
)
from morphspace.errors import BadInput, UnwritableFile
from morphspace.face.anchor import FaceAnchor, anchor_of_build, points_of, rigid_movement, was_held
from morphspace.face.detector import MissingModels, Person
from morphspace.face.faceframe import FaceFrame, Frame, RegistrationKind, aligned
from morphspace.face.mesh import SCHEME, FacePoints
from morphspace.face.regions import rigid_region
from morphspace.face.registration import Registration
from morphspace.flow import Flow, methods
from morphspace.grid import warp
from morphspace.linear.pca import Basis
from morphspace.model import display
from morphspace.model.file import (
    FaceframePoints,
    LandmarksEntry,
    ModelDocument,
    content_digest,
    read_model_file,
)
from morphspace.model.fit import Fitter
from morphspace.model.landmarks import LandmarkRegression
from morphspace.model.loadings import Loadings
from morphspace.model.morph import (
    Morph,
    MorphOffset,
    displacement_columns,
    inner_product,
    morph_of,
    resource,
    texture_columns,
)
from morphspace.model.revealed import Revealed, learn_revealed
from morphspace.settings import shown
from morphspace.storage import digest_of_array, digest_of_json, is_container_or_nothing, write_container


@dataclass(frozen=True, eq=False)
class MorphModel:
    """A person's face space: each face is the mean plus a weighted sum of components (Nagle et al., section 2).

    Attributes
    ----------
    mean : Morph
    basis : Basis
        Components on vectors (5 h w,) in the order of `Morph.vector`, with variances and inner product.
    warp_weight : float
        s, colour per px: the weight of a displacement against a change of colour in the inner product.
    mask : array (h, w), in [0, 1]
        The face on the mean face's grid.
    reference : array (h, w, 3), in [0, 1]
        The frame from which all flow is measured.
    mean_inverse : array (h, w, 2) px
        Displacement from the mean face to the reference.
    faceframe : FaceFrame or None
        Both eyes and the lip point, px on the mean face.
    reference_faceframe : FaceFrame or None
        The same on the reference; it places the rigid part that registration fits.
    training : Loadings
        Raw loadings of the training frames.
    registration : str
        Kind of head registration in the build.
    flow : str
        Flow method of the build.
    provenance : mapping
        JSON document: identity, consent, settings, versions and digests of the inputs.
    landmarks : LandmarkRegression or None
        Landmark positions as a linear function of the loadings.
    reading : {"as built", "flow alone"}
        How pictures are aligned and encoded: with the face points that the build used, or without any
        (`by_flow_alone`).
    person : {"largest", "left", "right"}, (x, y) px, or None
        Which face of a picture is read if it shows several (`for_person`); None for the choice of the build.

    Raises
    ------
    BadInput
        If the training loadings are in SD.

    References
    ----------
    Nagle, Griffin, Johnston and McOwan, Techniques for mimicry and identity blending using morph space PCA, section
    2.
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
    person: Person | None = None

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
        """Draw the first components from minus to plus `amount_sd` SD; return a matplotlib figure."""
        return display.plot_components(self, components, amount_sd)

    @property
    def model_id(self) -> str:
        """The 16 hexadecimal digits that identify this model's components; tables of loadings refer to them."""
        return self.training.model_id

    @property
    def identity(self) -> str:
        """The name of the person."""
        return str(self.provenance["identity"])

    @property
    def training_times_s(self) -> tuple[float, ...] | None:
        """The time of each training frame from the first, s, if the model was built from a video that has them."""
        times_s = self.provenance.get("times_s")
        return tuple(times_s) if times_s and len(times_s) == len(self.training.values) else None

    @property
    def rank(self) -> int:
        """The number of components k."""
        return self.basis.rank

    @property
    def size(self) -> tuple[int, int]:
        """The size (w, h) px of the model's frames."""
        return self.mask.shape[1], self.mask.shape[0]

    @property
    def sd(self) -> AnyArray:
        """The standard deviation (k,) of the training faces along each component."""
        return np.sqrt(self.basis.variances)

    @property
    def component_textures(self) -> AnyArray:
        """The change of colour (k, h, w, 3) for one unit of each component, a view."""
        columns = texture_columns(self.mean.shape)
        return self.basis.components[:, columns].reshape(self.rank, *self.mean.shape, 3)

    @property
    def component_displacements(self) -> AnyArray:
        """The displacement (k, h, w, 2) px for one unit of each component, a view."""
        columns = displacement_columns(self.mean.shape)
        return self.basis.components[:, columns].reshape(self.rank, *self.mean.shape, 2)

    @cached_property
    def flow_from_reference(self) -> Callable[[Frame], Flow]:
        """The flow to an aligned frame as in the build, with the reference prepared once, on first use."""
        find = methods.for_morphs(self.flow)(self.reference)
        if not was_held(self.provenance) or self.anchor is None:
            return lambda frame: find(frame.image, None)
        return self.anchor.held(find, *self.mask.shape)

    @cached_property
    def anchor(self) -> FaceAnchor | None:
        """The face points of the reference and their detector; None if pictures are read without face points.

        Raises
        ------
        MissingModels
            If the build used face points and the detector's networks are not installed.
        """
        if self.reading == "flow alone" or (self.registration == "none" and not was_held(self.provenance)):
            return None
        try:
            return anchor_of_build(self.reference, self.provenance, self.person)
        except MissingModels as error:
            raise MissingModels(
                f"{self.identity} was built with face points and reads pictures with them; {error}"
            ) from error

    def by_flow_alone(self) -> MorphModel:
        """Return a model that reads pictures without face points and needs no networks.

        If the build used face points, the loadings of a picture differ from those that this model gives, and are less
        exact.
        """
        return replace(self, reading="flow alone")

    def for_person(self, person: Person | None) -> MorphModel:
        """Return a model that reads this face of several, None as the build did; `BadInput` without face points."""
        chosen = self if person is None else replace(self, person=person)
        if person is not None and chosen.anchor is None:
            raise BadInput(
                f"--person selects a face, but {self.identity} was built without face points. Crop the frames to the "
                "face, or build the model again after `morphspace models fetch`"
            )
        return chosen

    @cached_property
    def _head(self) -> Registration:
        region = rigid_region(self.size[1], self.size[0], self.reference_faceframe)
        return Registration(self.reference, self.registration, region)

    def align(self, image: Image, name: str = "image", found: FacePoints | None = None) -> Frame:
        """Register a picture to the reference, as the build registered its frames.

        Parameters
        ----------
        image : array (h, w, 3) float32, in [0, 1]
            A picture of the model's size.
        name : str
            Names the frame in messages.
        found : FacePoints, optional
            The face in the picture if the `anchor`'s detector has found it already.

        Returns
        -------
        Frame
            The aligned picture, and the similarity or affine that aligned it.

        Raises
        ------
        BadInput
            If the picture has another size or type, or is not finite.
        MissingModels
            If the build used face points and the networks are not installed; `by_flow_alone` needs none.
        """
        self._check_size(image, name)
        if self.anchor is None:
            return aligned(image, name, self._head.of(image))
        found = found or self.anchor.detector(image)
        start = None if found is None else rigid_movement(self.anchor.face, found)
        return aligned(image, name, self._head.of(image, start), points_of(found))

    def morph_of(self, frame: Frame) -> Morph:
        """Vectorise an aligned frame: flow from the reference, carried to the mean face, then the texture.

        References
        ----------
        Nagle et al., section 2.
        """
        self._check_size(frame.image, frame.name)
        field = self.flow_from_reference(frame).displacement
        return morph_of(frame.image, resource(field, self.mean_inverse), self.mean.reference_id)

    def project(self, morph: Morph) -> LoadingVector:
        """Project a morph: inner products of its offset from the mean with the components, raw loadings (k,).

        References
        ----------
        Nagle et al., section 2: L = (M - mean) x P.
        """
        return self.basis.project((morph - self.mean).vector)

    def encode(self, image: Image, *, name: str = "image") -> Loadings:
        """Encode a picture: align it, project its morph, and refine the loadings on the picture.

        Parameters
        ----------
        image : array (h, w, 3) float32, in [0, 1]
            A picture of the model's size.
        name : str
            The frame's name in the result.

        Returns
        -------
        Loadings
            One row of raw loadings.

        Raises
        ------
        BadInput
            If the picture has another size or type, or is not finite.
        MissingModels
            As `align`.
        """
        return self.encode_aligned(self.align(image, name))

    def encode_aligned(self, frame: Frame) -> Loadings:
        """Encode a frame that is aligned already: one row of raw loadings."""
        return self.fit(frame, self.project(self.morph_of(frame)))

    def fit(self, frame: Frame, start: LoadingVector) -> Loadings:
        """Refine raw loadings (k,) on an aligned frame with `fit.Fitter`: one row of raw loadings."""
        fitted = self._fitter.fit(frame.image, start)
        return Loadings(fitted[None], (frame.name,), self.model_id)

    @cached_property
    def _fitter(self) -> Fitter:
        return Fitter(self.mean, self.basis, self.mask)

    def expand(self, loadings: AnyArray | Loadings) -> Morph:
        """Compute the morph of one face: mean + P L (Nagle et al., section 2).

        Parameters
        ----------
        loadings : array (j,) or Loadings of one face
            Raw loadings of the first j <= k components, or `Loadings` in either unit.

        Raises
        ------
        BadInput
            If the loadings are more than k, not finite, or those of several faces.
        ReferenceMismatch
            If `Loadings` belong to another model.
        """
        return self.mean + self.offset(loadings)

    def offset(self, loadings: AnyArray | Loadings) -> MorphOffset:
        """Compute the offset of one face from the mean, P L; loadings as in `expand`."""
        basis, values = self._checked_loadings(loadings)
        return MorphOffset(basis.expand(values), self.mean.shape, self.mean.reference_id)

    def texture_offset(self, loadings: AnyArray | Loadings) -> Image:
        """Compute the texture (h, w, 3) of `offset` alone."""
        basis, values = self._checked_loadings(loadings)
        return basis.expand(values, texture_columns(self.mean.shape)).reshape(*self.mean.shape, 3)

    def displacement_offset(self, loadings: AnyArray | Loadings) -> Displacement:
        """Compute the displacement (h, w, 2) px of `offset` alone."""
        basis, values = self._checked_loadings(loadings)
        return basis.expand(values, displacement_columns(self.mean.shape)).reshape(*self.mean.shape, 2)

    def _checked_loadings(self, loadings: AnyArray | Loadings) -> tuple[Basis, LoadingVector]:
        """Check the loadings of one face; return the basis cut to their number, and raw values (j,)."""
        if isinstance(loadings, Loadings):
            if len(loadings.values) != 1:
                raise BadInput(
                    f"loadings of {len(loadings.values)} faces were given; expected one face. Draw "
                    "them one after the other"
                )
            loadings = loadings.in_raw(self).values
        try:
            values = np.asarray(loadings, np.float64).reshape(-1)
        except (TypeError, ValueError) as error:
            raise BadInput(
                f"the loadings are {shown(loadings)}; expected numbers, one for each component"
            ) from error
        if len(values) > self.rank or not np.isfinite(values).all():
            raise BadInput(
                f"{len(values)} loadings were given; expected at most {self.rank}, the model's components, all finite"
            )
        return (self.basis if len(values) == self.rank else self.basis.truncate(len(values))), values

    @cached_property
    def revealed(self) -> Revealed:
        """How the colours of mouth and eyes follow a warp that the texture does not share."""
        found = self.provenance.get("keypoints") or {}
        points = np.array(found["points"]) if found.get("points") and found.get("scheme") == SCHEME else None
        return learn_revealed(self.expand, self.training.values, points)

    def render(self, loadings: AnyArray | Loadings) -> Image:
        """Draw the face of raw loadings (j,), or of `Loadings` of one face, as a picture (h, w, 3).

        Fewer than k loadings use the first components; zeros draw the mean face. Raises as `expand`.
        """
        return self.expand(loadings).render()

    def sample(self, rng: np.random.Generator, count: int) -> Loadings:
        """Draw `count` faces from the normal distribution of the training faces: raw loadings (count, k)."""
        values = rng.standard_normal((count, self.rank)) * self.sd
        return Loadings(values, tuple(f"sample_{i:04d}" for i in range(count)), self.model_id)

    def truncate(self, components: int) -> MorphModel:
        """Return the model of the first `components`; its loadings are the first columns of this model's."""
        basis = self.basis.truncate(components)
        model_id = digest_of_json([self.model_id, components])[:16]
        training = Loadings(self.training.values[:, :components], self.training.frame_names, model_id)
        landmarks = self.landmarks and self.landmarks.truncate(components, self.training.values)
        return replace(self, basis=basis, training=training, landmarks=landmarks)

    def with_faceframe(self, faceframe: FaceFrame, origin: Mapping[str, Any] | None = None) -> MorphModel:
        """Return the model with this faceframe on its mean face; loadings and `model_id` do not change.

        `origin` replaces the entry `keypoints` of the provenance; None removes it.
        """
        provenance = {key: value for key, value in self.provenance.items() if key != "keypoints"}
        if origin is not None:
            provenance["keypoints"] = dict(origin)
        return replace(self, faceframe=faceframe, provenance=provenance)

    def with_landmarks(self, landmarks: LandmarkRegression | None) -> MorphModel:
        """Return the model with this landmark regression; loadings and `model_id` do not change."""
        return replace(self, landmarks=landmarks)

    def placed(self, rendered: Image, original: Image, registration: Affine) -> Image:
        """Blend a rendered face into the original picture, weighted by the mask.

        Parameters
        ----------
        rendered : array (h, w, 3)
            A picture of the model.
        original : array (H, W, 3)
            The picture that supplies hair, background and size.
        registration : array (2, 3)
            Affine from the rendered picture's points to the original's.

        Returns
        -------
        array (H, W, 3) float32
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
        """Check that an image has the model's size, is float32 and finite."""

        if image.shape != self.reference.shape:
            raise BadInput(
                f"{name} is {image.shape[1]}x{image.shape[0]} px; expected {self.size[0]}x{self.size[1]}, the model's "
                "frame size. Scale or crop it"
            )
        if image.dtype != np.float32 or not np.isfinite(image).all():
            raise BadInput(
                f"{name} is {image.dtype} or not finite; expected finite float32 in [0, 1], as `read_image` returns"
            )

    def save(self, path: Path | str) -> None:
        """Write the model as a `.morph` file, completely or not at all (data_spec/model-file.md).

        Raises `UnwritableFile`, also if a file that is no model would be replaced.
        """
        if not is_container_or_nothing(Path(path)):
            raise UnwritableFile(
                f"{path} is no file of morphspace and would be replaced. Choose another name, or move it away"
            )
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
            "format": "morphspace-model",
            "version": 1,
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
    """Return a faceframe as the three named points of a file, or None."""
    if faceframe is None:
        return None
    names = ("right_eye", "left_eye", "philtrum")
    return {name: list(map(float, point)) for name, point in zip(names, faceframe.points, strict=True)}


def model_digest(basis: Basis, mean: Morph, provenance: Mapping[str, Any]) -> str:
    """Compute a model's name: 16 hexadecimal digits of the SHA-256 of all that defines its loadings."""
    parts = [digest_of_array(a) for a in (basis.variances, mean.texture, mean.displacement)]
    parts += [digest_of_array(np.ascontiguousarray(row)) for row in basis.components]
    return digest_of_json([parts, dict(provenance)])[:16]


def load_model(path: Path | str) -> MorphModel:
    """Open a `.morph` file; its arrays are memory maps.

    Raises
    ------
    ModelFileError
        If the file is truncated, of a future version, or inconsistent.
    """
    return _assembled(*read_model_file(Path(path)))


def _assembled(arrays: Mapping[str, AnyArray], document: ModelDocument) -> MorphModel:
    """Build the model from arrays and document that were checked."""
    warp_weight = float(document["warp_weight"])
    mask = arrays["mask"]
    basis = Basis(
        arrays["components"],
        arrays["variances"],
        inner_product(mask, warp_weight),
        float(document["discarded_variance"]),
    )
    return MorphModel(
        mean=Morph.of(arrays["mean_texture"], arrays["mean_displacement"], document["reference_id"]),
        basis=basis,
        warp_weight=warp_weight,
        mask=mask,
        reference=arrays["reference"],
        mean_inverse=arrays["mean_inverse"],
        faceframe=_faceframe(document["faceframe"]),
        reference_faceframe=_faceframe(document["reference_faceframe"]),
        training=Loadings(
            arrays["training_loadings"], tuple(document["training_frames"]), document["model_id"]
        ),
        registration=document["registration"],
        flow=document["flow"],
        provenance=dict(document["provenance"]),
        landmarks=_landmarks(arrays, document.get("landmarks")),
    )


def _landmarks(arrays: Mapping[str, AnyArray], entry: LandmarksEntry | None) -> LandmarkRegression | None:
    if entry is None or entry["scheme"] != SCHEME:  # points of an older mesh lie elsewhere on the face
        return None
    return LandmarkRegression(
        np.array(arrays["landmark_mean"]),
        np.array(arrays["landmark_weights"]),
        np.array(arrays["landmark_error"]),
        faces=entry["faces"],
        ridge=float(entry["ridge"]),
        follows_warp=entry["toward"] == "warp",
    )


def _faceframe(entry: FaceframePoints | None) -> FaceFrame | None:
    if entry is None:
        return None
    return FaceFrame.at(np.array([entry["right_eye"], entry["left_eye"], entry["philtrum"]]))
