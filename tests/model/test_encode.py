"""Encoding: what of a face lies outside a model's space."""

import numpy as np
import pytest

from morphspace.model.encode import energy_outside
from morphspace.model.morph import MorphOffset


def test_energy_outside_is_what_the_components_leave(model):
    """Half a training face lies inside; what no component holds counts by its energy in the model's variances."""
    offset = model.offset(0.5 * model.training.values[0])
    assert energy_outside(offset, model) < 1e-4
    rng = np.random.default_rng(2)
    values = rng.standard_normal(model.basis.components.shape[1]).astype(np.float32)
    values -= model.basis.expand(model.basis.project(values))
    stranger = offset + MorphOffset(values, offset.shape, offset.reference_id)
    energy = (model.basis.weight * values * values).sum()
    variance = model.basis.variances.sum() + model.basis.discarded_variance
    assert energy_outside(stranger, model) == pytest.approx(energy / variance, rel=1e-4)
