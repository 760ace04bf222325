# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Validation and assessment: predictions of other data, checks of residuals, and the level with warnings and advice."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.special import stdtr

from pendubot_identification.arrays import Array
from pendubot_identification.criteria.energy import energy_regression
from pendubot_identification.criteria.likelihood import LikelihoodFit, LikelihoodSettings
from pendubot_identification.criteria.prediction_error import ASSESSED, HORIZONS, Prediction, predict
from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.criteria.weak import WIDTH
from pendubot_identification.errors import ExcitationError, TrajectoryError
from pendubot_identification.level import NORMAL_95, Level
from pendubot_identification.model.parameters import LARGEST_COUPLING, MODELS, NAMES, UNITS, Bounds, Parameters
from pendubot_identification.trajectories.conventions import JOINT_NAMES
from pendubot_identification.trajectories.conversion import Affine
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import SMOOTHING
from pendubot_identification.trajectories.trajectory import Trajectory

from . import DELAYS
from .conventions import SETTINGS as CONVENTIONS
from .conventions import (
    Fault,
    agrees_with_exact_fit,
    corrected,
    corrections,
    detect_faults,
    joint_regression,
    unexplained_fraction,
)
from .effects import DetectedEffect, compensated
from .estimate import Estimate, Progress, Zeros
from .fitting import SETTINGS as FITTING
from .fitting import TrainingData, estimate_linear, linear, torque_noise, unexplained, with_given_parameters
from .selection import Composite, recorded_zeros
from .settings import Settings

SEVEN = NAMES[: MODELS['viscous']]


@dataclass(frozen=True, slots=True)
class ValidationSettings:
    """Thresholds of the residual checks and of the assessment, as listed in the documentation."""

    #: Ratio of squared residuals with common and with separate parameters, above which recordings contradict each
    #: other: real recordings of one rig reach 1.7, of two rigs at least 4.2.
    ratio: float = 3.0
    #: Least difference of these, as a fraction of the squared effort: 1 % of its RMS.
    contradiction: float = 1e-4
    #: Significance level of a disturbance, for all samples together.
    disturbance: float = 1e-4
    #: Interval within which disturbances are joined [s]; number of listed disturbances.
    joined: float = 0.5
    listed: int = 3
    #: Motion of a joint [rad] below which it is noise.
    still: float = 0.02
    #: Sensitivity of the residuals to a parameter, relative to the largest, below which it is not identifiable.
    insensitive: float = 1e-6
    #: J over J at zero parameters above which work and energy hardly correlate.
    unbalanced: float = 0.5
    #: Condition number (columns scaled to one) above which theta is too sensitive to errors of the data.
    ill_conditioned: float = 1e3
    #: Error of a recording's zero [degrees] beyond its 95 % interval.
    zero: float = 3.0
    #: Limits of the least mass of link 2 by the torque over its weighed mass: 1 of a point mass, 0.75 of a uniform rod.
    light: float = 0.25
    heavy: float = 1.2
    #: P3 squared over its largest value for P1 and P2.
    singular: float = 0.999
    #: Difference of two input delays [s] below which they are equal: half of the least faulty delay.
    delay: float = 0.005
    #: Standard error over value above which advice is given, and correlation above which it is mentioned.
    uninformative: float = 0.1
    correlated: float = 0.95


