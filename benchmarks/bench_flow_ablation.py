"""What each part of the registration form is worth: presets with one thing changed, on what they were tuned on."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from bench_tables import print_table, tell
from flow_estimators import Prepare, Prepared, one_thread, real_of
from flow_truth import REAL_PAIRS, RealPair, face_sets, real_pairs, scene_pairs

from morphspace.arrays import Image
from morphspace.flow import multiscale, presets
from morphspace.flow.presets import Preset
from morphspace.linear.quality import flow_errors
from morphspace.synthetic.warped import FlowPair

BASES = ("fast", "balanced", "accurate")
WITH_REAL = ("balanced",)  # the real pairs cost as much again
HIGHEST_ORDERS = (0, 1, 2, 3)
LEAST_ORDERS = 2  # rivals are judged by second derivatives, which orders 0 and 1 need
COARSE_LIGHTS = (0.0, 2.0, 6.0)
SDS_PX = (0.5, 0.7, 0.85, 1.0)
FACTORS = (0.5, 0.7, 0.8)
WARPS = ((1, 1, 1), (1, 1, 2), (1, 2, 2), (1, 1, 2, 6), (1, 2, 4, 4), (2, 3, 4, 4), (3, 4, 5, 5))
ROUNDS = ((1,), (2,), (3, 2), (3,), (4, 2), (4,))
COUPLINGS = (0.1, 0.2, 0.4, 0.8)
POOLINGS_PX = (0.0, 0.6, 1.0)
FINESTS = (0.375, 0.5, 0.7, 1.0)
CHECKED_PX = (0, 70, 140)
SINGLE_STRENGTH = 10.0  # of a single smoothing that smooths about as far
NEVER_LIGHT, NEVER_FAR = 1e6, 30.0  # codes; px
TYPICAL_MISS_PX = (0.1, 0.3)


@dataclass(frozen=True, eq=False)
class Figures:
    """What a variant gives: end-point errors (px) by set, ms a face pair, and the three figures of the real pairs."""

    faces: dict[str, float]
    scenes: float
    ms: float
    real: str


def flow_ablation(data: Path) -> None:
    """Measure and print all variants."""
    print("## Flow: what each part is worth\n")
    print(
        'One thing changed at a time; mean end-point errors (px) on the part "tune" of the faces (six pairs a set) and '
        "on the three scenes: what the presets were tuned on. `faces x`: the error over the preset's, geometric mean "
        "of the face sets; above 1 the change costs accuracy. Orders: order 0 weighs as in the preset and each other "
        "1, then all are scaled to weigh as much together as in the preset. Coarse: the weight of order 0 at coarse "
        "scales. Robust weights off: all residuals weigh as one of the stated size does in the preset. Real pairs: "
        f"RMSE / forward-backward px / folds %, {sum(len(strong) for *_, strong in REAL_PAIRS['tune'])} pairs of the "
        "tune part. ms: processor time of a face pair, rough.\n"
    )
    faces = face_sets(data, "tune")
    scenes = scene_pairs(data)
    real = real_pairs(data, "tune")
    heads = ["preset", "change", *faces, "faces x", "scenes", "scenes x", "real pairs", "ms"]
    rows = []
    with one_thread():
        for name in BASES:
            base = measured(presets.PRESETS[name], faces, scenes, real if name in WITH_REAL else ())
            rows.append(_row(name, "none", base, base))
            for change, preset in variants(presets.PRESETS[name]):
                tell(f"flow-ablation: {name}, {change}")
                found = measured(preset, faces, scenes, real if name in WITH_REAL else ())
                rows.append(_row(name, change, found, base))
    print_table(heads, rows)


def _row(name: str, change: str, found: Figures, base: Figures) -> list[str]:
    shares = [found.faces[what] / base.faces[what] for what in base.faces]
    return [
        name,
        change,
        *(f"{value:.3f}" for value in found.faces.values()),
        f"{np.exp(np.mean(np.log(shares))):.2f}",
        f"{found.scenes:.3f}",
        f"{found.scenes / base.scenes:.2f}",
        found.real,
        f"{found.ms:.0f}",
    ]


def variants(base: Preset) -> Iterator[tuple[str, Preset]]:
    """Give a preset's variants, named; those that are the preset itself are left out."""
    as_it_is = asdict(base)
    for name, preset in _all_variants(base):
        if asdict(preset) != as_it_is:
            yield name, preset


