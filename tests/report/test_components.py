"""Components on a page."""

import numpy as np
import pytest

from morphspace.report.components import explained


def test_variance_explained_rises_to_all(build):
    shares = explained(build.model)
    assert (np.diff(shares) >= 0).all()
    assert 0 < shares[0] < shares[-1] <= 100
    rows = build.model.truncate(3)
    assert explained(rows)[-1] == pytest.approx(shares[2], abs=0.01)  # percent: truncation keeps the total
