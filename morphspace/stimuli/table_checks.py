"""Check that a table of loadings belongs to a model and can be drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from morphspace.arrays import LoadingTable
from morphspace.errors import BadInput, ReferenceMismatch
from morphspace.io.tables import LoadingsTable
from morphspace.model.model import MorphModel
from morphspace.stimuli.drawing import FURTHEST_SD


def check_table(model: MorphModel, table: LoadingsTable, path: Path) -> tuple[str, ...]:
    """Check that a table belongs to the model. Return notes if it has no JSON file, or was changed.

    Raises
    ------
    ReferenceMismatch
        If the table belongs to another model.
    BadInput
        If it has more components than the model.
    """
    columns = table.loadings_sd.shape[1]
    if columns > model.rank:
        raise BadInput(
            f"{path} has {columns} components; expected at most {model.rank} of {model.identity}. Encode with "
            "this model"
        )
    if table.document is None:
        return (f"{path} has no sidecar: whether it belongs to this model cannot be checked",)
    named = table.document.get("model_id")
    if named != model.model_id:
        raise ReferenceMismatch(
            f"{path} belongs to model {named}, this is model {model.model_id} ({model.identity}): encode the images "
            "with this model, or render with the other"
        )
    return table.notes


def check_reach(loadings_sd: LoadingTable, names: tuple[str, ...], path: Path) -> None:
    """Raise `BadInput`, which names row and column, if a loading is beyond `FURTHEST_SD`."""
    with np.errstate(invalid="ignore"):
        beyond = np.argwhere(~(np.abs(loadings_sd) <= FURTHEST_SD))
    if len(beyond):
        row, column = beyond[0]
        raise BadInput(
            f"{path}: pc{column + 1:03d} of {names[row]} comes to {loadings_sd[row, column]:.3g} SD, at most "
            f"{FURTHEST_SD:g} can be drawn: mend the table or lower the gain"
        )
