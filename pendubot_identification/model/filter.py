# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Extended Kalman filters for many recordings and many parameter vectors, in parallel.

The state is (q, q') and M(q) q'' + ... = tau + w, where w is white torque noise of each joint. The measurement is
q + offset + r, where r is white. The mean is predicted by classic Runge-Kutta steps with the mean torque of each step,
the covariance by I + h A + h^2 A^2 / 2 with the analytic Jacobian A. The sign of dry friction, tanh(v / width), is
linearised statistically (Gelb, Applied Optimal Estimation, 1974, section 6.2). Its width becomes
sqrt(width^2 + pi / 2 var(v)), so that innovations are smooth functions of the parameters.

The compiled kernel (filter.c) is used if it was built, otherwise numpy; their results agree to rounding errors.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from pendubot_identification import kernel as compiled
from pendubot_identification.arrays import Array, Indices

from .dynamics import GRAVITY, SIGN_WIDTH, STRIBECK_SPEED


class TermKind(IntEnum):
    """An additional torque, as a function of the angle q and speed v of its joint; numbered as in filter.c."""

    CONSTANT = 0
    ANGLE = 1  #: q
    DRAG = 2  #: v |v|
    DIRECTION = 3  #: |tanh(v / width)|
    VISCOUS_DRIFT = 4  #: v times the elapsed fraction
    COULOMB_DRIFT = 5  #: tanh(v / width) times the elapsed fraction
    SINE = 6  #: sin(number q)
    COSINE = 7  #: cos(number q)
    CREEP = 8  #: tanh(v / width) exp(-(v / number)^2)


@dataclass(frozen=True, slots=True)
class Term:
    """A torque at one joint (0 or 1) per unit of its coefficient."""

    kind: TermKind
    joint: int
    number: float = 0.0  #: repetitions per turn, or a speed [rad/s].

    def torque(self, q: Array, v: Array, elapsed: float) -> Array:
        """Return the torque per unit of its coefficient at angles [rad] and speeds [rad/s], with the default width."""
        return _term(self.kind, self.number, q, v, np.tanh(v / SIGN_WIDTH), np.array(SIGN_WIDTH), np.array(elapsed))[0]


@dataclass(frozen=True, slots=True)
class Samples:
    """The inputs and measurements of G filters, each with at most S steps; N measurements in total.

    Attributes:
        start: mean of the initial state, before subtraction of offsets [rad, rad/s], in T tables, shape (T, G, 4).
        spread: variance of the initial state, shape (G, 4).
        level: index of the noise level of each filter, shape (G,).
        length: number of steps of each filter, shape (G,).
        h: length of each step [s], shape (G, S).
        elapsed: elapsed fraction of the total duration, from -0.5 to 0.5, shape (G, S).
        tau: mean torques of each step [N m], shape (T, G, S, 2).
        y: measured positions at the end of each step [rad], shape (T, G, S, 2).
        row: index of this measurement, from 0 to N - 1; -1 without a measurement, shape (G, S).
    """

    start: Array
    spread: Array
    level: Indices
    length: Indices
    h: Array
    elapsed: Array
    tau: Array
    y: Array
    row: Indices

    @property
    def measurements(self) -> int:
        """The number of measurements N."""
        return int(self.row.max(initial=-1)) + 1


@dataclass(frozen=True, slots=True)
class Vectors:
    """L parameter vectors, with noise, offsets and additional torques.

    Attributes:
        theta: the 14 parameters, shape (14, L).
        offset: of the measured positions [rad], shape (2, L).
        noise: variances of both positions [rad^2] and intensities of both torques [(N m)^2 s] at each of K levels,
            shape (K, 4, L).
        width: of the change of sign of dry friction [rad/s], shape (2, L).
        coefficient: of each of E terms, shape (E, L).
        table: index of the table of the samples, shape (L,).
    """

    theta: Array
    offset: Array
    noise: Array
    width: Array
    coefficient: Array
    table: Indices


class _Work(ctypes.Structure):
    """The struct Filter of filter.c."""

    _fields_ = [(name, ctypes.c_int64) for name in ('lanes', 'groups', 'steps', 'terms', 'tables')] + [
        (name, ctypes.c_void_p)
        for name in (
            *('kind', 'joint', 'number', 'theta', 'width', 'coefficient', 'offset', 'noise', 'table'),
            *('level', 'length', 'start', 'spread', 'h', 'elapsed', 'tau', 'y', 'row', 'e', 's'),
        )
    ]


def innovations(samples: Samples, vectors: Vectors, terms: tuple[Term, ...] = ()) -> tuple[Array, Array]:
    """Return the innovations [rad] and their variances, both of shape (N, 2, L).

    The innovation of the elbow is conditional on the position of the shoulder, so that all are independent. A filter
    that diverges gives NaN or infinity, without a warning.
    """
    lanes = vectors.theta.shape[1]
    e, s = (np.empty((samples.measurements, 2, lanes)) for _ in range(2))
    if (library := compiled.library()) is None:
        with np.errstate(all='ignore'):
            _Filter(samples, vectors, terms).run(e, s)
        return e, s
    groups, steps = samples.h.shape
    numbers = {
        'kind': np.array([t.kind for t in terms], dtype=np.int64),
        'joint': np.array([t.joint for t in terms], dtype=np.int64),
        'number': np.array([t.number for t in terms], dtype=float),
        'e': e,
        's': s,
    }
    for part in (samples, vectors):
        for field in fields(part):
            value = getattr(part, field.name)
            numbers[field.name] = np.ascontiguousarray(value, np.int64 if value.dtype.kind == 'i' else float)
    work = _Work(lanes, groups, steps, len(terms), len(samples.tau))
    for name, array in numbers.items():
        setattr(work, name, array.ctypes.data)
    blocks = groups * -(-lanes // compiled.BLOCK)
    compiled.share(library.pendubot_filter, blocks, 500.0 * steps, ctypes.addressof(work))
    return e, s


class _Point(NamedTuple):
    """Accelerations (2, G, L), M^-1 (2, 2, G, L), P3 cos q2, P3 sin q2, and dry friction and terms at a state."""

    a: Array
    inverse: Array
    c2: Array
    s2: Array
    q: Array
    sign: Array
    fade: Array
    dry: Array
    by_q: Array
    by_v: Array


class _Filter:
    """The filters in numpy, on arrays of shape (G, L)."""

    def __init__(self, samples: Samples, vectors: Vectors, terms: tuple[Term, ...]) -> None:
        self._samples, self._vectors = samples, vectors
        self._terms = _Terms.grouped(terms, vectors.coefficient)
        self._theta = [row[None] for row in vectors.theta]
        self._viscous, self._coulomb, self._stribeck, self._load = vectors.theta[
            [[5, 6], [7, 8], [10, 11], [12, 13]], None
        ]
        self._noise = np.moveaxis(vectors.noise[samples.level], 1, 0)
        self._none = (np.zeros((2, len(samples.level), len(vectors.table))),) * 3

    def run(self, e: Array, s: Array) -> None:
        """Compute the innovations e and their variances s, shape (N, 2, L)."""
        samples, vectors = self._samples, self._vectors
        groups, lanes = len(samples.level), len(vectors.table)
        x = samples.start[vectors.table].T
        x[:2] -= vectors.offset[:, None]
        p = np.zeros((4, 4, groups, lanes))
        p[range(4), range(4)] = samples.spread.T[:, :, None]
        for k in range(samples.h.shape[1]):
            tau = samples.tau[:, :, k][vectors.table].T
            x, p = self._predicted(x, p, tau, samples.h[:, k, None], samples.elapsed[:, k, None])
            measured = np.flatnonzero(samples.row[:, k] >= 0)
            if measured.size:
                row, y = samples.row[measured, k], samples.y[:, measured, k][vectors.table]
                x[:, measured], p[:, :, measured] = self._corrected(
                    x[:, measured], p[:, :, measured], measured, row, y, e, s
                )

    def _corrected(
        self, x: Array, p: Array, groups: Indices, row: Indices, y: Array, e: Array, s: Array
    ) -> tuple[Array, Array]:
        for joint in range(2):  # sequential update: the errors of both joints are independent
            innovation = y[:, :, joint].T - self._vectors.offset[joint] - x[joint]
            variance = p[joint, joint] + self._noise[joint, groups]
            e[row, joint], s[row, joint] = innovation, variance
            gain = p[:, joint] / variance
            x = x + gain * innovation
            p = p - gain[:, None] * gain * variance
        return x, p

    def _predicted(self, x: Array, p: Array, tau: Array, h: Array, elapsed: Array) -> tuple[Array, Array]:
        width = np.sqrt(self._vectors.width[:, None] ** 2 + np.pi / 2 * p[[2, 3], [2, 3]])
        point = self._point(x[:2], x[2:], tau, elapsed, width)
        a, inverse = point.a, point.inverse
        A = np.zeros_like(p)
        A[0, 2] = A[1, 3] = 1.0
        A[2:] = self._derived(x[2:], point, width)
        F = h * A + h * h / 2 * _product(A, A)
        F[range(4), range(4)] += 1.0
        p = _product(_product(F, p), F.swapaxes(0, 1))
        w = _product(inverse * self._noise[2:], inverse)  # M^-1 is symmetric
        p[:2, :2] += h**3 / 3 * w
        crossed = h**2 / 2 * w
        p[:2, 2:] += crossed
        p[2:, :2] += crossed
        p[2:, 2:] += h * w
        q, v, half = x[:2], x[2:], h / 2
        v2 = v + half * a
        a2 = self._point(q + half * v, v2, tau, elapsed, width).a
        v3 = v + half * a2
        a3 = self._point(q + half * v2, v3, tau, elapsed, width).a
        a4 = self._point(q + h * v3, v + h * a3, tau, elapsed, width).a
        return np.concatenate([q + h * (v + h / 6 * (a + a2 + a3)), v + h / 6 * (a + 2 * (a2 + a3) + a4)]), p

    def _point(self, q: Array, v: Array, tau: Array, elapsed: Array, width: Array) -> _Point:
        """Return the accelerations, (2, G, L), and terms that their derivatives also need."""
        P1, P2, P3, P4, P5, _, _, _, _, J2, *_ = self._theta
        (v1, v2), c2, s2 = v, P3 * np.cos(q[1]), P3 * np.sin(q[1])
        sign, fade = np.tanh(v / width), np.exp(-((v / STRIBECK_SPEED) ** 2))
        dry = self._coulomb + self._stribeck * fade + self._load * abs(tau)
        extra, by_q, by_v = self._extra(q, v, sign, width, elapsed) if self._terms else self._none
        h = tau + extra - self._viscous * v - dry * sign
        gravity = P5 * GRAVITY * np.cos(q[0] + q[1])
        h1 = h[0] + s2 * v2 * (2 * v1 + v2) - P4 * GRAVITY * np.cos(q[0]) - gravity
        h2 = h[1] - s2 * v1 * v1 - gravity
        m11, m12, m22 = P1 + P2 + 2 * c2, P2 + c2, P2 + J2
        scale = 1 / (m11 * m22 - m12 * m12)
        inverse = np.empty((2, 2, *scale.shape))
        np.multiply(m22, scale, out=inverse[0, 0])
        np.multiply(m12, -scale, out=inverse[0, 1])
        inverse[1, 0] = inverse[0, 1]
        np.multiply(m11, scale, out=inverse[1, 1])
        a = inverse[0] * h1 + inverse[1] * h2
        return _Point(a, inverse, c2, s2, q, sign, fade, dry, by_q, by_v)

    def _derived(self, v: Array, point: _Point, width: Array) -> Array:
        """Return the accelerations' derivatives by the state, shape (2, 4, G, L)."""
        P4, P5 = self._theta[3:5]
        (v1, v2), (a1, a2), (q1, q2), c2, s2 = v, point.a, point.q, point.c2, point.s2
        slope = (1 - point.sign * point.sign) / width * point.dry - point.by_v + self._viscous
        slope -= self._stribeck * v * point.fade * point.sign * (2 / STRIBECK_SPEED**2)
        g1, g12 = P4 * GRAVITY * np.sin(q1), P5 * GRAVITY * np.sin(q1 + q2)
        right = np.empty((2, 4, *a1.shape))
        right[0, 0] = g1 + g12 + point.by_q[0]
        right[0, 1] = c2 * v2 * (2 * v1 + v2) + s2 * (2 * a1 + a2) + g12
        right[0, 2] = 2 * s2 * v2 - slope[0]
        right[0, 3] = 2 * s2 * (v1 + v2)
        right[1, 0] = g12
        right[1, 1] = s2 * a1 - c2 * v1 * v1 + g12 + point.by_q[1]
        right[1, 2] = -2 * s2 * v1
        right[1, 3] = -slope[1]
        return _product(point.inverse, right)

    def _extra(self, q: Array, v: Array, sign: Array, width: Array, elapsed: Array) -> tuple[Array, Array, Array]:
        """Return the terms' torques and their derivatives by angle and speed, shapes (2, G, L)."""
        extra, by_q, by_v = (np.zeros_like(v) for _ in range(3))
        for kind, j, lanes, number, coefficient in self._terms:
            state = q[j][:, lanes], v[j][:, lanes], sign[j][:, lanes], width[j][:, lanes]
            for total, value in zip((extra, by_q, by_v), _term(kind, number, *state, elapsed), strict=True):
                total[j][:, lanes] += coefficient * value
        return extra, by_q, by_v


class _Terms(NamedTuple):
    """Terms of one kind and joint, at most one in a lane: their lanes, numbers and coefficients."""

    kind: TermKind
    joint: int
    lanes: Indices
    number: Array
    coefficient: Array

    @classmethod
    def grouped(cls, terms: tuple[Term, ...], coefficient: Array) -> list[_Terms]:
        """Return all terms with a coefficient (E, L) that is not 0, in as few groups as possible."""
        groups: dict[tuple[TermKind, int, int], list[tuple[int, float, float]]] = {}
        for k, lane in np.argwhere(coefficient):
            kind, joint, number = terms[k].kind, terms[k].joint, 0
            while any(lane == other for other, *_ in groups.get((kind, joint, number), ())):
                number += 1
            groups.setdefault((kind, joint, number), []).append((lane, terms[k].number, coefficient[k, lane]))
        return [cls(kind, joint, *map(np.array, zip(*rows, strict=True))) for (kind, joint, _), rows in groups.items()]


def _product(a: Array, b: Array) -> Array:
    """Return the matrix products over the first two axes."""
    return np.asarray(np.matmul(a, b, axes=[(0, 1), (0, 1), (0, 1)]))


def _term(
    kind: TermKind, number: Array | float, q: Array, v: Array, sign: Array, width: Array, elapsed: Array
) -> tuple[Array, Array, Array]:
    """Return a term's torque per unit of its coefficient, and its derivatives by angle and speed."""
    none, slope = np.zeros_like(q), (1 - sign**2) / width
    match kind:
        case TermKind.ANGLE:
            return q, none + 1, none
        case TermKind.DRAG:
            return v * abs(v), none, 2 * abs(v)
        case TermKind.DIRECTION:
            return abs(sign), none, np.copysign(slope, v)
        case TermKind.VISCOUS_DRIFT:
            return elapsed * v, none, none + elapsed
        case TermKind.COULOMB_DRIFT:
            return elapsed * sign, none, elapsed * slope
        case TermKind.SINE:
            return np.sin(number * q), number * np.cos(number * q), none
        case TermKind.COSINE:
            return np.cos(number * q), -number * np.sin(number * q), none
        case TermKind.CREEP:
            fade = np.exp(-((v / number) ** 2))
            return sign * fade, none, (slope - sign * v * (2 / number**2)) * fade
    return none + 1, none, none
