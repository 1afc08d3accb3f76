"""The quality table of a mimicry: quality.csv with one row a frame, and quality.json that describes it.

The column `flags` names what a person should inspect. The layout is `data_spec/mimicry.md`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict

from annotated_types import Ge, Gt

from morphspace.documents import Columns, Digest, Document, FrameRate, ModelId, OrNull, Versions
from morphspace.io.tables import metrics_text
from morphspace.model.encode import STRANGE
from morphspace.outcome import versions
from morphspace.storage import json_text, write_texts
from morphspace.transfer.quality import Quality, Reach

# Eye distances of missing motion at the features. In five pairs of people, 1 % of 360 frames are above it. With a
# target of a single smile and a source that opens its mouth wide, three in four are.
OUT_OF_RANGE = 0.10
# Eye distances of requested opening beyond the widest training face. In six pairs, 29 of 432 frames are above it: 14 of
# the 72 whose target shows a single smile, none of those of speech.
WIDER = 0.03
FOLDED = 0.005  # share of cells inside the mask; good results are below it
FLAGS = NO_FACE, TURNED, BEYOND, FOLDS = "no-face", "turned", "out-of-range", "folds"

COLUMNS: dict[str, tuple[str, str]] = {
    "frame": ("", "the driving frame; its picture is frames/NAME.png"),
    "texture_kept": (
        "share",
        "energy of the requested change of colour that the face shows: 1 - |asked - shown|^2 / |asked|^2; usually "
        "below 0 between people, whose skin and light differ: use colour_agreement instead",
    ),
    "warp_kept": (
        "share",
        "energy of the requested motion that the face shows, by the same formula, over the whole face",
    ),
    "length_sd": ("SD", "Mahalanobis length of the loadings, root mean square over components"),
    "largest_sd": ("SD", "the largest loading before the bound"),
    "bounded": ("components", "components that the bound shortened by more than a tenth"),
    "folds": ("share", "folded cells inside the mask"),
    "missing_motion": (
        "eye distance",
        "requested motion at lids, brows and lips that the loadings do not show, 95th percentile; over the whole face "
        "if the target has no mesh points",
    ),
    "colour_agreement": (
        "correlation",
        "uncentred, of the requested and the shown change of colour inside both masks: 1 is equal, 0 unrelated; about "
        "0 to .4 between people",
    ),
    "opening_beyond": (
        "eye distance",
        "requested lip opening minus the widest of the target's training faces, mean over the inner lips; empty if a "
        "model has no landmark regression",
    ),
    "outside_source": (
        "variances",
        "energy of the driving frame outside the source's components, in variances of the source's training faces: "
        f"about 0.2 for frames of the same recording, above {STRANGE:g} for another person, day or camera; empty if "
        "training frames drive",
    ),
    "yaw_deg": (
        "degree",
        "turn of the driving head, positive towards the picture's right; empty if not measured",
    ),
    "pitch_deg": ("degree", "turn of the driving head upwards; empty if not measured"),
    "flags": (
        "",
        f"words with blanks between: {NO_FACE}, no face was found in the driving frame; {TURNED}, by more than 20 "
        f"degrees; {BEYOND}, missing_motion is above {OUT_OF_RANGE:g} or opening_beyond above {WIDER:g}; {FOLDS}, "
        f"more than {FOLDED:.1%} of the cells",
    ),
}
"""Unit and meaning of each column."""
# Of each column. Another flow method or machine changes shares and correlations in the third decimal.
DECIMALS = {
    "texture_kept": 4,
    "warp_kept": 4,
    "length_sd": 3,
    "largest_sd": 3,
    "folds": 6,
    "missing_motion": 4,
    "colour_agreement": 4,
    "opening_beyond": 4,
    "outside_source": 3,
    "yaw_deg": 1,
    "pitch_deg": 1,
}


class UsedModelEntry(TypedDict):
    """The source or the target."""

    identity: str
    model_id: ModelId
    sha256: Digest


class NeutralEntry(TypedDict):
    """The neutral faces; a frame is null for the mean, a distance if a model has no mesh points."""

    asked: str
    source_frame: OrNull[str]
    target_frame: OrNull[str]
    means_apart: OrNull[float]
    apart: OrNull[float]


class Mimicry(TypedDict):
    """The entries of quality.json (data_spec/mimicry.md)."""

    format: Literal["morphspace-mimicry"]
    version: Literal[1]
    columns: Columns
    source: UsedModelEntry
    target: UsedModelEntry
    driver: str
    frames: Literal["clip", "training"]
    frame_rate_hz: OrNull[FrameRate]
    method: Literal["paper", "map", "transfer", "guided"]
    gain: float
    gain_asked: float | Literal["auto"]
    max_sd: Annotated[float, Gt(0)]
    components: Annotated[int, Ge(1)]
    neutral: NeutralEntry
    faces_looked_for: bool
    notes: list[str]
    versions: Versions


MIMICRY = Document("mimicry", "morphspace mimicry, version 1: the JSON beside quality.csv", Mimicry)


@dataclass(frozen=True)
class FaceSeen:
    """The detection in a driving frame: whether a face was `found`, and its turn in degrees."""

    found: bool
    is_turned: bool = False
    yaw_deg: float | None = None
    pitch_deg: float | None = None


@dataclass(frozen=True)
class FrameMade:
    """One finished frame.

    Attributes
    ----------
    loadings : tuple of k float
        Raw loadings of the target.
    quality : Quality
    reach : Reach
    face : FaceSeen or None
        The detection in the driving frame; None without a detector.
    outside_source : float or None
        Energy of the driving frame outside the source's model (`encode.energy_outside`).
    clipped : int
        Values of the picture that were clipped to [0, 1].
    sha256 : str
        Of the picture file.
    """

    loadings: tuple[float, ...]
    quality: Quality
    reach: Reach
    face: FaceSeen | None
    outside_source: float | None
    clipped: int
    sha256: str

    @property
    def flags(self) -> tuple[str, ...]:
        """The words of column `flags`, decided on the rounded figures of the table."""
        wider = self.reach.opening_beyond
        conditions = {
            NO_FACE: self.face is not None and not self.face.found,
            TURNED: self.face is not None and self.face.is_turned,
            BEYOND: rounded("missing_motion", self.reach.missing_motion) > OUT_OF_RANGE
            or (wider is not None and rounded("opening_beyond", wider) > WIDER),
            FOLDS: rounded("folds", self.quality.folds) > FOLDED,
        }
        return tuple(word for word, holds in conditions.items() if holds)

    def document(self) -> dict[str, Any]:
        """Return the frame as JSON; `made_of` is the inverse."""
        return asdict(self)


def made_of(document: Mapping[str, Any]) -> FrameMade:
    """Restore a finished frame from its JSON, bit-equal."""
    face = document["face"]
    return FrameMade(
        tuple(map(float, document["loadings"])),
        Quality(**document["quality"]),
        Reach(**document["reach"]),
        None if face is None else FaceSeen(**face),
        None if document["outside_source"] is None else float(document["outside_source"]),
        int(document["clipped"]),
        str(document["sha256"]),
    )


def quality_columns(names: Sequence[str], made: Sequence[FrameMade]) -> dict[str, list[Any]]:
    """Return the table's columns by name, in order, each figure rounded to `DECIMALS`."""
    table: dict[str, list[Any]] = {"frame": list(names)}
    for entry in fields(Quality):
        table[entry.name] = [getattr(one.quality, entry.name) for one in made]
    for entry in fields(Reach):
        table[entry.name] = [getattr(one.reach, entry.name) for one in made]
    table["outside_source"] = [one.outside_source for one in made]
    table["yaw_deg"] = [None if one.face is None else one.face.yaw_deg for one in made]
    table["pitch_deg"] = [None if one.face is None else one.face.pitch_deg for one in made]
    table["flags"] = [" ".join(one.flags) for one in made]
    for name in DECIMALS:
        table[name] = [None if value is None else rounded(name, value) for value in table[name]]
    return table


def rounded(name: str, value: float) -> float:
    """Round a figure to the decimals of its column."""
    return round(float(value), DECIMALS[name])


def write_quality(
    folder: Path, columns: Mapping[str, Sequence[Any]], about: Mapping[str, Any]
) -> tuple[Path, Path]:
    """Write quality.csv, and quality.json with its columns' meanings and the entries of `about`."""
    table, beside = folder / "quality.csv", folder / "quality.json"
    document = {
        "format": "morphspace-mimicry",
        "version": 1,
        "columns": {
            name: {"unit": unit, "meaning": meaning}
            for name, (unit, meaning) in COLUMNS.items()
            if name in columns
        },
        **about,
        "versions": versions(),
    }
    write_texts({table: metrics_text(table, columns), beside: json_text(document)})
    return table, beside
