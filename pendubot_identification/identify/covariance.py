# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Covariance of a trajectory estimate: what the information matrix says where residuals are noise, else a jackknife."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.criteria.trajectory_fit import TrajectoryFit
from pendubot_identification.level import NORMAL_95

from .estimate import FEWEST_RECORDINGS
from .significance import student_quantile

Array = NDArray[np.float64]

#: A block's length [s]: longer than what the segments of one motion have in common.
BLOCK = 4.0
#: Blocks at least; of short recordings they are shorter.
FEWEST_BLOCKS = 6
#: The same for the zeros [s]: what tells them is one recording alone.
ZEROS_BLOCK = 2.0
#: A zero that is off by so much [rad] costs as much as one segment usually does: it holds those that nothing tells.
ZERO_PRIOR = math.radians(20.0)


def trajectory_covariance(found: TrajectoryFit) -> tuple[Array, Array, str]:
    """Return covariance and standard errors of theta and delay, and in words how they were found.

    White residuals: the inverse of the condensed Gauss-Newton matrix times the residuals' variance. Otherwise they
    hang together, and what counts is how the estimate moves from one part of the data to the next: the cluster-robust
    sandwich in its jackknife form (CR3; Bell and McCaffrey 2002). Its clusters are segments where the model is exact,
    else recordings or, where there are fewer than three, blocks of 4 s. Few clusters make Student's quantile; it is
    part of the errors here, so that 1.96 of them hold the truth in 95 % of cases. Blocks of time have the zeros of
    their recording in common; so there the step that theta would take were the zeros unknown is one more standard
    error.

    Args:
        found: the fit of D parameters and the delay, G = D + 1.

    Returns:
        Covariance, shape (G, G), NaN where a bound holds; standard errors, shape (G,), of what a bound holds those
        that it would have without; a sentence.
    """
    fit, free = found.fit, found.fit.free
    information, slopes = _information(found), fit.slopes[:, :-2]
    inverse = _inverse(information, free)
    if found.white:
        covariance = found.variance * found.together * inverse
        words = (
            f"Gauss-Newton; the residuals are white, with {found.variance:.2f} times the variance of the positions' "
            'noise'
        )
    else:
        several = len(np.unique(found.group)) >= FEWEST_RECORDINGS
        clusters, what = (found.group, 'recordings') if several else _blocks(found, BLOCK)
        if found.exact:
            clusters, what = np.arange(len(found.group)), f'segments of {found.length:.2g} s'
        members = [clusters == k for k in np.unique(clusters)]
        rest = [information - fit.informations[m].sum(axis=0)[:-2, :-2] for m in members]
        moves = [_solve(r, slopes[m].sum(axis=0), free) for r, m in zip(rest, members, strict=True)]
        covariance, quantile = _jackknife(np.array(moves))
        words = f'cluster jackknife over {len(members)} {what}; Student quantile {quantile * NORMAL_95:.2f} included'
        if found.exact:
            # What readings err, as far as neighbours err alike, and where the simulation errs alike in all segments.
            covariance += max(found.variance, 1.0) * found.together * inverse
        elif not several:
            # Blocks of a recording have its zeros in common, so that they do not show what these do.
            moved, _ = _freed(found)
            covariance += np.outer(moved, moved)
            words += "; the recordings' zeros too"
    unidentifiable = _unidentifiable(information, free)
    covariance[unidentifiable, unidentifiable] = np.inf
    std_error = np.sqrt(np.diag(covariance))
    identifiable = free & ~unidentifiable
    if identifiable.any():
        inflation = np.median(std_error[identifiable] / np.sqrt(np.diag(inverse))[identifiable])
        everything = np.sqrt(np.diag(_inverse(information, np.ones_like(free))))
        std_error = np.where(free, std_error, inflation * everything)
    covariance[~free], covariance[:, ~free] = np.nan, np.nan
    return covariance, std_error, words


def correlations(information: Array, free: NDArray[np.bool_]) -> Array:
    """Return the correlations of errors by an information matrix, shape (G, G).

    They are NaN in the rows and columns of what is not free, and of what has a part in a direction that nothing tells.
    """
    covariance = _inverse(information, free)
    deviation = np.sqrt(np.where(free & ~_unidentifiable(information, free), np.diag(covariance), np.nan))
    return np.asarray(covariance / deviation / deviation[:, None])


def scaled_condition_number(found: TrajectoryFit) -> float:
    """Return the condition number of the residuals' derivative, columns scaled to one, of what no bound holds."""
    free = found.fit.free
    scaled, scale = _scaled(_information(found)[np.ix_(free, free)])
    return float(np.sqrt(np.linalg.cond(scaled))) if np.isfinite(scale).all() else float('inf')


