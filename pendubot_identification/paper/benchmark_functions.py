# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Table 2 of the paper: the benchmark functions of the optimizers."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pendubot_identification.arrays import Array
from pendubot_identification.model.parameters import Bounds


@dataclass(frozen=True, slots=True)
class BenchmarkFunction:
    """A function of points, shape (..., n) in, (...) out, on [-half_width, half_width]^n, with the minimum 0 at 0."""

    name: str
    half_width: float
    value: Callable[[ArrayLike], Array]

    def gradient(self, x: ArrayLike) -> Array:
        """Return the gradient by central differences: (..., n) in, (..., n) out."""
        x = np.asarray(x, dtype=float)[..., None, :]
        step = 1e-7 * self.half_width
        steps = step * np.eye(x.shape[-1])
        return (self.value(x + steps) - self.value(x - steps)) / (2 * step)

    def bounds(self, dimension: int) -> Bounds:
        """Return the bounds in n dimensions."""
        width = np.full(dimension, self.half_width)
        return Bounds(-width, width, tuple(f'x{k}' for k in range(1, dimension + 1)))


def sphere(x: ArrayLike) -> Array:
    """Return sum x_i^2."""
    return np.asarray((np.asarray(x) ** 2).sum(axis=-1))


def griewank(x: ArrayLike) -> Array:
    """Return 1 + sum x_i^2 / 4000 - prod cos(x_i / sqrt(i)), i from 1."""
    x = np.asarray(x)
    roots = np.sqrt(np.arange(1, x.shape[-1] + 1))
    return np.asarray(1 + (x**2).sum(axis=-1) / 4000 - np.cos(x / roots).prod(axis=-1))


def ackley(x: ArrayLike) -> Array:
    """Return 20 + e - 20 exp(-0.2 sqrt(mean x_i^2)) - exp(mean cos 2 pi x_i)."""
    x = np.asarray(x)
    distance = np.sqrt((x**2).mean(axis=-1))
    return np.asarray(20 + np.e - 20 * np.exp(-0.2 * distance) - np.exp(np.cos(2 * np.pi * x).mean(axis=-1)))


def rastrigin(x: ArrayLike) -> Array:
    """Return sum x_i^2 + 10 - 10 cos 2 pi x_i."""
    x = np.asarray(x)
    return np.asarray((x**2 + 10 - 10 * np.cos(2 * np.pi * x)).sum(axis=-1))


#: The benchmark functions in the order of the paper's tables.
FUNCTIONS = (
    BenchmarkFunction('Sphere', 100.0, sphere),
    BenchmarkFunction('Griewank', 600.0, griewank),
    BenchmarkFunction('Ackley', 30.0, ackley),
    BenchmarkFunction('Rastrigin', 5.12, rastrigin),
)
