# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Design of an excitation: the most informative pulse train within the limits of a rig.

The Fisher information of a motion is the sum of the squared sensitivities of the positions, over the variance of the
encoder quantization. The D-optimal motion has the information with the greatest determinant (Goodwin and Payne, Dynamic
System Identification, 1977): the smallest confidence ellipsoid, independent of the parameters' units.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.errors import ExcitationError, ParameterError
from pendubot_identification.model.parameters import NAMES, Bounds, Parameters
from pendubot_identification.model.rollout import roll, sensitivities
from pendubot_identification.model.simulation import HANGING, longest_step
from pendubot_identification.optimizers.mde import MDESettings, mde

from .excitation import PulseTrain


@dataclass(frozen=True, slots=True)
class DesignSettings:
    """The search for a pulse train, and the margins to the limits."""

    #: Duration of the segments [s], each with its own initial state: chaotic motion is not predictable for longer.
    segment: float = 2.0
    coarser: float = 4.0  #: Factor of the simulation step: a design needs less accuracy than a virtual rig.
    used: float = 0.9  #: Fraction of the limits that a design uses, because the parameters are estimates.
    draws: int = 8  #: Number of random parameter vectors about the estimate that test the best designs.
    spread: float = 0.03  #: Least standard deviation of these vectors, as a fraction of each parameter.
    finalists: int = 40  #: Number of best designs that are tested with these vectors.
    beyond: float = 1e6  #: A cost above the cost of every train within the limits.
    population: int = 80  #: Population of MDE.
    generations: int = 30  #: Generations of MDE.
    seeds: int = 1000  #: Number of seeds of the random torques.
    longest_period: float = 5.0  #: Largest period [s].
    longest_hold: float = 1.0  #: Largest hold [s].
    narrowest: float = 0.02  #: Smallest width, a fraction of the period.
    digits: int = 3  #: Significant digits of the numbers in the file of the exciter.


SETTINGS = DesignSettings()
COORDINATES = ('period', 'width', 'amplitude_min', 'amplitude_max', 'hold', 'seed')
#: The identifiable parameters of a pendubot: all but k2, friction by the elbow's torque, which is zero.
IDENTIFIABLE = NAMES.index('k2')


@dataclass(frozen=True, slots=True)
class Experiment:
    """The conditions under which a motion is recorded. Raises ParameterError: a value is out of range."""

    duration: float = 18.0  #: Duration of the excitation, from hanging at rest [s].
    interval: float = 0.01  #: Sampling interval [s].
    counts: int = 4000  #: Encoder counts per turn.

    def __post_init__(self) -> None:
        if not (1e-4 <= self.interval <= 0.1 and 1 <= self.duration <= 600):
            raise ParameterError(
                f'{self.duration:g} s sampled every {self.interval:g} s cannot be designed; 1 to 600 s at 10 to 10000 '
                'Hz are expected'
            )
        if self.counts < 4:
            raise ParameterError(f'an encoder of {self.counts} counts per turn is too coarse; at least 4 are expected')


@dataclass(frozen=True, slots=True)
class Limits:
    """The limits of a rig. Raises ParameterError: a limit is not a positive number, or too large."""

    torque: float = 1.0  #: Greatest torque, either way [N m].
    speed: float = 30.0  #: Greatest speed of either joint [rad/s].
    #: Largest angles of shoulder and elbow from hanging, either way [rad].
    angle: tuple[float, float] = (math.inf, math.inf)

    def __post_init__(self) -> None:
        limits = [('torque', self.torque, 'N m', 1e3), ('speed', self.speed, 'rad/s', 1e6)]
        limits += [('angle', angle, 'rad', math.inf) for angle in self.angle]
        for name, value, unit, most in limits:
            if not 0 < value <= most:
                expected = 'a number above 0' + f', at most {most:g},' * math.isfinite(most)
                raise ParameterError(f'the limit of the {name} is {value:g} {unit}; {expected} is expected')

    def used(self, speed: Array, angle: Array) -> Array:
        """Return the used fraction of the limits, shape (...), of speeds [rad/s] and angles [rad], shape (2, ...)."""
        # A joint without a limit uses 0 of it, even if the simulation diverges.
        turned = np.divide(angle.T, self.angle, out=np.zeros(angle.T.shape), where=np.isfinite(self.angle))
        return np.asarray(np.maximum(speed.T / self.speed, turned).max(axis=-1).T)


@dataclass(frozen=True, slots=True)
class Predicted:
    """The predicted motion and information of an excitation."""

    train: PulseTrain
    #: Standard errors of the parameters by encoder quantization, shape (D,); infinite if not identifiable.
    std_error: Array
    log_information: float  #: Logarithm of the determinant of the information.
    speed: Array  #: Greatest speed of shoulder and elbow [rad/s], shape (2,).
    angle: Array  #: Largest angles of shoulder and elbow from hanging [rad], shape (2,).