def estimated_zeros(found: TrajectoryFit, recordings: int) -> tuple[Array, Array]:
    """Return how far off the zeros of every recording's positions are, and the standard errors of that.

    The fit holds them at 0. This is the Gauss-Newton step from there to where they are unknowns like theta and delay.

    Args:
        found: the fit of so many recordings.
        recordings: R.

    Returns:
        Angles and standard errors [rad], shapes (2, R); NaN for recordings without a segment. Standard errors are
        those of a jackknife over blocks of 2 s, Student's quantile included.
    """
    blocks, _ = _blocks(found, ZEROS_BLOCK)
    without = [_freed(found, blocks != k)[1].ravel() for k in range(blocks.max() + 1)]
    angles, std_error = np.full((2, 2, recordings), np.nan)
    identifiable = np.unique(found.group)
    angles[:, identifiable] = _freed(found)[1]
    std_error[:, identifiable] = np.sqrt(np.diag(_jackknife(np.array(without))[0])).reshape(2, -1)
    return angles, std_error


def _information(found: TrajectoryFit) -> Array:
    """Return the information matrix of theta and delay, the recordings' zeros being 0, shape (G, G)."""
    return np.asarray(found.fit.informations.sum(axis=0)[:-2, :-2])


def _freed(found: TrajectoryFit, which: NDArray[np.bool_] | slice = slice(None)) -> tuple[Array, Array]:
    """Return the step of theta and delay, shape (G,), and the recordings' zeros that some segments ask for."""
    fit = found.fit
    of = (np.unique(found.group)[:, None] == found.group[which]).astype(float)
    information, slope = np.tensordot(of, fit.informations[which], 1), np.tensordot(of, fit.slopes[which], 1)
    # What belongs to one recording is condensed out.
    own = information[:, -2:, -2:] + (np.median(fit.costs) / ZERO_PRIOR**2 + 1e-12) * np.eye(2)
    gain, rest = np.split(np.linalg.solve(own, np.dstack([information[:, -2:, :-2], slope[:, -2:]])), [-1], axis=2)
    back = information[:, :-2, -2:]
    condensed = (information[:, :-2, :-2] - back @ gain).sum(axis=0)
    moved = -_solve(condensed, (slope[:, :-2] - (back @ rest)[:, :, 0]).sum(axis=0), fit.free)
    return moved, -(rest[:, :, 0] + gain @ moved).T


def _jackknife(without: Array) -> tuple[Array, float]:
    """Return the covariance of an estimate by where it goes without each cluster, shape (C, G), and what it holds.

    That is Student's quantile over the normal one; it is part of the standard errors.
    """
    count = len(without)
    moves = without - without.mean(axis=0)
    quantile = student_quantile(max(count - 1, 1)) / NORMAL_95
    return quantile**2 * (count - 1) / count * moves.T @ moves, quantile


def _blocks(found: TrajectoryFit, longest: float) -> tuple[NDArray[np.intp], str]:
    """Return the number of each segment's block of time, shape (L,), and what the blocks are."""
    spans = [np.ptp(found.start[found.group == g]) + found.length for g in np.unique(found.group)]
    block = min(longest, sum(spans) / FEWEST_BLOCKS)
    labels = np.column_stack([found.group, (found.start - found.start.min()) // block])
    return np.unique(labels, axis=0, return_inverse=True)[1].ravel(), f'blocks of {block:.2g} s'


def _unidentifiable(information: Array, free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which free unknowns have a part in a direction that nothing tells, shape (G,)."""
    unidentifiable = free & (np.diag(information) <= 0)
    _, vectors = _identifiable(_scaled(information[np.ix_(free, free)])[0])
    unidentifiable[free] |= (vectors**2).sum(axis=1) < 1 - 1e-6
    return unidentifiable


def _identifiable(scaled: Array) -> tuple[Array, Array]:
    """Return the eigenvalues and eigenvectors of the identifiable directions.

    Rounding makes those of a singular matrix a little positive or negative: a variance below 0 is none.
    """
    values, vectors = np.linalg.eigh(scaled)
    identifiable = values > len(values) * np.finfo(float).eps * values.max(initial=0.0)
    return values[identifiable], vectors[:, identifiable]


def _inverse(information: Array, free: NDArray[np.bool_]) -> Array:
    """Return the pseudo-inverse of what is free; the rest is 0."""
    result = np.zeros_like(information)
    scaled, scale = _scaled(information[np.ix_(free, free)])
    values, vectors = _identifiable(scaled)
    result[np.ix_(free, free)] = (vectors / values) @ vectors.T / scale / scale[:, None]
    return result


def _solve(information: Array, slope: Array, free: NDArray[np.bool_]) -> Array:
    """Return the step of what is free along a slope; the rest stays."""
    scaled, scale = _scaled(information[np.ix_(free, free)])
    step = np.zeros_like(slope)
    step[free] = np.linalg.lstsq(scaled, slope[free] / scale, rcond=1e-8)[0] / scale
    return step


def _scaled(information: Array) -> tuple[Array, Array]:
    """Return a matrix with ones on its diagonal and what it was divided by; infinite where there is no information."""
    diagonal = np.diag(information)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, np.inf))
    scaled = information / scale / scale[:, None]
    np.fill_diagonal(scaled, 1.0)
    return scaled, scale
