"""The table of a stimulus set: `manifest.csv` has one row per stimulus, `manifest.json` explains each column.

The format follows Psych-DS: a plain CSV beside a schema.org `Dataset` whose `variableMeasured` describes every column
with its unit (`data_spec/manifest.md`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NotRequired, TypedDict

from annotated_types import Ge, Len

from morphspace.documents import Document
from morphspace.errors import BadInput
from morphspace.io.tables import metrics_text
from morphspace.stimuli.image_statistics import FIGURES, SPACES
from morphspace.storage import json_text, write_texts

MANIFEST_NAME = "manifest.csv"
Property = TypedDict(
    "Property",
    {"@type": Literal["PropertyValue"], "name": str, "description": str, "unitText": NotRequired[str]},
)
Manifest = TypedDict(
    "Manifest",
    {
        "@context": Literal["https://schema.org/"],
        "@type": Literal["Dataset"],
        "format": Literal["morphspace-manifest"],
        "version": Literal[1],
        "name": str,
        "description": str,
        "verb": str,
        "stimulus_count": Annotated[int, Ge(1)],
        "variableMeasured": Annotated[list[Property], Len(1)],
    },
)
MANIFEST = Document("manifest", "morphspace manifest, version 1: the JSON beside the CSV", Manifest)


@dataclass(frozen=True)
class Column:
    """The meaning of a manifest column, and its unit; None for a column without a unit."""

    description: str
    unit: str | None = None


def _statistic(space: str, figure: str) -> Column:
    where = "in linear light" if space == "linear" else "in code values"
    what = {
        "luminance": ("Mean luminance (ITU-R BT.709)", "0 to 1"),
        "rms_contrast": ("RMS contrast: standard deviation of luminance over its mean", "ratio"),
        "spectral_slope": (
            "Slope of log amplitude on log spatial frequency of luminance",
            "log amplitude per log frequency",
        ),
        "red": ("Mean of the red channel", "0 to 1"),
        "green": ("Mean of the green channel", "0 to 1"),
        "blue": ("Mean of the blue channel", "0 to 1"),
    }[figure]
    return Column(f"{what[0]}, {where}, over the whole picture; of a video the mean over its frames", what[1])


FIRST_COLUMNS: Mapping[str, Column] = {
    "name": Column("The stimulus: its file without suffix, from the set's folder"),
    "file": Column("The picture or video, from the set's folder"),
    "verb": Column("What made it, as it is called on the command line"),
    "identity": Column("Whose face the model shows"),
    "model_id": Column("The model: 16 hexadecimal digits that name its components"),
}
LAST_COLUMNS: Mapping[str, Column] = {
    "frames": Column("Frames of the stimulus; 1 for a picture", "frames"),
    "frame_rate_hz": Column("Frames a second of a video", "Hz"),
    "width_px": Column("Width of the picture", "px"),
    "height_px": Column("Height of the picture", "px"),
    **{f"{space}_{figure}": _statistic(space, figure) for space in SPACES for figure in FIGURES},
    "outlier_in": Column(
        "Image statistics in which the stimulus stands out from its set: modified z-score above 3.5 "
        "(Iglewicz and Hoaglin 1993)"
    ),
    "clipped_percent": Column("Colour values that were clipped to the range of the file", "percent"),
    "folded_percent": Column(
        "Cells of the face's grid that the warp turns over, in the worst frame", "percent"
    ),
    "largest_sd": Column("The loading furthest from the mean face", "SD of its component"),
    "largest_component": Column("The component that has it, from 1"),
    "rms_sd": Column("Root mean square of the loadings, in the frame furthest from the mean face", "SD"),
    "beyond": Column(
        "Components further out than 3 SD and than any training face: the face may not be one the model can vouch for"
    ),
    "consent": Column("What the person shown agreed to, as the model carries it"),
    "licence": Column("The licence of the material, as the model carries it"),
    "sha256": Column("SHA-256 of the picture or video"),
    "sidecar_sha256": Column("SHA-256 of the sidecar, the file of the same name that ends in .json"),
}
VARIABLE_COLUMNS: Mapping[str, Column] = {
    "frame": Column("The frame of the clip or the row of the table it was made from"),
    "gain": Column("Factor on the loadings: 1 veridical, above 1 a caricature, below 0 an anti-face"),
    "warp_gain": Column("Factor on the loadings of the warp"),
    "texture_gain": Column("Factor on the loadings of the texture"),
    "components": Column("The components that were changed; empty where all were"),
    "region": Column("The region of the face that was changed; empty where all was"),
    "component": Column("The component that was varied, from 1"),
    "amount_sd": Column("How far along the component", "SD"),
    "first_sd": Column("How far along the first component of a grid", "SD"),
    "second_sd": Column("How far along the second component of a grid", "SD"),
    "seed": Column("The seed of the random numbers"),
    "draw": Column("The number of the face among those drawn, from 0"),
    "step": Column("The step along a continuum, from 0"),
    "original": Column("The original frame the face was put back into"),
}
"""Columns that verbs add to their stimuli; a verb may describe further ones."""


def write_manifest(
    folder: Path,
    rows: Sequence[Mapping[str, Any]],
    columns: Mapping[str, Column],
    verb: str,
) -> tuple[Path, Path]:
    """Write the manifest of a set and the description of its columns.

    Parameters
    ----------
    rows
        One mapping per stimulus. Columns without any entry are omitted.
    columns
        Columns beyond the usual ones, in their order.
    verb
        The verb that made the set.

    Raises
    ------
    BadInput
        If a row holds an entry without a description.
    """
    known = {**FIRST_COLUMNS, **columns, **LAST_COLUMNS}
    held = {key for row in rows for key in row}
    unknown = sorted(held - set(known))
    if unknown:
        raise BadInput(
            f"the manifest's column {unknown[0]!r} has no description. Add it to the set's columns"
        )
    names = [name for name in known if name in held]
    table = folder / MANIFEST_NAME
    text = metrics_text(table, {name: [row.get(name) for row in rows] for name in names})
    described: Manifest = {
        "@context": "https://schema.org/",
        "@type": "Dataset",
        "format": "morphspace-manifest",
        "version": 1,
        "name": f"Stimuli of morphspace {verb}",
        "description": f"{len(rows)} stimuli; one row a stimulus, its sidecar beside it says how it was made",
        "verb": verb,
        "stimulus_count": len(rows),
        "variableMeasured": [_property(name, known[name]) for name in names],
    }
    write_texts({table: text, table.with_suffix(".json"): json_text(described)})
    return table, table.with_suffix(".json")


def _property(name: str, column: Column) -> Property:
    entry: Property = {"@type": "PropertyValue", "name": name, "description": column.description}
    return entry if column.unit is None else {**entry, "unitText": column.unit}


def described_columns(names: Iterable[str], more: Mapping[str, Column]) -> dict[str, Column]:
    """Return the descriptions of the drawings' entries, in order. Raises `BadInput` for an entry without one."""
    found = {}
    for key in names:
        if key in FIRST_COLUMNS or key in LAST_COLUMNS:
            raise BadInput(f"the column {key!r} is one of the manifest's own. Give it another name")
        column = more.get(key) or VARIABLE_COLUMNS.get(key)
        if column is None:
            raise BadInput(f"the column {key!r} has no description. Add it to the set's columns")
        found[key] = column
    return found
