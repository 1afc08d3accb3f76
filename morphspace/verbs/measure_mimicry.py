"""measure-mimicry: how close a real imitation comes to its stimulus, in the stimulus' own expression space.

Nagle section 5.1: both sequences are loadings on one model, and are compared by distances, correlation, mutual
information and entropy. A clip is encoded with the model; a table of loadings, such as `mimic` writes, is taken as it
is.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphspace.errors import BadInput
from morphspace.face.detector import Detector, own_detector
from morphspace.face.regions import WHOLE
from morphspace.model.encode import check_components
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import Outcome
from morphspace.sets.imitation import (
    VERB,
    WRITTEN,
    MeasureSettings,
    WrittenImitation,
    mark_of,
    written_imitation,
)
from morphspace.sets.protect import check_file, check_ours, no_empty_folders
from morphspace.steps import Steps


@dataclass(frozen=True)
class MeasureMimicryRequest:
    """Measure how `imitation` follows `stimulus`, each a clip or a loadings table (.csv), in the space of `model`.

    `output` is a folder (None: named after the imitation); `components` the first so many (None: all both have);
    `mask` a grey picture on the mean face, or `region` by name: both sequences are then measured from that part alone.
    `imitator` is the model of who imitates, where that is another person: the imitation is read in it and carried over.
    """

    stimulus: str
    imitation: str
    model: Path
    output: Path | None = None
    components: int | None = None
    permutations: int = 1000
    seed: int = 0
    mask: Path | None = None
    region: str = WHOLE
    imitator: Path | None = None


def run(request: MeasureMimicryRequest, detector: Detector | None = None) -> Steps[Outcome]:
    """Write measures.csv, the loadings of both, a video side by side and index.html. Returns an `Outcome`.

    Its document has `no_face`, the number of frames in which no face was found. `detector` None takes the package's
    own, where its files have been fetched.
    """
    model = load_model(request.model)
    _check_request(request, model)
    folder = request.output or Path(f"{Path(request.imitation).stem or 'clip'}-mimicry")
    kept = [Path(given) for given in (request.stimulus, request.imitation)]
    for name in WRITTEN:
        check_file(folder / name, Path(name).suffix, kept)
    for path in kept:
        if path.is_dir() and folder.resolve() == path.resolve():
            raise BadInput(
                f"the output folder {folder} is one of the two clips: choose another output folder"
            )
    check_ours(folder, VERB, WRITTEN)
    settings = MeasureSettings(
        request.components,
        request.permutations,
        request.seed,
        request.mask,
        request.region,
        request.imitator,
    )
    with no_empty_folders(folder, ()), mark_of(folder):
        made = yield from written_imitation(
            folder,
            request.model,
            model,
            request.stimulus,
            request.imitation,
            settings,
            detector or own_detector(),
        )
    return _outcome(folder, made)


def _check_request(request: MeasureMimicryRequest, model: MorphModel) -> None:
    if model.rank == 0:
        raise BadInput(
            f"{request.model} has no component: nothing can be measured in its space; build it from more frames"
        )
    check_components(request.components)
    if request.permutations < 0:
        raise BadInput(f"{request.permutations} permutations cannot be drawn: give 0 or more")
    if request.mask is not None and request.region != WHOLE:
        raise BadInput(f"both the mask {request.mask} and the region {request.region} were given: choose one")


def _outcome(folder: Path, made: WrittenImitation) -> Outcome:
    comparison, told = made.comparison, made.told
    last = {name: float(values[-1]) for name, values in comparison.measures.items()}
    document = {name: value if np.isfinite(value) else None for name, value in last.items()}
    document |= {"alignment_timing_rms_frames": comparison.alignment.timing_rms_frames}

    def said(name: str, decimals: int = 2) -> str:
        return f"{last[name]:.{decimals}f}" if np.isfinite(last[name]) else "undefined"

    first = f"{folder}: {told['paired_frames']} frames in pairs, {told['components']} components"
    if made.still:
        return Outcome(
            (first, *made.still), {"output": str(folder), **told, **document}, made.notes, made.files
        )
    lines = (
        first,
        f"correlation {said('correlation')} (p {said('correlation_p', 3)}), gain {said('gain')}, distance "
        f"{said('distance_sd')} SD",
        f"correlation at its best lag of {said('lag_frames', 0)} frames {said('correlation_at_lag')} (p "
        f"{said('correlation_at_lag_p', 3)}, chance at its own best lag); aligned {said('correlation_aligned')} (p "
        f"{said('correlation_aligned_p', 3)}, chance aligned too), frames moved by "
        f"{comparison.alignment.timing_rms_frames:.1f} rms",
    )
    return Outcome(lines, {"output": str(folder), **told, **document}, made.notes, made.files)
