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
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import lsq_linear

from pendubot_identification.arrays import Array, Flags, Indices
from pendubot_identification.model.dynamics import SIGN_WIDTH
from pendubot_identification.model.filter import Samples, Term, Vectors, innovations
from pendubot_identification.model.parameters import repaired
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import encoder_step

T = TypeVar('T')
#: Maps a recorded motion and the unknowns of an effect to the motion with acting torques.
Shape = Callable[[Motion, Array], Motion]
#: Maps recorded positions [rad], shape (N, 2), and the unknowns of an effect to the true positions.
Calibration = Callable[[Array, Array], Array]
#: Number of unknowns before the effects: theta, delay.
SHARED = 15


@dataclass(frozen=True, slots=True)
class LikelihoodSettings:
    """The sampling of the recordings, and the distribution of the innovations."""

    #: sampling intervals of the filters [s]; beyond 0.2 s the likelihood has wrong optima.
    intervals: tuple[float, ...] = (0.05, 0.1, 0.2)
    step: float = 0.01  #: longest Runge-Kutta step [s].
    freedom: float = 12.0  #: nu, degrees of freedom of the innovations; 1e9: Gaussian.
    #: standard deviation of the zeros of both positions in a recording [rad]: dry friction holds a link away from
    #: hanging, by up to Fc over its largest gravity torque, 0.03 to 0.1 rad on small rigs.
    offset: float = 0.05
    #: a sample has no weight if both joints move by at most this number of encoder steps: at rest neither torque noise
    #: nor quantization is white.
    rest: float = 2.5
    still: float = 0.1  #: time before and after a sample within which ``rest`` counts the motion [s].
    block: float = 1.0  #: approximate duration of the blocks of time, the correlation time of the errors [s].
    turn: float = 0.2  #: largest rotation of a joint in a step [rad].
    #: longest step [s] where a joint is slower than ``slow`` [rad/s] or reverses: dry friction is stiff.
    fine: float = 0.005
    slow: float = 0.3  #: six widths of the change of sign of dry friction [rad/s].


class Series(NamedTuple):
    """The inputs of one filter: a recording at one sampling interval."""

    level: int  #: index of the interval.
    recording: int  #: index of the recording.
    chosen: Indices  #: indices of the samples that the filter uses.
    edges: Array  #: boundaries of its steps [s].
    last: Indices  #: index of the step that ends at each of these samples but the first.
    rows: slice  #: its measurements, of those of all filters.


