"""A planned set of stimuli: checked as a whole before the first stimulus is drawn (ours).

Every stimulus verb plans a `PlannedSet`, and `write_set` draws it into a folder. A batch draws the stimuli of several
planned sets with `make_stimulus`, and then calls `complete_set` on their common folder.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from morphspace.errors import BadInput
from morphspace.io.stimulus_sidecars import STIMULUS, UNITS
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import versions
from morphspace.requests import request_document
from morphspace.sets.kept import digest_of_kept
from morphspace.sets.manifest import Column, described_columns
from morphspace.sets.outputs import files_named
from morphspace.stimuli.drawing import Drawing
from morphspace.storage import digest_of_json, make_folder

KEPT_STEMS = ("manifest", "loadings", "colour_loadings", "record", "index")  # a set's own files


@dataclass(frozen=True, eq=False)
class PlannedSet:
    """Stimuli to draw with one model; everything is read and checked, nothing is drawn.

    Attributes
    ----------
    verb
        Name on the command line.
    request
        The request as JSON without its output (`request_document`).
    inputs
        Name to SHA-256.
    drawings
        The drawings, in order.
    notes
        Notes for the user.
    tables
        Further CSV files of the folder: file name to columns.
    columns
        Descriptions of the drawings' entries beyond `manifest.VARIABLE_COLUMNS`.
    new_model
        A model built by the verb; `keep_model` writes it to `model_path` before drawing starts.
    files
        Files that were read; the set may replace none of them.
    rights
        Consent and licence if the stimuli show more than the model's person.

    Raises
    ------
    BadInput
        If there are no drawings, names collide, or an entry has no description.
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
            raise BadInput(f"{self.verb} has nothing to draw. Give at least one frame, step or gain")
        check_names([drawing.name for drawing in self.drawings], tuple(self.tables))
        self.variable_columns()

    def variable_columns(self) -> dict[str, Column]:
        """Return the descriptions of the drawings' entries, in order."""
        keys = dict.fromkeys(key for drawing in self.drawings for key in drawing.variables)
        return described_columns(keys, self.columns)

    def sidecar_head(self) -> dict[str, Any]:
        """Return the entries that all sidecars of the set share, as JSON, for `make_stimulus`."""
        provenance = self.model.provenance
        head: dict[str, Any] = {
            "format": STIMULUS.format,
            "version": 1,
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
    """Build the planned set of a verb's request; the request's `model` is the path of the model."""
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
    """Check that no two stimuli share a file on any common system, and that none uses a file name of the set.

    Raises `BadInput` otherwise.
    """
    counts = Counter(name.casefold() for name in names)
    kept = {*KEPT_STEMS, *(Path(table).stem.casefold() for table in tables)}
    for name in names:
        if counts[name.casefold()] > 1:
            same = [other for other in names if other.casefold() == name.casefold()]
            raise BadInput(
                f"{len(same)} stimuli have the name {same[0]!r}{'' if len(set(same)) == 1 else f' or {same[-1]!r}'}. "
                "Give each its own name"
            )
        if name.casefold() in kept:
            raise BadInput(f"the stimulus name {name!r} is that of a file of the set. Rename it")


def keep_model(planned: PlannedSet) -> None:
    """Write the model that the verb of a set has built, unless it is present; a given model stays as it is.

    Raises `BadInput` if another model is at its path.
    """
    if not planned.new_model:
        return
    check_kept_model(planned.model, planned.model_path)
    if not planned.model_path.exists():
        make_folder(planned.model_path.parent)
        planned.model.save(planned.model_path)


def check_kept_model(model: MorphModel, path: Path) -> None:
    """Check that a file at the path of a new model is that model. Raises `BadInput` otherwise."""
    if path.exists() and load_model(path).model_id != model.model_id:
        raise BadInput(
            f"{path} is another model than the one to write. Choose another output folder, or move it away"
        )