SETTINGS = ValidationSettings()
#: The motion that excites each parameter, by its term in the equations of motion, with a torque at the shoulder.
EXCITATION = {
    'P1': 'accelerate the shoulder harder: torques that change their sign every tenth of a second',
    'P2': 'accelerate the elbow harder: short, strong pulses at the shoulder',
    'P3': 'bend the elbow by a quarter turn and more while the shoulder moves: there the links interact',
    'P4': 'lift link 1 to the horizontal and beyond, and let it fall: longer pulses',
    'P5': "swing link 2 to the horizontal and beyond: pulses in time with the elbow's own swing",
    'b1': 'turn the shoulder fast for longer',
    'b2': 'let the elbow swing freely, far out, until it stops: pauses of seconds between the pulses',
    'Fc1': 'turn the shoulder to and fro, slowly and fast: slow motion separates dry from viscous friction',
    'Fc2': 'let the elbow swing out between pulses: slow motion separates dry from viscous friction',
    'J2': 'accelerate the elbow against the shoulder: the rotor matters where both do not turn together',
    'Fs1': 'start and stop the shoulder slowly, below 0.5 rad/s',
    'Fs2': 'stop the elbow repeatedly, from below 0.5 rad/s',
    'k1': 'turn the shoulder at one speed under small and under large torques',
    'k2': 'turn the elbow at one speed under small and under large torques',
}


@dataclass(frozen=True, slots=True)
class Fold:
    """A part of a recording that is predicted from the rest of the data."""

    held_out: Motion  #: the part.
    recording: int  #: index of its recording.
    rest: tuple[Motion, ...]  #: the other data.


def folds(motions: Sequence[Motion]) -> list[Fold]:
    """Return a fold for each of three or more recordings, or for each of five or six blocks of time of fewer."""
    result = []
    for number, m in enumerate(motions):
        others = [other for other in motions if other is not m]
        if len(motions) >= 3:
            result.append(Fold(m, number, tuple(others)))
            continue
        blocks = 5 if len(motions) == 1 else 3
        for low, high in pairwise(np.linspace(m.start, m.end, blocks + 1)):
            rest = [m.part(begin, end) for begin, end in ((m.start, low), (high, m.end)) if end > begin]
            result.append(Fold(m.part(low, high), number, (*others, *rest)))
    return result


@dataclass(frozen=True, slots=True)
class Validation:
    """Recordings for validation alone, each fitted with the estimated parameters: only zeros and noise are free."""

    motions: Sequence[Motion]  #: the recordings that are long enough, without compensated effects.
    fits: Sequence[LikelihoodFit]  #: of those that a filter follows.
    problems: Sequence[str]  #: why no filter follows the others.
    zeros: Zeros  #: of the training recordings, then of all of these; NaN where they were not fitted.

    @classmethod
    def of(cls, motions: Sequence[Motion], answer: Composite) -> Validation:
        """Fit the zeros and the noise of recordings."""
        parts, actual, fits, problems = (
            [recorded_zeros(answer.rough)],
            list[Motion](),
            list[LikelihoodFit](),
            list[str](),
        )
        for motion in motions:
            zeros = Zeros((motion.name,), np.full((2, 1), math.nan), np.full((2, 1), math.nan))
            if motion.end - motion.start > FITTING.shortest:
                actual.append(compensated(motion, answer.effects, answer.delay))
                try:
                    fits.append(with_given_parameters(actual[-1:], answer.theta, answer.delay, answer.data.settings))
                    zeros = recorded_zeros(fits[-1])
                except TrajectoryError as error:
                    problems.append(str(error))
            parts.append(zeros)
        names = tuple(name for part in parts for name in part.recordings)
        angles, std_error = (np.hstack([getattr(part, of) for part in parts]) for of in ('angles', 'std_error'))
        return cls(actual, fits, problems, Zeros(names, angles, std_error))


def basis(validation: int, parts: int, recordings: int) -> str:
    """Return in words which data validate, by the numbers of validation recordings, folds and recordings."""
    if validation:
        return 'on data that was not used for estimation'
    if parts == recordings:
        return 'each recording predicted from the others'
    return f'each of {parts} blocks of time predicted from the others'


