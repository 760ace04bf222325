# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A square-root information filter of parameters that drift, and the noise of its rows.

An estimate is a R factor R and a vector z: x minimises |R x - z|^2, so that its covariance is R^-1 R^-T (Bierman,
Factorization Methods for Discrete Sequential Estimation, 1977, chapters II and VI). Measured rows are put below R and
rotated into it; so is a random walk. Neither needs an inverse. The last element of x is the rate at which all torque
drifts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .blocks import Block
from .settings import TrackerSettings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """The R factor R, shape (D, D), and z, shape (D,)."""

    r_factor: Array
    right: Array

    @classmethod
    def of(cls, mean: Array, deviation: Array) -> Estimate:
        """Return the estimate with a mean and independent errors of these deviations, both of shape (D,)."""
        return cls(np.diag(1 / deviation), mean / deviation)

    @cached_property
    def mean(self) -> Array:
        """The unknowns, shape (D,)."""
        return np.asarray(np.linalg.solve(self.r_factor, self.right))

    @cached_property
    def covariance(self) -> Array:
        """Of the unknowns, shape (D, D)."""
        inverse = np.linalg.inv(self.r_factor)
        return np.asarray(inverse @ inverse.T)

    def measurement_update(self, rows: Array) -> Estimate:
        """Return the estimate after rows [phi, y] of noise 1, shape (N, D+1)."""
        size = len(self.right)
        whole = np.concatenate([np.column_stack([self.r_factor, self.right]), rows])
        made: Array = np.asarray(np.linalg.qr(whole, mode='r'))
        return Estimate(made[:size, :size], made[:size, size])

    def time_update(self, deviation: Array, drift: Array) -> Estimate:
        """Return the estimate after each unknown moved by a random step of this deviation, shape (D,).

        ``drift``: what a rate of 1 has moved the others by meanwhile, shape (D,).
        """
        size, none = len(self.right), np.zeros((len(self.right), 1))
        r_factor = self.r_factor.copy()
        r_factor[:, -1] -= self.r_factor @ drift
        steps = np.column_stack([np.diag(1 / deviation), np.zeros((size, size)), none])
        moved = np.column_stack([-r_factor, r_factor, self.right])
        made: Array = np.asarray(np.linalg.qr(np.concatenate([steps, moved]), mode='r'))[size : 2 * size]
        return Estimate(made[:, size:-1], made[:, -1])

    def inflate_covariance(self, directions: Array) -> Estimate:
        """Return the estimate after a step of unknown size, of deviation 1, along the columns, shape (D, F)."""
        lower = np.linalg.inv(np.linalg.cholesky(self.covariance + directions @ directions.T))
        r_factor: Array = np.asarray(np.linalg.qr(lower, mode='r'))
        return Estimate(r_factor, r_factor @ self.mean)

    def with_rate(self, deviation: float) -> Estimate:
        """Return the estimate for a rate that was 0 and may now be anything of this deviation."""
        r_factor, right = self.r_factor.copy(), self.right.copy()
        r_factor[:, -1], right[-1] = 0.0, 0.0
        r_factor[-1, -1] = 1 / deviation
        return Estimate(r_factor, right)


class Noise:
    """How far a block's rows, as its R factor has them, are off, by what they were off so far.

    Neighbouring test functions overlap, velocities are smoothed, and angles are rounded the more often the faster they
    change: rows are far from independent, and unlike. What a block leaves unexplained by any parameters tells its size,
    and what its D rows leave of the estimate before it, how much more each of them is off, neighbours included.
    """

    def __init__(self, blocks: Sequence[Block], x: Array, settings: TrackerSettings) -> None:
        self._settings = settings
        size = len(x)
        self._usual = float(np.mean([left_of(block) for block in blocks]))
        self._given = float(np.mean([left_given(block, x[-3:]) for block in blocks]))
        off = np.array([_off(block, x) / self.scale(block) for block in blocks])
        # Of n blocks D parameters were made.
        self._square = (off**2).mean(axis=0) * len(blocks) / max(len(blocks) - 1, 1)
        self._product = (off[1:] * off[:-1]).mean(axis=0) if len(blocks) > 1 else np.zeros(size)
        self._last, self._count = off[-1], len(blocks)

    def left(self, block: Block) -> float:
        """Return how much more than usual a block leaves unexplained, in squares."""
        return left_of(block) / self._usual

    @property
    def beyond(self) -> float:
        """How many times what errors of the angles explain blocks usually leave unexplained, in root mean squares."""
        return math.sqrt(self._given)

    def scale(self, block: Block) -> float:
        """Return by how much the rows of a block are to be divided before their own noise counts."""
        return float(np.sqrt(left_of(block) + self._settings.least_noise * self._usual))

    @property
    def variance(self) -> Array:
        """Of the rows so divided, shape (D,); what neighbours have in common included."""
        return np.asarray(np.maximum(self._square + 2 * np.maximum(self._product, 0.0), 1e-12))

    def rows(self, block: Block) -> Array:
        """Return a block's rows with noise 1, and a column for the rate, shape (D, D+2)."""
        rows = block.r_factor[:-1] / (self.scale(block) * np.sqrt(self.variance))[:, None]
        return np.insert(rows, -1, 0.0, axis=1)

    def update(self, block: Block, estimate: Estimate) -> None:
        """Take what a block leaves of the estimate before it."""
        rows = self.rows(block)[:, :-1]
        off = _off(block, estimate.mean[:-1]) / self.scale(block)
        # What is not known of theta is no noise of the rows.
        off = off / np.sqrt(1 + ((rows @ estimate.covariance) * rows).sum(axis=1))
        self._count = min(self._count + 1, self._settings.noise_memory)
        part = 1 / self._count
        self._usual += part * (min(left_of(block), 10 * self._usual) - self._usual)
        self._given += part * (min(left_given(block, estimate.mean[-4:-1]), 10 * self._given) - self._given)
        self._square += part * (off**2 - self._square)
        self._product += part * (off * self._last - self._product)
        self._last = off


def left_of(block: Block) -> float:
    """Return the mean square of what no parameters explain of a block's rows."""
    return float(block.r_factor[-1, -1] ** 2) / block.rows


def left_given(block: Block, beside: Array) -> float:
    """Return the same where tilt and dead zone are given, shape (3,): theta and delay may be any."""
    tail = block.r_factor[-4:, -4:]
    return float(np.square(tail[:, -1] - tail[:, :-1] @ beside).sum()) / block.rows


def _off(block: Block, x: Array) -> Array:
    return np.asarray(block.r_factor[:-1, -1] - block.r_factor[:-1, :-1] @ x)
