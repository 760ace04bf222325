# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Covariances and standard errors of estimates, for residuals that are correlated in time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import fdtrc, stdtrit

from pendubot_identification.arrays import Array, Flags
from pendubot_identification.criteria.energy import Regression
from pendubot_identification.level import NORMAL_95


def student_quantile(freedom: ArrayLike) -> Array:
    """Return the half-width of 95 % intervals in standard errors; infinite degrees of freedom are normal."""
    n = np.asarray(freedom, dtype=float)
    return np.where(np.isfinite(n), stdtrit(np.where(np.isfinite(n), n, 1.0), 0.975), NORMAL_95)


@dataclass(frozen=True, slots=True)
class IntervalSettings:
    """Settings of the variance by the influence of parts of the data.

    Attributes:
        prior: degrees of freedom of the common factor; with 2, the variance of two recordings, which has a single
            degree of freedom, is as certain as the variance of four.
        significance: level of the test whether recordings differ by more in one parameter than in the others.
    """

    prior: float = 2.0
    significance: float = 0.05


SETTINGS = IntervalSettings()


def influence_covariance(
    information: Array,
    slopes: Array,
    owner: NDArray[np.intp],
    free: Flags,
    difference: Array,
    *,
    exact: bool,
) -> tuple[Array, Array, Array, str]:
    """Return the covariance of the minimum of a composite criterion, by the influence of parts of the data.

    The inverse curvature V of a composite criterion understates the variance, because its parts share data. The
    influence of each recording on the minimum is u = V g; the variance by these is W = m / (m - 1) sum u u', with
    m - 1 degrees of freedom (the infinitesimal jackknife). Few recordings make W uncertain, so it is moderated by a
    factor common to all parameters (Smyth, Statistical Applications in Genetics and Molecular Biology 3, 2004). The
    estimate is the mean of W and c V, weighted by degrees of freedom, where c is the mean of W over V. A parameter in
    which recordings differ by more than in the others (F test) has its own variance. Blocks of time take the place of
    recordings if there is one recording, or if the residual is at the quantization level.

    An unmodelled effect biases all recordings in the same way. It also separates estimates that weight frequencies
    differently (Hausman, Econometrica 46, 1978): their difference adds to the standard error.

    Args:
        information: the inverse of V, for errors of unit variance, shape (D, D).
        slopes: g of each block of time at the minimum, shape (B, D).
        owner: index of the recording of each block, shape (B,).
        free: which unknowns lie on no bound, shape (D,).
        difference: to the estimate of the shortest interval, shape (D,); 0 if the residual is at the quantization
            level.
        exact: whether the residual is at the quantization level.

    Returns:
        Covariance, shape (D, D), NaN for unknowns on a bound; standard errors, shape (D,), of these without the bound;
        degrees of freedom, shape (D,); the method, in words.
    """
    size, count = len(free), int(owner.max(initial=-1)) + 1
    inverse = inverse_information(information, free)
    curvature = np.sqrt(np.diag(inverse))
    covariance, std_error, freedom = inverse, curvature, np.full(size, math.inf)
    words = 'curvature of the likelihood'
    if len(owner) > 1:
        recordings = np.array([slopes[owner == k].sum(axis=0) for k in range(count)])
        by_block = exact or count == 1
        parts = slopes if by_block else recordings
        # Blocks of one recording contain no information on differences between recordings.
        n = 0.0 if count == 1 and not exact else len(parts) - 1.0
        words = f'influence of {len(owner)} blocks of time' if by_block else f'influence of {count} recordings'
        spread = _spread(parts, inverse)
        total, known = float(np.trace(information @ spread)), max(int((curvature > 0).sum()), 1)
        covariance = (SETTINGS.prior * max(total / known, 1.0) * inverse + n * spread) / (SETTINGS.prior + n)
        variance, freedom = np.diag(covariance).copy(), np.full(size, SETTINGS.prior + n)
        if count > 1:
            between = _spread(recordings, inverse)
            odd = _differ(np.diag(between), np.diag(spread), np.diag(inverse), total, n, count - 1)
            variance[odd] = np.maximum(np.diag(between)[odd], variance[odd])
            freedom[odd] = count - 1
            words += f' and of {count} recordings' if by_block and odd.any() else ''
        std_error = np.sqrt(variance + difference**2)
        wide = curvature * NORMAL_95 > std_error * student_quantile(freedom)
        std_error, freedom = np.where(wide, curvature, std_error), np.where(wide, math.inf, freedom)
        covariance = covariance + np.outer(difference, difference)
        scale = std_error / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        covariance = covariance * scale * scale[:, None]
        words += ', and the difference to the estimate of the shortest interval' if difference.any() else ''
    lost = unidentifiable(information, free)
    std_error = np.where(lost, np.inf, std_error)
    for k in np.flatnonzero(~free & (np.diag(information) > 0)):
        released = free.copy()
        released[k] = True
        ratio = np.median((std_error / np.maximum(curvature, 1e-300))[free & ~lost]) if (free & ~lost).any() else 1.0
        std_error[k] = ratio * math.sqrt(inverse_information(information, released)[k, k])
    covariance = covariance.copy()
    covariance[lost, lost] = np.inf
    covariance[~free], covariance[:, ~free] = np.nan, np.nan
    return covariance, std_error, freedom, words