def validated(
    criterion: str,
    data: TrainingData,
    composite: Composite | None,
    left_out: Sequence[Fold],
    motions: Sequence[Motion],
    zeros: Zeros | None,
    report: Progress,
) -> Estimate:
    """Return the estimate of one criterion with its errors in predicting motions, and each fold from its rest.

    The ``zeros`` are subtracted from the positions: a zero belongs to a recording, not to the rig.
    """
    off = np.zeros((len(data.motions) + len(motions), 2)) if zeros is None else np.nan_to_num(zeros.angles.T)
    effects: tuple[DetectedEffect, ...] = ()
    if criterion == 'likelihood' and composite is not None:
        estimate = replace(composite.estimate(), zeros=zeros)
        effects, filter_data = composite.effects, composite.filter_data

        def of_rest(fold: Fold) -> Array:
            start, end, times = fold.held_out.start, fold.held_out.end, filter_data.block_times
            inside = (times >= start - 1e-9) & (times <= end + 1e-9) & (filter_data.owner == fold.recording)
            return composite.without(inside)[: len(estimate.theta)]

    else:
        model = data.settings.model
        if model == 'auto':
            model = 'viscous' if criterion == 'energy' else 'geared' if composite is None else composite.model
        estimate = estimate_linear(criterion, model, data, motions, report)
        problem, box = data.linear(criterion, model), data.settings.box(model)

        def of_rest(fold: Fold) -> Array:
            return linear(criterion, fold.rest, model, data.settings, like=problem).criterion.minimum(box)

    delay = estimate.effort.delay

    def predicted(motion: Motion, theta: Array, zero: Array) -> Prediction:
        return predict([compensated(motion, effects, delay)], theta, delay, data.scale, zero)

    own = off[len(data.motions) :]
    parts = [predicted(motion, estimate.theta, zero) for motion, zero in zip(motions, own, strict=True)]
    for fold in left_out:
        with contextlib.suppress(TrajectoryError):  # the rest is too short for a test function
            parts.append(predicted(fold.held_out, of_rest(fold), off[fold.recording]))
    return replace(estimate, prediction=Prediction.pool(parts) if parts else Prediction.none())


def faults_left(faults: tuple[Fault, ...], answer: Composite) -> tuple[Fault, ...]:
    """Return the faults that neither an exact fit nor accepted effects explain, and an offset, which has an option.

    Without both, a motion that is predictable over a short interval only is a further fault.
    """
    accepted = any(effect.accepted for effect in answer.effects)
    if answer.exact and not accepted:
        return tuple(fault for fault in faults if agrees_with_exact_fit(fault, answer.offsets))
    usual = LikelihoodSettings().intervals[0]
    if answer.rough.interval < usual and not accepted:
        found = f'the model predicts the motion over {answer.rough.interval:g} s, and over {usual:g} s is expected'
        return (*faults, Fault('motion', found, 'check the recording, or record slower motion', Level.ERROR))
    if not faults or not accepted:
        return faults
    motions = [compensated(motion, answer.effects, answer.delay) for motion in answer.data.excerpt().motions]
    named = {fault.name for fault in detect_faults(motions, answer.data.settings)}
    mild = [fault if fault.name in named else replace(fault, level=Level.WARN) for fault in faults]
    return tuple(fault for fault in mild if fault.name in {*named, 'offset'})


def remarks(answer: Composite, validation: Validation | None, faults: Sequence[Fault]) -> Iterator[str]:
    """Yield findings for the user, besides the faults of the recordings."""
    named = {fault.name for fault in faults}
    if validation is not None:  # a contradiction may be the cause of effects
        yield from _inconsistencies(answer, validation)
    yield from (found.sentence for found in answer.effects if found.name not in named)
    if validation is not None and not answer.exact:
        yield from disturbances(answer.rough)
    if not answer.exact and (answer.unexplained > FITTING.least).any():
        shoulder, elbow = (f'{100 * part:.3g} %' for part in answer.unexplained)
        yield (
            f'the rig has unmodelled effects, or its angles are noisy: they make {shoulder} and {elbow} of the '
            'variance of the innovations at shoulder and elbow; the intervals cover them as far as recordings differ'
        )


