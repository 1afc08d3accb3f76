"""The table of what became of each frame that was mimicked: quality.csv, and quality.json that describes it.

What a person should look at has a word in the column `flags`. The layout is `data_spec/mimicry.md`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from morphspace.io.tables import write_metrics_table
from morphspace.model.encode import STRANGE
from morphspace.outcome import versions
from morphspace.storage import json_text, write_text
from morphspace.transfer.quality import Quality, Reach

FORMAT = "morphspace-mimicry"
VERSION = 1
# Missing motion at the features, in eye distances. Five pairs of people, 360 frames: one of a hundred above it. A
# target that holds one single smile, asked for the frames of a face that opens its mouth wide: three of four above it.
OUT_OF_RANGE = 0.10
# Opening asked for beyond the widest ever shown, in eye distances. Six pairs, 432 frames: 29 above it, 14 of them of
# the 72 that are asked of a person who shows one single smile, none of those that ask for speech.
WIDER = 0.03
FOLDED = 0.005  # of the cells inside the mask; a good result stays below
FLAGS = NO_FACE, TURNED, BEYOND, FOLDS = "no-face", "turned", "out-of-range", "folds"

COLUMNS: dict[str, tuple[str, str]] = {
    "frame": ("", "the driving frame; its picture is frames/NAME.png"),
    "texture_kept": (
        "share",
        "energy of the carried change of colour that the face shows: 1 - |asked - shown|^2 / |asked|^2; below 0 where "
        "what is shown differs from what was asked by more than showing nothing would, which is usual between people, "
        "whose skin and light differ: read colour_agreement instead",
    ),
    "warp_kept": ("share", "energy of the carried motion that the face shows, likewise; over the whole face"),
    "length_sd": ("SD", "Mahalanobis length of the loadings, root mean square over components"),
    "largest_sd": ("SD", "the largest loading as it was asked for, before the bound"),
    "bounded": ("components", "how many the bound shortened by more than a tenth"),
    "folds": ("share", "cells inside the mask that the face turns over"),
    "missing_motion": (
        "eye distance",
        "what the loadings leave of the motion asked for at lids, brows and lips, 95th percentile; over the whole face "
        "where the target does not know where those are",
    ),
    "colour_agreement": (
        "correlation",
        "of the change of colour asked for with the one shown, means not taken off, inside both masks: 1 the same, 0 "
        "unrelated; some 0 to .4 between people",
    ),
    "opening_beyond": (
        "eye distance",
        "how much wider the lips are asked to open than in any training face of the target, mean over the inner lips; "
        "below 0 where they are not; empty where a model does not know its landmarks",
    ),
    "outside_source": (
        "variances",
        "energy of the driving frame that the source's components cannot show, in variances of the source's training "
        f"faces: some 0.2 of frames of the same recording, above {STRANGE:g} of another person, day or camera; empty "
        "where training frames drive",
    ),
    "yaw_deg": (
        "degree",
        "turn of the driving head, positive towards the picture's right; empty where not measured",
    ),
    "pitch_deg": ("degree", "turn of the driving head upwards; empty where not measured"),
    "flags": (
        "",
        f"words with blanks between: {NO_FACE} none was found in the driving frame; {TURNED} by more than 20 degrees; "
        f"{BEYOND} missing_motion is above {OUT_OF_RANGE:g} or opening_beyond above {WIDER:g}; {FOLDS} more than "
        f"{FOLDED:.1%}",
    ),
}
"""Each column of the table: its unit and what it means."""
# Of each number in the file. Another flow or another machine moves shares and correlations in the third decimal.
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


@dataclass(frozen=True)
class FaceSeen:
    """What the detector saw in a driving frame: whether a face was `found`, and its turn in degrees."""

    found: bool
    is_turned: bool = False
    yaw_deg: float | None = None
    pitch_deg: float | None = None


@dataclass(frozen=True)
class FrameMade:
    """One finished frame: `loadings` (k,), its quality and reach, what was seen in the driving frame, how much of that
    the source's model cannot show (`encoding.energy_outside`), how many values were clipped, and the SHA-256 of its
    picture.
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
        """The words a person should read about it, by the figures as the table has them."""
        wider = self.reach.opening_beyond
        told = {
            NO_FACE: self.face is not None and not self.face.found,
            TURNED: self.face is not None and self.face.is_turned,
            BEYOND: rounded("missing_motion", self.reach.missing_motion) > OUT_OF_RANGE
            or (wider is not None and rounded("opening_beyond", wider) > WIDER),
            FOLDS: rounded("folds", self.quality.folds) > FOLDED,
        }
        return tuple(word for word, holds in told.items() if holds)

    def document(self) -> dict[str, Any]:
        """Give it as JSON; `made_of` is the inverse."""
        return asdict(self)


def made_of(document: Mapping[str, Any]) -> FrameMade:
    """Read a finished frame back from its JSON, bit-equal."""
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
    """Give the table's columns by name, in order, each figure to as many decimals as it is good for."""
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
    """Give a figure of a column as the table has it."""
    return round(float(value), DECIMALS[name])


def write_quality(
    folder: Path, columns: Mapping[str, Sequence[Any]], told: Mapping[str, Any]
) -> tuple[Path, Path]:
    """Write quality.csv, and quality.json that describes its columns and holds what was `told`."""
    table, beside = folder / "quality.csv", folder / "quality.json"
    write_metrics_table(table, columns)
    document = {
        "format": FORMAT,
        "version": VERSION,
        "columns": {
            name: {"unit": unit, "meaning": meaning}
            for name, (unit, meaning) in COLUMNS.items()
            if name in columns
        },
        **told,
        "versions": versions(),
    }
    write_text(beside, json_text(document))
    return table, beside
