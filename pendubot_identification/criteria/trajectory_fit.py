# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Minimising the trajectory criterion: from rough parameters to the sharpest that the recordings support."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.model.parameters import MODELS, Bounds, coupling_excess, repaired
from pendubot_identification.model.rollout import roll
from pendubot_identification.optimizers.mde import MDESettings, mde
from pendubot_identification.optimizers.optimizer import OptimizationResult
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.piecewise import cubic_spline
from pendubot_identification.trajectories.signals import encoder_step

from .levenberg_marquardt import LEAST_INERTIA, Fit, levenberg_marquardt
from .shooting import LONGEST_STEP, AgainstPositions, AgainstStates, Segments

Array = NDArray[np.float64]

#: Segments against smoothed states: length and stride [s]. Short ones find the way from a bad start, where long ones
#: are chaotic; 0.5 s is what the errors of real rigs' models allow.
STATES_LADDER = ((0.1, 0.2), (0.25, 0.2), (0.5, 0.1))
#: Segments against recorded positions: lengths [s] as long as the model's errors stay below the encoder's. Each rung
#: starts at the states that the one before it found, so that a chaotic motion is followed for seconds.
POSITIONS_LADDER = (0.2, 0.5, 1.0, 2.0, 4.0, 8.0, np.inf)
#: P3 at the start: at most this fraction of sqrt(P1 P2). Near the limit M(q) is nearly singular, and nothing moves on.
START_COUPLING = 0.5
#: A rung is supported while the residuals' variance exceeds the first rung's by no more than this factor ...
GROWTH = 1.3
#: ... and that of the encoder's rounding by no more than this.
NOISIEST = 9.0
#: Errors of positions below this [rad] are the simulation's own.
FINEST = 1e-6
#: What a simulation errs over a segment of a fast motion [rad]. Positions that are rounded no coarser than that, or not
#: at all, do not tell their noise.
NEGLIGIBLE = 5e-5
#: Simulation steps [s] against positions are no longer than the sampling interval, in which the torque changes, nor,
#: with dry friction, positions whose noise is not known or torques that change within an interval, than this: the first
#: rung apart, what a longer step errs would bend parameters by many of the standard errors that residuals as small as
#: an encoder's rounding promise.
SHORT_STEP = 0.0005
#: Stamps that stray by more [s] from a grid make torques that change within an interval.
STRAYING = 1e-4
#: How far a rung may move the delay [s] before segments are cut anew, and how often they are.
NEAR, ANEW = 0.003, 10
#: Below this length [s] of segments that are supported, positions say less than states.
SHORTEST_EXACT = 0.5
#: The same where the noise is not known and more than :data:`NEGLIGIBLE` is left: a model's errors may pass for it.
SHORTEST_UNKNOWN = 2.0
#: Where one short segment of so many leaves so many times that, the others are not looked at; nor counts what so few
#: segments leave.
FEW, FAR, FEWEST_SHOWN = 5.0, 4.0, 20
#: Residuals are white where their correlation from one sample to the next is below the first, and where what the
#: simulation errs, as half the step shows it, is below the second times their size.
WHITE, SIMULATED = 0.15, 0.02
#: A correlation below which those of longer lags are chance.
UNCORRELATED = 0.05
#: Where they are not, so many segments or more show how large the errors of the parameters are.
FEWEST_SEGMENTS = 4
#: What MDE simulates: so many segments of this length [s], compared at so many times.
SEARCH_SEGMENTS, SEARCH_LENGTH, SEARCH_TIMES = 60, 0.15, 12


@dataclass(frozen=True, slots=True)
class TrajectoryFit:
    """The minimum of the trajectory criterion."""

    fit: Fit  #: where Levenberg-Marquardt came to rest.
    kind: str  #: ``states`` or ``positions``: what the simulated segments were compared with.
    length: float  #: of the segments [s].
    group: NDArray[np.intp]  #: the number of each segment's recording, shape (L,).
    start: Array  #: the time at which each begins [s], shape (L,).
    #: Reduced chi-square of the positions, in variances of their rounding, or of :data:`FINEST`; NaN for ``states``.
    variance: float
    white: bool = False  #: whether the residuals are white.
    rounded: bool = True  #: whether the noise of the positions is known: an encoder's rounding.
    together: float = 1.0  #: how many residuals, one after the other, tell as much as one that is independent.

    @property
    def exact(self) -> bool:
        """Whether the model leaves nothing but the noise of the positions: else they are not fitted."""
        return self.kind == 'positions'


