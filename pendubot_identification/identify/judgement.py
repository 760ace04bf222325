# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What data and results are worth: what is refused, what is an error, what a warning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.criteria.energy import energy_regression
from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.errors import ExcitationError
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import LARGEST_COUPLING, MODELS, NAMES, UNITS, Parameters
from pendubot_identification.trajectories.signals import SMOOTHING
from pendubot_identification.trajectories.trajectory import Trajectory

from .advice import advise
from .diagnosis import LEAST_DELAY, Fault
from .estimate import NORMAL_95, Estimate
from .prediction import HORIZONS, JUDGED
from .settings import Settings

Array = NDArray[np.float64]

SEVEN = NAMES[: MODELS['viscous']]
#: Motion of either joint below this [rad] is noise.
STILL = 0.02
#: Parameters to which the residuals respond this much less than to the strongest are not told by the motion.
SILENT = 1e-6
#: J above this fraction of what zero parameters leave: energy and work have little to do with each other.
UNBALANCED = 0.5
#: A condition number (columns scaled to one) beyond which small errors of the data become large ones of theta.
ILL_CONDITIONED = 1e3
#: J on validation above so many times J on training: what was learned does not carry over.
UNFORESEEN = 10.0
#: A zero of a recording that is off by more [degrees], its standard errors aside.
ZERO_OFF = 3.0
#: P3 / P5 off the elbow's own value by more than this fraction, and more than three standard errors.
LENGTH_OFF = 0.25


def require_excitation(training: Sequence[Trajectory], settings: Settings) -> None:
    """Refuse motions from which some parameters cannot be told.

    Raises:
        ExcitationError: it names the parameters.
    """
    moved = np.max([np.ptp(motion.q, axis=0) for motion in training], axis=0)
    names = ', '.join(motion.name for motion in training)
    if (moved < STILL).all():
        raise ExcitationError(
            f'{names}: the joints moved by only {moved[0]:.3g} and {moved[1]:.3g} rad, so none of {", ".join(SEVEN)} '
            'can be told; excite the rig and record again, or choose a window in which it moves'
        )
    smoothing = SMOOTHING if settings.smoothing is None else settings.smoothing
    regressions = [energy_regression(motion, settings.sliding, smoothing) for motion in training]
    criterion = Quadratic.pool([Quadratic.reduce(r.phi, r.y) for r in regressions])
    silent = criterion.undetermined(SILENT)
    if silent.any():
        still = [
            f'the {joint} moved by only {m:.3g} rad'
            for joint, m in zip(('shoulder', 'elbow'), moved, strict=True)
            if m < STILL
        ]
        raise ExcitationError(
            f'{names}: {", ".join(np.array(SEVEN)[silent])} cannot be told apart from this motion'
            f'{" (" + still[0] + ")" if still else ""}; excite both joints at changing speeds, or choose another window'
        )
    if not criterion(np.zeros(len(SEVEN))):
        raise ExcitationError(
            f'{names}: the torque does no work, so that all parameters could be zero; record the effort while the rig '
            'is excited'
        )


