"""Shared fixtures: smooth random pictures, a drawn clip and a model made of them, and two drawn people."""

import os
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from scipy import ndimage

from morphspace.face import mesh
from morphspace.face.regions import face_mask
from morphspace.grid import warp
from morphspace.linear.pca import fit_basis
from morphspace.linear.rows import RowArray
from morphspace.model.keypoints import (
    DetectedFaceframe,
    moved_by_components,
    reference_to_mean,
    with_detected,
)
from morphspace.model.landmarks import learn_landmarks
from morphspace.model.loadings import Loadings
from morphspace.model.model import MorphModel, model_digest
from morphspace.model.morph import Morph, inner_product
from morphspace.synthetic import Actor, Expression, Identity, drawn_actor
from morphspace.synthetic.inverse import at_points

HEIGHT, WIDTH = 72, 60
MOUTH_ROW = 50  # the slit lies between this row and the next
FRAMES = 9


@pytest.fixture(scope="session", autouse=True)
def nobody_pulls_the_plug():
    """Files are not forced to the disk: no test cuts the power, and waiting for disks was a fifth of the suite."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)
        yield


def textured(height, width, seed=0, sd_px=2.0):
    """A smooth random picture (h, w, 3) in [0.1, 0.9]."""
    noise = np.random.default_rng(seed).standard_normal((height, width, 3))
    smooth = ndimage.gaussian_filter(noise, (sd_px, sd_px, 0), mode="mirror")
    low, high = smooth.min(), smooth.max()
    return (0.1 + 0.8 * (smooth - low) / (high - low)).astype(np.float32)


def wavy(height, width, amplitude_px, seed=0, sd_px=8.0):
    """A smooth random displacement (h, w, 2) whose largest component is `amplitude_px`."""
    noise = np.random.default_rng(seed).standard_normal((height, width, 2))
    smooth = ndimage.gaussian_filter(noise, (sd_px, sd_px, 0), mode="mirror")
    return (amplitude_px * smooth / np.abs(smooth).max()).astype(np.float32)


def expression(opening_px, smile_px, height=HEIGHT, width=WIDTH):
    """A field (h, w, 2): the jaw below the slit goes down by `opening_px`, the cheeks go out by `smile_px`."""
    y, x = np.mgrid[:height, :width].astype(np.float64)
    across = np.exp(-(((x - (width - 1) / 2) / (0.2 * width)) ** 2))
    below = (y > MOUTH_ROW) * np.exp(-(((y - MOUTH_ROW - 1) / (0.2 * height)) ** 2))
    cheeks = np.exp(-(((y - 0.6 * height) / (0.15 * height)) ** 2))
    sideways = np.sin(2 * np.pi * (x - (width - 1) / 2) / width)
    return np.stack([smile_px * sideways * cheeks, opening_px * across * below], axis=-1).astype(np.float32)


@dataclass(frozen=True, eq=False)
class DrawnClip:
    """Frames with their truth: a `FrameSource`; fields (h, w, 2) say where each point of `neutral` is found."""

    names: tuple[str, ...]
    digests: tuple[str, ...]
    pictures: tuple[np.ndarray, ...]
    fields: tuple[np.ndarray, ...]
    neutral: np.ndarray

    def images(self, indices: list[int]) -> Iterator[np.ndarray]:
        for index in indices:
            yield self.pictures[index]


def clip_of(pictures, fields=(), neutral=None):
    """A clip of these pictures; equal pictures get equal digests, as equal files do."""
    digests = tuple(f"digest-{hash_of(picture)}" for picture in pictures)
    names = tuple(f"frame_{i:03d}" for i in range(len(pictures)))
    return DrawnClip(names, digests, tuple(pictures), tuple(fields), neutral)


def hash_of(picture):
    from morphspace.storage import digest_of_array

    return digest_of_array(picture)[:16]


def drawn_neutral():
    neutral = textured(HEIGHT, WIDTH, seed=1)
    neutral[MOUTH_ROW - 1 : MOUTH_ROW + 3, WIDTH // 4 : -WIDTH // 4] *= 0.3  # lips, dark around the slit
    return neutral


def solid_face():
    """478 points (x, y, depth) of a made-up head in its own axes: eyes at y 0, the base of the nose in front."""
    rng = np.random.default_rng(3)
    solid = np.column_stack([rng.uniform(-60, 60, 478), rng.uniform(-80, 80, 478), rng.uniform(-20, 40, 478)])
    for outer, inner, place in ((33, 133, -1), (263, 362, 1)):
        solid[outer], solid[inner] = (place * 45, 0, 10), (place * 15, 0, 0)
    for right, left, x, y, depth in ((127, 356, 70, 5, 70), (234, 454, 70, 25, 75), (162, 389, 65, -20, 60)):
        solid[right], solid[left] = (-x, y, depth), (x, y, depth)
    # The base of the nose stands before the eyes by the angle a resting face has.
    forward = 50 * np.tan(np.radians(mesh.RESTING_PITCH_DEG))
    solid[98], solid[2], solid[327] = (-12, 50, 5 - forward), (0, 50, 5 - forward), (12, 50, 5 - forward)
    return solid


def turned(solid, yaw_deg=0.0, pitch_deg=0.0, roll_deg=0.0):
    """The head turned to the image's right, up, and clockwise in the picture."""
    yaw, pitch, roll = np.radians([yaw_deg, pitch_deg, roll_deg])
    # A face that looks to the image's right brings its right-hand side (larger x) away from the camera.
    about_y = np.array([[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(pitch), np.sin(pitch)], [0, -np.sin(pitch), np.cos(pitch)]])
    about_z = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    solid = solid @ (about_z @ about_y @ about_x).T
    return mesh.FacePoints(solid[:, :2] + 100, 0.9, depth=solid[:, 2])


