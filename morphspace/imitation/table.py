"""Write the table of an imitation's measures, and the description of its columns (data_spec/imitation-table.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict

import numpy as np
from annotated_types import Ge, Gt, Le

from morphspace.arrays import AnyArray, LoadingTable
from morphspace.documents import Columns, Document, FrameRate, OrNull, Versions
from morphspace.face.regions import REGIONS
from morphspace.imitation import Comparison
from morphspace.imitation.information import LEAST_FRAMES_INFORMATION
from morphspace.imitation.shape import varies
from morphspace.io.tables import metrics_text
from morphspace.outcome import versions
from morphspace.settings import Pattern
from morphspace.storage import json_text, write_texts

NAMED = 5  # components in a sentence
ALL = "all"  # the row of all components together

_SHIFTED = "p: share of the imitation's circular shifts, itself included, with"
_COPIED = "p: share of the imitation's altered copies, itself included, with"
_BOTH = "(copies of random phases or of reordered pieces; the larger of the two shares)"

# In the order of the table: name -> (unit, what it is).
COLUMNS: dict[str, tuple[str, str]] = {
    "name": ("", f"component of the row; {ALL}: all components together"),
    "variance_percent": ("%", "share of the model's variance that the component explains"),
    "visible_share": ("", "share of the component that lies inside the mask or region; 1 for the whole face"),
    "correlation": (
        "",
        f"Pearson correlation over paired frames; {ALL}: sum of the covariances divided by the root of the product of "
        "the summed variances",
    ),
    "correlation_p": ("", f"{_SHIFTED} a correlation at least as high"),
    "correlation_p_familywise": (
        "",
        "correlation_p corrected for the number of components (Westfall and Young 1993, single step)",
    ),
    "cosine": ("", "cosine of the angle between the two sequences as vectors from the model's mean face"),
    "gain": ("", "slope of the regression of the imitation on the stimulus, both without their means"),
    "distance_sd": (
        "SD",
        "root mean square over paired frames of the Euclidean distance, each component in its SD",
    ),
    "distance_sd_p": ("", f"{_SHIFTED} a distance at least as small"),
    "distance": (
        "loading",
        "root mean square over paired frames of the Euclidean distance, in plain loadings",
    ),
    "distance_centred_sd": ("SD", "distance_sd after the mean of each sequence is subtracted"),
    "mutual_information_nats": (
        "nat",
        "mutual information of paired frames (Kraskov, Stögbauer and Grassberger 2004, estimator 1, 3 neighbours); "
        f"{ALL}: sum over components",
    ),
    "mutual_information_nats_p": ("", f"{_SHIFTED} at least as much mutual information"),
    "entropy_stimulus_nats": (
        "nat",
        "differential Shannon entropy of the stimulus' loadings in SD (Ebrahimi, Pflughoeft and Soofi 1994); "
        f"{ALL}: sum over components",
    ),
    "entropy_imitation_nats": (
        "nat",
        "differential Shannon entropy of the imitation's loadings in SD, likewise",
    ),
    "lag_frames": (
        "frame",
        "lag at which the correlation is highest, with at least half of the shorter sequence in common; positive: the "
        "imitation is later",
    ),
    "lag_s": ("s", "lag_frames in seconds; empty if the frame rate is unknown"),
    "correlation_at_lag": ("", "correlation at that lag"),
    "correlation_at_lag_p": ("", f"{_COPIED} a correlation at least as high at its own best lag {_BOTH}"),
    "correlation_aligned": (
        "",
        "correlation after dynamic time warping: one alignment for all components, which shifts a frame by at most a "
        "quarter of the longer sequence",
    ),
    "correlation_aligned_p": (
        "",
        f"{_COPIED} a correlation at least as high after its own alignment {_BOTH}",
    ),
    "alignment_cost": (
        "",
        "mean distance of aligned frames, after both sequences are centred and scaled to a mean square of 1; only in "
        f"the row {ALL}",
    ),
    "alignment_cost_p": ("", f"{_COPIED} a cost at least as low {_BOTH}"),
    "alignment_steps": ("step", f"number of pairs of aligned frames; only in the row {ALL}"),
    "alignment_timing_rms_frames": (
        "frame",
        "root mean square of the difference between the alignment and an imitation that runs evenly from start to end; "
        f"only in the row {ALL}",
    ),
    "alignment_delay_frames": (
        "frame",
        "mean delay of the imitation relative to one that runs evenly from start to end; only in the row "
        f"{ALL}",
    ),
    "undefined": ("", "the reason why measures of the row are empty"),
}

Share = Annotated[float, Gt(0), Le(1)]
Frames = Annotated[int, Ge(3)]
Count = Annotated[int, Ge(0)]
Names = list[Annotated[str, Pattern("pc[0-9]{3,}", "the name of a component")]]
_PART = f" *({'|'.join(REGIONS)}) *"


class FrameNames(TypedDict):
    """Names of frames of both motions; null for a table."""

    stimulus: OrNull[list[str]]
    imitation: OrNull[list[str]]


class Outside(TypedDict):
    """Energy outside the model's space, of both motions."""

    stimulus: OrNull[Annotated[float, Ge(0)]]
    imitation: OrNull[Annotated[float, Ge(0)]]


