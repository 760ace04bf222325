# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The composite likelihood of the innovations of an extended Kalman filter.

The filter (:mod:`.model.filter`) processes each recording at several sampling intervals. Its innovations e
with variances s are Student-t distributed with nu degrees of freedom:

    J = 1/K sum over K intervals of sum[ log(s) / 2 + (nu + 1) / 2 log(1 + e^2 / (nu s)) ] + |offset / prior|^2 / 2

J is a composite likelihood (Varin, Reid and Firth, Statistica Sinica 21, 2011): the intervals share data, so that its
curvature overstates the information. Short intervals are sensitive to friction and inertia, long ones to prediction
errors. White torque noise, with one intensity for each interval, represents unmodelled effects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.optimize import lsq_linear

from pendubot_identification.arrays import Array, Flags
from pendubot_identification.model.dynamics import SIGN_WIDTH
from pendubot_identification.model.filter import Samples, Term, Vectors, innovations
from pendubot_identification.model.parameters import repaired
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import encoder_step

#: Maps a recorded motion and the unknowns of an effect to the motion with acting torques and true angles.
Shape = Callable[[Motion, Array], Motion]
#: Number of unknowns before the effects: theta, delay, offsets.
SHARED = 17


@dataclass(frozen=True, slots=True)
class LikelihoodSettings:
    """The sampling of the recordings, and the distribution of the innovations.

    Attributes:
        intervals: sampling intervals of the filters [s]; beyond 0.2 s the likelihood has wrong optima.
        step: longest Runge-Kutta step [s].
        turn: largest rotation of a joint in a step [rad].
        freedom: nu, degrees of freedom of the innovations; infinite: Gaussian.
        offset: standard deviation of the zeros of both positions [rad].
        rest: a sample has no weight if both joints move by at most this number of encoder steps: at rest neither torque
            noise nor quantization is white.
        still: time before and after a sample within which ``rest`` counts the motion [s].
        block: approximate duration of the blocks of time, the correlation time of the errors [s].
        fine: longest step [s] where a joint is slower than ``slow`` [rad/s] or reverses: dry friction is stiff.
        slow: speed limit of ``fine`` [rad/s].
    """

    intervals: tuple[float, ...] = (0.05, 0.1, 0.2)
    step: float = 0.005
    freedom: float = 12.0
    offset: float = 0.005
    rest: float = 2.5
    still: float = 0.1
    block: float = 1.0
    turn: float = 0.2
    fine: float = math.inf
    slow: float = 0.0


