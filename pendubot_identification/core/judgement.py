"""What data and results are worth: what is refused, what is an error, what a warning."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .errors import ExcitationError
from .level import Level
from .parameters import NAMES, UNITS, Bounds, Parameters
from .quadratic import Quadratic
from .trajectory import Trajectory

Array = NDArray[np.float64]

#: Motion of either joint below this [rad] is noise.
STILL = 0.02
#: Parameters to which the residuals respond this much less than to the strongest are not told by the motion.
SILENT = 1e-6
#: More than this fraction of the samples missing is worth a warning: the torque meanwhile is not known.
MISSING = 0.02
#: J above this fraction of what zero parameters leave: energy and work have little to do with each other.
UNBALANCED = 0.5
#: A condition number (columns scaled to one) beyond which small errors of the data become large ones of theta.
ILL_CONDITIONED = 1e3
#: A standard error above this fraction of the value leaves little of it.
POOR = 0.5
#: J on validation above so many times J on training: what was learned does not carry over.
UNFORESEEN = 10.0


def require_excitation(training: Sequence[Trajectory], criterion: Quadratic) -> None:
    """Refuse motions from which some parameters cannot be told.

    Raises:
        ExcitationError: it names the parameters.
    """
    moved = np.max([np.ptp(motion.q, axis=0) for motion in training], axis=0)
    names = ', '.join(motion.name for motion in training)
    if (moved < STILL).all():
        raise ExcitationError(
            f'{names}: the joints moved by only {moved[0]:.3g} and {moved[1]:.3g} rad, so none of {", ".join(NAMES)} '
            'can be told; excite the rig and record again, or choose a window in which it moves'
        )
    silent = criterion.undetermined(SILENT)
    if silent.any():
        still = [
            f'the {joint} moved by only {m:.3g} rad'
            for joint, m in zip(('shoulder', 'elbow'), moved, strict=True)
            if m < STILL
        ]
        raise ExcitationError(
            f'{names}: {", ".join(np.array(NAMES)[silent])} cannot be told apart from this motion'
            f'{" (" + still[0] + ")" if still else ""}; excite both joints at changing speeds, or choose another window'
        )
    if not criterion(np.zeros(len(NAMES))):
        raise ExcitationError(
            f'{names}: the torque does no work, so that all parameters could be zero; record the effort while the rig '
            'is excited'
        )


def missing_samples(motions: Sequence[Trajectory]) -> list[str]:
    """Say where samples are missing; a jittering stamp alone makes no interval of two."""
    notes = []
    for motion in motions:
        steps = np.diff(motion.t) / motion.interval
        lost = int(np.rint(steps[steps > 1.9] - 1).sum())
        if lost > MISSING * len(motion):
            notes.append(
                f'{motion.name}: about {lost} of {len(motion) + lost} samples are missing; the torque meanwhile is not '
                'known and is taken to have stayed the same'
            )
    return notes


def judge(
    *,
    theta: Array,
    std_error: Array,
    free: NDArray[np.bool_],
    bounds: Bounds,
    condition_number: float,
    unexplained: float,
    foreseen: float | None,
    reached: tuple[int, int],
    notes: Sequence[str],
) -> tuple[Level, tuple[str, ...]]:
    """Return how far to trust an estimate, and why, in sentences for the user.

    Args:
        theta: the estimate, shape (D,).
        std_error: its standard errors, shape (D,).
        free: which parameters lie on no bound, shape (D,).
        bounds: the search box.
        condition_number: of the regressor with columns scaled to one.
        unexplained: J over what it is with all parameters zero.
        foreseen: J on validation over J on training; None without validation.
        reached: how many runs of the optimiser reached the exact minimum, of how many.
        notes: what else the user should know of the data.
    """
    # MDE comes ever closer to a bound and never quite reaches it: what is judged is the bound.
    nearest = np.where(theta - bounds.lower < bounds.upper - theta, bounds.lower, bounds.upper)
    failures = [f'not physical: {p}' for p in Parameters.from_vector(np.where(free, theta, nearest)).unphysical()]
    if unexplained > UNBALANCED:
        failures.append(
            f'energy and work do not balance: J is {100 * unexplained:.0f} % of what it is with all parameters zero; '
            'look at the signs of angles and torque, at the zero of q1, and at their units'
        )
    warnings = [*failures, *notes]
    if condition_number > ILL_CONDITIONED:
        warnings.append(
            f'ill-conditioned: condition number {condition_number:.3g} (above {ILL_CONDITIONED:g}); this motion hardly '
            'tells some parameters apart: excite both joints more'
        )
    for k in np.flatnonzero(~free):
        warnings.append(f'{NAMES[k]} lies on its bound {nearest[k]:g} {UNITS[k]}: the data ask for a value beyond')
    poor = [NAMES[k] for k in np.flatnonzero(free) if std_error[k] > POOR * abs(theta[k])]
    if poor:
        warnings.append(f'poorly determined: the standard error of {", ".join(poor)} exceeds half the value')
    if reached[0] < reached[1]:
        warnings.append(
            f'only {reached[0]} of {reached[1]} runs reached the exact minimum of J; give more generations or a larger '
            'population'
        )
    if foreseen is not None and foreseen > UNFORESEEN:
        warnings.append(
            f'J on validation is {foreseen:.0f} times J on training: these parameters do not foresee data that they '
            'have not seen'
        )
    level = Level.ERROR if failures else Level.WARN if warnings else Level.OK
    return level, tuple(warnings)
