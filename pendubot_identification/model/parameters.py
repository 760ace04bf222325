# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The parameter vector theta: names, units, meaning, bounds and physical checks; the paper's Section 2 and friction."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pendubot_identification.arrays import Array, Flags
from pendubot_identification.errors import ParameterError
from pendubot_identification.trajectories.trajectory import LARGEST

from . import MODELS as MODELS


class Specification(NamedTuple):
    """One parameter: its name, unit, meaning, and the default search interval."""

    name: str
    unit: str
    meaning: str
    lower: float
    upper: float


#: In the order of theta: the seven of the paper, then friction and inertia of geared motors. The search intervals hold
#: all known bench-top rigs. No value is negative if the centre of mass of each link lies beyond its joint.
SPECIFICATIONS = (
    Specification('P1', 'kg m^2', 'm1 d1^2 + m2 l1^2 + I1', 0.0, 1.0),
    Specification('P2', 'kg m^2', 'm2 d2^2 + I2', 0.0, 1.0),
    Specification('P3', 'kg m^2', 'm2 l1 d2', 0.0, 1.0),
    Specification('P4', 'kg m', 'm1 d1 + m2 l1', 0.0, 5.0),
    Specification('P5', 'kg m', 'm2 d2', 0.0, 5.0),
    Specification('b1', 'N m s/rad', 'viscous friction of the shoulder', 0.0, 1.0),
    Specification('b2', 'N m s/rad', 'viscous friction of the elbow', 0.0, 1.0),
    Specification('Fc1', 'N m', 'Coulomb friction of the shoulder', 0.0, 5.0),
    Specification('Fc2', 'N m', 'Coulomb friction of the elbow', 0.0, 5.0),
    Specification('J2', 'kg m^2', "inertia of the elbow motor's rotor, reflected to the joint", 0.0, 1.0),
    Specification('Fs1', 'N m', 'Stribeck friction of the shoulder: increase of dry friction at rest', 0.0, 5.0),
    Specification('Fs2', 'N m', 'Stribeck friction of the elbow', 0.0, 5.0),
    Specification('k1', '1', 'friction of the shoulder per torque', 0.0, 0.9),
    Specification('k2', '1', 'friction of the elbow per torque', 0.0, 0.9),
)
NAMES = tuple(s.name for s in SPECIFICATIONS)
UNITS = tuple(s.unit for s in SPECIFICATIONS)
FRICTION = ('b1', 'b2', 'Fc1', 'Fc2', 'Fs1', 'Fs2', 'k1', 'k2')
#: Friction under load of shoulder and elbow, absent in a joint without a motor.
UNDER_LOAD = ('k1', 'k2')
#: Largest |P3| / sqrt(P1 P2); at 1, M(q) is singular.
LARGEST_COUPLING = 0.99


