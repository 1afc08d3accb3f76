"""A set of stimuli: planned whole before anything is drawn, then drawn, measured, listed and shown on one page.

Every stimulus verb plans a `PlannedSet`; `write_set` fills a folder with it. A batch draws the stimuli of many planned
sets by itself, through `make_stimulus`, and ends with `complete_set` on the folder that holds them all.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from morphspace.errors import BadInput
from morphspace.io.stimulus_sidecars import STIMULUS_FORMAT, STIMULUS_VERSION, UNITS
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import versions
from morphspace.requests import request_document
from morphspace.sets.kept import digest_of_kept
from morphspace.sets.manifest import Column, described_columns
from morphspace.sets.protect import files_named
from morphspace.stimuli.drawing import Drawing
from morphspace.storage import digest_of_json, make_folder

KEPT_STEMS = ("manifest", "loadings", "colour_loadings", "record", "index")  # a set's own files


@dataclass(frozen=True, eq=False)
class PlannedSet:
    """Stimuli to be drawn with one model: everything is read and checked, nothing is drawn.

    `verb` as it is called on the command line | `request` as JSON, without its output (`request_document`) | `inputs`,
    name to SHA-256 | `drawings`, in their order | `notes` to act on | `tables`, more CSVs for the folder: file name to
    columns | `columns`, what entries the drawings tell mean, where `manifest.TOLD_COLUMNS` does not say | `new_model`
    where the verb has built the model itself: `keep_model` writes it to `model_path` before anything is drawn | `files`
    that were read, none of which the set may replace | `rights`, consent and licence of what is shown where that is
    not the model's person alone.

    Raises `BadInput` where there are no drawings, names collide, or a told entry is not described.
    """

    verb: str
    request: Mapping[str, Any]
    model_path: Path
    model: MorphModel
    model_sha256: str
    inputs: Mapping[str, str]
    drawings: tuple[Drawing, ...]
    notes: tuple[str, ...] = ()
    tables: Mapping[str, Mapping[str, Sequence[Any]]] = field(default_factory=dict)
    columns: Mapping[str, Column] = field(default_factory=dict)
    new_model: bool = False
    files: tuple[Path, ...] = ()
    rights: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.drawings:
            raise BadInput(f"{self.verb} has nothing to draw: give at least one frame, step or gain")
        check_names([drawing.name for drawing in self.drawings], tuple(self.tables))
        self.told_columns()

    def told_columns(self) -> dict[str, Column]:
        """Give what the entries that the drawings tell mean, in their order."""
        keys = dict.fromkeys(key for drawing in self.drawings for key in drawing.told)
        return described_columns(keys, self.columns)

    def sidecar_head(self) -> dict[str, Any]:
        """Give what the sidecars of all stimuli of the set share, for `make_stimulus`; plain JSON."""
        provenance = self.model.provenance
        head: dict[str, Any] = {
            "format": STIMULUS_FORMAT,
            "version": STIMULUS_VERSION,
            "verb": self.verb,
            "request": dict(self.request),
            "model": {
                "file": self.model_path.name,
                "identity": self.model.identity,
                "model_id": self.model.model_id,
                "sha256": self.model_sha256,
            },
            "inputs": dict(self.inputs),
            "units": UNITS,
            "consent": provenance.get("consent"),
            "licence": provenance.get("licence"),
            **self.rights,
            "versions": versions(),
        }
        head["request_sha256"] = digest_of_json(head["request"])
        return head


def plan_of(
    request: Any,
    verb: str,
    model: MorphModel,
    drawings: Sequence[Drawing],
    *,
    inputs: Mapping[str, str] | None = None,
    notes: Sequence[str] = (),
    tables: Mapping[str, Mapping[str, Sequence[Any]]] | None = None,
    columns: Mapping[str, Column] | None = None,
    rights: Mapping[str, Any] | None = None,
) -> PlannedSet:
    """Make the planned set of a verb's request, whose `model` is the path the model was opened from."""
    sha256 = digest_of_kept(Path(request.model))
    return PlannedSet(
        verb=verb,
        request=request_document(request),
        model_path=Path(request.model),
        model=model,
        model_sha256=sha256,
        inputs={"model": sha256, **(inputs or {})},
        drawings=tuple(drawings),
        notes=tuple(notes),
        tables=tables or {},
        columns=columns or {},
        files=files_named(request),
        rights=rights or {},
    )


def check_names(names: Sequence[str], tables: Sequence[str] = ()) -> None:
    """Raise `BadInput` where two stimuli would share a file on any usual system, or take one of the set's own."""
    counts = Counter(name.casefold() for name in names)
    kept = {*KEPT_STEMS, *(Path(table).stem.casefold() for table in tables)}
    for name in names:
        if counts[name.casefold()] > 1:
            same = [other for other in names if other.casefold() == name.casefold()]
            raise BadInput(
                f"{len(same)} stimuli would be called {same[0]!r}{'' if len(set(same)) == 1 else f' or {same[-1]!r}'}: "
                "give each a name of its own"
            )
        if name.casefold() in kept:
            raise BadInput(
                f"a stimulus is called {name!r}, which is the name of a file of the set: rename it"
            )


def keep_model(planned: PlannedSet) -> None:
    """Write the model of a set that its verb has built, unless it is there already; a model that was given stays.

    Raises `BadInput` where the model of something else is in the way.
    """
    if not planned.new_model:
        return
    check_kept_model(planned.model, planned.model_path)
    if not planned.model_path.exists():
        make_folder(planned.model_path.parent)
        planned.model.save(planned.model_path)


def check_kept_model(model: MorphModel, path: Path) -> None:
    """Raise `BadInput` where a file is at the path of a new model and is not that model."""
    if path.exists() and load_model(path).model_id != model.model_id:
        raise BadInput(
            f"{path} is in the way, and is another model: choose another output folder, or move it away"
        )
