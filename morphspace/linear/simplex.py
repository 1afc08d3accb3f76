"""The convex mixture of faces that is nearest to another face: a quadratic programme over the simplex (ours).

Weights that are >= 0 and sum to 1 keep a mixture among the mixed faces. Each face may have a cost. Of many equal
mixtures the solution is then the one of few and near faces, as in locality-constrained coding (Wang et al., CVPR
2010). The solver is an active-set method (Nocedal and Wright, Numerical Optimization, 2006, algorithm 16.3). Few
faces have a positive weight, so each step solves a system of a few equations.
"""

from __future__ import annotations

import numpy as np

from morphspace.arrays import AnyArray

STEPS = 500  # upper limit; a face joins or leaves in each, and 5 to 20 are usual
RELATIVE_TOL = 1e-9  # share of the largest squared distance; least gain for which a further face joins
RIDGE = 1e-10  # share of the largest squared distance; makes the solution unique for many faces
LEAST_WEIGHT = 1e-12  # a face of a smaller weight leaves


def nearest_mixture(differences: AnyArray, costs: AnyArray) -> AnyArray:
    """Compute the weights z >= 0 of sum 1 that minimise |z D|^2 + z c.

    Parameters
    ----------
    differences : array (n, m)
        D: each of n faces minus the target face.
    costs : array (n,)
        c, of each face. A face equal to the target and without cost is the solution alone.

    Returns
    -------
    array (n,)

    References
    ----------
    Nocedal and Wright, Numerical Optimization, 2006, algorithm 16.3; Wang et al., CVPR 2010 (the costs).

    Examples
    --------
    >>> import numpy as np
    >>> nearest_mixture(np.array([[-1.0], [3.0]]), np.zeros(2)).round(6).tolist()
    [0.75, 0.25]
    """
    count = len(costs)
    gram = differences @ differences.T
    scale = float(max(np.diag(gram).max(), np.abs(costs).max()))
    weights = np.zeros(count)
    start = int(np.argmin(np.diag(gram) + costs))
    weights[start] = 1.0
    if scale == 0:
        return weights
    gram[np.diag_indices(count)] += RIDGE * scale
    hessian = 2 * gram
    active = [start]
    for _ in range(STEPS):
        wanted = _on_plane(hessian, costs, active)
        now = weights[active]
        if (wanted >= 0).all():
            weights[active] = wanted
            slope = hessian @ weights + costs
            best = int(np.argmin(slope))
            if slope[best] >= float(slope[active].min()) - RELATIVE_TOL * scale:
                break
            active.append(best)
            continue
        falling = wanted < 0
        step = float((now[falling] / (now[falling] - wanted[falling])).min())
        moved = now + step * (wanted - now)
        weights[active] = np.where(moved > LEAST_WEIGHT, moved, 0.0)
        active = [place for place, weight in zip(active, moved, strict=True) if weight > LEAST_WEIGHT]
    return weights / weights.sum()


def _on_plane(hessian: AnyArray, costs: AnyArray, active: list[int]) -> AnyArray:
    """Compute the weights (m,) of the active faces, of sum 1 and any sign, that minimise the objective.

    `hessian` (n, n) is twice the inner products of all faces.
    """
    size = len(active)
    system, right_side = np.ones((size + 1, size + 1)), np.ones(size + 1)
    system[:size, :size] = hessian[active][:, active]
    system[size, size] = 0.0
    right_side[:size] = -costs[active]
    return np.linalg.solve(system, right_side)[:size]
