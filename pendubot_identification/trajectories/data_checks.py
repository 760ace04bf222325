# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What looks wrong with the samples of a recording before anything is estimated from them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .signals import encoder_step, evenly_stamped, falsely_stamped
from .trajectory import Trajectory

Array = NDArray[np.float64]

#: More than this fraction of the samples missing is worth a warning: the torque meanwhile is not known.
MISSING = 0.02
#: An effort that stands at its greatest value in more than this fraction of the samples in which there is any.
SATURATED = 0.2
#: A joint that stands still at its greatest or least position for so many samples or more, so often, having come there
#: by so many encoder steps at once.
STANDS, TIMES, ABRUPT = 3, 3, 4.0


def data_checks(recordings: Sequence[Trajectory]) -> list[str]:
    """Say where samples are missing, stamps are false, an effort stands at a limit, or angles are cut off."""
    looks = _missing, _false_stamps, _saturated, _clipped
    return [text for recording in recordings for look in looks for text in look(recording)]


def _missing(motion: Trajectory) -> list[str]:
    lost = motion.lost
    if lost <= MISSING * len(motion):
        return []
    return [
        f'{motion.name}: about {lost} of {len(motion) + lost} samples are missing; the torque meanwhile is not known '
        'and is taken to have stayed the same'
    ]


def _false_stamps(motion: Trajectory) -> list[str]:
    """Say where stamps jitter and samples do not."""
    if not falsely_stamped(motion):
        return []
    even = evenly_stamped(motion) is not motion
    steps = np.diff(motion.t)
    done = 'even ones are taken in their place' if even else 'what they bend is not put right'
    return [
        f'{motion.name}: its stamps jitter, from {1e3 * steps.min():.3g} to {1e3 * steps.max():.3g} ms apart, and its '
        f'samples did not: the motion is smooth only where they are taken as even; {done}. Stamp samples by the clock '
        'of the board that takes them'
    ]


def _saturated(motion: Trajectory) -> list[str]:
    """Say where the effort stands at a limit; constant efforts, such as square pulses, do too, and say so likewise."""
    found = []
    for joint, tau in zip(('shoulder', 'elbow'), motion.tau.T, strict=True):
        size = np.abs(tau)
        greatest, some = float(size.max()), size > 1e-9
        share = float((size[some] > greatest * (1 - 1e-6)).mean()) if some.any() else 0.0
        if share > SATURATED and some.sum() > 10 and np.unique(tau[some]).size > 2:
            found.append(
                f'{motion.name}: the effort of the {joint} stands at {greatest:.4g} N m in {100 * share:.0f} % of the '
                'samples that have any; if that is a limit of the motor or of the record, more or less than what is '
                'recorded has acted: excite with less'
            )
    return found


def _clipped(motion: Trajectory) -> list[str]:
    found = []
    for joint, q, step in zip(('shoulder', 'elbow'), motion.q.T, encoder_step(motion.q), strict=True):
        for word, extreme in (('greatest', q.max()), ('least', q.min())):
            edges = np.flatnonzero(np.diff(np.concatenate([[False], q == extreme, [False]]).astype(int)))
            runs = [(a, b) for a, b in edges.reshape(-1, 2) if a > 0 and b - a >= STANDS]
            abrupt = [a for a, b in runs if abs(q[a] - q[a - 1]) > ABRUPT * max(step, 1e-6)]
            if len(abrupt) >= TIMES:
                found.append(
                    f'{motion.name}: the {joint} stands still at its {word} position of {extreme:.4g} rad '
                    f'{len(abrupt)} times, having come there at speed; are its angles cut off there, '
                    'or does it meet a stop? choose a window without that'
                )
    return found