def judge(
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
    failures = [*_unphysical(estimate, settings), *_lost(estimate)]
    doubts = [*_doubts(estimate, settings), *_wrong_zeros(estimate), *_wrong_length(estimate, link_length)]
    grave = [fault.sentence for fault in faults if _grave(fault, estimate)]
    mild = [fault.sentence for fault in faults if not _grave(fault, estimate)]
    if grave:
        warnings, consequences = [*grave, *mild, *notes], [*failures, *doubts]
    else:
        warnings, consequences = [*failures, *mild, *notes, *doubts], []
    return replace(
        estimate,
        level=Level.ERROR if grave or failures else Level.WARN if warnings else Level.OK,
        warnings=tuple(warnings),
        consequences=tuple(consequences),
        advice=() if grave else advise(estimate),
    )


def _grave(fault: Fault, estimate: Estimate) -> bool:
    """Return whether a fault makes an estimate useless: not where the estimate has found the same delay itself."""
    allowed_for = fault.delay is not None and abs(estimate.effort.delay - fault.delay) < LEAST_DELAY / 2
    return fault.level is Level.ERROR and not allowed_for


def _unphysical(estimate: Estimate, settings: Settings) -> list[str]:
    theta = estimate.theta
    bounds = settings.bounds.of(len(theta))
    # MDE comes ever closer to a bound and never quite reaches it: what is judged is the bound.
    nearest = np.where(theta - bounds.lower < bounds.upper - theta, bounds.lower, bounds.upper)
    held = bounds.at_bound(theta, tolerance=1e-6)
    problems = [f'not physical: {p}' for p in Parameters.from_vector(np.where(held, nearest, theta)).unphysical()]
    if not problems and theta[2] ** 2 > 0.999 * LARGEST_COUPLING**2 * theta[0] * theta[1]:
        problems.append(
            f'hardly physical: P3 = {theta[2]:.4g} is the most that P1 and P2 allow, M(q) being nearly singular; the '
            'data ask for a value beyond'
        )
    return problems


def _lost(estimate: Estimate) -> list[str]:
    """Name what makes a result useless whatever its parameters."""
    problems = []
    if estimate.criterion != 'trajectory' and estimate.unexplained > UNBALANCED:
        problems.append(
            f'energy and work do not balance: J is {100 * estimate.unexplained:.0f} % of what it is with all '
            'parameters zero; look at the signs of angles and torque, at the zero of q1, and at their units'
        )
    prediction = estimate.prediction
    if prediction is not None:
        worse = prediction.error[:JUDGED] > prediction.standing_still[:JUDGED]
        if worse.any():
            ahead = ', '.join(f'{h:g} s' for h, w in zip(HORIZONS, worse, strict=False) if w)
            problems.append(
                f'predicts worse than assuming that nothing moves, {ahead} ahead: do not use these parameters in a '
                'controller'
            )
    return problems


def _doubts(estimate: Estimate, settings: Settings) -> list[str]:
    theta = estimate.theta
    bounds = settings.bounds.of(len(theta))
    doubts = []
    untold = np.isinf(estimate.std_error)
    if untold.any():
        doubts.append(
            f'cannot be told: {", ".join(np.array(NAMES[: len(theta)])[untold])}; the residuals do not depend on them '
            '(the information matrix is singular): excite both joints more, or choose another window'
        )
    elif estimate.condition_number > ILL_CONDITIONED:
        doubts.append(
            f'ill-conditioned: condition number {estimate.condition_number:.3g} (above {ILL_CONDITIONED:g}); this '
            'motion hardly tells some parameters apart: excite both joints more'
        )
    viscous = len(theta) == len(SEVEN)
    for k in np.flatnonzero(~estimate.free):
        # Friction of one kind may well be nothing where there is another.
        if k < 5 or viscous or theta[k] > bounds.lower[k] + 0.5 * (bounds.upper[k] - bounds.lower[k]):
            nearest = bounds.lower[k] if theta[k] - bounds.lower[k] < bounds.upper[k] - theta[k] else bounds.upper[k]
            doubts.append(f'{NAMES[k]} lies on its bound {nearest:g} {UNITS[k]}: the data ask for a value beyond')
    poor = [NAMES[k] for k in np.flatnonzero(estimate.free & ~estimate.determined & ~untold) if k < 5 or viscous]
    if poor:
        doubts.append(f'poorly determined: the standard error of {", ".join(poor)} exceeds half the value')
    if estimate.criterion != 'trajectory' and estimate.runs_at_minimum < len(estimate.J_runs):
        doubts.append(
            f'only {estimate.runs_at_minimum} of {len(estimate.J_runs)} runs reached the exact minimum of J; give more '
            'generations or a larger population'
        )
    if not estimate.converged:
        doubts.append('the optimiser did not converge: start elsewhere, or choose another part of the recording')
    if estimate.criterion != 'trajectory' and estimate.J_validation > UNFORESEEN * estimate.J:
        doubts.append(
            f'J on validation is {estimate.J_validation / estimate.J:.0f} times J on training: these parameters do not '
            'predict data that they have not seen'
        )
    low, high = settings.delays
    delay = estimate.effort.delay
    # No delay at all is what a rig has at best, and no end of a search.
    at_end = delay >= high - 1e-4 or (low != 0 and delay <= low + 1e-4)
    if low < high and at_end and estimate.criterion != 'energy':
        doubts.append(
            f'the delay of the effort lies at {delay:.4f} s, the end of where it was searched; are the '
            'stamps of effort and angles of one clock?'
        )
    return doubts


def _wrong_zeros(estimate: Estimate) -> list[str]:
    zeros, found = estimate.zeros, []
    if zeros is None:
        return []
    for joint, (angles, errors) in enumerate(zip(np.degrees(zeros.angles), np.degrees(zeros.std_error), strict=True)):
        for name, angle, error in zip(zeros.recordings, angles, errors, strict=True):
            if abs(angle) - NORMAL_95 * error > ZERO_OFF:
                found.append(
                    f"{name}: q{joint + 1}'s zero is off by {angle:.1f} +- {error:.1g} degrees; subtract them, or let "
                    'the links swing out before the zeros are set (friction may have held one away from hanging) and '
                    'record again'
                )
    return found


def _wrong_length(estimate: Estimate, link_length: tuple[float, float]) -> list[str]:
    length, error = link_length
    if estimate.criterion == 'energy' or not estimate.theta[4] > 0 or not np.isfinite([length, error]).all():
        return []
    own = estimate.theta[2] / estimate.theta[4]
    if abs(own - length) <= max(LENGTH_OFF * abs(length), 3 * error):
        return []
    return [
        f'P3 / P5, the length of link 1, is {own:.3g} m here and {length:.3g} m (standard error {error:.2g} m) by the '
        "elbow's own equation, in which the shoulder's torque has no part: look at signs and zeros of the angles and "
        'at the stamps of the effort'
    ]