@dataclass(frozen=True, slots=True)
class FilterData:
    """The inputs of the filters for R recordings at K intervals, in the order of :class:`.filter.Samples`.

    Attributes:
        motions: the recordings.
        settings: the sampling.
        samples: without states, torques and positions.
        chosen: indices of the samples that each filter uses.
        edges: boundaries of the steps of each filter [s].
        recording: index of the recording of each filter, shape (G,).
        rows: slice of the measurements of each filter.
        weight: of each measurement, 1 or, at rest, 0, shape (N,).
        t: time of each measurement [s], shape (N,).
        block: index of the block of time of each measurement, shape (N,).
        owner: index of the recording of each block, shape (B,).
        quantization: variance of the positions' quantization [rad^2], shape (2,).
    """

    motions: tuple[Motion, ...]
    settings: LikelihoodSettings
    samples: Samples
    chosen: tuple[NDArray[np.intp], ...]
    edges: tuple[Array, ...]
    recording: NDArray[np.intp]
    rows: tuple[slice, ...]
    weight: Array
    t: Array
    block: NDArray[np.intp]
    owner: NDArray[np.intp]
    quantization: Array

    @classmethod
    def of(cls, motions: Sequence[Motion], settings: LikelihoodSettings | None = None) -> FilterData:
        """Sample recordings at all intervals."""
        settings = settings or LikelihoodSettings()
        quantum = np.max([encoder_step(m.recorded.q) for m in motions], axis=0)
        ends = np.cumsum([0.0, *(m.end - m.start for m in motions)])
        parts, row = list[_Series](), 0
        for level, interval in enumerate(settings.intervals):
            for number, motion in enumerate(motions):
                chosen = _thinned(motion.recorded.t, interval)
                t = motion.recorded.t[chosen]
                longest = np.full(len(t) - 1, settings.step)
                if settings.fine < settings.step:
                    longest[_slow(motion, chosen, settings.slow)] = settings.fine
                faster = np.abs(motion.states(t)[2:]).max(axis=0)
                turns = np.maximum(faster[:-1], faster[1:]) / settings.turn
                count = np.ceil(np.diff(t) * np.maximum(1 / longest, turns) - 1e-9).astype(int)
                part = np.arange(1, count.sum() + 1) - np.repeat(np.cumsum(count) - count, count)
                edges = np.append(t[0], np.repeat(t[:-1], count) + part * np.repeat(np.diff(t) / count, count))
                rows = np.full(count.sum(), -1)
                rows[np.cumsum(count) - 1] = row + np.arange(len(t) - 1)
                elapsed = (ends[number] + (edges[1:] + edges[:-1]) / 2 - motion.start) / ends[-1] - 0.5
                weight = (~_at_rest(motion, settings.rest * quantum, settings.still)[chosen[1:]]).astype(float)
                measured = slice(row, row + len(t) - 1)
                parts.append(_Series(level, number, motion, chosen, t, edges, rows, elapsed, weight, measured))
                row = measured.stop
        steps = max(len(p.rows) for p in parts)
        counts = [max(1, round((m.end - m.start) / settings.block)) for m in motions]
        owner = np.repeat(np.arange(len(motions)), counts)
        block = [_blocks(p.motion, np.flatnonzero(owner == p.number), p.t[1:]) for p in parts]

        def padded(values: NDArray[Any], fill: float = 0.0) -> NDArray[Any]:
            shape = (steps - len(values), *values.shape[1:])
            return np.concatenate([values, np.full(shape, fill, values.dtype)])

        speed = np.array([0.1 + 0.1 * p.motion.states(p.t)[2:].std(axis=1) for p in parts])
        spread = np.column_stack([np.maximum(quantum**2 / 12, 1e-10) * np.ones((len(parts), 2)), speed**2])
        samples = Samples(
            start=np.empty((0, len(parts), 4)),
            spread=spread,
            level=np.array([p.level for p in parts]),
            length=np.array([len(p.rows) for p in parts]),
            h=np.array([padded(np.diff(p.edges)) for p in parts]),
            elapsed=np.array([padded(p.elapsed) for p in parts]),
            tau=np.empty((0, len(parts), steps, 2)),
            y=np.empty((0, len(parts), steps, 2)),
            row=np.array([padded(p.rows, -1) for p in parts]),
        )
        return cls(
            motions=tuple(motions),
            settings=settings,
            samples=samples,
            chosen=tuple(p.chosen for p in parts),
            edges=tuple(p.edges for p in parts),
            recording=np.array([p.number for p in parts]),
            rows=tuple(p.measured for p in parts),
            weight=np.concatenate([p.weight for p in parts]),
            t=np.concatenate([p.t[1:] for p in parts]),
            block=np.concatenate(block),
            owner=owner,
            quantization=np.maximum(quantum**2 / 12, 1e-14),
        )

    @property
    def measurements(self) -> int:
        """The number of measurements with weight 1."""
        return int(self.weight.sum())

    def block_times(self, block: int) -> float:
        """Return the middle of a block of time [s]."""
        motion, blocks = self.motions[self.owner[block]], np.flatnonzero(self.owner == self.owner[block])
        return float(motion.start + (block - blocks[0] + 0.5) / len(blocks) * (motion.end - motion.start))

    def block_of(self, recording: int, t: Array) -> NDArray[np.intp]:
        """Return the index of the block of time of a recording that contains each of the times t [s]."""
        return _blocks(self.motions[recording], np.flatnonzero(self.owner == recording), t)

    def torques(self, motions: Sequence[Motion], delay: float) -> Array:
        """Return mean torques of all steps [N m] with a delay [s], shape (G, S, 2)."""
        tau = np.zeros((*self.samples.h.shape, 2))
        for g, edges in enumerate(self.edges):
            impulse = motions[self.recording[g]].impulse(edges - delay)
            tau[g, : len(edges) - 1] = np.diff(impulse, axis=0) / np.diff(edges)[:, None]
        return tau

    def positions(self, motions: Sequence[Motion]) -> tuple[Array, Array]:
        """Return the initial states and the measured positions, shapes (G, 4), (G, S, 2)."""
        start, y = np.zeros((len(self.chosen), 4)), np.zeros((*self.samples.h.shape, 2))
        for g, chosen in enumerate(self.chosen):
            motion = motions[self.recording[g]]
            q = motion.recorded.q[chosen]
            start[g] = [*q[0], *motion.states(motion.recorded.t[chosen[:1]])[2:, 0]]
            y[g, self.samples.row[g] >= 0] = q[1:]
        return start, y


