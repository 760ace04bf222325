# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The paper's Table 2: functions with many minima but one, on boxes around it, with their gradients."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pendubot_identification.model.parameters import Bounds

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class BenchmarkFunction:
    """A function of points of shape (..., n), whose least value is 0, at 0.

    Attributes:
        name: as in the paper.
        half_width: the box is [-half_width, half_width]^n.
        value: (..., n) in, (...) out.
        gradient: (..., n) in, (..., n) out.
    """

    name: str
    half_width: float
    value: Callable[[ArrayLike], Array]
    gradient: Callable[[ArrayLike], Array]

    def bounds(self, dimension: int) -> Bounds:
        """Return its box in n dimensions."""
        names = tuple(f'x{k}' for k in range(1, dimension + 1))
        return Bounds(np.full(dimension, -self.half_width), np.full(dimension, self.half_width), names)


def sphere(x: ArrayLike) -> Array:
    """Return sum x_i^2."""
    return np.asarray((np.asarray(x) ** 2).sum(axis=-1))


def sphere_gradient(x: ArrayLike) -> Array:
    """Return the gradient of :func:`sphere`."""
    return 2.0 * np.asarray(x, dtype=float)


def griewank(x: ArrayLike) -> Array:
    """Return 1 + sum x_i^2 / 4000 - prod cos(x_i / sqrt(i)), i from 1."""
    x = np.asarray(x)
    return np.asarray(1 + (x**2).sum(axis=-1) / 4000 - np.cos(x / _roots(x)).prod(axis=-1))


def griewank_gradient(x: ArrayLike) -> Array:
    """Return the gradient of :func:`griewank`."""
    x = np.asarray(x, dtype=float)
    root = _roots(x)
    cosine = np.cos(x / root)
    # The product of all the other cosines, without dividing by one that may be 0.
    before = np.cumprod(np.concatenate([np.ones_like(x[..., :1]), cosine[..., :-1]], axis=-1), axis=-1)
    after = np.cumprod(np.concatenate([np.ones_like(x[..., :1]), cosine[..., :0:-1]], axis=-1), axis=-1)[..., ::-1]
    return np.asarray(x / 2000 + np.sin(x / root) / root * before * after)


def ackley(x: ArrayLike) -> Array:
    """Return 20 + e - 20 exp(-0.2 sqrt(mean x_i^2)) - exp(mean cos 2 pi x_i)."""
    x = np.asarray(x)
    distance = np.sqrt((x**2).mean(axis=-1))
    return np.asarray(20 + np.e - 20 * np.exp(-0.2 * distance) - np.exp(np.cos(2 * np.pi * x).mean(axis=-1)))


def ackley_gradient(x: ArrayLike) -> Array:
    """Return the gradient of :func:`ackley`; 0 at 0, where there is a kink."""
    x = np.asarray(x, dtype=float)
    n = x.shape[-1]
    distance = np.sqrt((x**2).mean(axis=-1, keepdims=True))
    direction = x / np.where(distance > 0, distance, 1.0)
    waves = np.exp(np.cos(2 * np.pi * x).mean(axis=-1, keepdims=True))
    return np.asarray((4 * np.exp(-0.2 * distance) * direction + 2 * np.pi * waves * np.sin(2 * np.pi * x)) / n)


def rastrigin(x: ArrayLike) -> Array:
    """Return sum x_i^2 + 10 - 10 cos 2 pi x_i."""
    x = np.asarray(x)
    return np.asarray((x**2 + 10 - 10 * np.cos(2 * np.pi * x)).sum(axis=-1))


def rastrigin_gradient(x: ArrayLike) -> Array:
    """Return the gradient of :func:`rastrigin`."""
    x = np.asarray(x, dtype=float)
    return np.asarray(2 * x + 20 * np.pi * np.sin(2 * np.pi * x))


def _roots(x: Array) -> Array:
    return np.sqrt(np.arange(1, x.shape[-1] + 1))


#: In the order of the paper's tables.
FUNCTIONS = (
    BenchmarkFunction('Sphere', 100.0, sphere, sphere_gradient),
    BenchmarkFunction('Griewank', 600.0, griewank, griewank_gradient),
    BenchmarkFunction('Ackley', 30.0, ackley, ackley_gradient),
    BenchmarkFunction('Rastrigin', 5.12, rastrigin, rastrigin_gradient),
)