@dataclass(frozen=True, slots=True)
class FilterData:
    """The inputs of the filters for R recordings at K intervals, in the order of :class:`.filter.Samples`."""

    motions: tuple[Motion, ...]  #: the recordings.
    settings: LikelihoodSettings  #: the sampling.
    series: tuple[Series, ...]  #: of each filter.
    samples: Samples  #: without states, torques and positions.
    weight: Array  #: of each measurement, 1 or, at rest, 0, shape (N,).
    t: Array  #: time of each measurement [s], shape (N,).
    block: Indices  #: index of the block of time of each measurement, shape (N,).
    owner: Indices  #: index of the recording of each block, shape (B,).
    quantization: Array  #: variance of the positions' quantization [rad^2], shape (2,).

    @classmethod
    def of(cls, motions: Sequence[Motion], settings: LikelihoodSettings | None = None) -> FilterData:
        """Sample recordings at all intervals."""
        settings = settings or LikelihoodSettings()
        variance = quantization(motions)
        still = settings.rest * np.sqrt(12 * variance)
        owner = np.repeat(np.arange(len(motions)), [max(1, round((m.end - m.start) / settings.block)) for m in motions])
        series, weight, times, block, row = [], [], [], [], 0
        for level, interval in enumerate(settings.intervals):
            for number, motion in enumerate(motions):
                chosen = _thinned(motion.recorded.t, interval)
                t = motion.recorded.t[chosen]
                edges, last = _steps(motion, chosen, settings)
                series.append(Series(level, number, chosen, edges, last, slice(row, row + len(last))))
                weight.append(~_at_rest(motion, still, settings.still)[chosen[1:]])
                times.append(t[1:])
                block.append(_blocks(motion, np.flatnonzero(owner == number), t[1:]))
                row += len(last)
        return cls(
            motions=tuple(motions),
            settings=settings,
            series=tuple(series),
            samples=_samples(motions, series, variance),
            weight=np.concatenate(weight).astype(float),
            t=np.concatenate(times),
            block=np.concatenate(block),
            owner=owner,
            quantization=variance,
        )

    @property
    def measurements(self) -> int:
        """The number of measurements with weight 1."""
        return int(self.weight.sum())

    @property
    def block_times(self) -> Array:
        """The middle of each block of time [s], shape (B,)."""
        counts = zip(self.motions, np.bincount(self.owner), strict=True)
        return np.concatenate([m.start + (np.arange(n) + 0.5) / n * (m.end - m.start) for m, n in counts])

    def block_of(self, recording: int, t: Array) -> Indices:
        """Return the index of the block of time of a recording that contains each of the times t [s]."""
        return _blocks(self.motions[recording], np.flatnonzero(self.owner == recording), t)

    def torques(self, motions: Sequence[Motion], delay: float) -> tuple[Array, Array]:
        """Return the torques of all steps [N m] with a delay [s]: mean, and half of their change, shapes (G, S, 2)."""
        tau, change = (np.zeros((*self.samples.h.shape, 2)) for _ in range(2))
        for g, each in enumerate(self.series):
            steps = slice(len(each.edges) - 1)
            tau[g, steps], change[g, steps] = motions[each.recording].torques(each.edges - delay)
        return tau, change

    def positions(self, calibrated: Callable[[Array], Array]) -> tuple[Array, Array]:
        """Return the initial states and the measured positions, with true angles, shapes (G, 4), (G, S, 2)."""
        start, y = np.zeros((len(self.series), 4)), np.zeros((*self.samples.h.shape, 2))
        for g, each in enumerate(self.series):
            motion = self.motions[each.recording]
            q = calibrated(motion.recorded.q[each.chosen])
            start[g] = [*q[0], *motion.states(motion.recorded.t[each.chosen[:1]])[2:, 0]]
            y[g, self.samples.row[g] >= 0] = q[1:]
        return start, y


def quantization(motions: Sequence[Motion]) -> Array:
    """Return the variance of the positions' quantization [rad^2], shape (2,)."""
    quantum = np.max([encoder_step(m.recorded.q) for m in motions], axis=0)
    return np.asarray(np.maximum(quantum**2 / 12, 1e-14))


def _steps(motion: Motion, chosen: Indices, settings: LikelihoodSettings) -> tuple[Array, Indices]:
    """Return the boundaries of the steps of a filter [s], and the index of the step that ends at each sample."""
    t = motion.recorded.t[chosen]
    longest = np.full(len(t) - 1, settings.step)
    if settings.fine < settings.step:
        longest[_slow(motion, chosen, settings.slow)] = settings.fine
    faster = np.abs(motion.states(t)[2:]).max(axis=0)
    turns = np.maximum(faster[:-1], faster[1:]) / settings.turn
    count = np.ceil(np.diff(t) * np.maximum(1 / longest, turns) - 1e-9).clip(1).astype(int)
    part = np.arange(1, count.sum() + 1) - np.repeat(np.cumsum(count) - count, count)
    edges = np.append(t[0], np.repeat(t[:-1], count) + part * np.repeat(np.diff(t) / count, count))
    return edges, np.cumsum(count) - 1


def _samples(motions: Sequence[Motion], series: Sequence[Series], variance: Array) -> Samples:
    """Return the inputs of all filters without states, torques and positions; ``variance``: of the first positions."""
    filters, length = len(series), np.array([len(each.edges) - 1 for each in series])
    h, elapsed, row = (np.full((filters, length.max()), fill) for fill in (0.0, 0.0, -1))
    spread = np.tile(np.maximum(variance, 1e-10), (filters, 2))
    ends = np.cumsum([0.0, *(m.end - m.start for m in motions)])
    for g, each in enumerate(series):
        motion, number, edges = motions[each.recording], each.recording, each.edges
        h[g, : length[g]] = np.diff(edges)
        elapsed[g, : length[g]] = (ends[number] + (edges[1:] + edges[:-1]) / 2 - motion.start) / ends[-1] - 0.5
        row[g, each.last] = np.arange(each.rows.start, each.rows.stop)
        spread[g, 2:] = (0.1 + 0.1 * motion.states(motion.recorded.t[each.chosen])[2:].std(axis=1)) ** 2
    none = np.empty((0, *h.shape, 2))
    level = np.array([each.level for each in series])
    return Samples(np.empty((0, filters, 4)), spread, level, length, h, elapsed, none, none, none, row)