class Still(TypedDict):
    """Components of both motions that do not move."""

    stimulus: Names
    imitation: Names


class LeastP(TypedDict):
    """The smallest possible p of each kind of measure."""

    frame_by_frame: Share
    information: Share
    lag: Share
    alignment: Share


class Measures(TypedDict):
    """The entries of measures.json (data_spec/imitation-table.md)."""

    format: Literal["morphspace-imitation"]
    version: Literal[1]
    columns: Columns
    model_id: str
    identity: str
    imitator_model_id: OrNull[str]
    imitator_identity: OrNull[str]
    frame_rate_hz: OrNull[FrameRate]
    stimulus_frames: Frames
    imitation_frames: Frames
    paired_frames: Frames
    components: Annotated[int, Ge(1)]
    permutations: Count
    seed: Count
    mask: OrNull[str]
    region: Annotated[str, Pattern(f"{_PART}(\\+{_PART})*", "parts of the face joined by +")]
    imitator: OrNull[str]
    carried_by: OrNull[Literal["paper", "map", "guided", "transfer"]]
    shifts: Count
    shifts_of_information: Count
    shifts_are_all_there_are: bool
    copies_of_lag: Count
    copies_of_alignment: Count
    least_p: LeastP
    frames_without_face: FrameNames
    outside_space: Outside
    still: Still
    notes: list[str]
    versions: Versions


MEASURES = Document(
    "imitation-table", "morphspace imitation, version 1: the JSON beside measures.csv", Measures
)

# Of each number in the file. Loadings of one clip by another build, flow or machine move measures in the third.
DECIMALS = {"variance_percent": 3, "distance": 6, "lag_frames": 3, "alignment_steps": 0}
P_DECIMALS = 6  # a p is a count over the permutations
OTHERS = 4  # decimals of every other measure
TEXTS = "name", "undefined"


def component_names(count: int) -> list[str]:
    """Return the names of the rows: the components, then all together.

    Examples
    --------
    >>> component_names(2)
    ['pc001', 'pc002', 'all']
    """
    return [*(f"pc{number:03d}" for number in range(1, count + 1)), ALL]


def reasons_of(comparison: Comparison, stimulus_sd: LoadingTable, imitation_sd: LoadingTable) -> list[str]:
    """Return for each row why measures are undefined; "" if all are defined."""
    n = min(len(stimulus_sd), len(imitation_sd))
    motions = {"stimulus": stimulus_sd, "imitation": imitation_sd}
    reasons = []
    for place in range(stimulus_sd.shape[1] + 1):
        columns = slice(None) if place == stimulus_sd.shape[1] else slice(place, place + 1)
        found = []
        for role, values in motions.items():
            if not varies(values[:n, columns]).any():
                later = f" in the first {n} frames" if varies(values[:, columns]).any() else ""
                found.append(f"the {role} does not move{later}")
        reasons.append("; ".join(found or _missing(comparison, place, n)))
    return reasons


def still_names(stimulus_sd: LoadingTable, imitation_sd: LoadingTable) -> dict[str, list[str]]:
    """Return for stimulus and imitation the names of the components that are constant.

    Examples
    --------
    >>> import numpy as np
    >>> still_names(np.array([[0.0, 1.0], [1.0, 1.0]]), np.array([[0.0, 1.0], [1.0, 2.0]]))
    {'stimulus': ['pc002'], 'imitation': []}
    """
    names = component_names(stimulus_sd.shape[1])
    return {
        role: [name for name, moves in zip(names, varies(values), strict=False) if not moves]
        for role, values in (("stimulus", stimulus_sd), ("imitation", imitation_sd))
    }


