"""A drawing: the numbers from which one model draws a stimulus (ours).

A stimulus is a table of loadings in SD, one row per frame. A second table holds the colours if shape and colour have
different gains; a third the rest of the face if only a region changes. A drawing is written to JSON and read back
bit-equal: the sidecar is sufficient to draw the stimulus again.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable, Mask
from morphspace.errors import BadInput
from morphspace.io.names import FORMULA, UNFIT
from morphspace.io.stimulus_sidecars import DrawingDocument, PlacingDocument
from morphspace.requests import AS_IT_IS, VIDEO_SUFFIXES, ClipOptions, check_rate

FURTHEST_SD = 1000.0  # SD; larger values are errors, and colours overflow
PICTURE_SUFFIXES = (".png",)
LONGEST_PART_BYTES = 200  # of a name's part; file systems take 255, and an unfinished file has a longer name
RESERVED = re.compile(
    r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE
)  # names that Windows reserves
SCALARS = (str, int, float, bool, type(None))


@dataclass(frozen=True, eq=False)
class Placing:
    """The original frames into which rendered faces are placed, one per frame.

    Attributes
    ----------
    names : tuple of n str
    digests : tuple of n str
        The SHA-256 of each original.
    registrations : array (n, 2, 3), px
        Maps a point of the rendered image to the original.
    sources : tuple of str
        The sources that open the clip of the originals.
    options : ClipOptions
        How they open it.

    Raises
    ------
    BadInput
        If the numbers disagree or a registration is not finite.
    """

    names: tuple[str, ...]
    digests: tuple[str, ...]
    registrations: AnyArray
    sources: tuple[str, ...]
    options: ClipOptions = AS_IT_IS

    def __post_init__(self) -> None:
        maps = _fixed(self.registrations)
        if maps.shape != (len(self.names), 2, 3) or len(self.digests) != len(self.names):
            raise BadInput(
                f"registrations of shape {maps.shape} and {len(self.digests)} digests do not fit "
                f"{len(self.names)} original frames: give one of each a frame"
            )
        if not np.isfinite(maps).all():
            raise BadInput("a registration is not finite; expected finite numbers. Align the frames again")
        object.__setattr__(self, "registrations", maps)

    def document(self) -> dict[str, Any]:
        """Return the placing as JSON data."""
        return {
            "names": list(self.names),
            "digests": list(self.digests),
            "registrations": self.registrations.reshape(-1, 6).tolist(),
            "sources": list(self.sources),
            "deinterlace": self.options.deinterlace,
            "frame_rate_hz": self.options.frame_rate_hz,
        }


@dataclass(frozen=True, eq=False)
class Drawing:
    """A stimulus as numbers.

    Attributes
    ----------
    name : str
        The file's name without suffix, with "/" between folders.
    loadings_sd : array (n, k), SD, one row per frame
        The shape, and the colours unless `colour_sd` is set.
    colour_sd : array (n, k), SD, or None
    region : str or None
        The part of the face drawn with these loadings.
    outside_sd : array (n, k), SD, or None
        The face outside the region.
    frame_rate_hz : float or None
        The rate of a video; None for one image.
    suffix : str
    placing : Placing or None
        The originals, if the face is placed into images.
    variables : mapping of str to text or number
        The description for the manifest.
    region_mask : array (h, w) or None
        The region on the mean face, if it is not a named one.

    Raises
    ------
    BadInput
        If these disagree, or a loading is not finite or beyond `FURTHEST_SD`.

    Examples
    --------
    >>> import numpy as np
    >>> drawing = Drawing("mean", np.zeros((1, 3)))
    >>> drawing.file_name, drawing_of(drawing.document()).loadings_sd.tolist()
    ('mean.png', [[0.0, 0.0, 0.0]])
    """

    name: str
    loadings_sd: LoadingTable
    colour_sd: LoadingTable | None = None
    region: str | None = None
    outside_sd: LoadingTable | None = None
    frame_rate_hz: float | None = None
    suffix: str = ".png"
    placing: Placing | None = None
    variables: Mapping[str, Any] = field(default_factory=dict)
    region_mask: Mask | None = None

    def __post_init__(self) -> None:
        check_name(self.name)
        for entry in ("loadings_sd", "colour_sd", "outside_sd"):
            if getattr(self, entry) is not None:
                object.__setattr__(self, entry, self._checked(entry))
        if (self.region is None) != (self.outside_sd is None):
            raise BadInput(
                f"{self.name} has only one of a region and the face outside it; expected both or neither. Add the other"
            )
        self._check_kind()
        if self.placing is not None and len(self.placing.names) != len(self.loadings_sd):
            raise BadInput(
                f"{self.name} has {len(self.loadings_sd)} frames and {len(self.placing.names)} originals to put them "
                "into: give one a frame"
            )
        for key, value in self.variables.items():
            if not isinstance(value, SCALARS) or (isinstance(value, float) and not np.isfinite(value)):
                raise BadInput(
                    f"{self.name}: {key} is {value!r}; expected a text or a finite number. Correct it"
                )

    @property
    def file_name(self) -> str:
        """The stimulus' file, relative to the folder of its set."""
        return self.name + self.suffix

    def _check_kind(self) -> None:
        """Check that suffix, number of frames and frame rate agree."""

        kinds = PICTURE_SUFFIXES if self.frame_rate_hz is None else VIDEO_SUFFIXES
        if self.suffix not in kinds:
            raise BadInput(
                f"{self.name} has the suffix {self.suffix!r}; expected one of {', '.join(kinds)}. Change it"
            )
        if self.frame_rate_hz is None and len(self.loadings_sd) != 1:
            raise BadInput(
                f"{self.name} has {len(self.loadings_sd)} frames and no frame rate: a picture has one frame, a video "
                "needs a rate in Hz"
            )
        if self.frame_rate_hz is not None:
            check_rate(self.frame_rate_hz, f"the frame rate of {self.name}")

    def _checked(self, entry: str) -> LoadingTable:
        """Return a table as read-only float64. Raise `BadInput` if its shape or a value is not possible."""

        values = _fixed(getattr(self, entry))
        shape = np.shape(self.loadings_sd)
        if values.ndim != 2 or len(values) == 0 or values.shape != shape:
            raise BadInput(
                f"{self.name}: {entry} has the shape {values.shape}, one row a frame and the loadings' own shape "
                f"{shape} were expected"
            )
        with np.errstate(invalid="ignore"):
            beyond = np.argwhere(~(np.abs(values) <= FURTHEST_SD))
        if len(beyond):
            row, column = beyond[0]
            raise BadInput(
                f"{self.name}: pc{column + 1:03d} comes to {values[row, column]:.3g} SD, at most {FURTHEST_SD:g} can "
                "be drawn: mend the loadings, use fewer SD, or lower the gain"
            )
        return values

    def document(self) -> dict[str, Any]:
        """Return the drawing as JSON data, from which `drawing_of` restores it bit-equal."""
        return {
            "name": self.name,
            "suffix": self.suffix,
            "frame_rate_hz": self.frame_rate_hz,
            "loadings_sd": self.loadings_sd.tolist(),
            "colour_sd": None if self.colour_sd is None else self.colour_sd.tolist(),
            "region": self.region,
            "outside_sd": None if self.outside_sd is None else self.outside_sd.tolist(),
            "placing": None if self.placing is None else self.placing.document(),
            "variables": dict(self.variables),
        }