def _blocks(motion: Motion, blocks: Indices, t: Array) -> Indices:
    """Return the index of the block of time, of those of a motion, that contains each of the times t [s]."""
    part = (t - motion.start) / max(motion.end - motion.start, 1e-9) * len(blocks)
    return np.asarray(blocks[np.clip(part.astype(int), 0, len(blocks) - 1)])


def _thinned(t: Array, interval: float) -> Indices:
    """Return the indices of samples about ``interval`` [s] apart, or of all samples if their interval is longer."""
    usual = float(np.median(np.diff(t)))
    every = max(1, round(interval / usual)) * usual
    nearest = np.searchsorted(t, np.arange(t[0], t[-1] + usual / 2, every) - usual / 2)
    return np.unique(np.minimum(nearest, len(t) - 1))


def _slow(motion: Motion, chosen: Indices, limit: float) -> Flags:
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
class Effect:
    """An extension of the model by an unmodelled effect."""

    name: str  #: of the effect.
    where: str  #: the joint or part on which it acts.
    unknowns: tuple[Unknown, ...]  #: of the effect.
    terms: tuple[Term, ...] = ()  #: additional torques, whose coefficients are the first unknowns.
    shape: Shape | None = None  #: change of the recorded torque by the other unknowns.
    calibration: Calibration | None = None  #: change of the recorded angles by the other unknowns.
    #: joints for which the width of the change of sign of dry friction is an unknown, the last ones.
    width: tuple[int, ...] = ()
    blind: bool = False  #: whether the slope of J by its unknowns is 0 without it, so that it needs a start with it.


@dataclass(frozen=True, slots=True)
class Evaluation:
    """J with slope and expected information by P unknowns."""

    costs: Array  #: of each block of time, shape (B,).
    slopes: Array  #: of each block, shape (B, P).
    #: of each block by the unknowns of its recording, see :meth:`Likelihood.of_recording`, shape (B, Q, Q).
    informations: Array
    cost: float  #: of all blocks and the prior, infinite if a filter diverges.
    slope: Array  #: likewise, shape (P,).
    information: Array  #: likewise, shape (P, P).