def predict(
    parameters: Parameters, trains: Sequence[PulseTrain], experiment: Experiment, limits: Limits | None = None
) -> list[Predicted]:
    """Predict each of several excitations of a rig, from hanging at rest.

    The information is zero, and not computed, if a motion exceeds :attr:`DesignSettings.used` of the ``limits``.

    Raises:
        ParameterError: the parameters are not physical.
    """
    if problems := parameters.unphysical():
        raise ParameterError(f'no rig moves like this: {problems[0]}; design with the parameters of a real one')
    theta = parameters.vector()
    tau, step = _torques(parameters, trains, experiment)
    states, speed, angle = _simulated(theta, tau, step)
    valid = np.isfinite(speed + angle).all(axis=0)
    if limits is not None:
        valid &= limits.used(speed, angle) <= SETTINGS.used
    errors, size = np.full((len(trains), len(theta)), np.inf), np.full(len(trains), -np.inf)
    if valid.any():
        with np.errstate(all='ignore'):
            informations = _information(theta, states[:, :, valid], tau[:, :, valid], step, experiment)
            for k, information in zip(np.flatnonzero(valid), informations, strict=True):
                size[k], errors[k, : len(information)] = _accuracy(information)
    return [Predicted(train, errors[k], float(size[k]), speed[:, k], angle[:, k]) for k, train in enumerate(trains)]


def design(
    parameters: Parameters,
    limits: Limits,
    experiment: Experiment,
    *,
    uncertainty: Array | None = None,
    generations: int = SETTINGS.generations,
    progress: Callable[[int, float], None] | None = None,
) -> Predicted:
    """Return the pulse train of the greatest information, as far as MDE finds it.

    Args:
        parameters: the estimated parameters of the rig.
        limits: of the rig, kept with margins, also with similar parameters: see :class:`DesignSettings`.
        experiment: the conditions of the recording.
        uncertainty: standard errors of the parameters, shape (D,); None: 3 % of each.
        generations: number of generations of MDE.
        progress: called with the number of generations done and the best log_information so far.

    Raises:
        ParameterError: the parameters are not physical.
        ExcitationError: no pulse train within the limits was found.
    """
    finalists: list[Predicted] = []

    def costs(points: Array) -> Array:
        trains = [_train(u, limits, experiment.interval) for u in points[0]]
        candidates = predict(parameters, trains, experiment, limits)
        informative = [candidate for candidate in candidates if np.isfinite(candidate.log_information)]
        finalists[:] = sorted(finalists + informative, key=lambda p: -p.log_information)[: SETTINGS.finalists]
        return np.array([[_cost(candidate, limits) for candidate in candidates]])

    def report(generation: int, _: float) -> None:
        if progress is not None:
            progress(generation, finalists[0].log_information if finalists else math.nan)

    box = Bounds(np.zeros(len(COORDINATES)), np.ones(len(COORDINATES)), COORDINATES)
    settings = MDESettings(SETTINGS.population, generations, per_component=False)
    mde(costs, box, settings, runs=1, progress=report)
    if not finalists:
        raise ExcitationError(
            f'no pulses up to {limits.torque:g} N m were found that identify all parameters below '
            f'{limits.speed:g} rad/s and within the limits of the angles; allow a greater speed or angle, or a greater '
            'or smaller torque'
        )
    # Select the best design that keeps the limits with the most of the random parameter vectors.
    theta = parameters.vector()
    given = 0.0 if uncertainty is None else uncertainty[: len(theta)]
    spread = np.maximum(given, SETTINGS.spread * np.abs(theta))
    drawn = theta + spread * np.random.default_rng(1).standard_normal((SETTINGS.draws, len(theta)))
    drawn = np.maximum(drawn, 0.2 * theta)
    drawn[:, 2] = np.clip(drawn[:, 2], -0.9 * (root := np.sqrt(drawn[:, 0] * drawn[:, 1])), 0.9 * root)
    tau, step = _torques(parameters, [finalist.train for finalist in finalists], experiment)
    _, speed, angle = _simulated(drawn.T[:, :, None], tau, step)
    return finalists[int(np.argmin((~(limits.used(speed, angle) <= 1)).sum(axis=0)))]


def _cost(candidate: Predicted, limits: Limits) -> float:
    """Return the cost that MDE minimises: minus the log information within the limits, the excess beyond them."""
    if np.isfinite(candidate.log_information):
        return -candidate.log_information
    used = float(limits.used(candidate.speed, candidate.angle))
    return SETTINGS.beyond * (1 + used) if np.isfinite(used) else SETTINGS.beyond**2


def _train(u: Array, limits: Limits, interval: float) -> PulseTrain:
    """Return the pulse train at a point of the search, with all :data:`COORDINATES` from 0 to 1."""
    period = _between(max(20 * interval, 0.01), max(SETTINGS.longest_period, 40 * interval), u[0])
    low, high = (min(_rounded(limits.torque * max(a, 1e-3)), limits.torque) for a in u[2:4])
    hold = _between(interval, max(SETTINGS.longest_hold, 2 * interval), u[4])
    width = _between(SETTINGS.narrowest, 1.0, u[1])
    return PulseTrain(_rounded(period), _rounded(width), -low, high, _rounded(hold), int(u[5] * (SETTINGS.seeds - 1)))