class _Series(NamedTuple):
    """The data of one filter: a recording at one sampling interval."""

    level: int
    number: int
    motion: Motion
    chosen: NDArray[np.intp]
    t: Array
    edges: Array
    rows: NDArray[np.int_]
    elapsed: Array
    weight: Array
    measured: slice


def _blocks(motion: Motion, blocks: NDArray[np.intp], t: Array) -> NDArray[np.intp]:
    """Return the index of the block of time, of those of a motion, that contains each of the times t [s]."""
    part = (t - motion.start) / max(motion.end - motion.start, 1e-9) * len(blocks)
    return np.asarray(blocks[np.clip(part.astype(int), 0, len(blocks) - 1)])


def _thinned(t: Array, interval: float) -> NDArray[np.intp]:
    """Return the indices of samples about ``interval`` [s] apart, or of all samples if their interval is longer."""
    usual = float(np.median(np.diff(t)))
    every = max(1, round(interval / usual)) * usual
    nearest = np.searchsorted(t, np.arange(t[0], t[-1] + usual / 2, every) - usual / 2)
    return np.unique(np.minimum(nearest, len(t) - 1))


def _slow(motion: Motion, chosen: NDArray[np.intp], limit: float) -> Flags:
    """Return whether a joint is slower than a limit [rad/s] or reverses between consecutive chosen samples."""

    def all_samples() -> Flags:
        v = motion.states(motion.recorded.t)[2:]
        slow = (np.minimum(np.abs(v[:, 1:]), np.abs(v[:, :-1])) < limit) | (v[:, 1:] * v[:, :-1] < 0)
        return np.asarray(slow.any(axis=0))

    return np.asarray(np.logical_or.reduceat(motion.once(('slow', limit), all_samples), chosen[:-1]))


def _at_rest(motion: Motion, limit: Array, still: float) -> Flags:
    """Return whether both joints move by at most a limit [rad] within about ``still`` [s] around each sample."""
    t, q = motion.recorded.t, motion.recorded.q
    block = ((t - t[0]) / still).astype(int)
    first = np.flatnonzero(np.append(True, np.diff(block) > 0))
    low, high = (np.pad(f.reduceat(q, first), ((1, 1), (0, 0)), mode='edge') for f in (np.minimum, np.maximum))
    around = [slice(k, len(first) + k) for k in range(3)]
    span = np.max([high[part] for part in around], axis=0) - np.min([low[part] for part in around], axis=0)
    return np.asarray((span <= np.maximum(limit, 1e-9)).all(axis=1)[np.cumsum(np.isin(np.arange(len(t)), first)) - 1])


class Unknown(NamedTuple):
    """One unknown of an effect: its scale, bounds, and initial value."""

    scale: float
    lower: float
    upper: float
    start: float = 0.0


@dataclass(frozen=True, slots=True)
class Extension:
    """The extension of the model by one effect.

    Attributes:
        unknowns: the E unknowns of the effect.
        terms: additional torques, whose coefficients are the first unknowns.
        shape: change of the recorded torque or the recorded angles by the other unknowns.
        width: joints for which the width of the change of sign of dry friction is an unknown, the last ones.
    """

    unknowns: tuple[Unknown, ...]
    terms: tuple[Term, ...] = ()
    shape: Shape | None = None
    width: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Evaluation:
    """J of each block of time, with slope and expected information by P unknowns: (B,), (B, P), (B, P, P)."""

    costs: Array
    slopes: Array
    informations: Array


class _Shaped(NamedTuple):
    """Motions changed by effects, with initial states and positions, see :meth:`FilterData.positions`."""

    motions: tuple[Motion, ...]
    start: Array
    y: Array