def drawing_of(document: DrawingDocument, region_mask: Mask | None = None) -> Drawing:
    """Restore a drawing from its document. Raises `BadInput` as the constructor does."""
    placing, rate_hz = document["placing"], document["frame_rate_hz"]
    return Drawing(
        name=document["name"],
        loadings_sd=np.array(document["loadings_sd"], np.float64),
        colour_sd=_table_or_none(document["colour_sd"]),
        region=document["region"],
        outside_sd=_table_or_none(document["outside_sd"]),
        frame_rate_hz=None if rate_hz is None else float(rate_hz),
        suffix=document["suffix"],
        placing=None if placing is None else _placing_of(placing),
        variables=dict(document["variables"]),
        region_mask=region_mask,
    )


def _placing_of(document: PlacingDocument) -> Placing:
    return Placing(
        tuple(document["names"]),
        tuple(document["digests"]),
        np.array(document["registrations"], np.float64).reshape(-1, 2, 3),
        tuple(document["sources"]),
        ClipOptions(deinterlace=document["deinterlace"], frame_rate_hz=document["frame_rate_hz"]),
    )


def check_name(name: str) -> None:
    """Raise `BadInput` if a stimulus' name is not a valid file name on Linux, macOS and Windows."""
    parts = name.split("/")
    for part in parts:
        wrong = UNFIT.search(part)
        if not part.strip(". ") or part != part.strip() or part.endswith(".") or part.startswith("."):
            raise BadInput(
                f"a stimulus is called {name!r:.80}: a part of its name is empty, or begins or ends with a dot or "
                "a space; rename it"
            )
        if FORMULA.match(part):
            raise BadInput(
                f"a stimulus is called {name!r:.80}: a cell that begins with {part[0]!r} is computed; rename it"
            )
        if wrong or RESERVED.fullmatch(part):
            which = repr(wrong.group()) if wrong else repr(part)
            raise BadInput(
                f"a stimulus is called {name!r:.80}: {which} cannot be in a file's name; rename it"
            )
        if len(part.encode()) > LONGEST_PART_BYTES:
            raise BadInput(
                f"a stimulus is called {part[:20]}... with {len(part.encode())} bytes: give at most "
                f"{LONGEST_PART_BYTES}"
            )


def _fixed(values: Any) -> AnyArray:
    """Return a read-only float64 copy."""
    array = np.array(values, np.float64)
    array.setflags(write=False)
    return array


def _table_or_none(values: Any) -> LoadingTable | None:
    return None if values is None else np.array(values, np.float64)
