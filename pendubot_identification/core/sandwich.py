"""Covariance of a trajectory estimate: what the information matrix says where residuals are noise, else a jackknife."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from .estimate import NORMAL_95
from .trajectory_fit import TrajectoryFit

Array = NDArray[np.float64]

#: With fewer recordings than this, blocks of time take their place as clusters.
FEWEST_RECORDINGS = 3
#: A block's length [s]: longer than what the segments of one motion have in common.
BLOCK = 4.0
#: Blocks at least; of short recordings they are shorter.
FEWEST_BLOCKS = 6


def trajectory_covariance(found: TrajectoryFit) -> tuple[Array, Array, str]:
    """Return covariance and standard errors of theta and delay, and in words how they were found.

    White residuals: the inverse of the condensed Gauss-Newton matrix times the residuals' variance. Otherwise the
    model errs more than the encoders, its errors hang together, and what counts is how the estimate moves from one
    recording to the next: the cluster-robust sandwich in its jackknife form (CR3; Bell and McCaffrey 2002), with
    recordings as clusters or, where there are fewer than three, blocks of 4 s. Few clusters make Student's
    quantile; it is part of the errors here, so that 1.96 of them hold the truth in 95 % of cases.

    Args:
        found: the fit of D parameters and the delay, G = D + 1.

    Returns:
        Covariance, shape (G, G), NaN where a bound holds; standard errors, shape (G,), of what a bound holds those
        that it would have without; a sentence.
    """
    fit, free = found.fit, found.fit.free
    information = fit.informations.sum(axis=0)
    if found.white:
        variance = found.variance
        covariance = variance * _inverse(information, free)
        words = f"Gauss-Newton; the residuals are white, with {variance:.2f} times the variance of the positions' noise"
    else:
        clusters, what = _clusters(found)
        count = int(clusters.max()) + 1
        moves = np.zeros((count, len(free)))
        for k in range(count):
            members = clusters == k
            rest = information - fit.informations[members].sum(axis=0)
            moves[k, free] = _solve(rest, fit.slopes[members].sum(axis=0), free)
        moves -= moves.mean(axis=0)
        quantile = float(stdtrit(max(count - 1, 1), 0.975)) / NORMAL_95
        covariance = quantile**2 * (count - 1) / count * moves.T @ moves
        words = f'cluster jackknife over {count} {what}; Student quantile {quantile * NORMAL_95:.2f} included'
    untold = free & (np.diag(information) <= 0)
    covariance[untold, untold] = np.inf
    std_error = np.sqrt(np.diag(covariance))
    everything = np.sqrt(np.diag(_inverse(information, np.ones_like(free))))
    told = free & ~untold
    if told.any():
        inflation = np.median(std_error[told] / np.sqrt(np.diag(_inverse(information, free)))[told])
        std_error = np.where(free, std_error, inflation * everything)
    covariance[~free], covariance[:, ~free] = np.nan, np.nan
    return covariance, std_error, words


def scaled_condition_number(found: TrajectoryFit) -> float:
    """Return the condition number of the residuals' derivative, columns scaled to one, of what no bound holds."""
    free = found.fit.free
    scaled, scale = _scaled(found.fit.informations.sum(axis=0)[np.ix_(free, free)])
    return float(np.sqrt(np.linalg.cond(scaled))) if np.isfinite(scale).all() else float('inf')


def _clusters(found: TrajectoryFit) -> tuple[NDArray[np.intp], str]:
    """Return the number of each segment's cluster, shape (L,), and what the clusters are."""
    if len(np.unique(found.group)) >= FEWEST_RECORDINGS:
        return np.unique(found.group, return_inverse=True)[1], 'recordings'
    spans = [np.ptp(found.start[found.group == g]) + found.length for g in np.unique(found.group)]
    block = min(BLOCK, sum(spans) / FEWEST_BLOCKS)
    labels = np.column_stack([found.group, (found.start - found.start.min()) // block])
    return np.unique(labels, axis=0, return_inverse=True)[1].ravel(), f'blocks of {block:.2g} s'


def _inverse(information: Array, free: NDArray[np.bool_]) -> Array:
    result = np.zeros_like(information)
    scaled, scale = _scaled(information[np.ix_(free, free)])
    result[np.ix_(free, free)] = np.linalg.pinv(scaled, hermitian=True) / scale / scale[:, None]
    return result


def _solve(information: Array, slope: Array, free: NDArray[np.bool_]) -> Array:
    scaled, scale = _scaled(information[np.ix_(free, free)])
    return np.asarray(np.linalg.lstsq(scaled, slope[free] / scale, rcond=1e-8)[0] / scale)


def _scaled(information: Array) -> tuple[Array, Array]:
    """Return a matrix with ones on its diagonal and what it was divided by; infinite where there is no information."""
    diagonal = np.diag(information)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, np.inf))
    scaled = information / scale / scale[:, None]
    np.fill_diagonal(scaled, 1.0)
    return scaled, scale