@pytest.fixture(scope="session")
def turned_face():
    """A function of yaw, pitch and roll, degrees, that gives the points and depth of a made-up head."""
    return lambda **turns: turned(solid_face(), **turns)


@pytest.fixture(scope="session")
def picture():
    return textured


@pytest.fixture(scope="session")
def wavy_field():
    return wavy


@pytest.fixture(scope="session")
def make_clip():
    return clip_of


@pytest.fixture(scope="session")
def clip():
    """Nine frames of one drawn face: its mouth opens up to 5 px, it smiles up to 1.5 px, the light changes by 6 %."""
    neutral = drawn_neutral()
    phase = 2 * np.pi * np.arange(FRAMES) / FRAMES
    fields = [
        expression(2.5 - 2.5 * np.cos(angle), 1.5 * np.sin(2 * angle)).astype(np.float32) for angle in phase
    ]
    light = 1 + 0.06 * np.sin(phase + 1)
    pictures = [
        np.clip(warp.render(neutral * np.float32(gain), field), 0, 1)
        for gain, field in zip(light, fields, strict=True)
    ]
    return clip_of(pictures, fields, neutral)


@pytest.fixture(scope="session")
def model():
    """A model of rank 3 whose morphs are known exactly, without any flow."""
    neutral = drawn_neutral()
    rng = np.random.default_rng(5)
    amounts = rng.standard_normal((12, 3)) * (1.2, 0.8, 0.05)
    amounts -= amounts.mean(axis=0)
    shade = (textured(HEIGHT, WIDTH, seed=9, sd_px=10.0) - 0.5) * 2
    opening, smile = expression(1.0, 0.0), expression(0.0, 1.0)
    rows = np.stack(
        [Morph.of(neutral + c * shade, a * opening + b * smile, "").vector for a, b, c in amounts]
    )
    mask = face_mask(HEIGHT, WIDTH)
    warp_weight = 0.1
    mean, basis, loadings = fit_basis(RowArray(rows), inner_product(mask, warp_weight), 10)
    mean_morph = Morph(mean, (HEIGHT, WIDTH), "d2a11f0123456789")
    provenance = {
        "identity": "drawn",
        "licence": "CC0",
        "framing": {"source_size": [64, 80], "crop": None, "size": [64, 80]},
        "reference": {"frame": "neutral", "reason": "it was asked for", "sha256": "0" * 64},
        "versions": {},
    }
    names = tuple(f"frame_{i:03d}" for i in range(len(rows)))
    return MorphModel(
        mean=mean_morph,
        basis=basis,
        warp_weight=warp_weight,
        mask=mask,
        reference=mean_morph.render(),
        mean_inverse=np.zeros((HEIGHT, WIDTH, 2), np.float32),
        faceframe=None,
        reference_faceframe=None,
        training=Loadings(loadings, names, model_digest(basis, mean_morph, provenance)),
        registration="none",
        flow="dis",
        provenance=provenance,
    )


DRAWN_SIZE = (80, 96)
DRAWN_FRAMES = 16


@dataclass(frozen=True, eq=False)
class DrawnPerson:
    """A drawn actor, and the model of its performance, made from the exact truth: no flow and no detector took part."""

    actor: Actor
    model: MorphModel

    def face(self, **actions):
        """The morph of an expression of the actor, from its exact truth."""
        return self._morph(self.actor.draw(Expression(**actions)))

    def picture(self, **actions):
        return self.actor.draw(Expression(**actions)).image

    def points(self, **actions):
        """The face points of an expression of the actor, in its picture."""
        return mesh.FacePoints(drawn_mesh(self.actor, Expression(**actions)), 1.0)

    def _morph(self, shot):
        field = warp.compose(shot.displacement, self.model.mean_inverse)
        return Morph.of(warp.sample(shot.image, field), field, self.model.mean.reference_id)


