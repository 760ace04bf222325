# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What data and results are worth: what is refused, what is an error, what a warning."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.criteria.energy import energy_regression
from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.errors import ExcitationError
from pendubot_identification.level import NORMAL_95, Level
from pendubot_identification.model.parameters import LARGEST_COUPLING, MODELS, NAMES, UNITS, Bounds, Parameters
from pendubot_identification.trajectories.signals import SMOOTHING
from pendubot_identification.trajectories.trajectory import Trajectory

from .advice import advise
from .diagnosis import SETTINGS as DIAGNOSIS
from .diagnosis import Fault
from .estimate import Estimate
from .options import DELAYS
from .prediction import ASSESSED, HORIZONS
from .settings import Settings

Array = NDArray[np.float64]

SEVEN = NAMES[: MODELS['viscous']]
#: Motion of either joint below this [rad] is noise.
STILL = 0.02
#: Parameters to which the residuals respond this much less than to the strongest are not identifiable.
SILENT = 1e-6
#: J above this fraction of what zero parameters leave: energy and work have little to do with each other.
UNBALANCED = 0.5
#: A condition number (columns scaled to one) beyond which small errors of the data become large ones of theta.
ILL_CONDITIONED = 1e3
#: J on validation above so many times J on training: the parameters do not generalise.
UNFORESEEN = 10.0
#: A zero of a recording that is off by more [degrees], its standard errors aside.
ZERO_OFF = 3.0
#: P3 / P5 off the elbow's own value by more than this fraction, and more than three standard errors.
LENGTH_OFF = 0.25
#: P3^2 over the most that P1 and P2 allow.
NEARLY_SINGULAR = 0.999


def require_excitation(training: Sequence[Trajectory], settings: Settings) -> None:
    """Refuse motions from which some parameters are not identifiable.

    Raises:
        ExcitationError: it names the parameters.
    """
    moved = np.max([np.ptp(motion.q, axis=0) for motion in training], axis=0)
    names = ', '.join(motion.name for motion in training)
    if (moved < STILL).all():
        raise ExcitationError(
            f'{names}: the joints moved by only {moved[0]:.3g} and {moved[1]:.3g} rad, so none of {", ".join(SEVEN)} '
            'is identifiable; excite the rig and record again, or choose a window in which it moves'
        )
    smoothing = SMOOTHING if settings.smoothing is None else settings.smoothing
    regressions = [energy_regression(motion, settings.sliding, smoothing) for motion in training]
    criterion = Quadratic.pool([Quadratic.reduce(r.phi, r.y) for r in regressions])
    silent = criterion.undetermined(SILENT) & ~settings.box('viscous').held
    if silent.any():
        joints = zip(('shoulder', 'elbow'), moved, strict=True)
        still = next((f' (the {joint} moved by only {m:.3g} rad)' for joint, m in joints if m < STILL), '')
        raise ExcitationError(
            f'{names}: {", ".join(np.array(SEVEN)[silent])} are not identifiable from this motion{still}; excite both '
            'joints at changing speeds, or choose another window'
        )
    if not criterion(np.zeros(len(SEVEN))):
        raise ExcitationError(
            f'{names}: the torque does no work, so that all parameters could be zero; record the effort while the rig '
            'is excited'
        )


def assess(
    estimate: Estimate,
    settings: Settings,
    link_length: tuple[float, float],
    faults: Sequence[Fault] = (),
    notes: Sequence[str] = (),
) -> Estimate:
    """Return the estimate with how far to trust it, and why, in sentences for the user.

    Where a fault of the recordings is grave, all that looks odd about the estimate follows from it: these sentences
    are kept apart, as consequences, and no other motion is advised.

    Args:
        estimate: of one criterion, its prediction included.
        settings: what was asked for.
        link_length: P3 / P5 [m] of the elbow's own equation, and its standard error.
        faults: of the recordings, see :func:`.diagnosis.diagnose`.
        notes: what else the user should know of the data.
    """
    severe = tuple(fault.sentence for fault in faults if _severe(fault, estimate))
    mild = tuple(fault.sentence for fault in faults if not _severe(fault, estimate))
    named = () if severe else faults
    at_end = () if 'delay' in {fault.name for fault in named} else tuple(_delay_at_end(estimate, settings))
    # The default search covers every sensible delay; a narrower one is the user's.
    beyond_sense = settings.delays == DELAYS
    failures = (*_failures(estimate, settings), *at_end * beyond_sense)
    doubts = (
        *_doubts(estimate, settings),
        *at_end * (not beyond_sense),
        *_unexplained_by(named, estimate, link_length),
    )
    warnings = (*severe, *mild, *notes) if severe else (*failures, *mild, *notes, *doubts)
    return replace(
        estimate,
        level=Level.ERROR if severe or failures else Level.WARN if warnings else Level.OK,
        warnings=warnings,
        consequences=(*failures, *doubts) if severe else (),
        advice=() if severe else advise(estimate),
    )


def _severe(fault: Fault, estimate: Estimate) -> bool:
    """Tell whether a fault makes an estimate useless: not where the estimate has found the same delay itself."""
    allowed_for = fault.delay is not None and abs(estimate.effort.delay - fault.delay) < DIAGNOSIS.least_delay / 2
    return fault.level is Level.ERROR and not allowed_for


def _nearest_bound(theta: Array, bounds: Bounds) -> Array:
    return np.where(theta - bounds.lower < bounds.upper - theta, bounds.lower, bounds.upper)


