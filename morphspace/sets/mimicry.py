"""From driving frames to pictures and their side-by-side video, a few frames at a time, and none of them twice.

What is finished is kept in the output folder until all is, under a name made of everything it depends on, so that a run
that was stopped goes on where it was. The video shows the pictures as they were written, in a pass of its own.
"""

from __future__ import annotations

import json
import re
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Image
from morphspace.face.detector import Detector
from morphspace.face.mesh import FacePoints
from morphspace.io.images import read_image, write_image
from morphspace.io.video import write_video
from morphspace.model.encode import energy_outside
from morphspace.model.model import MorphModel
from morphspace.model.morph import vector_of
from morphspace.outcome import versions
from morphspace.report.mimic_page import PAIRS_SHOWN
from morphspace.sets.sources import FRAME_RATE_HZ
from morphspace.steps import Step, Steps, in_order
from morphspace.storage import digest_of_file, digest_of_json, json_text, write_text
from morphspace.transfer.driver import Driver
from morphspace.transfer.mimicry import Mimic, Quality, offset_of
from morphspace.transfer.probable import InnerProducts
from morphspace.transfer.quality import Reach, ReachOf
from morphspace.transfer.quality_table import FaceSeen, FrameMade, made_of

WORK_FORMAT = "morphspace-mimic-frame-3"
KEY_DIGITS = 32
FINISHED = re.compile(rf"[0-9a-f]{{{KEY_DIGITS}}}\.json")
MARK_NAME = "begun"  # says that the pictures are ours before there is one
GAP_PX = 4  # between the panels of the video
THUMBNAIL_WIDTH_PX = 132


@dataclass(frozen=True, eq=False)
class FinishedFrames:
    """The finished frames of this request in the output folder, each under a name made of all it depends on."""

    folder: Path
    common: list[Any]
    driver: Driver
    pictures: tuple[Path, ...]

    def file(self, place: int) -> Path:
        names = [entry.name for kind in (Quality, Reach) for entry in fields(kind)]
        parts = [WORK_FORMAT, self.common, names, versions(), self.pictures[place].name]
        return self.folder / f"{digest_of_json([*parts, self.driver.digests[place]])[:KEY_DIGITS]}.json"

    def read(self, place: int) -> FrameMade | None:
        """Give a frame that was finished before, or None where its row or its picture is missing or another."""
        file, picture = self.file(place), self.pictures[place]
        if not (file.is_file() and picture.is_file()):
            return None
        try:
            made = made_of(json.loads(file.read_text(encoding="utf-8")))
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return made if made.sha256 == digest_of_file(picture) else None

    def write(self, place: int, made: FrameMade) -> None:
        write_text(self.file(place), json_text(made.document()))

    @contextmanager
    def begun(self) -> Iterator[None]:
        """Leave a mark before there is any picture, and take it away where the block ends without one.

        A run that failed or was stopped goes on in a folder with the mark (`mimic_folder.check_ours`).
        """
        mark = self.folder / MARK_NAME
        write_text(mark, "")
        try:
            yield
        finally:
            if not any(picture.exists() for picture in self.pictures):
                mark.unlink(missing_ok=True)

    def remove(self) -> None:
        """Take away what is finished and recorded, of this request and of earlier ones that were stopped."""
        if not self.folder.is_dir():
            return
        for path in sorted(self.folder.iterdir()):
            if path.name == MARK_NAME or FINISHED.fullmatch(path.name):
                path.unlink()
        if not any(self.folder.iterdir()):
            self.folder.rmdir()


