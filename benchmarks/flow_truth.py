"""Pairs of pictures whose flow is known, or can be judged: what benchmarks/flow.py measures and tuning looks at.

Warped photographs (morphspace.synthetic.warped), Middlebury scenes, drawn actors and real pairs. What is tuned on and
what is reported are kept apart by `part`: other London faces, other fields, other clips, other actors. Two things are
in both: the astronaut's photograph (with other fields), and the scenes, which have no parts.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from clips import clip_frames

from morphspace.arrays import Image, Mask, Points
from morphspace.errors import BadInput
from morphspace.face.faceframe import aligned
from morphspace.face.regions import face_mask, rigid_region
from morphspace.face.registration import register
from morphspace.io.flow_fields import read_flow
from morphspace.io.images import read_image
from morphspace.linear.quality import known_flow
from morphspace.report.flow_scenes import find_scenes
from morphspace.synthetic import Expression, Identity, drawn_actor
from morphspace.synthetic.warped import FaceMarks, FlowPair, WarpKind, astronaut_face, flow_pair

Part = Literal["tune", "report"]

FACE_SETS: tuple[tuple[str, WarpKind, float, int], ...] = (  # name, kind, peak px, seed
    ("face 8", "smooth", 8.0, 0),
    ("face 14", "smooth", 14.0, 10),
    ("face 20 mouth", "mouth", 20.0, 20),
    ("face 14 lit", "lit", 14.0, 10),  # the fields of "face 14" again
)
FACE_SIZE = 256  # px a side
STILLS: dict[Part, tuple[str, ...]] = {
    "tune": ("001", "002", "003", "004", "005"),
    "report": ("019", "044", "082", "104", "131"),
}
SEEDS: dict[Part, int] = {"tune": 100, "report": 500}  # the astronaut is in both parts, with other fields

# Places in a London face's template (its 189 points): pupils, corners of the mouth, the lips' edges between them.
PUPILS = (0, 1)
MOUTH_CORNERS = (87, 93)
UPPER_LIP_EDGE, LOWER_LIP_EDGE = slice(94, 99), slice(99, 104)
SIDE_IN_FACES = 3.2  # of the square, in distances from eyes to mouth: brow to below the chin

# Clip, neutral frame with the lips nearly closed, frames of strong expression: chosen by eye, before any flow was seen.
# "tune" has every clip of which any frame was used to tune the estimator; "report" has clips of which none was.
REAL_PAIRS: dict[Part, tuple[tuple[str, int, tuple[int, ...]], ...]] = {
    "tune": (
        ("lp_d18", 34, (26, 46)),
        ("lp_d6", 0, (10, 42)),
        ("lp_d13", 58, (34, 44)),
        ("grid_pwij3p", 28, (10,)),
        ("obama_a", 16, (26, 38)),
    ),
    "report": (
        ("lp_d0", 4, (26,)),
        ("lp_d3", 26, (42,)),
        ("lp_d9", 2, (10,)),
        ("grid_lbax4n", 28, (24,)),
        ("obama_b", 12, (20,)),
    ),
}
REAL_SIZE = (256, 307)  # (w, h) px

DRAWN_SIZE = (256, 307)
DRAWN_EXPRESSIONS: dict[str, Expression] = {
    "smile": Expression(
        lip_corner_up=0.9, cheek_raise=0.7, upper_lip_raise=0.3, brow_outer_raise=0.3, lip_stretch=0.3
    ),
    "shout": Expression(
        jaw_open=0.8, brow_lower=0.7, nose_wrinkle=0.5, upper_lip_raise=0.5, lower_lip_drop=0.5
    ),
    "pout": Expression(lip_pucker=0.9, brow_inner_raise=0.8, chin_raise=0.5, lid_close_left=0.6),
}
DRAWN_SEEDS: dict[Part, tuple[int, ...]] = {"tune": (1, 2), "report": (11, 12)}


@dataclass(frozen=True, eq=False)
class RealPair:
    """A neutral frame and an expression of the same face, brought to it as a build does; nobody knows the flow.

    `reference` and `frame` (h, w, 3); `mask` (h, w) in [0, 1], the face on the reference.
    """

    name: str
    reference: Image
    frame: Image
    mask: Mask


def face_sets(
    data: Path, part: Part, titles: Collection[str] | None = None, size: int = FACE_SIZE
) -> dict[str, tuple[FlowPair, ...]]:
    """Give the sets of warped photographs, six pairs each: the astronaut and five London faces of the data folder.

    Only the sets in `titles`, where given. `size` px a side; displacements grow with it.
    """
    photographs = [("astronaut", *astronaut_face())]
    photographs += [(name, *london_face(data, name)) for name in STILLS[part]]
    sets = {}
    for title, kind, peak_px, seed in FACE_SETS:
        if titles is not None and title not in titles:
            continue
        first, peak = SEEDS[part] + seed, peak_px * size / FACE_SIZE
        sets[title] = tuple(
            flow_pair(image, marks, kind=kind, peak_px=peak, seed=first + place, size=size, name=name)
            for place, (name, image, marks) in enumerate(photographs)
        )
    return sets


def london_face(data: Path, name: str) -> tuple[Image, FaceMarks]:
    """Give a neutral face of the London set and its marks, `stills_london/neutral/NAME.jpg` and `.tem`."""
    image = data / "stills_london" / "neutral" / f"{name}.jpg"
    template = image.with_suffix(".tem")
    for path in (image, template):
        if not path.is_file():
            raise BadInput(f"{path} does not exist: give --data a folder that holds stills_london")
    points = template_points(template)
    lips = (points[UPPER_LIP_EDGE] + points[LOWER_LIP_EDGE]) / 2
    mouth = np.vstack([points[MOUTH_CORNERS[0]], lips, points[MOUTH_CORNERS[1]]])
    right, left = ((float(x), float(y)) for x, y in points[list(PUPILS)])
    to_mouth = float(mouth[:, 1].mean() - (right[1] + left[1]) / 2)
    return read_image(image), FaceMarks(right, left, mouth, SIDE_IN_FACES * to_mouth)


def template_points(path: Path) -> Points:
    """Read the points (m, 2) px of a webmorph template: their number, then one `x<TAB>y` a line."""
    lines = path.read_text().splitlines()
    return np.array([line.split() for line in lines[1 : 1 + int(lines[0])]], np.float64)


def scene_pairs(data: Path) -> tuple[FlowPair, ...]:
    """Give the Middlebury scenes of the data folder, `flow/SCENE`; `visible` is where the truth is known.

    They have no parts: the folder holds three, and the estimator was tuned on all of them.
    """
    pairs = []
    for scene in find_scenes(data / "flow")[0]:
        stored = read_flow(scene.truth)
        field = stored.displacement
        known = stored.known & known_flow(field)
        pairs.append(FlowPair(scene.name, read_image(scene.reference), read_image(scene.frame), field, known))
    return tuple(pairs)


def drawn_pairs(part: Part) -> tuple[FlowPair, ...]:
    """Give drawn actors, at rest and with each of `DRAWN_EXPRESSIONS`; six pairs."""
    pairs = []
    for seed in DRAWN_SEEDS[part]:
        actor = drawn_actor(Identity.random(np.random.default_rng(seed)), DRAWN_SIZE)
        rest = actor.draw().image
        for name, expression in DRAWN_EXPRESSIONS.items():
            frame = actor.draw(expression)
            visible = frame.visibility > 0.5
            pairs.append(FlowPair(f"actor {seed} {name}", rest, frame.image, frame.displacement, visible))
    return tuple(pairs)


def real_pairs(data: Path, part: Part) -> tuple[RealPair, ...]:
    """Give the real pairs of this part, at `REAL_SIZE`, registered by a similarity on brow to nose."""
    width, height = REAL_SIZE
    region, mask = rigid_region(height, width), face_mask(height, width)
    pairs = []
    for clip, neutral, strong in REAL_PAIRS[part]:
        reference, *others = clip_frames(data, clip, REAL_SIZE).images([neutral, *strong])
        for index, image in zip(strong, others, strict=True):
            name = f"{clip} {neutral}-{index}"
            movement = register(reference, image, "similarity", region)
            pairs.append(RealPair(name, reference, aligned(image, name, movement).image, mask))
    return tuple(pairs)