def _failures(e: Estimate, settings: Settings) -> Iterator[str]:
    """Say why nobody can use the result."""
    theta, bounds = e.theta, settings.box(e.model)
    # MDE comes ever closer to a bound and never quite reaches it: what is judged is the bound.
    assessed = np.where(bounds.at_bound(theta, tolerance=1e-6), _nearest_bound(theta, bounds), theta)
    problems = Parameters.from_vector(assessed).unphysical()
    yield from (f'not physical: {problem}' for problem in problems)
    if not problems and theta[2] ** 2 > NEARLY_SINGULAR * LARGEST_COUPLING**2 * theta[0] * theta[1]:
        yield (
            f'hardly physical: P3 = {theta[2]:.4g} is the most that P1 and P2 allow, M(q) being nearly singular; the '
            'data ask for a value beyond'
        )
    if e.unexplained > UNBALANCED:
        yield (
            f'energy and work do not balance: J is {100 * e.unexplained:.0f} % of what it is with all parameters zero; '
            'look at the signs of angles and torque, at the zero of q1, and at their units'
        )
    worse = e.prediction.error[:ASSESSED] > e.prediction.persistence[:ASSESSED]
    if worse.any():
        ahead = ', '.join(f'{h:g} s' for h, w in zip(HORIZONS, worse, strict=False) if w)
        yield (
            f'predicts worse than assuming that nothing moves, {ahead} ahead: do not use these parameters in a '
            'controller'
        )


def _doubts(e: Estimate, settings: Settings) -> Iterator[str]:
    """Say what speaks against trusting the result."""
    theta, bounds, names = e.theta, settings.box(e.model), np.array(NAMES)
    # Friction of one kind may well be nothing where there is another.
    matters = (np.arange(len(theta)) < 5) | (len(theta) == len(SEVEN))
    unidentifiable = np.isinf(e.std_error)
    if unidentifiable.any():
        yield (
            f'not identifiable: {", ".join(names[: len(theta)][unidentifiable])}; the residuals do not depend on them '
            '(the information matrix is singular): excite both joints more, or choose another window'
        )
    poor = e.free & ~e.determined & ~unidentifiable & matters
    if poor.any():
        poorest = ', '.join(names[: len(theta)][poor])
        yield f'poorly determined: the standard error of {poorest} exceeds half the value'
    elif e.condition_number > ILL_CONDITIONED and not e.exact and not unidentifiable.any():
        yield (
            f'ill-conditioned: condition number {e.condition_number:.3g} (above {ILL_CONDITIONED:g}); this '
            'motion hardly tells some parameters apart: excite both joints more'
        )
    high_half = theta > bounds.lower + 0.5 * (bounds.upper - bounds.lower)
    # P1 or P2 at 0 is a failure, and named there.
    failed = np.isin(names[: len(theta)], ('P1', 'P2')) & (_nearest_bound(theta, bounds) <= 0)
    for k in np.flatnonzero(~e.free & ~e.held & ~failed & (matters | high_half)):
        nearest = _nearest_bound(theta, bounds)[k]
        yield f'{NAMES[k]} lies on its bound {nearest:g} {UNITS[k]}: the data ask for a value beyond'
    if e.runs_at_minimum < len(e.J_runs):
        yield (
            f'only {e.runs_at_minimum} of {len(e.J_runs)} runs reached the exact minimum of J; give more '
            'generations or a larger population'
        )
    if not e.converged:
        yield 'the optimiser did not converge: start elsewhere, or choose another part of the recording'
    if e.J_validation > UNFORESEEN * e.J:
        yield (
            f'J on validation is {e.J_validation / e.J:.0f} times J on training: these parameters do not '
            'predict data that they have not seen'
        )


def _unexplained_by(faults: Sequence[Fault], e: Estimate, link_length: tuple[float, float]) -> Iterator[str]:
    """Say what looks like a fault of the recordings, unless a fault is named that explains it."""
    named = {fault.name for fault in faults}
    if 'zero' not in named:
        yield from _wrong_zeros(e)
    # Signs, order, zeros, units, counts and stamps all change the length.
    if not named:
        yield from _wrong_length(e, *link_length)


def _delay_at_end(e: Estimate, settings: Settings) -> Iterator[str]:
    (low, high), delay = settings.delays, e.effort.delay
    # No delay at all is what a rig has at best, and no end of a search.
    at_end = delay >= high - 1e-4 or (low != 0 and delay <= low + 1e-4)
    if low < high and at_end and e.criterion != 'energy':
        yield (
            f'the delay of the effort lies at {delay:.4f} s, the end of where it was searched; are the '
            'stamps of effort and angles of one clock?'
        )


def _wrong_zeros(e: Estimate) -> Iterator[str]:
    if e.zeros is None:
        return
    for joint, (angles, errors) in enumerate(
        zip(np.degrees(e.zeros.angles), np.degrees(e.zeros.std_error), strict=True)
    ):
        for name, angle, error in zip(e.zeros.recordings, angles, errors, strict=True):
            if abs(angle) - NORMAL_95 * error > ZERO_OFF:
                yield (
                    f"{name}: q{joint + 1}'s zero is off by {angle:.1f} +- {error:.1g} degrees; subtract them, or let "
                    'the links swing out before the zeros are set (friction may have held one away from hanging) and '
                    'record again'
                )


def _wrong_length(e: Estimate, length: float, error: float) -> Iterator[str]:
    if e.criterion == 'energy' or not e.theta[4] > 0 or not np.isfinite([length, error]).all():
        return
    own = e.theta[2] / e.theta[4]
    if abs(own - length) > max(LENGTH_OFF * abs(length), 3 * error):
        yield (
            f'P3 / P5, the length of link 1, is {own:.3g} m here and {length:.3g} m (standard error {error:.2g} m) by '
            "the elbow's own equation, in which the shoulder's torque has no part: look at signs and zeros of the "
            'angles and at the stamps of the effort'
        )
