"""The most probable face of a model for what is seen of it, and the bound that keeps it a face.

A model is taken as probabilistic PCA (Tipping and Bishop 1999): each loading has a variance, and what the components
leave out is noise. What is seen may be part of an offset, and where landmarks lie (methods 5, steps 4 and 6).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from morphspace.arrays import AnyArray, LoadingVector
from morphspace.model.model import MorphModel

KNEE = 4.0  # how sharply the bound sets in: at a third of it a loading keeps .997 of its length
BLOCK = 2**15  # columns of the components at a time: 26 MB of float64 for a hundred


@dataclass(frozen=True, eq=False)
class InnerProducts:
    """The inner products of a model's components with offsets, seen where `weight` (5 h w,) says.

    Many pixels lie outside every mask. The components at the others are copied once, which halves what each face
    reads.
    """

    model: MorphModel
    weight: AnyArray

    @cached_property
    def places(self) -> AnyArray:
        """Where something is seen, (n,)."""
        return np.flatnonzero(self.weight)

    @cached_property
    def weighed(self) -> AnyArray:
        """The components there, weighed: (k, n) float32."""
        weighed = np.ascontiguousarray(self.model.basis.components[:, self.places], np.float32)
        weighed *= self.weight[self.places]
        return weighed

    def with_offset(self, offset: AnyArray) -> LoadingVector:
        """Give the inner products (k,) with a mean-relative vector (5 h w,)."""
        return np.asarray(self.weighed @ np.take(offset, self.places), np.float64)


@dataclass(frozen=True, eq=False)
class Guide:
    """How far the target's landmarks move with its loadings, and how far the source asks them to (methods 5, step 6).

    `weights` (k_B, 2 m) px per loading of the target | `precision` (2 m,) 1 / px^2, what an observation counts |
    `asked` (k_A, 2 m) px on the target's mean face per loading of the source.
    """

    weights: AnyArray
    precision: AnyArray
    asked: AnyArray


@dataclass(frozen=True, eq=False)
class Solver:
    """The most probable loadings given an offset seen where `weight` (5 h w,) says: the posterior of the target's
    probabilistic PCA (Tipping and Bishop 1999), l = (P' C P + sigma^2 diag(1 / variances))^-1 P' C r, with `noise` for
    sigma^2. With a `guide`, landmarks W l ~ y of precision N join: P' C P + sigma^2 W N W', P' C r + sigma^2 W N y.
    """

    model: MorphModel
    weight: AnyArray
    noise: float
    guide: Guide | None = None

    @cached_property
    def inner_products(self) -> InnerProducts:
        """P' C."""
        return InnerProducts(self.model, self.weight)

    @cached_property
    def gram(self) -> AnyArray:
        """P' C P (k, k), summed over blocks of columns in float64."""
        components = self.model.basis.components
        total = np.zeros((len(components), len(components)))
        places, weighed = self.inner_products.places, self.inner_products.weighed
        for start in range(0, len(places), BLOCK):
            columns = slice(start, start + BLOCK)
            block = np.asarray(components[:, places[columns]], np.float64)
            total += np.asarray(weighed[:, columns], np.float64) @ block.T
        return total

    @cached_property
    def inverse(self) -> AnyArray:
        """(P' C P + sigma^2 W N W' + sigma^2 diag(1 / variances))^-1, (k, k)."""
        known = self.gram + np.diag(self.noise / self.model.basis.variances)
        if self.guide is not None:
            known = known + self.noise * (self.guide.weights * self.guide.precision) @ self.guide.weights.T
        return np.linalg.inv(known)

    def loadings(self, offset: AnyArray, moved: AnyArray | None = None) -> LoadingVector:
        """Give the loadings (k,) of a mean-relative vector (5 h w,), and of landmarks `moved` (2 m,) px."""
        told = self.inner_products.with_offset(offset)
        if self.guide is not None and moved is not None:
            told = told + self.noise * (self.guide.weights @ (self.guide.precision * moved))
        return self.inverse @ told


def bounded(loadings_sd: AnyArray, max_sd: float) -> AnyArray:
    """Give loadings (..., k) in SD drawn smoothly inside `max_sd`, each component by itself, its sign kept."""
    return loadings_sd / (1 + np.abs(loadings_sd / max_sd) ** KNEE) ** (1 / KNEE)