def fit_states(
    motions: Sequence[Motion],
    theta: Array,
    delay: float,
    bounds: Bounds,
    delay_bounds: tuple[float, float],
    scale: Array,
    *,
    ladder: Sequence[tuple[float, float]] = STATES_LADDER,
    iterations: int = 40,
    tolerance: float = 1e-5,
    progress: Callable[[float], None] | None = None,
) -> TrajectoryFit:
    """Fit segments to the smoothed states, from theta, shape (D,), and a delay [s] on.

    The segments' (length, stride) [s] are those of the ladder, one after the other. ``scale`` are the states' standard
    deviations, shape (4,). Each rung takes so many iterations at most, and the last one ends when a step gains no more
    than the fraction ``tolerance`` of the cost. ``progress`` is called with the criterion after every iteration.

    Raises:
        TrajectoryError: the recordings are too short to be cut into segments.
    """
    theta = theta.copy()
    limit = START_COUPLING * np.sqrt(max(theta[0] * theta[1], 0.0))
    theta[2] = np.clip(theta[2], -limit, limit) if len(ladder) > 1 else theta[2]
    margin = max(map(abs, delay_bounds)) + 1e-6
    for length, stride in ladder:
        segments = Segments.cut(motions, min(length, longest_segment(motions, margin)), stride, margin)
        last = length == ladder[-1][0]
        fit = levenberg_marquardt(
            AgainstStates(segments, scale),
            theta,
            delay,
            bounds,
            delay_bounds,
            robust=last,
            iterations=iterations,
            tolerance=tolerance if last else 1e-2,
            progress=progress,
        )
        theta, delay = fit.theta, fit.delay
    return TrajectoryFit(fit, 'states', segments.steps * segments.step, segments.group, segments.start, np.nan)


def longest_segment(motions: Sequence[Motion], margin: float) -> float:
    """Return the longest segment [s] of which the longest motion still holds two."""
    return max(m.end - m.start for m in motions) / 2 - 2 * margin


def segment_cost(
    motions: Sequence[Motion], theta: Array, delay: float, bounds: Bounds, scale: Array
) -> tuple[float, int]:
    """Return the criterion's J and how many residuals it averages, with the initial states alone estimated.

    J is the mean square of the four states' errors over segments of half a second, in variances of the states, and
    what the initial states cost that leave the smoothed ones.
    """
    comparison, fit = _initial_states(motions, theta, delay, bounds, scale)
    lanes = len(comparison.segments)
    return fit.cost / (4 * lanes), 4 * lanes * comparison.times


def segment_errors(
    motions: Sequence[Motion], theta: Array, delay: float, bounds: Bounds, scale: Array
) -> tuple[list[Array], list[Array]]:
    """Return what :func:`segment_cost` averages, but for what holds the initial states: errors of simulated segments.

    Returns:
        For each recording that is as long as a segment, the times [s] that are compared, shape (M, L), and the errors
        of the four states in standard deviations, shape (M, 4, L).
    """
    comparison, fit = _initial_states(motions, theta, delay, bounds, scale)
    segments = comparison.segments
    states = segments.roll(fit.theta, fit.initial)
    rows = comparison.residuals(states, fit.delay).T.reshape(-1, 4, len(segments))
    t = segments.start + fit.delay + comparison.offset[1:, None]
    errors = rows[1:] * np.sqrt(comparison.times)
    groups = [segments.group == number for number in np.unique(segments.group)]
    return [t[:, g] for g in groups], [errors[:, :, g] for g in groups]


def _initial_states(
    motions: Sequence[Motion], theta: Array, delay: float, bounds: Bounds, scale: Array
) -> tuple[AgainstStates, Fit]:
    """Return the best initial states of half a second's segments, for theta and delay as they are."""
    length, stride = STATES_LADDER[-1]
    margin = abs(delay) + 1e-6
    segments = Segments.cut(motions, min(length, longest_segment(motions, margin)), stride, margin)
    comparison = AgainstStates(segments, scale)
    fit = levenberg_marquardt(
        comparison, theta, delay, bounds, (delay, delay), fixed=True, iterations=8, tolerance=1e-3
    )
    return comparison, fit