def still_words(stimulus_sd: LoadingTable, imitation_sd: LoadingTable) -> tuple[str, ...]:
    """Return one line if the stimulus, the imitation or both are constant, else nothing.

    Examples
    --------
    >>> import numpy as np
    >>> moving = np.array([[0.0], [1.0], [3.0]])
    >>> still_words(moving, 0 * moving)
    ('the imitation does not move: correlation, gain, lag and alignment are undefined; the distance is 1.83 SD',)
    """
    count = stimulus_sd.shape[1]
    names = [role for role, found in still_names(stimulus_sd, imitation_sd).items() if len(found) == count]
    if not names:
        return ()
    n = min(len(stimulus_sd), len(imitation_sd))
    apart = float(np.sqrt(((stimulus_sd[:n] - imitation_sd[:n]) ** 2).sum(axis=1).mean()))
    what = (
        f"the {names[0]} does not move" if len(names) == 1 else "neither the stimulus nor the imitation moves"
    )
    return (f"{what}: correlation, gain, lag and alignment are undefined; the distance is {apart:.2f} SD",)


def still_components_words(stimulus_sd: LoadingTable, imitation_sd: LoadingTable) -> list[str]:
    """Return a line for each motion in which some, but not all, components are constant."""
    words = []
    for role, names in still_names(stimulus_sd, imitation_sd).items():
        if 0 < len(names) < stimulus_sd.shape[1]:
            some = ", ".join(names[:NAMED]) + (" ..." if len(names) > NAMED else "")
            words.append(
                f"{len(names)} of {stimulus_sd.shape[1]} components of the {role} do not move ({some}): their "
                "undefined measures are empty, and the column `undefined` gives the reason"
            )
    return words


def _missing(comparison: Comparison, place: int, n: int) -> list[str]:
    if n < LEAST_FRAMES_INFORMATION:
        return [f"{n} frames: information and entropy need {LEAST_FRAMES_INFORMATION}"]
    entropies = [comparison.measures[f"entropy_{role}_nats"][place] for role in ("stimulus", "imitation")]
    return [] if np.isfinite(entropies).all() else ["too many equal values for an entropy"]


def write_measures(
    folder: Path,
    comparison: Comparison,
    variance_percent: AnyArray,
    visible_share: AnyArray,
    rate_hz: float | None,
    reasons: Sequence[str],
    described: Mapping[str, Any],
) -> tuple[Path, Path]:
    """Write measures.csv, and measures.json with the meaning of its columns and the entries of `described`.

    Parameters
    ----------
    folder : Path
    comparison : Comparison
    variance_percent, visible_share : array (k,)
    rate_hz : float or None
    reasons : sequence of k + 1 str
        As `reasons_of` returns them.
    described : mapping
        Further entries of measures.json.

    Returns
    -------
    tuple of Path
        The table and its description.
    """
    k = len(variance_percent)
    nothing = np.full(k, np.nan)
    measures = comparison.measures
    alignment = comparison.alignment
    moves = np.isfinite(measures["alignment_cost"][-1])
    path_figures = {
        "alignment_steps": float(len(alignment.path)),
        "alignment_timing_rms_frames": alignment.timing_rms_frames,
        "alignment_delay_frames": alignment.delay_frames,
    }
    values: dict[str, Sequence[Any]] = {
        "name": component_names(k),
        "variance_percent": [*variance_percent.tolist(), float(variance_percent.sum())],
        "visible_share": [*visible_share.tolist(), None],
        "lag_s": (measures["lag_frames"] / rate_hz if rate_hz else np.full(k + 1, np.nan)).tolist(),
        **{name: values.tolist() for name, values in measures.items()},
        **{name: [*nothing.tolist(), value if moves else None] for name, value in path_figures.items()},
        "undefined": list(reasons),
    }
    table, beside = folder / "measures.csv", folder / "measures.json"
    document = {
        "format": "morphspace-imitation",
        "version": 1,
        "columns": {name: {"unit": unit, "meaning": meaning} for name, (unit, meaning) in COLUMNS.items()},
        **described,
        "versions": versions(),
    }
    write_texts(
        {
            table: metrics_text(table, {name: _rounded(name, values[name]) for name in COLUMNS}),
            beside: json_text(document),
        }
    )
    return table, beside


def _rounded(name: str, values: Sequence[Any]) -> list[Any]:
    """Round the numbers of a column to its number of decimals; texts are unchanged."""
    if name in TEXTS:
        return list(values)
    others = P_DECIMALS if name.endswith(("_p", "_p_familywise")) else OTHERS
    decimals = DECIMALS.get(name, others)
    return [None if value is None else round(float(value), decimals) + 0.0 for value in values]