@dataclass(frozen=True)
class Likelihood:
    """J as a function of x: theta (14), delay, offsets, effects, and log noise (position, torque) at each level."""

    filter_data: FilterData
    effects: tuple[Extension, ...] = ()
    scale: Array = field(default_factory=lambda: np.ones(SHARED))
    _shaped: dict[bytes, _Shaped] = field(default_factory=dict, repr=False)

    def of(self, filter_data: FilterData) -> Likelihood:
        """Return the likelihood of other filter data, with the same effects."""
        return replace(self, filter_data=filter_data, _shaped={})

    @property
    def levels(self) -> int:
        """The number of sampling intervals K."""
        return len(self.filter_data.settings.intervals)

    @property
    def shared(self) -> int:
        """The number of unknowns that all levels share."""
        return SHARED + sum(len(e.unknowns) for e in self.effects)

    @property
    def size(self) -> int:
        """The number of unknowns P."""
        return self.shared + 4 * self.levels

    def _vectors(self, lanes: Array) -> tuple[Samples, Vectors, tuple[Term, ...]]:
        """Return the inputs of the filters for L vectors of unknowns, shape (P, L)."""
        count, levels = lanes.shape[1], self.levels
        width = np.full((2, count), SIGN_WIDTH)
        terms: list[Term] = []
        coefficients, shapes = [], []
        first = SHARED
        for effect in self.effects:
            unknowns = lanes[first : first + len(effect.unknowns)]
            first += len(effect.unknowns)
            n = len(effect.terms)
            terms += effect.terms
            coefficients.append(unknowns[:n])
            if effect.shape is not None:
                shapes.append((effect.shape, unknowns[n:]))
            for k, joint in enumerate(effect.width):
                width[joint] = unknowns[n + k]
        keys = np.vstack([lanes[14], *(unknowns for _, unknowns in shapes)])
        _, different, table = np.unique(keys, axis=1, return_index=True, return_inverse=True)
        shaped = [self._shaped_by([(f, unknowns[:, lane]) for f, unknowns in shapes]) for lane in different]
        delays = lanes[14, different].tolist()
        samples = replace(
            self.filter_data.samples,
            start=np.stack([s.start for s in shaped]),
            tau=np.stack([self.filter_data.torques(s.motions, d) for s, d in zip(shaped, delays, strict=True)]),
            y=np.stack([s.y for s in shaped]),
        )
        noise = np.exp(2 * lanes[self.shared :].reshape(levels, 4, count))
        vectors = Vectors(
            theta=lanes[:14],
            offset=lanes[15:17],
            noise=noise,
            width=width,
            coefficient=np.concatenate(coefficients) if coefficients else np.zeros((0, count)),
            table=table.ravel(),
        )
        return samples, vectors, tuple(terms)

    def _shaped_by(self, shapes: Sequence[tuple[Shape, Array]]) -> _Shaped:
        """Return the motions changed by effects, from a cache of recent results."""
        key = b''.join(unknowns.tobytes() for _, unknowns in shapes)
        if key not in self._shaped:
            if len(self._shaped) > 30:
                self._shaped.clear()
            motions = self.filter_data.motions
            for shape, unknowns in shapes:
                motions = tuple(shape(motion, unknowns) for motion in motions)
            self._shaped[key] = _Shaped(motions, *self.filter_data.positions(motions))
        return self._shaped[key]

    def innovations(self, x: Array) -> tuple[Array, Array]:
        """Return the innovations [rad] and their squared scales [rad^2], shapes (N, 2)."""
        e, s = innovations(*self._vectors(x[:, None]))
        return e[:, :, 0], s[:, :, 0]

    @np.errstate(all='ignore')
    def costs(self, x: Array) -> Array:
        """Return J of each block, without the prior, shape (B,)."""
        e, s = self.innovations(x)
        return self._costs(e, s)

    def _costs(self, e: Array, s: Array) -> Array:
        filter_data, nu = self.filter_data, self.filter_data.settings.freedom
        if np.isinf(nu):
            each = np.log(s) / 2 + e * e / s / 2
        else:
            each = np.log(s) / 2 + (nu + 1) / 2 * np.log1p(e * e / (nu * s))
        each = (np.where(filter_data.weight[:, None] > 0, each, 0.0)).sum(axis=1) / self.levels
        return np.asarray(np.bincount(filter_data.block, each, minlength=len(filter_data.owner)), dtype=float)

    @np.errstate(all='ignore')
    def evaluate(self, x: Array, free: Flags) -> Evaluation:
        """Return J, and slopes and information by the free unknowns, from finite differences."""
        filter_data, nu = self.filter_data, self.filter_data.settings.freedom
        shared = np.flatnonzero(free[: self.shared])
        steps = 1e-5 * self.scale[shared]
        lanes = np.repeat(x[:, None], 1 + len(shared) + 4, axis=1)
        lanes[shared, 1 + np.arange(len(shared))] += steps
        noise = self.shared + np.arange(4 * self.levels).reshape(self.levels, 4)
        for k in range(4):  # of all levels at once: a filter depends only on the noise of its level
            lanes[noise[:, k], 1 + len(shared) + k] += 1e-5
        e, s = innovations(*self._vectors(lanes))
        by = np.concatenate([steps, np.full(4, 1e-5)])
        de, ds = (values[:, :, 1:] - values[:, :, :1] for values in (e, s))
        e, s = e[:, :, 0], s[:, :, 0]
        costs = self._costs(e, s)
        w = np.broadcast_to(filter_data.weight[:, None] / self.levels, e.shape)
        if np.isinf(nu):
            to_e, to_s, ee, ss = e / s, 0.5 / s - e * e / (2 * s * s), 1 / s, 0.5 / s**2
        else:
            to_e = (nu + 1) * e / (nu * s + e * e)
            to_s = 0.5 / s - (nu + 1) / 2 * e * e / (s * (nu * s + e * e))
            ee, ss = (nu + 1) / ((nu + 3) * s), nu / (2 * (nu + 3) * s * s)
        count = len(filter_data.owner)
        slopes, informations = np.zeros((count, self.size)), np.zeros((count, self.size, self.size))
        for g, rows in enumerate(filter_data.rows):
            index = np.concatenate([shared, noise[filter_data.samples.level[g]]])
            square = np.ix_(index, index)
            first = rows.start + np.append(0, np.flatnonzero(np.diff(filter_data.block[rows])) + 1)
            for part in map(slice, first, [*first[1:], rows.stop]):
                a, b = de[part].reshape(-1, len(index)), ds[part].reshape(-1, len(index))
                weight, block = w[part].ravel(), filter_data.block[part.start]
                slope = (weight * to_e[part].ravel()) @ a + (weight * to_s[part].ravel()) @ b
                information = (a * (weight * ee[part].ravel())[:, None]).T @ a
                information += (b * (weight * ss[part].ravel())[:, None]).T @ b
                slopes[block, index] += slope / by
                informations[block][square] += information / by / by[:, None]
        return Evaluation(costs, slopes, informations)

    def prior(self, x: Array) -> float:
        """Return the part of J by the prior of the offsets."""
        return float((x[15:17] ** 2).sum() / self.filter_data.settings.offset**2 / 2)