def _inconsistencies(answer: Composite, validation: Validation) -> Iterator[str]:
    """Yield contradictions of all recordings, and disturbances or a poor fit of those for validation."""
    data, model, delay = answer.data, answer.model, answer.delay
    training = [compensated(m, answer.effects, delay) for m in data.excerpt().motions]
    found = list(contradictions([*training, *validation.motions], model, delay, data.settings))
    found += [sentence for fit in validation.fits for sentence in disturbances(fit)]
    # Quantization alone can look like torque noise.
    worse = any(
        ((torque_noise(data, fit) > 1) & (unexplained(fit.likelihood, fit.x) > FITTING.least)).any()
        for fit in validation.fits
    )
    if answer.exact and worse and not found:
        found.append(
            'the parameters do not explain the validation data to the quantization level, as they do the training '
            'data; check that all recordings are of one rig, with the same signs'
        )
    yield from (*found, *validation.problems)


def contradictions(motions: Sequence[Motion], model: str, delay: float, settings: Settings) -> Iterator[str]:
    """Yield a warning if a recording has other parameters than the rest (Chow, Econometrica 28, 1960), and why."""
    motions = [motion for motion in motions if motion.end - motion.start > WIDTH + abs(delay)]
    if len(motions) < 2:
        return
    bounds = settings.box(model)

    def reduced(motion: Motion, delay: float) -> Quadratic:
        rows = joint_regression(motion, model, delay)
        return Quadratic.reduce(rows.phi, rows.y)

    def squared(group: Sequence[Quadratic]) -> float:
        criterion = Quadratic.pool(group)
        return criterion.count * criterion.least_in_box(bounds)

    parts = [reduced(motion, delay) for motion in motions]
    rests = [[*parts[:k], *parts[k + 1 :]] for k in range(len(parts))]
    separate = [squared([part]) + squared(rest) for part, rest in zip(parts, rests, strict=True)]
    odd, common = int(np.argmin(separate)), squared(parts)
    effort = sum(part.count * float(part(np.zeros_like(part.y))) for part in parts)
    apart = common > SETTINGS.ratio * separate[odd] and common - separate[odd] > SETTINGS.contradiction * effort
    cause = ''
    if len(motions) > 2 and (apart or common > CONVENTIONS.poor_fit * effort):
        faults = corrections(motions[odd], delay, settings)
        groups = [[*rests[odd], reduced(*corrected(motions[odd], delay, [fault]))] for fault in faults]
        fractions = [unexplained_fraction(Quadratic.pool(group), bounds) for group in groups]
        if faults and common > SETTINGS.ratio * min(fractions) * effort:
            best = faults[int(np.argmin(fractions))]
            cause = f'in it, {best.found}; {best.remedy}'
    if not (apart or cause):
        return
    found = f'{motions[odd].name} contradicts the other recordings'
    if len(motions) == 2:
        one, other = (motion.name for motion in motions)
        found = f'{"both parts of " + one if one == other else f"{one} and {other}"} contradict each other'
    yield (
        f'{found}: common parameters leave {common / max(separate[odd], 1e-300):.2g} times the squared residual of '
        'separate ones; ' + (cause or 'check that all recordings are of one rig, with the same signs and zeros')
    )


def disturbances(rough: LikelihoodFit) -> Iterator[str]:
    """Yield a warning with the times of innovations that are too large for their distribution."""
    filter_data = rough.likelihood.filter_data
    e, s = rough.likelihood.innovations(rough.x)
    z = np.abs(e) / np.sqrt(s)
    probability = 2 * stdtr(filter_data.settings.freedom, -z) * z.size
    large = (probability < SETTINGS.disturbance).any(axis=1) & (filter_data.weight > 0)
    found = []
    for each in filter_data.series:
        t = filter_data.t[each.rows]
        # The first speed is unknown, so the first innovations are large.
        t = t[large[each.rows] & (t > t[:1] + SETTINGS.joined)]
        starts = t[np.diff(t, prepend=-math.inf) > SETTINGS.joined]
        found += [f'{filter_data.motions[each.recording].name} at {start:.1f} s' for start in starts]
    if found:
        more = f' and {len(found) - SETTINGS.listed} more' if len(found) > SETTINGS.listed else ''
        yield (
            f'a disturbance: {", ".join(found[: SETTINGS.listed])}{more}; the cause may be a hand, a cable, an end '
            'stop, lost samples or encoder counts, or abrupt friction'
        )


