# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Extended Kalman filters for many recordings and many parameter vectors, in parallel.

The state is (q, q') and M(q) q'' + ... = tau + w, where w is white torque noise of each joint. The measurement is
q + offset + r, where r is white. The mean is predicted by classic Runge-Kutta steps with a linear torque in each, the
covariance by I + h A + h^2 A^2 / 2 with the analytic Jacobian A. The sign of dry friction, tanh(v / width), is
linearised statistically (Gelb, Applied Optimal Estimation, 1974, section 6.2). Its width becomes
sqrt(width^2 + pi / 2 var(v)), so that innovations are smooth functions of the parameters.

The compiled kernel (filter.c) is used if it was built, otherwise numpy; their results agree to rounding errors.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np

from pendubot_identification import kernel as compiled
from pendubot_identification.arrays import Array, Indices

from .dynamics import NO_TERMS, SIGN_WIDTH, Linearised, accelerations, linearised, product, runge_kutta, stages


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
    number: float | Array = 0.0  #: repetitions per turn, or a speed [rad/s].

    def torques(
        self, q: Array, v: Array, elapsed: float | Array, width: float | Array = SIGN_WIDTH
    ) -> tuple[Array, Array, Array]:
        """Return the torque at angles [rad] and speeds [rad/s], and its derivatives by angle and speed."""
        number, sign, none = self.number, np.tanh(v / width), np.zeros_like(q)
        slope = (1 - sign**2) / width
        match self.kind:
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


@dataclass(frozen=True, slots=True)
class Samples:
    """The inputs and measurements of G filters, each with at most S steps; N measurements in total."""

    #: mean of the initial state, before subtraction of offsets [rad, rad/s], in T tables, shape (T, G, 4).
    start: Array
    spread: Array  #: variance of the initial state, shape (G, 4).
    level: Indices  #: index of the noise level of each filter, shape (G,).
    length: Indices  #: number of steps of each filter, shape (G,).
    h: Array  #: length of each step [s], shape (G, S).
    elapsed: Array  #: elapsed fraction of the total duration, from -0.5 to 0.5, shape (G, S).
    tau: Array  #: mean torques of each step [N m], shape (T, G, S, 2).
    change: Array  #: half of the torques' change within each step, if it is linear [N m], shape (T, G, S, 2).
    y: Array  #: measured positions at the end of each step [rad], shape (T, G, S, 2).
    row: Indices  #: index of this measurement, from 0 to N - 1; -1 without a measurement, shape (G, S).

    @property
    def measurements(self) -> int:
        """The number of measurements N."""
        return int(self.row.max(initial=-1)) + 1


@dataclass(frozen=True, slots=True)
class Vectors:
    """L parameter vectors, with noise, offsets and additional torques."""

    theta: Array  #: the 14 parameters, shape (14, L).
    offset: Array  #: of the measured positions [rad], shape (2, L).
    #: variances of both positions [rad^2] and intensities of both torques [(N m)^2 s] at each of K levels, shape
    #: (K, 4, L).
    noise: Array
    width: Array  #: of the change of sign of dry friction [rad/s], shape (2, L).
    coefficient: Array  #: of each of E terms, shape (E, L).
    table: Indices  #: index of the table of the samples, shape (L,).


class _Work(ctypes.Structure):
    """The struct Filter of filter.c."""

    _fields_ = [(name, ctypes.c_int64) for name in ('lanes', 'groups', 'steps', 'terms', 'tables')] + [
        (name, ctypes.c_void_p)
        for name in (
            *('kind', 'joint', 'number', 'theta', 'width', 'coefficient', 'offset', 'noise', 'table'),
            *('level', 'length', 'start', 'spread', 'h', 'elapsed', 'tau', 'change', 'y', 'row', 'e', 's'),
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
            _filter(samples, vectors, terms, e, s)
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


def _filter(samples: Samples, vectors: Vectors, terms: tuple[Term, ...], e: Array, s: Array) -> None:
    """Compute the innovations e and their variances s in numpy, on arrays of shape (G, L)."""
    theta, table, grouped = vectors.theta[:, None], vectors.table, _grouped(terms, vectors.coefficient)
    position, intensity = np.split(np.moveaxis(vectors.noise[samples.level], 1, 0), 2)
    x = samples.start[table].T
    x[:2] -= vectors.offset[:, None]
    p = np.zeros((4, 4, *x.shape[1:]))
    p[range(4), range(4)] = samples.spread.T[:, :, None]
    for k in range(samples.h.shape[1]):
        tau, change = samples.tau[:, :, k][table].T, samples.change[:, :, k][table].T
        h, elapsed, torque = samples.h[:, k, None], samples.elapsed[:, k, None], stages(tau, change)
        width = np.sqrt(vectors.width[:, None] ** 2 + np.pi / 2 * p[[2, 3], [2, 3]])

        def torques(x: Any, elapsed: Array = elapsed, width: Array = width) -> Array:
            """Return the torques of all terms and their derivatives by angle and speed, shape (3, 2, G, L)."""
            total = np.zeros((3, 2, *width.shape[1:]))
            for term, lanes, coefficient in grouped:
                q, v, its = (values[term.joint][:, lanes] for values in (x[:2], x[2:], width))
                total[:, term.joint][:, :, lanes] += coefficient * np.array(term.torques(q, v, elapsed, its))
            return total if grouped else NO_TERMS

        def accelerated(x: Any, torque: Iterator[Array] = torque, width: Array = width) -> Any:
            return accelerations(theta, x, next(torque), np, torques(x)[0], width)

        at = linearised(theta, x, next(torque), width, torques(x))
        p = _predicted(p, at, intensity, h)
        x = np.array(runge_kutta(accelerated, x, h, at.a))
        measured = np.flatnonzero(samples.row[:, k] >= 0)
        row, y = samples.row[measured, k], samples.y[:, measured, k][table]
        for j in range(2):  # sequential update: the errors of both joints are independent
            here, covariance = x[:, measured], p[:, :, measured]
            innovation = y[:, :, j].T - vectors.offset[j] - here[j]
            variance = covariance[j, j] + position[j, measured]
            e[row, j], s[row, j] = innovation, variance
            gain = covariance[:, j] / variance
            x[:, measured], p[:, :, measured] = (
                here + gain * innovation,
                covariance - gain[:, None] * gain * variance,
            )


def _predicted(p: Array, at: Linearised, intensity: Array, h: Array) -> Array:
    """Return the covariance (4, 4, G, L) after a step of h [s] under white torques of an intensity (2, G, L)."""
    inverse = at.inverse
    A = np.zeros_like(p)
    A[0, 2] = A[1, 3] = 1.0
    A[2:] = product(inverse, at.slopes)
    F = h * A + h * h / 2 * product(A, A)
    F[range(4), range(4)] += 1.0
    p = product(product(F, p), F.swapaxes(0, 1))
    w = product(inverse * intensity, inverse)  # M^-1 is symmetric
    p[:2, :2] += h**3 / 3 * w
    p[:2, 2:] += h**2 / 2 * w
    p[2:, :2] += h**2 / 2 * w
    p[2:, 2:] += h * w
    return p


def _grouped(terms: tuple[Term, ...], coefficient: Array) -> list[tuple[Term, Indices, Array]]:
    """Return terms with the lanes in which their coefficient (E, L) is not 0, and the coefficients there.

    For speed, terms of one kind and joint in different lanes are one term with an array of numbers.
    """
    groups: dict[tuple[TermKind, int, int], list[tuple[int, float, float]]] = {}
    for k, lane in np.argwhere(coefficient):
        kind, joint, copy = terms[k].kind, terms[k].joint, 0
        while any(lane == other for other, *_ in groups.get((kind, joint, copy), ())):
            copy += 1
        groups.setdefault((kind, joint, copy), []).append((lane, terms[k].number, coefficient[k, lane]))
    grouped = []
    for (kind, joint, _), rows in groups.items():
        lanes, numbers, coefficients = map(np.array, zip(*rows, strict=True))
        grouped.append((Term(kind, joint, numbers), lanes, coefficients))
    return grouped
