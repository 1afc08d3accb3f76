"""The mixture of some faces that comes nearest to another: a convex quadratic programme over the simplex (ours).

Weights that are not negative and sum to 1 keep a mixture among what is mixed. Each face may cost something for its
part, so that of many mixtures alike the one of few and near faces is taken, as in locality-constrained coding (Wang et
al., CVPR 2010). An active-set method (Nocedal and Wright, Numerical Optimization, 2006, algorithm 16.3): few faces have
a part in the end, so each step is a system of a few equations.
"""

from __future__ import annotations

import numpy as np

from morphspace.arrays import AnyArray

STEPS = 500  # a face joins or leaves in each; some 5 to 20 are taken
RELATIVE_TOL = 1e-9  # of the largest squared distance: what a further face would gain
RIDGE = 1e-10  # likewise; among more faces than dimensions no mixture is otherwise the only one
LEAST_PART = 1e-12


def nearest_mixture(apart: AnyArray, costs: AnyArray) -> AnyArray:
    """Give the weights w (n,), none negative, sum 1, for which |w apart|^2 + w costs is least.

    `apart` (n, m) is how far each of n faces lies from the one that is looked for, `costs` (n,) what each costs. A face
    that is not apart and costs nothing is taken alone.
    """
    count = len(costs)
    gram = apart @ apart.T
    scale = float(max(np.diag(gram).max(), np.abs(costs).max()))
    weights = np.zeros(count)
    start = int(np.argmin(np.diag(gram) + costs))
    weights[start] = 1.0
    if scale == 0:
        return weights
    gram[np.diag_indices(count)] += RIDGE * scale
    double = 2 * gram
    taken = [start]
    for _ in range(STEPS):
        wanted = _on_plane(double, costs, taken)
        now = weights[taken]
        if (wanted >= 0).all():
            weights[taken] = wanted
            slope = double @ weights + costs
            best = int(np.argmin(slope))
            if slope[best] >= float(slope[taken].min()) - RELATIVE_TOL * scale:
                break
            taken.append(best)
            continue
        falling = wanted < 0
        step = float((now[falling] / (now[falling] - wanted[falling])).min())
        moved = now + step * (wanted - now)
        weights[taken] = np.where(moved > LEAST_PART, moved, 0.0)
        taken = [place for place, part in zip(taken, moved, strict=True) if part > LEAST_PART]
    return weights / weights.sum()


def _on_plane(double: AnyArray, costs: AnyArray, taken: list[int]) -> AnyArray:
    """Give the weights (m,) of the faces taken, sum 1, at which the aim is least, negative ones allowed.

    `double` (n, n) is twice the inner products of all faces.
    """
    size = len(taken)
    system, told = np.ones((size + 1, size + 1)), np.ones(size + 1)
    system[:size, :size] = double[taken][:, taken]
    system[size, size] = 0.0
    told[:size] = -costs[taken]
    return np.linalg.solve(system, told)[:size]