def fitted_information(likelihood: Likelihood, evaluation: Evaluation, x: Array) -> tuple[Array, Array]:
    """Return slope and information of all blocks and the prior together, shapes (P,), (P, P)."""
    prior = np.zeros(len(x))
    prior[[15, 16]] = 1 / likelihood.filter_data.settings.offset**2
    return evaluation.slopes.sum(axis=0) + prior * x, evaluation.informations.sum(axis=0) + np.diag(prior)


@dataclass(frozen=True, slots=True)
class LikelihoodFit:
    """The minimum of J by Fisher scoring.

    Attributes:
        x: the unknowns, shape (P,).
        free: whether each unknown is estimated and not on a bound, shape (P,).
        cost: J with the prior.
        evaluation: of J at x.
        information: of all recordings and the prior, shape (P, P).
        iterations: number of scoring steps.
        converged: whether the predicted gain of another step is negligible.
    """

    x: Array
    free: Flags
    cost: float
    evaluation: Evaluation
    information: Array
    iterations: int
    converged: bool


def fit(
    likelihood: Likelihood,
    x: Array,
    lower: Array,
    upper: Array,
    iterations: int = 40,
    tolerance: float = 0.05,
    progress: Callable[[float], None] | None = None,
) -> LikelihoodFit:
    """Minimise J within bounds by Fisher scoring with Levenberg and Marquardt's damping.

    If the model is wrong, the curvature of J differs from the expected information. Rank-one updates estimate the
    difference (Conn, Gould and Toint, Mathematical Programming 50, 1991). It is used while it predicts J better
    (Dennis, Gay and Welsch, ACM Transactions on Mathematical Software 7, 1981).

    Args:
        likelihood: J.
        x: initial values, shape (P,).
        lower: lower bounds; equal bounds fix an unknown.
        upper: upper bounds.
        iterations: largest number of scoring steps.
        tolerance: predicted gain of a step at which the iteration stops; 0.5 is about one standard error.
        progress: called with J after every iteration.
    """
    estimated = lower < upper
    x = repaired(np.clip(x, lower, upper))
    damping, converged, number, rejected = 1e-3, False, 0, 0
    reach = np.where(np.arange(len(x)) < likelihood.shared, np.inf, 1.0)  # noise changes by a factor of e at most
    now, cost = _evaluated(likelihood, x, estimated)
    if not np.isfinite(cost):
        raise FloatingPointError
    slope, information = fitted_information(likelihood, now, x)
    correction, corrected = np.zeros_like(information), False
    while number < iterations:
        curvature = _corrected(information, correction)
        low, high = np.maximum(lower - x, -reach), np.minimum(upper - x, reach)
        step, gain = bounded_step(curvature if corrected else information, slope, damping, low, high, estimated)
        if gain < tolerance or rejected == 12:
            converged = gain < 1.0
            break
        trial = repaired(x + step)
        after, value = _evaluated(likelihood, trial, estimated)
        moved, better = trial - x, value < cost - 0.01 * gain
        if np.isfinite(value):
            slope_after, information_after = fitted_information(likelihood, after, trial)
            wrong = [abs(value - cost - (slope + H @ moved / 2) @ moved) for H in (information, curvature)]
            corrected = bool(wrong[1] < wrong[0])
            near = information_after if better else information
            correction = _secant(correction, near, moved, slope_after - slope)
        if not better:
            damping, rejected = damping * 8.0, rejected + 1
            continue
        ratio = (cost - value) / gain
        damping = max(damping * (0.2 if ratio > 0.6 else 1.0 if ratio > 0.2 else 3.0), 1e-9)
        x, now, cost, slope, information = trial, after, value, slope_after, information_after
        number, rejected = number + 1, 0
        if progress is not None:
            progress(cost)
    margin = 1e-9 * np.maximum(upper - lower, 0)
    free = estimated & (x > lower + margin) & (x < upper - margin)
    return LikelihoodFit(x, free, cost, now, information, number, converged)


