# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The checks of recordings before anything is fitted: stamps, gaps, limits, conventions and excitation."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pendubot_identification.errors import ExcitationError, PendubotError
from pendubot_identification.identification.conventions import MODEL, detect_faults
from pendubot_identification.identification.pipeline import prepare
from pendubot_identification.identification.settings import Settings
from pendubot_identification.identification.validation import contradictions, stillness
from pendubot_identification.level import Level
from pendubot_identification.recordings.datasets import Datasets
from pendubot_identification.recordings.survey import regularity
from pendubot_identification.trajectories.conversion import Conversion
from pendubot_identification.trajectories.data_checks import CHECKS
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.trajectory import Trajectory


@dataclass(frozen=True)
class Finding:
    """The finding of a check."""

    check: str  #: ``reading``, ``stamps``, ``gaps``, ``limits``, ``conventions`` or ``excitation``.
    level: Level  #: severity.
    sentence: str  #: message to the user.
    remedy: Mapping[str, str] = field(default_factory=dict)  #: conversion options that correct it, as texts by name.

    def plain(self) -> dict[str, object]:
        """Return the fields for JSON."""
        return {**vars(self), 'level': self.level.name}


def check_recordings(load: Callable[[Conversion], Datasets], settings: Settings) -> list[Finding]:
    """Return all errors and warnings, and an ``OK`` of each passed check; an error ends the checks of the motion."""
    try:
        data = load(settings.reading)
    except PendubotError as error:
        return [Finding('reading', Level.ERROR, str(error), error.remedy)]
    training, validation = (sum(map(len, part)) for part in (data.training, data.validation))
    validated = f'{validation} for validation' if validation else 'each part is predicted from the others'
    read = [Finding('reading', Level.WARN, note) for note in data.notes] or [
        Finding('reading', Level.OK, f'{training} samples for training, {validated}')
    ]
    found = [*read, *_of_samples([*data.training, *data.validation]), *_of_motion(data, settings)]
    failed = {finding.check for finding in found if finding.level > Level.OK}
    return [finding for finding in found if finding.level > Level.OK or finding.check not in failed]


def _of_samples(motions: Sequence[Trajectory]) -> Iterator[Finding]:
    """Yield the findings on the stamps, gaps and limits of recordings."""
    measured = [regularity(np.rint(motion.t * 1e9).astype(np.int64)) for motion in motions]
    period, jitter = (max(each[name] or 0.0 for each in measured) for name in ('period', 'jitter'))
    gaps = sum(each['gaps'] for each in measured)
    longest = 1e3 * max(each['longest'] for each in measured)
    text = f'{gaps} gaps, short enough to interpolate the motion' if gaps else 'none'
    torque = max(np.abs(m.tau).max() for m in motions)
    speed = max(np.abs(np.diff(m.q, axis=0) / np.diff(m.t)[:, None]).max() for m in motions)
    passed = {
        'stamps': f'a sample every {1e3 * period:.4g} ms; jitter {max(1e3 * jitter, 1e-3):.3g} ms (99 % quantile)',
        'gaps': f'{text}; the longest interval is {longest:.4g} ms',
        'limits': f'torques up to {torque:.3g} N m and speeds up to {speed:.3g} rad/s, without clipping',
    }
    for name, checks in CHECKS.items():
        yield from (Finding(name, Level.WARN, text) for motion in motions for each in checks for text in each(motion))
        yield Finding(name, Level.OK, passed[name])


def _of_motion(data: Datasets, settings: Settings) -> Iterator[Finding]:
    """Yield the findings on the conventions of the recordings and on their excitation."""
    try:
        training, others = prepare(data.training, data.validation, settings)
        moving = [motion for motion in others if not stillness(motion)]
        motions = [*training.motions, *(Motion.prepare(each, training.smoothing, training.hold) for each in moving)]
        odd = list(contradictions(motions, MODEL, training.settings.least_delay, training.settings))
        faults = detect_faults(training.motions, training.settings)
    except PendubotError as error:
        # Options can correct speeds beyond all limits, but no gap.
        check_of = 'excitation' if isinstance(error, ExcitationError) else 'limits' if error.remedy else 'gaps'
        yield Finding(check_of, Level.ERROR, str(error), error.remedy)
        return
    for fault in faults:
        corrected = fault.corrected_conversion
        yield Finding('conventions', fault.level, fault.sentence, corrected.words() if corrected else {})
    yield from (Finding('conventions', Level.WARN, sentence) for sentence in odd)
    if not faults and not odd:
        yield Finding('conventions', Level.OK, 'signs, order, zeros and units fit the equations of motion')
    moved = np.max([np.ptp(motion.q, axis=0) for motion in data.training], axis=0)
    text = f'the joints move over {moved[0]:.3g} and {moved[1]:.3g} rad, and all parameters are identifiable'
    yield Finding('excitation', Level.OK, text)
