# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Checks of the samples of a recording before the estimation."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pendubot_identification.arrays import Flags, Indices

from .conventions import JOINT_NAMES
from .signals import encoder_step, evenly_stamped, has_timestamp_jitter
from .trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class CheckSettings:
    """Thresholds of the warnings."""

    missing: float = 0.02  #: Fraction of missing samples, during which the torque is unknown.
    saturated: float = 0.2  #: Fraction of the non-zero effort samples at the greatest value.
    lasting: int = 3  #: Angles are clipped if the extreme position lasts for this number of samples ...
    abrupt: float = 4.0  #: ... after a jump of more than this number of encoder steps.
    repeated: int = 3  #: Least number of times that an effort is at its limit, or an angle is clipped.


SETTINGS = CheckSettings()


def data_checks(recordings: Sequence[Trajectory]) -> list[str]:
    """Return warnings of missing samples, inconsistent timestamps, saturated efforts and clipped angles."""
    checks = [check for group in CHECKS.values() for check in group]
    return [text for recording in recordings for check in checks for text in check(recording)]


def _missing(motion: Trajectory) -> list[str]:
    steps = np.diff(motion.t) / motion.interval
    # Timestamp jitter alone does not count.
    lost = int(min(np.rint(steps[steps > 1.9] - 1).sum(), max(np.rint(steps.sum()) - len(steps), 0)))
    if lost <= SETTINGS.missing * len(motion):
        return []
    return [
        f'{motion.name}: about {lost} of {len(motion) + lost} samples are missing; the torque meanwhile is unknown '
        'and is assumed constant'
    ]


def _jitter(motion: Trajectory) -> list[str]:
    if not has_timestamp_jitter(motion):
        return []
    steps = np.diff(motion.t)
    handling = 'they are not corrected' if evenly_stamped(motion) is motion else 'even stamps replace them'
    return [
        f'{motion.name}: its stamps jitter, from {1e3 * steps.min():.3g} to {1e3 * steps.max():.3g} ms apart, but its '
        f'motion is smooth only with even stamps; {handling}. Stamp the samples by the clock of the board'
    ]


def _saturated(motion: Trajectory) -> list[str]:
    """Warn of a saturated effort; square pulses cause this warning as well."""
    warnings = []
    for joint, tau in zip(JOINT_NAMES, motion.tau.T, strict=True):
        size = np.abs(tau)
        greatest, acting = float(size.max()), size > 1e-9
        at_limit = acting & (size > greatest * (1 - 1e-6))
        fraction = at_limit.sum() / max(acting.sum(), 1)
        varied = acting.sum() > 10 and np.unique(tau[acting]).size > 2
        if varied and fraction > SETTINGS.saturated and len(_runs(at_limit)) >= SETTINGS.repeated:
            warnings.append(
                f'{motion.name}: the effort of the {joint} is at its maximum of {greatest:.4g} N m in '
                f'{100 * fraction:.0f} % of the samples with effort; if the motor or the recording limits it, '
                'the recorded effort is wrong: excite with smaller torques'
            )
    return warnings


def _clipped(motion: Trajectory) -> list[str]:
    warnings = []
    for joint, q, step in zip(JOINT_NAMES, motion.q.T, encoder_step(motion.q), strict=True):
        for word, extreme in (('greatest', q.max()), ('least', q.min())):
            runs = [(a, b) for a, b in _runs(q == extreme) if a > 0 and b - a >= SETTINGS.lasting]
            abrupt = [a for a, b in runs if abs(q[a] - q[a - 1]) > SETTINGS.abrupt * max(step, 1e-6)]
            if len(abrupt) >= SETTINGS.repeated:
                warnings.append(
                    f'{motion.name}: the {joint} stops abruptly at its {word} position of {extreme:.4g} rad '
                    f'{len(abrupt)} times; are its angles clipped, or does it hit a stop? choose a window '
                    'without these times'
                )
    return warnings


def _runs(flags: Flags) -> Indices:
    """Return the first index of each run of flags, and the index after its last, shape (R, 2)."""
    return np.asarray(np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]))).reshape(-1, 2))


#: The checks by their subject.
CHECKS = {'gaps': (_missing,), 'stamps': (_jitter,), 'limits': (_saturated, _clipped)}