def _torques(parameters: Parameters, trains: Sequence[PulseTrain], experiment: Experiment) -> tuple[Array, float]:
    """Return the torques of several trains in simulation steps, shape (2, K, C), and a step's length [s].

    They are sampled as by the exciter. A step is a part, or a multiple, of a sampling interval.
    """
    interval, samples = experiment.interval, round(experiment.duration / experiment.interval)
    greatest = max(max(abs(train.amplitude_min), abs(train.amplitude_max)) for train in trains)
    longest = SETTINGS.coarser * longest_step(parameters, greatest)
    together = max(1, int(longest / interval + 1e-9))
    parts = max(1, math.ceil(interval / longest - 1e-9))
    t = np.asarray(interval * np.arange(samples - samples % together), dtype=np.float64)
    torques = np.stack([train.torques(t) for train in trains], axis=-1)
    torques = torques.reshape(-1, together, len(trains)).mean(axis=1).repeat(parts, axis=0)
    return np.stack([torques, np.zeros_like(torques)]), interval * together / parts


def _simulated(theta: Array, tau: Array, step: float) -> tuple[Array, Array, Array]:
    """Return the states from hanging at rest, shape (K + 1, 4, C), or (K + 1, 4, V, C) for several theta.

    Also return the greatest speeds [rad/s] and angles from hanging [rad], shape (2, ...), infinite after divergence.
    """
    start = np.array([[*HANGING, 0.0, 0.0]]).T
    states = roll(theta, start.repeat(tau.shape[2], axis=1), tau, step)
    greatest = np.abs(states.T - start).max(axis=-1).T
    greatest[~np.isfinite(greatest)] = np.inf
    return states, greatest[2:], greatest[:2]


def _information(theta: Array, states: Array, tau: Array, step: float, experiment: Experiment) -> Array:
    """Return the information matrix of each motion, shape (C, D, D).

    D is at most IDENTIFIABLE. Initial states and the input delay are nuisance parameters, which are eliminated.
    """
    steps, lanes = tau.shape[1:]
    length = min(steps, round(SETTINGS.segment / step))
    count = steps // length
    within = length * np.arange(count) + np.arange(length + 1)[:, None]
    cut = np.moveaxis(states[within], 1, 2).reshape(length + 1, 4, -1)
    torques = tau[:, within[:-1]].reshape(2, length, -1)
    # Only sampled positions count. If a step is several samples long, its position counts for all of them.
    every = max(1, round(experiment.interval / step))
    weight = max(1.0, step / experiment.interval)
    seen = sensitivities(theta, cut, torques, step, every)[1:, :2]
    delay = -cut[every::every, 2:, None]
    jacobian = np.concatenate([seen[:, :, :4], delay, seen[:, :, 4:]], axis=2)
    jacobian *= math.sqrt(12 * weight) * experiment.counts / (2 * math.pi)
    rows = np.moveaxis(jacobian, 3, 0).reshape(count * lanes, -1, jacobian.shape[2])
    normal = (rows.transpose(0, 2, 1) @ rows).reshape(count, lanes, *[jacobian.shape[2]] * 2)
    # All segments of a motion share the delay; each segment has its own initial state.
    return _condensed(_condensed(normal, 4).sum(axis=0), 1)[:, :IDENTIFIABLE, :IDENTIFIABLE]


def _accuracy(information: Array) -> tuple[float, Array]:
    """Return the logarithm of the determinant, and the standard errors of the parameters.

    These are minus infinity and infinite if the determinant is not positive in floating point.
    """
    scale = np.sqrt(np.diag(information))
    scaled = information / scale / scale[:, None]
    if np.isfinite(scaled).all():
        values, vectors = np.linalg.eigh(scaled)
        if values[0] > 1e-12:
            errors = np.sqrt((vectors**2 / values).sum(axis=1)) / scale
            return float(np.log(values).sum() + 2 * np.log(scale).sum()), errors
    return -math.inf, np.full(len(scale), np.inf)


def _condensed(normal: Array, size: int) -> Array:
    """Return the Schur complement of a normal matrix, shape (..., M, M): its first unknowns are eliminated."""
    local, mixed = normal[..., :size, :size], normal[..., :size, size:]
    local = local + 1e-12 * np.trace(local, axis1=-2, axis2=-1)[..., None, None] * np.eye(size) + 1e-300 * np.eye(size)
    return np.asarray(normal[..., size:, size:] - np.swapaxes(mixed, -1, -2) @ np.linalg.solve(local, mixed))


def _between(low: float, high: float, u: float) -> float:
    return float(low * (high / low) ** u)


def _rounded(value: float) -> float:
    return float(f'{value:.{SETTINGS.digits}g}')
