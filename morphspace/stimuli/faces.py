"""Faces that are drawn when they are asked for: a sequence of images with names and loadings (ours)."""

from __future__ import annotations

import numbers
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import Image
from morphspace.errors import BadInput
from morphspace.io.images import write_image
from morphspace.model.display import card, picture_tag
from morphspace.model.loadings import Loadings, places_of
from morphspace.stimuli.drawing import check_name

SHEET_FACES = 12  # of a sequence on a card; a notebook is to stay small


@dataclass(frozen=True, eq=False)
class Faces(Sequence[Image]):
    """Faces of one model, drawn when they are asked for.

    `faces[i]`, by number or name, is an image (h, w, 3) float32 in [0, 1]; a slice or a list gives a list of images. A
    notebook shows the first faces as a contact sheet.

    Attributes
    ----------
    names : tuple of str, one a face
    loadings : Loadings
        The faces' loadings on the model that draws them.
    """

    names: tuple[str, ...]
    loadings: Loadings
    draw: Callable[[int], Image] = field(repr=False)

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: Any) -> Any:
        images = [np.clip(self.draw(place), 0, 1) for place in places_of(self.names, index)]
        return images[0] if isinstance(index, str | numbers.Integral) else images

    def __iter__(self) -> Iterator[Image]:
        return (self[place] for place in range(len(self)))

    def save(self, folder: Path | str, *, replace: bool = False) -> list[Path]:
        """Write each face as NAME.png into a folder, and return the files; `replace` allows existing files to be lost.

        Stimuli for an experiment are better made by the verbs, which leave a sidecar beside each.

        Raises
        ------
        BadInput
            If a name cannot name a file, or a file exists.
        UnwritableFile
        """
        for name in self.names:
            check_name(name)
        files = [Path(folder) / f"{name}.png" for name in self.names]
        there = next((file for file in files if file.exists()), None)
        if there is not None and not replace:
            raise BadInput(
                f"{there} exists; expected a new name. Choose another folder, or give replace=True"
            )
        for file, image in zip(files, self, strict=True):
            file.parent.mkdir(parents=True, exist_ok=True)
            write_image(file, image)
        return files

    def __repr__(self) -> str:
        return f"Faces({len(self)} of model {self.loadings.model_id})"

    def _repr_html_(self) -> str:
        count = min(len(self), SHEET_FACES)
        tags = [picture_tag(self[place], self.names[place]) for place in range(count)]
        drawn = f"{count} of {len(self)}" if count < len(self) else str(count)
        return card(
            f"Faces: {drawn}",
            {"model id": self.loadings.model_id},
            [tags[at : at + 6] for at in range(0, count, 6)],
        )
