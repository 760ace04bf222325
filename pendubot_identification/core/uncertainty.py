"""How far an estimate may be off: standard errors that allow for residuals which hang together in time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .energy import Regression
from .quadratic import Quadratic

Array = NDArray[np.float64]

#: Fewer blocks say too little of how blocks differ; longer ones would leave fewer.
FEWEST_BLOCKS = 10


def bootstrap_covariance(
    regressions: Sequence[Regression],
    theta: Array,
    free: NDArray[np.bool_],
    *,
    block: float = 2.0,
    resamples: int = 200,
    seed: int = 1,
) -> Array:
    """Return the covariance of a least-squares estimate by the bootstrap of blocks (Kuensch 1989).

    Residuals that are integrals over overlapping stretches of time are far from independent, so that the textbook
    covariance is many times too small. What can be drawn again independently is whole blocks of time. Against the
    spread over 24 recordings of the virtual rig these standard errors are 0.8 to 2.2 times as large with the weak
    criterion, 0.7 to 2.1 with the energy criterion over 0.5 s, 0.5 to 2.3 with the cumulative one.

    Args:
        regressions: the residuals, one regression a recording.
        theta: the estimate, shape (D,).
        free: which parameters moved freely, shape (D,); one on its bound has no variance of this kind.
        block: length of the blocks [s]; shorter where there would be fewer than ten.
        resamples: how often as many blocks as there are, are drawn with replacement.
        seed: same seed, same result.

    Returns:
        Covariance, shape (D, D); NaN in the rows and columns of parameters that are not free, and all NaN for a single
        instant, which has no blocks.
    """
    covariance = np.full((len(theta), len(theta)), np.nan)
    blocks = _blocks(regressions, theta, free, block)
    size, count = int(free.sum()), len(blocks)
    if size == 0 or count < 2:
        return covariance
    # In coordinates in which the criterion of all blocks is round, sums of squares lose no digits.
    whole = Quadratic.pool([Quadratic(triangle, 1) for triangle in blocks])
    unwhitened = np.linalg.pinv(whole.phi)
    phi = blocks[:, :, :size] @ unwhitened
    residual = blocks[:, :, size] - phi @ (whole.phi @ whole.free_minimum())
    squares = np.einsum('bij,bik->bjk', phi, phi)
    gradients = np.einsum('bij,bi->bj', phi, residual)
    drawn = np.random.default_rng(seed).multinomial(count, np.full(count, 1 / count), size=resamples)
    # What is added to the squares is nothing but where a draw lacks every block that tells some parameter.
    sums = np.tensordot(drawn, squares, axes=1) + 1e-9 * np.eye(size)
    steps = np.linalg.solve(sums, (drawn @ gradients)[:, :, None])[:, :, 0] @ unwhitened.T
    covariance[np.ix_(free, free)] = np.atleast_2d(np.cov(steps, rowvar=False)) * count / (count - 1)
    return covariance


def _blocks(regressions: Sequence[Regression], theta: Array, free: NDArray[np.bool_], block: float) -> Array:
    """Return the triangle of every block of time, shape (blocks, F+1, F+1) for F free parameters."""
    spans = [float(np.ptp(r.t)) for r in regressions]
    length = min(block, sum(spans) / FEWEST_BLOCKS)
    triangles = []
    for r, span in zip(regressions, spans, strict=True):
        number = max(1, round(span / length)) if length else 1
        cuts = np.searchsorted(r.t, r.t[0] + span * np.arange(1, number) / number)
        y = r.y - r.phi[:, ~free] @ theta[~free]
        parts = zip(np.split(r.phi[:, free], cuts), np.split(y, cuts), strict=True)
        triangles += [Quadratic.reduce(phi, part).triangle for phi, part in parts]
    return np.array(triangles)