def _all_variants(base: Preset) -> Iterator[tuple[str, Preset]]:
    channels = base.channels
    for highest in HIGHEST_ORDERS:
        name = f"orders 0-{highest}" if highest else "order 0"
        yield name, _with_orders(base, (channels.weights[0], *(1.0,) * highest))
    yield "orders 1-2", replace(_with_orders(base, (0.0, 1.0, 1.0)), coarse_light=0.0)
    for weight in COARSE_LIGHTS:
        yield f"coarse order 0: {weight:g}", replace(base, coarse_light=weight)
    for sd_px in SDS_PX:
        yield f"sd {sd_px:g} px", replace(base, channels=replace(channels, sd_px=sd_px))
    for factor in FACTORS:
        yield f"factor {factor:g}", replace(base, factor=factor)
    for warps in WARPS:
        yield f"warps {', '.join(map(str, warps))}", replace(base, warps=warps)
    for rounds in ROUNDS:
        yield f"rounds of robust weights {', '.join(map(str, rounds))}", replace(base, rounds=rounds)
    for coupling in COUPLINGS:
        yield f"coupling {coupling:g}", replace(base, coupling=coupling)
    for sd_px in POOLINGS_PX:
        yield f"pooling over {sd_px:g} px", replace(base, integration_px=sd_px)
    for finest in FINESTS:
        yield f"finest {finest:g}", replace(base, finest=finest)
    for miss_px in TYPICAL_MISS_PX:
        # all weights become 1 / NEVER_FAR where they were about 1 / miss_px: the coupling goes down with them
        coupling = base.coupling * float(np.hypot(miss_px, base.robust_px)) / NEVER_FAR
        name = f"robust weights off, {miss_px:g} px"
        yield name, replace(base, robust_px=NEVER_FAR, coupling=coupling)
    yield "light gate off", replace(base, channels=replace(channels, light_codes=NEVER_LIGHT))
    yield "one smoothing", replace(base, smoothings=1)
    name = f"one smoothing, strength {SINGLE_STRENGTH:g}"
    yield name, replace(base, smoothings=1, strength=SINGLE_STRENGTH)
    yield "rivals off", replace(base, rivals_px=0)
    for checked_px in CHECKED_PX:
        name = f"way back checked at {checked_px} px" if checked_px else "way back not checked"
        yield name, replace(base, checked_px=checked_px)
    yield "grey", replace(base, colours="grey")


def _with_orders(base: Preset, weights: tuple[float, ...]) -> Preset:
    """Give the preset with other weights of the orders, scaled so that all channels weigh as much as before."""
    channels = base.channels
    if weights == channels.weights or not any(weights):  # `fast` has no order 0 at fine scales
        return base
    scale = _together(channels.weights) / _together(weights)
    scaled = tuple(scale * weight for weight in weights)
    if len(scaled) < LEAST_ORDERS:
        scaled = (*scaled, *(0.0,) * (LEAST_ORDERS - len(scaled)))
    return replace(base, channels=replace(channels, weights=scaled))


def _together(weights: Sequence[float]) -> float:
    """Give the weight of all channels; there are n + 1 of total order n."""
    return sum((order + 1) * weight for order, weight in enumerate(weights))


def _prepare(preset: Preset) -> Prepare:
    """Give a variant on colour, from scratch."""

    def prepare(reference: Image, frame: Image) -> Prepared:
        return lambda: multiscale.method(preset)(reference)(frame, None).displacement

    return prepare


def measured(
    preset: Preset,
    faces: dict[str, tuple[FlowPair, ...]],
    scenes: Sequence[FlowPair],
    real: Sequence[RealPair],
) -> Figures:
    """Run a variant on everything."""
    prepare = _prepare(preset)
    start = time.process_time()
    errors = {what: float(np.mean([_aee(prepare, pair) for pair in pairs])) for what, pairs in faces.items()}
    ms = 1e3 * (time.process_time() - start) / sum(map(len, faces.values()))
    on_scenes = float(np.mean([_aee(prepare, pair) for pair in scenes]))
    three = ""
    if real:
        found = [real_of(prepare, pair) for pair in real]
        values = [(one.rmse, one.forward_backward_px, one.folded_percent) for one in found]
        three = "{:.2f} / {:.2f} / {:.2f}".format(*np.mean(values, axis=0))
    return Figures(errors, on_scenes, ms, three)


def _aee(prepare: Prepare, pair: FlowPair) -> float:
    truth = np.where(pair.visible[..., None], pair.truth, np.float32(np.inf))
    return flow_errors(prepare(pair.reference, pair.frame)(), truth).aee_px
