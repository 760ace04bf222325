# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What is believed of parameters that may drift: a square-root information filter, and the noise of its rows.

A belief is a triangle R and a vector z: theta has the least squares |R theta - z|^2, so that R^-1 R^-T is its
covariance (Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, chapters II and VI). Rows that are
learned are put below R and rotated into it; so is a random walk. Neither needs an inverse, and R may be singular.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .blocks import Block

Array = NDArray[np.float64]

#: So many blocks count for the noise of rows: about three minutes of motion.
MEMORY = 400
#: What a block leaves unexplained is taken to be at least this part of what blocks usually leave, in squares.
LEAST = 0.3


@dataclass(frozen=True, slots=True)
class Belief:
    """A triangle, shape (D, D), and what it makes of the parameters, shape (D,)."""

    triangle: Array
    right: Array

    @classmethod
    def nothing(cls, size: int) -> Belief:
        """Believe nothing of so many parameters."""
        return cls(np.zeros((size, size)), np.zeros(size))

    @classmethod
    def of(cls, mean: Array, covariance: Array) -> Belief:
        """Believe in a mean, shape (D,), with a covariance, shape (D, D)."""
        triangle = np.linalg.inv(np.linalg.cholesky(covariance))
        return cls.nothing(len(mean)).learned(np.column_stack([triangle, triangle @ mean]))

    @property
    def mean(self) -> Array:
        """The parameters, shape (D,); the smallest where many are as good."""
        if self.known:
            return np.asarray(np.linalg.solve(self.triangle, self.right))
        return np.asarray(np.linalg.lstsq(self.triangle, self.right, rcond=1e-12)[0])

    @property
    def known(self) -> bool:
        """Whether all of them are determined at all."""
        return bool(np.abs(np.diag(self.triangle)).min() > 1e-12)

    @property
    def covariance(self) -> Array:
        """Of the parameters, shape (D, D); infinite where nothing is known."""
        if not self.known:
            return np.diag(np.full(len(self.right), np.inf))
        inverse = np.linalg.inv(self.triangle)
        return np.asarray(inverse @ inverse.T)

    def learned(self, rows: Array) -> Belief:
        """Return what is believed after rows [phi, y] of noise 1, shape (N, D+1)."""
        size = len(self.right)
        whole = np.concatenate([np.column_stack([self.triangle, self.right]), rows])
        made: Array = np.asarray(np.linalg.qr(whole, mode='r'))
        return Belief(made[:size, :size], made[:size, size])

    def drifted(self, deviation: Array) -> Belief:
        """Return what is believed after each parameter has moved by a random step of this deviation, shape (D,)."""
        size, none = len(self.right), np.zeros((len(self.right), 1))
        steps = np.column_stack([np.diag(1 / deviation), np.zeros((size, size)), none])
        moved = np.column_stack([-self.triangle, self.triangle, self.right])
        made: Array = np.asarray(np.linalg.qr(np.concatenate([steps, moved]), mode='r'))[size : 2 * size]
        return Belief(made[:, size:-1], made[:, -1])

    def opened(self, directions: Array) -> Belief:
        """Return what is believed after a jump of unknown size, of deviation 1, along the columns, shape (D, F)."""
        return Belief.of(self.mean, self.covariance + directions @ directions.T)


class Noise:
    """How far a block's rows, as its triangle has them, are off, by what they were off so far.

    Neighbouring bumps overlap, velocities are smoothed, and angles are rounded the more often the faster they change:
    rows are far from independent, and unlike. What a block leaves unexplained by any parameters tells its size, and
    what its D rows leave of the parameters believed in, how much more each of them is off, neighbours included.
    """

    def __init__(self, blocks: Sequence[Block], theta: Array) -> None:
        size = len(theta)
        self._usual = float(np.mean([left_of(block) for block in blocks]))
        off = np.array([_off(block, theta) / self.scale(block) for block in blocks])
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
        return math.sqrt(self._usual)

    def scale(self, block: Block) -> float:
        """Return by how much the rows of a block are to be divided before their own noise counts."""
        return float(np.sqrt(left_of(block) + LEAST * self._usual))

    @property
    def variance(self) -> Array:
        """Of the rows so divided, shape (D,); what neighbours have in common included."""
        return np.asarray(np.maximum(self._square + 2 * np.maximum(self._product, 0.0), 1e-12))

    def rows(self, block: Block) -> Array:
        """Return a block's rows with noise 1, shape (D, D+1)."""
        return np.asarray(block.triangle[:-1] / (self.scale(block) * np.sqrt(self.variance))[:, None])

    def learn(self, block: Block, belief: Belief) -> None:
        """Take what a block leaves of what was believed before it."""
        rows = self.rows(block)
        off = _off(block, belief.mean) / self.scale(block)
        # What is not known of theta is no noise of the rows.
        off = off / np.sqrt(1 + ((rows[:, :-1] @ belief.covariance) * rows[:, :-1]).sum(axis=1))
        self._count = min(self._count + 1, MEMORY)
        part = 1 / self._count
        self._usual += part * (min(left_of(block), 10 * self._usual) - self._usual)
        self._square += part * (off**2 - self._square)
        self._product += part * (off * self._last - self._product)
        self._last = off


def left_of(block: Block) -> float:
    """Return the mean square of what no parameters explain of a block's rows."""
    return float(block.triangle[-1, -1] ** 2) / block.rows


def _off(block: Block, theta: Array) -> Array:
    return np.asarray(block.triangle[:-1, -1] - block.triangle[:-1, :-1] @ theta)