def _evaluated(likelihood: Likelihood, x: Array, estimated: Flags) -> tuple[Evaluation, float]:
    """Return J of the blocks, and J with the prior; infinite if a filter diverges."""
    evaluation = likelihood.evaluate(x, estimated)
    cost = float(evaluation.costs.sum()) + likelihood.prior(x)
    return evaluation, cost if np.isfinite(cost) and np.isfinite(evaluation.informations).all() else math.inf


def _corrected(information: Array, correction: Array) -> Array:
    """Return the information plus its correction, but along any direction at least a tenth of the information."""
    index = np.flatnonzero(np.diag(information) > 0)
    square, result = np.ix_(index, index), information.copy()
    scale = np.sqrt(np.diag(information)[index])
    H = information[square] / scale / scale[:, None] + 1e-9 * np.eye(len(index))
    values, vectors = eigh(correction[square] / scale / scale[:, None], H)
    root = scale[:, None] * (H @ vectors)
    result[square] += root * np.maximum(values, -0.9) @ root.T
    return np.asarray(result)


def _secant(correction: Array, information: Array, moved: Array, change: Array) -> Array:
    """Return the correction after a rank-one update by the change of the slope along a step."""
    scale = np.sqrt(np.diag(information))
    rest = np.where(scale > 0, change - (information + correction) @ moved, 0.0)
    along = rest @ moved
    if abs(along) <= 1e-8 * np.linalg.norm(rest[scale > 0] / scale[scale > 0]) * np.linalg.norm(scale * moved):
        return correction
    return np.asarray(correction + np.outer(rest, rest) / along)


def bounded_step(
    information: Array, slope: Array, damping: float, low: Array, high: Array, estimated: Flags
) -> tuple[Array, float]:
    """Return the damped scoring step within bounds, and the predicted decrease of J."""
    index, step = np.flatnonzero(estimated & (np.diag(information) > 0)), np.zeros(len(slope))
    if not index.size:
        return step, 0.0
    H, g = information[np.ix_(index, index)], slope[index]
    scale = np.sqrt(np.diag(H))
    H = H / scale / scale[:, None] + damping * np.eye(len(index))
    g = g / scale
    values, vectors = np.linalg.eigh(H)
    values = np.maximum(values, 1e-10 * values.max())
    root = (vectors * np.sqrt(values)).T
    target = -(vectors / np.sqrt(values)).T @ g
    d = lsq_linear(root, target, (low[index] * scale, high[index] * scale), 'bvls', tol=1e-15).x
    step[index] = d / scale
    return step, float(-(g @ d) - d @ H @ d / 2)