@dataclass(frozen=True)
class Likelihood:
    """J as a function of x: theta (14), delay, effects, offsets of each recording, log noise at each level.

    The offsets and the noise are of both positions; the noise is also of both torques.
    """

    filter_data: FilterData  #: the inputs of the filters.
    lower: Array  #: lower bounds of x, shape (P,); equal bounds fix an unknown.
    upper: Array  #: upper bounds.
    scale: Array  #: of the unknowns that all levels share, for finite differences.
    effects: tuple[Effect, ...] = ()  #: that extend the model.
    _made: dict[Hashable, Any] = field(default_factory=dict, repr=False)

    def of(self, filter_data: FilterData) -> Likelihood:
        """Return the likelihood of other filter data; further levels have the bounds of the first one."""
        levels = len(filter_data.settings.intervals)
        lower, upper = (self.widened(bound, levels) for bound in (self.lower, self.upper))
        return replace(self, filter_data=filter_data, lower=lower, upper=upper, _made={})

    def widened(self, x: Array, levels: int) -> Array:
        """Return x for another number of levels; further levels have the values of the first one."""
        before, noise = x[: self.before_noise], x[self.before_noise :]
        return np.append(before, noise if levels == self.levels else np.tile(noise[:4], levels))

    def extended(self, effects: Sequence[Effect], x: Array) -> tuple[Likelihood, Array]:
        """Return the likelihood with more effects, and x with their initial values."""
        scale, lower, upper, start = np.array([u for e in effects for u in e.unknowns]).T
        pairs = (self.lower, lower), (self.upper, upper), (x, start)
        lower, upper, x = (np.insert(values, self.shared, new) for values, new in pairs)
        grown = (*self.effects, *effects)
        return Likelihood(self.filter_data, lower, upper, np.append(self.scale, scale), grown), x

    @property
    def estimated(self) -> Flags:
        """Which unknowns are not fixed, shape (P,)."""
        return np.asarray(self.lower < self.upper)

    @property
    def levels(self) -> int:
        """The number of sampling intervals K."""
        return len(self.filter_data.settings.intervals)

    @property
    def shared(self) -> int:
        """The number of unknowns before the offsets."""
        return len(self.scale)

    @property
    def before_noise(self) -> int:
        """The number of unknowns before the noise."""
        return len(self.scale) + 2 * len(self.filter_data.motions)

    def of_recording(self, number: int) -> Indices:
        """Return the indices of a recording's unknowns: all but the offsets of the others, shape (Q,)."""
        offset, noise = self.shared + 2 * number, self.before_noise
        return np.asarray(np.r_[: self.shared, offset : offset + 2, noise : noise + 4 * self.levels])

    def offsets(self, x: Array) -> Array:
        """Return the offsets of the positions in each recording [rad], shape (R, 2)."""
        return x[self.shared : self.before_noise].reshape(-1, 2)

    def _vectors(self, lanes: Array) -> tuple[Samples, Vectors, tuple[Term, ...]]:
        """Return the inputs of the filters for L vectors of unknowns, shape (P, L)."""
        count, first = lanes.shape[1], SHARED
        width, coefficients = np.full((2, count), SIGN_WIDTH), list[Array]()
        shapes, calibrations = list[tuple[Shape, Array]](), list[tuple[Calibration, Array]]()
        for effect in self.effects:
            own, others = np.split(lanes[first : first + len(effect.unknowns)], [len(effect.terms)])
            first += len(effect.unknowns)
            coefficients += list(own)
            if effect.shape is not None:
                shapes.append((effect.shape, others))
            if effect.calibration is not None:
                calibrations.append((effect.calibration, others))
            for joint, each in zip(effect.width, others, strict=False):
                width[joint] = each
        keys = np.vstack([lanes[14], *(unknowns for _, unknowns in (*shapes, *calibrations))])
        _, different, table = np.unique(keys, axis=1, return_index=True, return_inverse=True)
        tau = [self._torques(float(lanes[14, k]), [(f, u[:, k]) for f, u in shapes]) for k in different]
        positions = [self._positions([(f, u[:, k]) for f, u in calibrations]) for k in different]
        start, y = map(np.stack, zip(*positions, strict=True))
        # All lanes have the offsets of the first one, or a common change of them: a filter has one recording.
        own = self.offsets(lanes[:, 0])[[each.recording for each in self.filter_data.series]]
        start[..., :2] -= own
        y -= own[:, None]
        offset = lanes[self.shared : self.shared + 2]
        mean, change = map(np.stack, zip(*tau, strict=True))
        samples = replace(self.filter_data.samples, start=start, tau=mean, change=change, y=y)
        vectors = Vectors(
            theta=lanes[:14],
            offset=offset - offset[:, :1],
            noise=np.exp(2 * lanes[self.before_noise :].reshape(self.levels, 4, count)),
            width=width,
            coefficient=np.reshape(coefficients, (-1, count)),
            table=table.ravel(),
        )
        return samples, vectors, tuple(term for effect in self.effects for term in effect.terms)

    def _torques(self, delay: float, shapes: Sequence[tuple[Shape, Array]]) -> tuple[Array, Array]:
        """Return the acting torques of all steps with a delay [s], see :meth:`FilterData.torques`."""

        def shaped() -> list[Motion]:
            motions = list(self.filter_data.motions)
            for shape, unknowns in shapes:
                motions = [shape(motion, unknowns) for motion in motions]
            return motions

        key = b''.join(unknowns.tobytes() for _, unknowns in shapes)
        return self._once((key, delay), lambda: self.filter_data.torques(self._once((key,), shaped), delay))

    def _positions(self, calibrations: Sequence[tuple[Calibration, Array]]) -> tuple[Array, Array]:
        """Return initial states and true positions, see :meth:`FilterData.positions`."""

        def calibrated(q: Array) -> Array:
            for calibration, unknowns in calibrations:
                q = calibration(q, unknowns)
            return q

        key = b''.join(unknowns.tobytes() for _, unknowns in calibrations)
        return self._once(key, lambda: self.filter_data.positions(calibrated))

    def _once(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return a recent result with this key, or the result of ``make``."""
        if key not in self._made:
            made = make()
            if len(self._made) > 30:
                self._made.clear()
            self._made[key] = made
        result: T = self._made[key]
        return result

    def innovations(self, x: Array) -> tuple[Array, Array]:
        """Return the innovations [rad] and their squared scales [rad^2], shapes (N, 2)."""
        e, s = innovations(*self._vectors(x[:, None]))
        return e[:, :, 0], s[:, :, 0]

    @np.errstate(all='ignore')
    def costs(self, x: Array) -> Array:
        """Return J of each block, without the prior, shape (B,)."""
        return self._costs(*self.innovations(x))

    def _costs(self, e: Array, s: Array) -> Array:
        filter_data, nu = self.filter_data, self.filter_data.settings.freedom
        each = np.log(s) / 2 + (nu + 1) / 2 * np.log1p(e * e / (nu * s))
        each = np.where(filter_data.weight[:, None] > 0, each, 0.0).sum(axis=1) / self.levels
        return np.asarray(np.bincount(filter_data.block, each, minlength=len(filter_data.owner)), dtype=float)

    def prior(self, x: Array) -> float:
        """Return the part of J by the prior of the offsets."""
        return float((self.offsets(x) ** 2).sum() / self.filter_data.settings.offset**2 / 2)

    @np.errstate(all='ignore')
    def evaluate(self, x: Array) -> Evaluation:
        """Return J, and slopes and information by the estimated unknowns, from finite differences."""
        filter_data, nu, size = self.filter_data, self.filter_data.settings.freedom, len(x)
        shared = np.flatnonzero(self.estimated[: self.shared])
        steps = 1e-5 * np.concatenate([self.scale[shared], [0.01, 0.01], np.ones(4)])
        lanes = np.repeat(x[:, None], 1 + len(steps), axis=1)
        offsets = np.arange(self.shared, self.before_noise).reshape(-1, 2)
        noise = np.arange(self.before_noise, size).reshape(self.levels, 4)
        lanes[shared, 1 + np.arange(len(shared))] += steps[:-6]
        for k in range(2):
            lanes[offsets[:, k], k - 6] += steps[k - 6]
        for k in range(4):  # of all levels at once: a filter depends only on the noise of its level
            lanes[noise[:, k], k - 4] += steps[k - 4]
        e, s = innovations(*self._vectors(lanes))
        de, ds = (values[:, :, 1:] - values[:, :, :1] for values in (e, s))
        e, s = e[:, :, 0], s[:, :, 0]
        w = np.broadcast_to(filter_data.weight[:, None] / self.levels, e.shape)
        to_e = w * ((nu + 1) * e / (nu * s + e * e))
        to_s = w * (0.5 / s - (nu + 1) / 2 * e * e / (s * (nu * s + e * e)))
        ee, ss = w * ((nu + 1) / ((nu + 3) * s)), w * (nu / (2 * (nu + 3) * s * s))
        costs, count = self._costs(e, s), len(filter_data.owner)
        own = len(self.of_recording(0))
        slopes, informations = np.zeros((count, size)), np.zeros((count, own, own))
        for each in filter_data.series:
            index = np.concatenate([shared, offsets[each.recording], noise[each.level]])
            local = np.searchsorted(self.of_recording(each.recording), index)
            square = np.ix_(local, local)
            first = each.rows.start + np.flatnonzero(np.diff(filter_data.block[each.rows], prepend=-1))
            for part in map(slice, first, [*first[1:], each.rows.stop]):
                block, a, b = filter_data.block[part.start], *(d[part].reshape(-1, len(index)) for d in (de, ds))
                information = (a * ee[part].reshape(-1, 1)).T @ a + (b * ss[part].reshape(-1, 1)).T @ b
                slopes[block, index] += (to_e[part].ravel() @ a + to_s[part].ravel() @ b) / steps
                informations[block][square] += information / steps / steps[:, None]
        information, prior = np.zeros((size, size)), np.zeros(size)
        for number in range(len(filter_data.motions)):
            index = self.of_recording(number)
            information[np.ix_(index, index)] += informations[filter_data.owner == number].sum(axis=0)
        prior[self.shared : self.before_noise] = 1 / filter_data.settings.offset**2
        cost = float(costs.sum()) + self.prior(x)
        return Evaluation(
            costs,
            slopes,
            informations,
            cost if np.isfinite(cost) and np.isfinite(informations).all() else math.inf,
            slopes.sum(axis=0) + prior * x,
            information + np.diag(prior),
        )


@dataclass(frozen=True, slots=True)
class LikelihoodFit:
    """The minimum of J by Fisher scoring."""

    likelihood: Likelihood  #: J.
    x: Array  #: the unknowns, shape (P,).
    free: Flags  #: whether each unknown is estimated and not on a bound, shape (P,).
    evaluation: Evaluation  #: of J at x.
    iterations: int  #: number of scoring steps.
    #: whether the last step, or one that failed, was predicted to gain less than 1: 1.4 standard errors.
    converged: bool

    @property
    def interval(self) -> float:
        """The shortest sampling interval [s]."""
        return self.likelihood.filter_data.settings.intervals[0]


def fit(
    likelihood: Likelihood,
    x: Array,
    iterations: int = 40,
    tolerance: float = 0.02,
    progress: Callable[[float], None] | None = None,
) -> LikelihoodFit:
    """Minimise J within bounds by Fisher scoring with Levenberg and Marquardt's damping.

    If the model is wrong, the curvature of J differs from the expected information. Rank-one updates estimate the
    difference (Conn, Gould and Toint, Mathematical Programming 50, 1991). It is used while it predicts J better
    (Dennis, Gay and Welsch, ACM Transactions on Mathematical Software 7, 1981).

    Args:
        likelihood: J, with the bounds.
        x: initial values, shape (P,).
        iterations: largest number of scoring steps.
        tolerance: predicted gain of a step at which the iteration stops; 0.5 is about one standard error.
        progress: called with J after every iteration.

    Raises:
        FloatingPointError: a filter diverges at the initial values.
    """
    lower, upper, estimated = likelihood.lower, likelihood.upper, likelihood.estimated
    x = repaired(np.clip(x, lower, upper))
    damping, gain, number, rejected = 1e-3, math.inf, 0, 0
    reach = np.where(np.arange(len(x)) < likelihood.before_noise, np.inf, 1.0)  # noise changes by a factor of e at most
    now = likelihood.evaluate(x)
    if not np.isfinite(now.cost):
        raise FloatingPointError
    correction, corrected = np.zeros_like(now.information), False
    while number < iterations:
        curvature = _corrected(now.information, correction)
        low, high = np.maximum(lower - x, -reach), np.minimum(upper - x, reach)
        information = curvature if corrected else now.information
        step, gain = bounded_step(information, now.slope, damping, low, high, estimated)
        if gain < tolerance or rejected == 12:
            break
        trial = repaired(np.clip(x + step, lower, upper))  # a sum at a bound may lie beyond it by a rounding error
        after = likelihood.evaluate(trial)
        moved, rise, better = trial - x, after.cost - now.cost, after.cost < now.cost - 0.01 * gain
        if np.isfinite(after.cost):
            wrong = [abs(rise - (now.slope + H @ moved / 2) @ moved) for H in (now.information, curvature)]
            corrected = bool(wrong[1] < wrong[0])
            near = after if better else now
            correction = _secant(correction, near.information, moved, after.slope - now.slope)
        if not better:
            damping, rejected = damping * 8.0, rejected + 1
            continue
        ratio = -rise / gain
        damping = max(damping * (0.2 if ratio > 0.6 else 1.0 if ratio > 0.2 else 3.0), 1e-9)
        x, now, number, rejected = trial, after, number + 1, 0
        if progress is not None:
            progress(now.cost)
    margin = 1e-9 * np.maximum(upper - lower, 0)
    free = estimated & (x > lower + margin) & (x < upper - margin)
    return LikelihoodFit(likelihood, x, free, now, number, converged=gain < 1.0)


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