def drawn_mesh(actor, expression):
    """The face mesh (478, 2) px of an actor: lids, brows, lips, rim and philtrum; all other points lie on the nose."""
    face = actor.geometry
    points = np.tile(face.nose_tip, (mesh.POINT_COUNT, 1)).astype(float)
    is_below = np.zeros(mesh.POINT_COUNT, bool)  # the slits of eyes and mouth
    there, back = np.linspace(-1, 1, 9), np.linspace(1, -1, 9)[1:-1]
    for ring, eye, way in ((mesh.RIGHT_LIDS, face.right_eye, 1), (mesh.LEFT_LIDS, face.left_eye, -1)):
        lids = (
            eye.point(way * t, side) for side, along in (("lower", there), ("upper", back)) for t in along
        )
        points[list(ring)] = list(lids)
        is_below[list(ring[1:8])] = True
    for ring, brow in ((mesh.RIGHT_BROW, face.right_brow), (mesh.LEFT_BROW, face.left_brow)):
        inwards = brow[[12, 9, 6, 3, 0]]
        points[list(ring)] = np.concatenate(
            [inwards - np.array((0, 0.03)), inwards[::-1] + np.array((0, 0.03))]
        )
    there, back = np.linspace(-1, 1, 11), np.linspace(1, -1, 11)[1:-1]
    for ring, edge in ((mesh.OUTER_LIPS, face.lip_edge), (mesh.INNER_LIPS, face.mouth.point)):
        points[list(ring)] = [
            edge(t, side) for side, along in (("upper", there), ("lower", back)) for t in along
        ]
        is_below[list(ring[11:])] = True
    turn = 2 * np.pi * np.arange(len(mesh.FACE_OUTLINE)) / len(mesh.FACE_OUTLINE)
    rim = np.column_stack([face.face_width * np.sin(turn), 0.3 - 1.3 * np.cos(turn)])
    points[list(mesh.FACE_OUTLINE)] = rim
    points[mesh.PHILTRUM] = face.philtrum
    points = face.to_px(points)
    above, below = (at_points(sheet, points) for sheet in actor.sheets(expression))
    return points + np.where(is_below[:, None], below, above) - actor.margin


def drawn_person(seed):
    """Sixteen expressions: at rest, then jaw, smile, brows and lids at random, each independent of the others."""
    actor = drawn_actor(Identity.random(np.random.default_rng(seed)), DRAWN_SIZE)
    expressions = [Expression()]
    for jaw, smile, brows, lids in np.random.default_rng(seed).uniform(0, 1, (DRAWN_FRAMES - 1, 4)):
        raised, closed = (("brow_outer_raise", "brow_inner_raise"), ("lid_close_right", "lid_close_left"))
        amounts = dict.fromkeys(raised, brows) | dict.fromkeys(closed, lids)
        expressions.append(Expression(jaw_open=0.7 * jaw, lip_corner_up=smile, **amounts))
    shots = [actor.draw(expression) for expression in expressions]
    (width, height), reference = DRAWN_SIZE, f"{seed:016x}"
    mean_inverse = warp.invert(np.mean([shot.displacement for shot in shots], axis=0))
    fields = [warp.compose(shot.displacement, mean_inverse) for shot in shots]
    rows = [
        Morph.of(warp.sample(shot.image, field), field, reference).vector
        for shot, field in zip(shots, fields, strict=True)
    ]
    mask = face_mask(height, width)
    mean, basis, loadings = fit_basis(RowArray(np.stack(rows)), inner_product(mask, 0.05), 6)
    mean_morph = Morph(mean, (height, width), reference)
    name = f"drawn {seed}"
    provenance = {
        "identity": name,
        "licence": "CC0",
        "framing": {"source_size": list(DRAWN_SIZE), "crop": None, "size": list(DRAWN_SIZE)},
        "reference": {"frame": "f00", "reason": "it was asked for", "sha256": "0" * 64},
        "versions": {},
    }
    names = tuple(f"f{i:02d}" for i in range(DRAWN_FRAMES))
    model = MorphModel(
        mean=mean_morph,
        basis=basis,
        warp_weight=0.05,
        mask=mask,
        reference=mean_morph.render(),
        mean_inverse=mean_inverse,
        faceframe=None,
        reference_faceframe=None,
        training=Loadings(loadings, names, model_digest(basis, mean_morph, provenance)),
        registration="none",
        flow="dis",
        provenance=provenance,
    )
    seen = np.stack([drawn_mesh(actor, expression) for expression in expressions])
    points = reference_to_mean(model, seen[0])
    learned = learn_landmarks(loadings, seen, model.sd, moved_by_components(model, points))
    faceframe = mesh.FacePoints(points, 1.0).faceframe()
    found = DetectedFaceframe(faceframe, np.zeros(3), points, DRAWN_FRAMES, DRAWN_FRAMES, learned)
    return DrawnPerson(actor, with_detected(model, found))


@pytest.fixture(scope="session")
def drawn_anna():
    return drawn_person(4)


@pytest.fixture(scope="session")
def drawn_ben():
    return drawn_person(9)
