"""The names of the flow methods without the methods, so that help can list them before anything heavy is imported."""

from __future__ import annotations

OURS: tuple[str, ...] = ("fast", "balanced", "accurate", "paper")
"""Presets of our own estimator, the quickest first, and the scheme of Nagle's authors as reconstructed."""

STOCK: tuple[str, ...] = ("deepflow", "dis", "tvl1")
"""Estimators from OpenCV and scikit-image, for comparison."""

NAMES = OURS + STOCK
DEFAULT = "balanced"

BACKENDS = ("opencv", "torch", "torch:cpu", "torch:cuda")
"""What our presets but `paper` run on: OpenCV on the CPU, torch on the best device, or on one of them."""
DEFAULT_BACKEND = "opencv"
