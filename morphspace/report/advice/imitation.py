"""Advice on a measured imitation: what to know before its measures are read, and the remedy."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable
from morphspace.imitation import Comparison
from morphspace.imitation.motions import Motion
from morphspace.model.model import MorphModel

# Means farther apart than this come from another face, light or camera, not from another expression
MOVED_SD = 2.0
HARDLY = 0.05  # of the other's motion, root mean square
SAME = 0.999  # a correlation with nothing left to find by a lag
# If p cannot fall below it, the reader should know: the smallest p then rest on one or two shifts
SMALL_P = 0.02


def mean_apart(a_sd: LoadingTable, b_sd: LoadingTable, imitation: Motion, notes: list[str]) -> AnyArray:
    """Return the offset of the stimulus' mean from the imitation's (k,), 0 where they are close; add a note if not."""
    apart = a_sd.mean(axis=0) - b_sd.mean(axis=0)
    farthest = int(np.abs(apart).argmax())
    if abs(apart[farthest]) <= MOVED_SD:
        return np.zeros_like(apart)
    why = "another face, light or camera"
    if imitation.imitator is not None:
        why = "the neutral faces of the two models differ, or the imitation shows mostly one expression"
    notes.append(
        f"the mean of the imitation is {abs(apart[farthest]):.1f} SD from that of the stimulus (pc{farthest + 1:03d}). "
        f"The likely cause is {why}. Distances include this offset; distance_centred_sd, correlations and the video do "
        "not"
    )
    return np.asarray(apart)


def strange_words(
    stimulus: Motion, imitation: Motion, model: MorphModel, faceless: Collection[str]
) -> list[str]:
    """Note each clip that evidently differs from the model in person, camera or light, with the remedy.

    A role in `faceless`, whose frames show no face at all, gets no note.
    """
    words = []
    for role, source, remedy in (
        ("stimulus", stimulus, "Give the stimulus' own model as --model"),
        (
            "imitation",
            imitation,
            "Build a model of the imitator, set its keypoints (morphspace keypoints), and give it as --imitator",
        ),
    ):
        if source.is_strange and role not in faceless:
            words.append(
                f"the {role} {source.name} is evidently of another person, day or camera than {model.identity}: the "
                f"energy of its frames outside the model's space is {source.outside:.1f} times the model's variance; "
                f"expected about 0.2. The measures then compare faces more than motions. {remedy}"
            )
    return words


def size_words(stimulus: LoadingTable, imitation: LoadingTable) -> list[str]:
    """Note loadings (n, k), (m, k) of which one hardly moves compared with the other."""
    sizes = {
        role: float(np.sqrt(values.var(axis=0).sum()))
        for role, values in (("stimulus", stimulus), ("imitation", imitation))
    }
    return [
        f"the {role} hardly moves: its motion is {100 * size / sizes[other]:.1f} % of the {other}'s. A correlation "
        "with it may be noise"
        for role, size, other in (
            ("stimulus", sizes["stimulus"], "imitation"),
            ("imitation", sizes["imitation"], "stimulus"),
        )
        if 0 < size < HARDLY * sizes[other]
    ]


def chance_words(comparison: Comparison) -> list[str]:
    """Note where no p can be small, and where the best lag is the longest that was searched."""
    notes = []
    baseline = comparison.baseline
    least = baseline.least
    if least["frame_by_frame"] > SMALL_P:
        searched = max(least["lag"], least["alignment"])
        others = (
            f" (at the best lag and aligned, below {searched:.2g})"
            if searched < least["frame_by_frame"]
            else ""
        )
        why = "more frames" if baseline.is_exhaustive else "more permutations"
        notes.append(
            f"with {len(baseline.shifts)} circular shifts, p of frames in pairs cannot be below "
            f"{least['frame_by_frame']:.2g}{others}. A smaller p needs {why}"
        )
    lag = comparison.measures["lag_frames"][-1]
    if lag in (comparison.lags[0], comparison.lags[-1]) and comparison.measures["correlation"][-1] < SAME:
        notes.append(
            f"the best lag, {lag:.0f} frames, is the longest that was tried. The true lag may be longer, or the "
            "motions may be unrelated"
        )
    return notes