def fit_positions(
    motions: Sequence[Motion],
    theta: Array,
    delay: float,
    bounds: Bounds,
    delay_bounds: tuple[float, float],
    *,
    ladder: Sequence[float] = POSITIONS_LADDER,
    progress: Callable[[float], None] | None = None,
) -> TrajectoryFit | None:
    """Fit ever longer segments to the recorded positions, as far as the residuals stay those of the encoders.

    The start should be near the end already, as :func:`fit_states` leaves it; arguments are those of it, but for the
    ladder: lengths [s] of the segments, one after the other.

    Returns:
        The fit with the longest segments that are supported and leave white residuals or, where none does, with the
        longest of which there are four; None where the model's errors exceed the noise of the positions within half a
        second already, as on most real rigs.
    """
    rounding = rounding_of(motions)
    rounded = bool((rounding > NEGLIGIBLE).all())
    noise = rounding if rounded else np.full(2, FINEST)
    margin = abs(delay) + 1e-9
    # Segments begin on samples, the next one behind the margin.
    whole = min(m.end - m.start - m.interval for m in motions) - 2 * margin
    step = min(LONGEST_STEP, *(m.interval for m in motions))
    if len(theta) > MODELS['viscous'] or not rounded or any(_strays(m) for m in motions):
        step = min(step, SHORT_STEP)

    def fitted(
        segments: Segments, theta: Array, delay: float, tolerance: float, initial: Array | None = None
    ) -> tuple[AgainstPositions, Fit, float] | None:
        """Return the fit and its reduced chi-square; None of positions that are too few."""
        comparison = AgainstPositions(segments, noise, delay=delay, initial=initial)
        unknowns = 4 * len(segments) + len(theta) + 1
        if comparison.count < 2 * unknowns:
            return None
        for _ in range(ANEW):
            around = max(delay - NEAR, delay_bounds[0]), min(delay + NEAR, delay_bounds[1])
            fit = levenberg_marquardt(
                comparison, theta, delay, bounds, around, tolerance=tolerance, least=comparison.count, progress=progress
            )
            moved = abs(fit.delay - delay)
            theta, delay = fit.theta, fit.delay
            if moved < 0.999 * NEAR:
                break
            comparison = AgainstPositions(segments, noise, delay=delay, initial=fit.initial)
        return comparison, fit, fit.cost / (comparison.count - unknowns)

    if rounded:
        few = Segments.cut(motions, min(ladder[0], whole), FEW * ladder[0], margin)
        found = fitted(few, theta, delay, 1e-3) if len(few) >= FEWEST_SHOWN else None
        if found is not None and found[2] > FAR * NOISIEST:
            return None
    first, best = np.nan, None
    before: tuple[Segments, Fit] | None = None
    for length in ladder:
        length = min(length, whole)
        rough = np.isnan(first)
        segments = Segments.cut(motions, length, length, margin, LONGEST_STEP if rough else step)
        initial = None if before is None else _continued(*before, segments)
        found = fitted(segments, theta, delay, 1e-3 if rough else 1e-6, initial)
        if found is None:
            continue
        comparison, fit, variance = found
        theta, delay = fit.theta, fit.delay
        before = segments, fit
        if rough:
            first = max(variance, 1.0)
        negligible = not rounded and np.sqrt(variance) * FINEST <= NEGLIGIBLE
        if not (variance <= GROWTH * first or negligible) or (rounded and variance > NOISIEST):
            break
        shortest = SHORTEST_EXACT if rounded or negligible else SHORTEST_UNKNOWN
        if length >= min(shortest, whole):
            white, together = _whiteness(comparison, fit)
            if best is not None and best.white and not white:
                break
            if best is None or (fit.converged and (white or len(segments) >= FEWEST_SEGMENTS)):
                group, start = segments.group, segments.start
                best = TrajectoryFit(fit, 'positions', length, group, start, variance, white, rounded, together)
        if length == whole:
            break
    return best


def rounding_of(motions: Sequence[Motion]) -> Array:
    """Return the standard deviation of what the coarsest encoder's rounding errs [rad], shape (2,)."""
    return np.asarray(np.array([encoder_step(m.recorded.q) for m in motions]).max(axis=0) / np.sqrt(12))


def _strays(motion: Motion) -> bool:
    """Tell whether stamps lie between the places of the grid on which segments begin and steps end."""
    places = (motion.recorded.t - motion.start) / motion.interval
    return bool(np.abs(places - np.rint(places)).max() * motion.interval > STRAYING)