@dataclass(frozen=True, slots=True)
class Parameters:
    """The parameters in SI units and in the order of theta: the seven of the paper's equation (2), then friction.

    P1, P2, P3 [kg m^2], P4, P5 [kg m] (torques, divided by g), b1, b2 [N m s/rad]; Fc1, Fc2 [N m], J2 [kg m^2],
    Fs1, Fs2 [N m], k1, k2 [1]. The friction of a joint is b v + (Fc + Fs exp(-(v / 0.5)^2) + k |tau|) tanh(v / 0.05)
    [N m], v in rad/s.
    """

    P1: float
    P2: float
    P3: float
    P4: float
    P5: float
    b1: float
    b2: float
    Fc1: float = 0.0
    Fc2: float = 0.0
    J2: float = 0.0
    Fs1: float = 0.0
    Fs2: float = 0.0
    k1: float = 0.0
    k2: float = 0.0

    def __post_init__(self) -> None:
        """Accept all values, because a search needs them; :class:`.api.Pendubot` rejects unphysical ones."""

    @classmethod
    def from_vector(cls, theta: ArrayLike) -> Parameters:
        """Make parameters from a model's vector, shape (7,), (9,), (10,) or (14,); missing ones are 0.

        Raises:
            ParameterError: the vector has another length.
        """
        values = np.asarray(theta, dtype=float).ravel()
        if values.size not in MODELS.values():
            raise ParameterError(
                f'a parameter vector of {values.size} values was given; '
                f'{", ".join(map(str, MODELS.values()))} are expected, the first of {", ".join(NAMES)}'
            )
        return cls(*map(float, values))

    @property
    def model(self) -> str:
        """The smallest model that has these parameters."""
        values = astuple(self)
        return next(model for model, size in MODELS.items() if not any(values[size:]))

    def vector(self, model: str = 'viscous') -> Array:
        """Return theta, shape (D,), of a model, or of :attr:`model` if that has more parameters."""
        return np.array(astuple(self)[: max(MODELS[model], MODELS[self.model])])

    def carrying(self, payload: float) -> Parameters:
        """Return the parameters with a payload [kg] on link 2, 3/2 P2 / P5 from the elbow: the end of a uniform rod.

        Raises:
            ParameterError: P5 is not positive.
        """
        if self.P5 <= 0:
            raise ParameterError(f'link 2 has no place for a payload: P5 is {self.P5:g}, and more than 0 is expected')
        l1, d = self.P3 / self.P5, 1.5 * self.P2 / self.P5
        factors = {'P1': l1**2, 'P2': d**2, 'P3': l1 * d, 'P4': l1, 'P5': d}
        return replace(self, **{name: getattr(self, name) + payload * factor for name, factor in factors.items()})

    def unphysical(self) -> tuple[str, ...]:
        """Return a sentence for each value that no real pendubot can have; empty for a physical vector.

        M(q) of the links is positive definite for every q if and only if P1 > 0, P2 > 0 and P1 P2 > P3^2.
        """
        values = asdict(self)
        problems = [f'{name} = {value:.4g} is not finite' for name, value in values.items() if not math.isfinite(value)]
        zero = [f'{name} = {values[name]:.4g} is not positive' for name in ('P1', 'P2') if values[name] <= 0]
        problems += zero
        if not zero and self.P1 * self.P2 <= self.P3 * self.P3:
            problems.append(
                f'M(q) is not positive definite for every q: P1 P2 = {self.P1 * self.P2:.4g} '
                f'does not exceed P3^2 = {self.P3 * self.P3:.4g}'
            )
        if self.J2 < 0:
            problems.append(f'the rotor inertia J2 = {self.J2:.4g} is negative')
        problems += [f'friction {name} = {values[name]:.4g} is negative' for name in FRICTION if values[name] < 0]
        return tuple(problems)


#: The paper's Table 8, the values of the virtual rig.
PAPER = Parameters(P1=0.002207, P2=0.000400, P3=0.000101, P4=0.022447, P5=0.003326, b1=0.006592, b2=0.00009)
#: A rig with the proportions of rigs for balancing: link 1 is 15 cm long, in the paper 3 cm.
BALANCE = Parameters(P1=0.0148, P2=0.0051, P3=0.0046, P4=0.1003, P5=0.0303, b1=0.0008, b2=0.0001)
#: The virtual rigs by name.
PRESETS = {'paper': PAPER, 'balance': BALANCE}