def require_excitation(training: Sequence[Trajectory], settings: Settings) -> None:
    """Reject motions from which some parameters are not identifiable.

    Raises:
        ExcitationError: some parameters are not identifiable; the message names them.
    """
    moved = np.max([np.ptp(motion.q, axis=0) for motion in training], axis=0)
    names = ', '.join(f'{motion.name}, {motion.t[0]:.4g} to {motion.t[-1]:.4g} s' for motion in training)
    if (moved < SETTINGS.still).all():
        raise ExcitationError(
            f'{names}: the joints moved by only {moved[0]:.3g} and {moved[1]:.3g} rad, so none of {", ".join(SEVEN)} '
            'is identifiable; excite the rig and record again, or choose a window in which it moves'
        )
    smoothing = SMOOTHING if settings.smoothing is None else settings.smoothing
    regressions = [energy_regression(motion, settings.sliding, smoothing) for motion in training]
    criterion = Quadratic.pool([Quadratic.reduce(r.phi, r.y) for r in regressions])
    insensitive = criterion.undetermined(SETTINGS.insensitive) & ~settings.box('viscous').fixed
    if insensitive.any():
        joints = zip(JOINT_NAMES, moved, strict=True)
        still = next((f' (the {joint} moved by only {m:.3g} rad)' for joint, m in joints if m < SETTINGS.still), '')
        raise ExcitationError(
            f'{names}: {", ".join(np.array(SEVEN)[insensitive])} are not identifiable from this motion{still}; excite '
            'both joints at changing speeds, or choose another window'
        )
    if not criterion(np.zeros(len(SEVEN))):
        raise ExcitationError(
            f'{names}: the torque does no work, so that all parameters could be zero; record the effort while the rig '
            'is excited'
        )


def stillness(motion: Trajectory) -> str:
    """Return a warning if no joint moves in a motion for validation; empty otherwise."""
    moved = np.ptp(motion.q, axis=0)
    if (moved >= SETTINGS.still).any():
        return ''
    return (
        f'{motion.name}, {motion.t[0]:.4g} to {motion.t[-1]:.4g} s: the joints moved by only {moved[0]:.3g} and '
        f'{moved[1]:.3g} rad, which validates nothing; choose another window for validation'
    )


def assess(
    estimate: Estimate,
    settings: Settings,
    faults: Sequence[Fault] = (),
    notes: Sequence[str] = (),
) -> Estimate:
    """Return the estimate with its level, the reasons in sentences for the user, and advice.

    A severe fault of the recordings explains all other findings: they become consequences, and no advice is given.

    Args:
        estimate: of one criterion, its prediction included.
        settings: of the identification.
        faults: of the recordings.
        notes: other warnings of the data.
    """
    severe = [fault.sentence for fault in faults if _severe(fault, estimate)]
    others = {fault.sentence: fault.name for fault in faults if not _severe(fault, estimate)}
    # A known cause, such as a push by hand, precedes the warning of a poor fit.
    unfit = [sentence for sentence, name in others.items() if name == 'motion']
    mild = [sentence for sentence in others if sentence not in unfit]
    named = set() if severe else {*others.values()} - {'motion'}
    errors, reservations = list(_errors(estimate, settings)), [*unfit, *_reservations(estimate, settings)]
    if 'delay' not in named:
        # The default interval covers all plausible delays; a narrower one is the choice of the user.
        (errors if settings.delays == DELAYS else reservations).extend(_delay_at_end(estimate, settings))
    common = next((fault.change for fault in faults if fault.name == 'zero'), Affine.of())
    if common is not None:
        reservations += _wrong_zeros(estimate.zeros, -common.c)
    if 'unit' not in named:
        reservations += _wrong_mass(estimate, settings.link_mass)
    warnings = [*severe, *mild, *notes] if severe else [*errors, *mild, *notes, *reservations]
    return replace(
        estimate,
        level=Level.ERROR if severe or errors else Level.WARN if warnings else Level.OK,
        warnings=tuple(warnings),
        consequences=(*errors, *reservations) if severe else (),
        advice=() if severe else tuple(_advice(estimate)),
    )


