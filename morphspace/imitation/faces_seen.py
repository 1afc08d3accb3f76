"""Whether the frames of a clip show a face at all: a model gives figures for whatever it is shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from morphspace.arrays import Image
from morphspace.face.detector import Detector
from morphspace.imitation.motions import Motion
from morphspace.steps import Step, Steps, in_order


@dataclass(frozen=True, eq=False)
class FacesSeen:
    """The frames of a motion in which no face was found, by name; None where they were not looked at, or are a table's.

    `is_all` says that it is all of them; `notes` what to know of it.
    """

    without: tuple[str, ...] | None
    notes: tuple[str, ...] = ()
    is_all: bool = False

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.without or ())


def look_for_faces(
    role: str, source: Motion, mean: Image, identity: str, detector: Detector | None
) -> Steps[FacesSeen]:
    """Look at each frame of a clip; a table has none.

    A detector that does not know the face on the `mean` (h, w, 3) of the model that reads the clip, that of `identity`,
    such as a drawn one, will not know it in the frames: they are not looked at then.
    """
    if source.clip is None:
        return FacesSeen(None)
    if detector is None:
        return FacesSeen(
            None,
            (
                f"whether the frames of the {role} {source.name} show a face was not looked at: that needs the "
                "networks (morphspace models fetch)",
            ),
        )
    if detector(np.clip(mean, 0, 1)) is None:
        return FacesSeen(
            None,
            (
                f"the detector sees no face in the mean of {identity}: the frames of the {role} {source.name} were not "
                "looked at for faces",
            ),
        )
    total = len(source.frame_names)
    missing = []
    images = source.clip.images(list(range(total)))
    for place, found in enumerate(in_order(detector, images)):
        if found is None:
            missing.append(source.frame_names[place])
        yield Step(f"look at {source.name}", place + 1, total)
    return FacesSeen(tuple(missing), _words(role, source.name, missing, total), len(missing) == total)


def _words(role: str, name: str, missing: Sequence[str], total: int) -> tuple[str, ...]:
    if not missing:
        return ()
    which = "" if len(missing) == total else f" (the first is {missing[0]})"
    return (
        f"{len(missing)} of {total} frames of the {role} {name} show no face to the detector{which}: what was measured "
        "of them means nothing; measures.json names them, frames_without_face",
    )
