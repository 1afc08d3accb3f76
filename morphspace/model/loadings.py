"""Loadings: faces as coordinates on the components of a model, with their unit (Nagle et al., section 2)."""

from __future__ import annotations

import numbers
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable, read_only
from morphspace.errors import BadInput, ReferenceMismatch, optional
from morphspace.model import display
from morphspace.settings import shown

Unit = Literal["raw", "sd"]


class HasComponents(Protocol):
    """A model as loadings see it: the digest that names its components, and the SD (k,) along each."""

    @property
    def model_id(self) -> str: ...

    @property
    def sd(self) -> AnyArray: ...


def places_of(names: Sequence[str], index: Any) -> list[int]:
    """Return the places of the faces that a number, a name, a slice, or a list of these selects.

    Raises
    ------
    BadInput
        For anything else.
    IndexError
        For a number beyond the last face.

    Examples
    --------
    >>> places_of(["a", "b", "c"], ["c", -2])
    [2, 1]
    """
    if isinstance(index, slice):
        return list(range(len(names))[index])
    if isinstance(index, list | tuple | np.ndarray):
        return [place for one in index for place in places_of(names, one)]
    if isinstance(index, str) and index in names:
        return [names.index(index)]
    if isinstance(index, numbers.Integral) and not isinstance(index, bool):
        return [range(len(names))[int(index)]]
    raise BadInput(
        f"the face is {shown(index)}; expected a number below {len(names)}, a slice, a name, such as "
        f"{', '.join(names[:1])}, or a list of these. Correct it"
    )


@dataclass(frozen=True, eq=False)
class Loadings:
    """Coordinates of n faces on the k components of a model.

    Attributes
    ----------
    values : array (n, k) float64, read-only
        One row a frame.
    frame_names : tuple of n str
    model_id : str
        The model whose components the columns refer to.
    unit : {"raw", "sd"}
        Raw loadings are in units of the model's inner product and satisfy R = P L. Tables and sidecars hold loadings
        in SD of each component over the training faces.

    Raises
    ------
    BadInput
        If the number of rows differs from the number of names.

    Examples
    --------
    >>> import numpy as np
    >>> loadings = Loadings(np.array([[0.5, -1.0], [2.0, 0.0]]), ("a", "b"), "0123456789abcdef")
    >>> loadings
    Loadings(2 frames x 2 components, raw, model 0123456789abcdef)
    >>> loadings[1].frame_names
    ('b',)
    """

    values: LoadingTable
    frame_names: tuple[str, ...]
    model_id: str
    unit: Unit = "raw"

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or len(self.values) != len(self.frame_names):
            raise BadInput(
                f"loadings have shape {self.values.shape}; expected {len(self.frame_names)} rows, one for each "
                "frame name"
            )
        object.__setattr__(self, "values", read_only(self.values))

    def __getitem__(self, rows: Any) -> Loadings:
        """Return the loadings of the faces that a number, a name, a slice, or a list of these selects."""
        places = places_of(self.frame_names, rows)
        names = tuple(self.frame_names[place] for place in places)
        return Loadings(self.values[places], names, self.model_id, self.unit)

    def __len__(self) -> int:
        return len(self.frame_names)

    def __repr__(self) -> str:
        count, components = self.values.shape
        return f"Loadings({count} frames x {components} components, {self.unit}, model {self.model_id})"

    def _repr_html_(self) -> str:
        return display.loadings_card(self)

    def plot(self, components: int = 6) -> Any:
        """Draw the first components' loadings over the frames; return a matplotlib figure."""
        return display.plot_loadings(self, components)

    def to_pandas(self) -> Any:
        """Return a pandas DataFrame in this unit: one row a frame, one column a component (pc001, ...)."""
        pandas = optional("pandas")
        columns = [f"pc{place + 1:03d}" for place in range(self.values.shape[1])]
        return pandas.DataFrame(np.array(self.values), index=list(self.frame_names), columns=columns)

    def in_sd(self, model: HasComponents) -> Loadings:
        """Convert the loadings to SD of each component over the training faces.

        Raises
        ------
        ReferenceMismatch
            If the loadings belong to another model.
        """
        self._check_model(model)
        return self if self.unit == "sd" else self._as("sd", self.values / self._sd(model))

    def in_raw(self, model: HasComponents) -> Loadings:
        """Convert the loadings to units of the model's inner product.

        Raises
        ------
        ReferenceMismatch
            If the loadings belong to another model.
        """
        self._check_model(model)
        return self if self.unit == "raw" else self._as("raw", self.values * self._sd(model))

    def _sd(self, model: HasComponents) -> AnyArray:
        return model.sd[: self.values.shape[1]]

    def _as(self, unit: Unit, values: LoadingTable) -> Loadings:
        return Loadings(values, self.frame_names, self.model_id, unit)

    def _check_model(self, model: HasComponents) -> None:
        if self.model_id != model.model_id:
            raise ReferenceMismatch(
                f"the loadings belong to model {self.model_id}; expected model {model.model_id}. Encode the pictures "
                "with this model"
            )