def _severe(fault: Fault, estimate: Estimate) -> bool:
    """Return whether a fault makes an estimate useless; a delay or a zero does not if the estimate compensates it."""
    delayed = fault.delay is not None and abs(estimate.effort.delay - fault.delay) < SETTINGS.delay
    compensated = delayed or (fault.name == 'zero' and estimate.zeros is not None)
    return fault.level is Level.ERROR and not compensated


def _nearest_bound(theta: Array, bounds: Bounds) -> Array:
    return np.where(theta - bounds.lower < bounds.upper - theta, bounds.lower, bounds.upper)


def _errors(e: Estimate, settings: Settings) -> Iterator[str]:
    """Yield the errors, which make the result useless."""
    theta, bounds = e.theta, settings.box(e.model)
    # MDE approaches a bound without reaching it.
    assessed = np.where(e.free, theta, _nearest_bound(theta, bounds))
    problems = Parameters.from_vector(assessed).unphysical()
    yield from (f'not physical: {problem}' for problem in problems)
    if not problems and theta[2] ** 2 > SETTINGS.singular * LARGEST_COUPLING**2 * theta[0] * theta[1]:
        yield (
            f'hardly physical: P3 = {theta[2]:.4g} is the largest value for P1 and P2, and M(q) is nearly '
            'singular; the minimum of J lies beyond it'
        )
    if e.unexplained > SETTINGS.unbalanced:
        yield (
            f'energy and work do not balance: J is {100 * e.unexplained:.0f} % of its value with all parameters zero; '
            'check the signs of angles and torque, the zero of q1, and their units'
        )
    worse = e.prediction.error[:ASSESSED] > e.prediction.persistence[:ASSESSED]
    # Near an unstable equilibrium all predictions diverge; an exact rig is known to the quantization level.
    if worse.any() and not e.exact:
        ahead = ', '.join(f'{h:g} s' for h, w in zip(HORIZONS, worse, strict=False) if w)
        yield (
            f'predicts worse than assuming that nothing moves, {ahead} ahead: do not use these parameters in a '
            'controller'
        )


def _reservations(e: Estimate, settings: Settings) -> Iterator[str]:
    """Yield the warnings about the result."""
    theta, bounds, names = e.theta, settings.box(e.model), np.array(NAMES[: len(e.theta)])
    # Friction of one kind may be zero in a model with several.
    matters = (np.arange(len(theta)) < 5) | (len(theta) == len(SEVEN))
    if (e.intervals[:3, 0] > 0).all() and not (e.fixed[3:5] | (e.intervals[3:5, 0] > 0)).any():
        matters[3:5] = False
        yield (
            'the 95 % intervals of P4 and P5 reach 0: gravity hardly acts on this motion; fix both at 0 if both axes '
            'are vertical, or else excite larger swings'
        )
    unidentifiable = np.isinf(e.std_error)
    if unidentifiable.any():
        yield (
            f'not identifiable: {", ".join(names[unidentifiable])}; the residuals do not depend on them (the '
            'information matrix is singular): excite both joints more, or choose another window'
        )
    poor = e.free & ~e.determined & ~unidentifiable & matters
    if poor.any():
        yield f'poorly determined: the standard error of {", ".join(names[poor])} exceeds half the value'
    elif e.condition_number > SETTINGS.ill_conditioned and not e.exact and not unidentifiable.any():
        yield (
            f'ill-conditioned: condition number {e.condition_number:.3g} (above {SETTINGS.ill_conditioned:g}); the '
            'effects of some parameters on this motion are nearly the same: excite both joints more'
        )
    high_half = theta > bounds.lower + 0.5 * (bounds.upper - bounds.lower)
    # P1 or P2 at 0 is reported as an error.
    failed = np.isin(names, ('P1', 'P2')) & (_nearest_bound(theta, bounds) <= 0)
    for k in np.flatnonzero(~e.free & ~e.fixed & ~failed & (matters | high_half)):
        nearest = _nearest_bound(theta, bounds)[k]
        yield f'{NAMES[k]} lies on its bound {nearest:g} {UNITS[k]}: the minimum of J lies beyond it'
    if e.runs_at_minimum < len(e.J_runs):
        yield (
            f'only {e.runs_at_minimum} of {len(e.J_runs)} runs reached the exact minimum of J; give more '
            'generations or a larger population'
        )
    if not e.converged:
        yield 'the optimiser did not converge: start elsewhere, or choose another part of the recording'