def regression_covariance(
    residuals: Sequence[Regression], theta: Array, free: Flags
) -> tuple[Array, Array, Array, str]:
    """Return the covariance of a least-squares estimate, see :func:`influence_covariance`.

    Residuals that are integrals over overlapping intervals of time are far from independent, so that the textbook
    covariance is many times too small. The blocks of time are about 1 s long.

    Args:
        residuals: of each recording.
        theta: the estimate, shape (D,).
        free: which parameters lie on no bound, shape (D,).
    """
    slopes, owner, information = list[Array](), list[int](), np.zeros((len(theta), len(theta)))
    errors = [r.phi @ theta - r.y for r in residuals]
    variance = max(float(np.mean(np.concatenate(errors) ** 2)), np.finfo(float).tiny)
    for number, (r, error) in enumerate(zip(residuals, errors, strict=True)):
        count = min(max(1, round(float(np.ptp(r.t)))), len(r.y))
        for rows in np.array_split(np.arange(len(r.y)), count):
            slopes.append(r.phi[rows].T @ error[rows] / variance)
            owner.append(number)
        information += r.phi.T @ r.phi / variance
    none = np.zeros_like(theta)
    return influence_covariance(information, np.array(slopes), np.array(owner), free, none, exact=False)


def _spread(parts: Array, inverse: Array) -> Array:
    """Return the covariance of the minimum by the influence of parts of the data, shape (D, D)."""
    moves = (parts - parts.mean(axis=0)) @ inverse
    return np.asarray(len(parts) / (len(parts) - 1) * moves.T @ moves)


def _differ(by_recording: Array, spread: Array, inverse: Array, total: float, n: float, between: int) -> Flags:
    """Return the parameters in which recordings vary more than in all others, relative to the curvature."""
    known = inverse > 0
    others = max(int(known.sum()) - 1, 1)
    scale = np.where(known, inverse, 1.0)
    rest = np.maximum((total - spread / scale) / others, 1.0)
    chance = fdtrc(between, n * others, by_recording / scale / rest)
    return np.asarray(known & (chance * (others + 1) < SETTINGS.significance))


def correlations(information: Array, free: Flags) -> Array:
    """Return the correlations of errors by an information matrix, shape (D, D).

    Rows and columns of unknowns that are not free or not identifiable are NaN.
    """
    covariance = inverse_information(information, free)
    deviation = np.sqrt(np.where(free & ~unidentifiable(information, free), np.diag(covariance), np.nan))
    return np.asarray(covariance / deviation / deviation[:, None])


def scaled_condition_number(information: Array, free: Flags) -> float:
    """Return the condition number of the residuals' derivative by the free unknowns, columns scaled to one."""
    scaled, scale = _scaled(information[np.ix_(free, free)])
    return float(np.sqrt(np.linalg.cond(scaled))) if np.isfinite(scale).all() and scaled.size else float('inf')


def unidentifiable(information: Array, free: Flags) -> Flags:
    """Return which free unknowns have a component in a direction without information, shape (D,)."""
    lost = free & (np.diag(information) <= 0)
    _, vectors = _identifiable(_scaled(information[np.ix_(free, free)])[0])
    lost[free] |= (vectors**2).sum(axis=1) < 1 - 1e-6
    return lost


def inverse_information(information: Array, free: Flags) -> Array:
    """Return the pseudo-inverse for the free unknowns; other rows and columns are 0."""
    result = np.zeros_like(information)
    scaled, scale = _scaled(information[np.ix_(free, free)])
    values, vectors = _identifiable(scaled)
    result[np.ix_(free, free)] = (vectors / values) @ vectors.T / scale / scale[:, None]
    return result


def _identifiable(scaled: Array) -> tuple[Array, Array]:
    """Return the eigenvalues and eigenvectors of the identifiable directions, which have positive eigenvalues."""
    values, vectors = np.linalg.eigh(scaled)
    identifiable = values > len(values) * 4 * np.finfo(float).eps * values.max(initial=0.0)
    return values[identifiable], vectors[:, identifiable]


def _scaled(information: Array) -> tuple[Array, Array]:
    """Return the matrix scaled to ones on its diagonal, and the scale, infinite without information."""
    diagonal = np.diag(information)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, np.inf))
    scaled = information / scale / scale[:, None]
    np.fill_diagonal(scaled, 1.0)
    return scaled, scale