@dataclass(frozen=True, slots=True)
class Bounds:
    """A box of parameter vectors: ``lower`` and ``upper``, each of shape (D,).

    Equal bounds fix a parameter at that value. Friction under load that is fixed at 0 is not in the model, as for a
    joint without a motor.

    Raises:
        ParameterError: lengths differ, a bound is not finite or too large, or a lower bound is above its upper one.
    """

    lower: Array
    upper: Array
    names: tuple[str, ...] = NAMES

    def __post_init__(self) -> None:
        lower, upper = (np.array(side, dtype=float) for side in (self.lower, self.upper))
        if lower.shape != upper.shape or lower.shape != (len(self.names),):
            raise ParameterError(
                f'{lower.size} lower and {upper.size} upper bounds were given, {len(self.names)} of each are '
                f'expected: {", ".join(self.names)}'
            )
        for name, low, high in zip(self.names, lower, upper, strict=True):
            if not (abs(low) < LARGEST and abs(high) < LARGEST):
                raise ParameterError(
                    f'the bounds of {name} are {low:g} to {high:g}; numbers between -{LARGEST:g} and {LARGEST:g} are '
                    'expected'
                )
            if low > high:
                raise ParameterError(
                    f'the bounds of {name} are inverted: {low:g} to {high:g}; give the smaller one first'
                )
        lower.setflags(write=False)
        upper.setflags(write=False)
        object.__setattr__(self, 'lower', lower)
        object.__setattr__(self, 'upper', upper)

    def replaced(self, name: str, low: float, high: float) -> Bounds:
        """Return these bounds with the interval of one parameter replaced."""
        if name not in self.names:
            raise ParameterError(f'there is no parameter {name!r}; the parameters are {", ".join(self.names)}')
        index = self.names.index(name)
        lower, upper = self.lower.copy(), self.upper.copy()
        lower[index], upper[index] = low, high
        return Bounds(lower, upper, self.names)

    def without(self, names: Collection[str]) -> Bounds:
        """Return these bounds with some parameters fixed at 0."""
        kept = [name not in names for name in self.names]
        return Bounds(np.where(kept, self.lower, 0.0), np.where(kept, self.upper, 0.0), self.names)

    @property
    def present(self) -> Flags:
        """Which parameters are in the model, shape (D,)."""
        return np.asarray((self.lower != 0) | (self.upper != 0) | ~np.isin(self.names, UNDER_LOAD))

    @property
    def fixed(self) -> Flags:
        """Which parameters of the model are fixed, shape (D,)."""
        return np.asarray(self.present & (self.lower == self.upper))

    @property
    def absent(self) -> tuple[str, ...]:
        """The names of the parameters that are not in the model."""
        return tuple(name for name, present in zip(self.names, self.present, strict=True) if not present)

    def beside(self, names: tuple[str, ...], limit: float) -> Bounds:
        """Return these bounds, followed by the interval from -limit to limit for each further unknown."""
        limits = np.full(len(names), limit)
        return Bounds(np.append(self.lower, -limits), np.append(self.upper, limits), (*self.names, *names))

    def of(self, size: int) -> Bounds:
        """Return the bounds of the first ``size`` parameters."""
        return Bounds(self.lower[:size], self.upper[:size], self.names[:size])

    def completed(self) -> Bounds:
        """Return the bounds of all parameters: these, then the default bounds of the others."""
        default, size = default_bounds(), len(self.names)
        return Bounds(np.append(self.lower, default.lower[size:]), np.append(self.upper, default.upper[size:]))

    def scaled(self, factor: float) -> Bounds:
        """Return these bounds with default upper bounds, except of k1 and k2, multiplied by a factor."""
        upper = default_bounds().upper[: len(self.names)]
        default = (self.lower == 0) & (self.upper == upper) & ~np.isin(self.names, UNDER_LOAD)
        return Bounds(self.lower, np.where(default, factor * upper, self.upper), self.names)

    def at_bound(self, theta: Sequence[float] | Array, tolerance: float = 1e-9) -> Flags:
        """Return which components of theta lie on a bound, within ``tolerance`` times the width of the interval."""
        margin = tolerance * (self.upper - self.lower)
        values = np.asarray(theta, dtype=float)
        return np.asarray((values <= self.lower + margin) | (values >= self.upper - margin))


def repaired(theta: ArrayLike) -> Array:
    """Return vectors of shape (..., D) with P3 moved to the nearest value at which M(q) is positive definite for all q.

    The minimum of a criterion over repaired vectors is its minimum over physical vectors.
    """
    result = np.array(theta, dtype=float)
    limit = LARGEST_COUPLING * np.sqrt(np.maximum(result[..., 0] * result[..., 1], 0.0))
    result[..., 2] = np.clip(result[..., 2], -limit, limit)
    return result


def coupling_excess(theta: Array) -> Array:
    """Return a penalty, shape (...), for vectors of shape (..., D) with |P3| too large for P1 and P2; 0 for all others.

    It directs an optimiser that has only bounds to the cone of vectors with positive definite M(q). It is relative to
    P1 + P2.
    """
    P1, P2, P3 = theta[..., 0], theta[..., 1], theta[..., 2]
    with np.errstate(invalid='ignore', divide='ignore'):
        # Not hypot, whose rounding differs between processors.
        excess = np.sqrt((P1 - P2) ** 2 + (2 * P3 / LARGEST_COUPLING) ** 2) / (P1 + P2) - 1
    return np.where(P1 + P2 > 0, np.maximum(excess, 0.0), np.abs(P3) + 1)


def default_bounds() -> Bounds:
    """Return the search box of :data:`SPECIFICATIONS`."""
    return Bounds(np.array([s.lower for s in SPECIFICATIONS]), np.array([s.upper for s in SPECIFICATIONS]))