@np.errstate(all='ignore')
def _whiteness(comparison: AgainstPositions, fit: Fit) -> tuple[bool, float]:
    """Return whether residuals are those of independent readings, and how many tell as much as one that is.

    They are not where a simulation or a model errs; nor where a joint stays within a count for several samples.
    """
    segments, halved = comparison.segments, comparison.segments.finer(2)
    states = segments.roll(fit.theta, fit.initial)
    finer_states = halved.roll(fit.theta, fit.initial)[::2]
    residuals, finer = (
        comparison.residuals(each, fit.delay).reshape(len(segments), -1, 2) for each in (states, finer_states)
    )
    difference = ((finer - residuals) ** 2).mean()
    white = abs(_correlation(residuals, 1)) < WHITE and difference < SIMULATED**2 * (residuals**2).mean()
    return bool(white), readings_together(residuals)


def readings_together(residuals: Array) -> float:
    """Return how many readings tell as much as one that is independent, by residuals of shape (L, S, 2)."""
    together, lag = 1.0, 1
    while lag < residuals.shape[1] // 2 and (correlation := _correlation(residuals, lag)) > UNCORRELATED:
        together, lag = together + 2 * correlation, lag + 1
    return together


def _correlation(residuals: Array, lag: int) -> float:
    return float((residuals[:, lag:] * residuals[:, :-lag]).mean() / (residuals**2).mean())


def _continued(segments: Segments, fit: Fit, others: Segments) -> Array:
    """Return the states that fitted segments have where others start, shape (4, L)."""
    states = segments.roll(fit.theta, fit.initial)
    times = np.asarray(segments.step * np.arange(segments.steps + 1.0))
    result = np.empty((4, len(others)))
    for lane, (group, start) in enumerate(zip(others.group, others.start, strict=True)):
        own = np.flatnonzero((segments.group == group) & (segments.start <= start + 1e-9))[-1]
        result[:, lane] = cubic_spline(times, states[:, :, own])(start - segments.start[own])
    return result


def search(
    motions: Sequence[Motion],
    bounds: Bounds,
    scale: Array,
    settings: MDESettings,
    runs: int,
    seed: int,
    progress: Callable[[int, float], None] | None = None,
) -> OptimizationResult:
    """Look for the basin of the trajectory criterion by MDE, anywhere within the bounds.

    What is minimised is the mean over short segments, simulated from their smoothed states, of e^2 / (1 + e^2 / 4)
    with e the error in standard deviations: a segment that is lost is lost, and by how much says nothing. The search
    box is searched in its cube root, because parameters of rigs differ by orders of magnitude. ``x`` of the result
    are parameter vectors.

    Raises:
        TrajectoryError: the recordings are too short to be cut into segments.
    """
    stride = max(sum(m.end - m.start for m in motions) / SEARCH_SEGMENTS, SEARCH_LENGTH / 2)
    segments = Segments.cut(motions, SEARCH_LENGTH, stride, 1e-6)
    initial = segments.measured(np.zeros(1))[:, 0]
    after = np.arange(segments.steps, 0, -max(1, segments.steps // SEARCH_TIMES))[::-1]
    measured = np.moveaxis(segments.measured(np.asarray(segments.step * after)), 1, 0)[:, :, None]
    width = bounds.upper - bounds.lower

    def vectors(u: Array) -> Array:
        theta = bounds.lower + width * u**3
        theta[..., :2] = np.maximum(theta[..., :2], LEAST_INERTIA * bounds.upper[:2])
        return theta

    def objective(u: Array) -> Array:
        theta = vectors(u).reshape(-1, u.shape[-1])
        states = roll(repaired(theta).T[:, :, None], initial, segments.tau, segments.step)[after]
        with np.errstate(all='ignore'):
            square = ((states - measured) / scale[:, None, None]) ** 2
            lost = np.where(np.isfinite(square), square / (1 + square / 4), 4.0)
        return np.asarray((lost.mean(axis=(0, 1, 3)) + 4 * coupling_excess(theta)).reshape(u.shape[:-1]))

    unit = Bounds(np.zeros_like(width), np.ones_like(width), bounds.names)
    found = mde(objective, unit, settings, runs=runs, seed=seed, progress=progress)
    return replace(found, x=repaired(vectors(found.x)))
