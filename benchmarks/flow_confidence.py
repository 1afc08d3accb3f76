"""What the confidence of a flow is worth: is it low where the flow is wrong, and high where it is right?"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from flow_estimators import PRESETS, one_thread
from flow_truth import FACE_SIZE, drawn_pairs, face_sets, scene_pairs
from tables import print_table, tell

from morphspace.arrays import AnyArray, Image
from morphspace.flow.methods import METHODS
from morphspace.linear.quality import endpoint_error
from morphspace.synthetic.warped import FlowPair

FACE_SET = "face 20 mouth"
WRONG_PX, RIGHT_PX = 3.0, 0.5


def flow_confidence(data: Path) -> None:
    """Measure and print the confidence of our presets."""
    print(
        f"Mean confidence. Wrong, right: points of all pairs whose end point is off by more than {WRONG_PX:g} px, by "
        f"less than {RIGHT_PX:g} px. Faces: the set `{FACE_SET}`. Hidden: points of the drawn actors at rest that "
        "cannot be seen in the expression. Strangers: those faces, with as frame the middle of each Middlebury scene; "
        "in brackets the share of points trusted by more than a half.\n"
    )
    faces = face_sets(data, "report", (FACE_SET,))[FACE_SET]
    scenes, drawn = scene_pairs(data), drawn_pairs("report")
    heads = [
        "preset",
        "faces: right",
        "wrong",
        "scenes: right",
        "wrong",
        "drawn: visible",
        "hidden",
        "strangers",
    ]
    rows = []
    with one_thread():
        for name in PRESETS:
            tell(f"flow-confidence: {name}")
            rows.append(
                [name, *_right_wrong(name, faces), *_right_wrong(name, scenes), *_seen_hidden(name, drawn)]
            )
            rows[-1].append(_strangers(name, faces, scenes))
    print_table(heads, rows)


def _right_wrong(name: str, pairs: Sequence[FlowPair]) -> tuple[str, str]:
    right, wrong = [], []
    for pair in pairs:
        flow = METHODS[name](pair.reference)(pair.frame, None)
        off_px = endpoint_error(
            flow.displacement, np.where(pair.visible[..., None], pair.truth, np.float32(0))
        )
        right.append(flow.confidence[pair.visible & (off_px < RIGHT_PX)])
        wrong.append(flow.confidence[pair.visible & (off_px > WRONG_PX)])
    return _mean(right), _mean(wrong)


def _seen_hidden(name: str, pairs: Sequence[FlowPair]) -> tuple[str, str]:
    found = [METHODS[name](pair.reference)(pair.frame, None).confidence for pair in pairs]
    seen = [confidence[pair.visible] for confidence, pair in zip(found, pairs, strict=True)]
    hidden = [confidence[~pair.visible] for confidence, pair in zip(found, pairs, strict=True)]
    return _mean(seen), _mean(hidden)


def _strangers(name: str, faces: Sequence[FlowPair], scenes: Sequence[FlowPair]) -> str:
    found = []
    for face in faces:
        to_frame = METHODS[name](face.reference)
        found += [to_frame(_middle(scene.frame), None).confidence for scene in scenes]
    confidence = np.concatenate([each.ravel() for each in found])
    return f"{confidence.mean():.2f} ({100 * (confidence > 0.5).mean():.0f} %)"


def _middle(image: Image) -> Image:
    top, left = (image.shape[0] - FACE_SIZE) // 2, (image.shape[1] - FACE_SIZE) // 2
    return np.ascontiguousarray(image[top : top + FACE_SIZE, left : left + FACE_SIZE])


def _mean(parts: Sequence[AnyArray]) -> str:
    values = np.concatenate(parts)
    return f"{values.mean():.2f}" if values.size else "none"
