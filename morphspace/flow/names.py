"""The names of the flow methods, so that the command line can list them without importing the methods."""

from __future__ import annotations

OURS: tuple[str, ...] = ("fast", "balanced", "accurate", "paper")
"""Presets of our estimator, the fastest first, and the reconstructed scheme of Nagle et al."""

STOCK: tuple[str, ...] = ("deepflow", "dis", "tvl1")
"""Estimators from OpenCV and scikit-image, for comparison."""

NAMES = OURS + STOCK
DEFAULT = "balanced"

BACKENDS = ("opencv", "torch", "torch:cpu", "torch:cuda")
"""Libraries and devices of our presets except `paper`: OpenCV on the CPU, torch on the best or a named device."""
DEFAULT_BACKEND = "opencv"