def _delay_at_end(e: Estimate, settings: Settings) -> Iterator[str]:
    (low, high), delay = settings.delays, e.effort.delay
    # A delay of 0 is plausible, also at the end of the search interval.
    at_end = abs(delay) > 1e-4 and not low + 1e-4 < delay < high - 1e-4
    if low < high and at_end and e.criterion != 'energy':
        yield (
            f'the delay of the effort lies at {delay:.4f} s, the end of its search interval; are the '
            'stamps of effort and angles of one clock?'
        )


def _wrong_zeros(zeros: Zeros | None, common: Array) -> Iterator[str]:
    """Yield the zeros that differ from the reported error of all recordings [rad], shape (2,)."""
    if zeros is None:
        return
    degrees, errors = np.degrees(zeros.angles), np.degrees(zeros.std_error)
    beyond = np.abs(degrees - np.degrees(common)[:, None]) - NORMAL_95 * errors
    for joint, k in np.argwhere(beyond > SETTINGS.zero):
        yield (
            f"{zeros.recordings[k]}: q{joint + 1}'s zero is off by {degrees[joint, k]:.1f} +- "
            f'{errors[joint, k]:.1g} degrees: compensated here, not in a controller; let the links swing out before '
            'the zeros are set, because friction may have held one away from hanging'
        )


def _wrong_mass(e: Estimate, expected: float | None) -> Iterator[str]:
    if expected is None or not e.theta[1] > 0:
        return
    least = e.theta[4] ** 2 / e.theta[1]  # (m2 d2)^2 over m2 d2^2 + I2
    if not SETTINGS.light <= least / expected <= SETTINGS.heavy:
        yield (
            f'by the torque link 2 weighs {least:.3g} kg or more, {4 / 3 * least:.3g} kg if it is a uniform rod, and '
            f'{expected:g} kg is expected: check the unit of the torque, and the torque constant and gear, to which '
            'all parameters are proportional'
        )


def _advice(e: Estimate) -> Iterator[str]:
    """Yield a sentence for each parameter with a large relative standard error, the worst first."""
    size = np.abs(e.theta)
    with np.errstate(all='ignore'):
        relative = np.where(e.free & (size > 0), e.std_error / size, 0.0)
        correlation = np.nan_to_num(np.abs(e.correlation - np.eye(len(size))))
    for k in (k for k in np.argsort(-relative) if relative[k] > SETTINGS.uninformative):
        found = f'standard error {100 * relative[k]:.0f} % of the value' if relative[k] < 100 else 'not identifiable'
        partner = int(np.argmax(correlation[k]))
        if correlation[k, partner] > SETTINGS.correlated:
            found += f', correlation {e.correlation[k, partner]:.2f} with {NAMES[partner]}'
        yield f'the motion is little informative of {NAMES[k]} ({found}); to improve: {EXCITATION[NAMES[k]]}'