def frame_steps(
    source: MorphModel, make: Mimic, reach: ReachOf, work: FinishedFrames, detect: Detector | None
) -> Steps[list[FrameMade]]:
    """Make each frame that is not there yet and write its picture, a few at a time; give what became of each.

    A detector that aligns the source's frames too looks at each driving frame once.
    """
    driver, total = work.driver, len(work.pictures)
    read = InnerProducts(source, source.basis.weight)
    made = {place: one for place in range(total) if (one := work.read(place)) is not None}
    missing = [place for place in range(total) if place not in made]
    if made:
        yield Step("mimic", len(made), total)
    if missing:
        # What they prepare on first use, they prepare here, not in each thread.
        make(offset_of(source, np.zeros(0)), np.zeros(source.rank))
        if driver.is_pictures:
            _ = source.flow_from_reference, read.weighed
    anchor = source.anchor if detect is not None and driver.is_pictures else None
    aligns = anchor is not None and detect is not None and anchor.detector.is_same(detect)

    def one_frame(item: tuple[int, AnyArray]) -> tuple[int, FrameMade]:
        place, given = item
        found = None if detect is None else detect(driver.picture(given))
        face = None if detect is None else _seen(found, driver)
        offset = driver.offset(driver.names[place], given, found if aligns else None)
        known = (
            read.with_offset(vector_of(offset.texture, offset.displacement)) if driver.is_pictures else given
        )
        mimicry = make(offset, known)
        clipped = write_image(work.pictures[place], mimicry.morph.render())
        digest = digest_of_file(work.pictures[place])
        loadings = tuple(mimicry.loadings.tolist())
        followed = reach(offset, mimicry, known)
        outside = energy_outside(offset, source, known) if driver.is_pictures else None
        return place, FrameMade(loadings, mimicry.quality, followed, face, outside, clipped, digest)

    under_way = cast(
        Generator[tuple[int, FrameMade]],
        in_order(one_frame, zip(missing, driver.given(missing), strict=True)),
    )
    with work.begun(), closing(under_way):  # the threads have ended before it is looked what they left
        for place, one in under_way:
            work.write(place, one)
            made[place] = one
            yield Step("mimic", len(made), total)
    return [made[place] for place in range(total)]


def _seen(points: FacePoints | None, driver: Driver) -> FaceSeen | None:
    """Say what was found in a driving frame; None where nothing can be said.

    A training frame is looked at as its loadings draw it. It is known to be a face, so one that is not found there is a
    matter of the drawing.
    """
    if points is None:
        return FaceSeen(found=False) if driver.is_pictures else None
    if points.depth is None:
        return FaceSeen(found=True)
    yaw, pitch = points.turn_degrees
    return FaceSeen(found=True, is_turned=points.is_turned(), yaw_deg=yaw, pitch_deg=pitch)


def video_steps(
    driver: Driver, pictures: Sequence[Path], video: Path
) -> Steps[list[tuple[str, Image, Image]]]:
    """Write the video of source beside mimicry; give small pairs of a few frames for the page."""
    total = len(pictures)
    shown = set(np.linspace(0, total - 1, min(total, PAIRS_SHOWN)).round().astype(int).tolist())
    pairs: list[tuple[str, Image, Image]] = []
    yield Step("video", 0, total)

    def frames() -> Iterator[Image]:
        sources = in_order(driver.picture, driver.given(range(total)))
        for place, (picture, path) in enumerate(zip(sources, pictures, strict=True)):
            mimicry = read_image(path)
            if place in shown:
                pairs.append(
                    (
                        driver.names[place],
                        _of_width(picture, THUMBNAIL_WIDTH_PX),
                        _of_width(mimicry, THUMBNAIL_WIDTH_PX),
                    )
                )
            gap = np.ones((mimicry.shape[0], GAP_PX, 3), np.float32)
            yield np.concatenate([_of_height(picture, mimicry.shape[0]), gap, mimicry], axis=1)

    write_video(video, frames(), frame_rate_hz=driver.rate_hz or FRAME_RATE_HZ, encoding="people")
    yield Step("video", total, total)
    return pairs


def _of_width(image: Image, width: int) -> Image:
    """Give an image (h, w, 3) at this width."""
    height = max(1, round(image.shape[0] * width / image.shape[1]))
    method = cv2.INTER_AREA if width < image.shape[1] else cv2.INTER_CUBIC
    scaled = cv2.resize(image, (width, height), interpolation=method)
    return np.asarray(np.clip(scaled, 0, 1), np.float32)


def _of_height(image: Image, height: int) -> Image:
    if image.shape[0] == height:
        return image
    width = max(1, round(image.shape[1] * height / image.shape[0]))
    method = cv2.INTER_AREA if height < image.shape[0] else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, (width, height), interpolation=method), np.float32)
