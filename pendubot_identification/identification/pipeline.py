# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""From motions to an identification: prepare, check conventions, fit, validate, assess."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pendubot_identification.errors import TrajectoryError
from pendubot_identification.trajectories.data_checks import data_checks
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import evenly_stamped
from pendubot_identification.trajectories.trajectory import Trajectory

from .assessment import assess, require_excitation, stillness
from .conventions import Fault, corrected_conversion, detect_faults, link_length
from .estimate import Progress
from .fitting import TrainingData, fit_composite
from .identification import Identification, Run
from .settings import Settings
from .validation import folds, remaining_faults, remarks, validated


def identify(
    training: Sequence[Trajectory],
    validation: Sequence[Trajectory] = (),
    settings: Settings | None = None,
    progress: Progress | None = None,
    notes: Sequence[str] = (),
) -> Identification:
    """Estimate the parameters of a rig from one or more of its motions; replace inconsistent timestamps by even ones.

    Args:
        training: the motions that estimate; they are pooled.
        validation: motions for validation alone. Without any, each recording of several (or block of time of one or
            two) is predicted from the others in turn; the estimates themselves use all of them.
        settings: see :class:`Settings`.
        progress: see :data:`.estimate.Progress`.
        notes: warnings of the data, such as an unclosed bag.

    Raises:
        TrajectoryError: a motion is too short or has gaps.
        ExcitationError: some parameters are not identifiable from the motions.
    """
    report = progress or (lambda activity, done, total, best: None)
    prepared = _prepare(training, validation, settings or Settings(), notes, report)
    checked = _check_conventions(prepared, report)
    fitted = _fit(checked, report)
    return _assess(_validate(fitted, report))


def check(
    training: Sequence[Trajectory], validation: Sequence[Trajectory] = (), settings: Settings | None = None
) -> tuple[Fault, ...]:
    """Return the faults of the recordings' conventions, as :func:`identify` before the fit.

    Raises:
        TrajectoryError, ExcitationError: as :func:`identify`.
    """
    prepared = _prepare(training, validation, settings or Settings(), (), lambda activity, done, total, best: None)
    return detect_faults(prepared.data.motions, prepared.data.settings)


def _prepare(
    training: Sequence[Trajectory],
    validation: Sequence[Trajectory],
    settings: Settings,
    notes: Sequence[str],
    report: Progress,
) -> Run:
    """Require informative motion, and smooth the recordings."""
    report('preparing', 0, 0, math.nan)
    motions, others = ([evenly_stamped(motion.require_samples()) for motion in part] for part in (training, validation))
    require_excitation(motions, settings)
    moving = tuple(motion for motion in others if not stillness(motion))
    noted = (*notes, *filter(None, map(stillness, others)))
    warnings = (*noted, *data_checks([*training, *validation]))
    return Run(TrainingData.prepare(motions, settings.of_rig(motions)), moving, noted, warnings)


def _check_conventions(run: Run, report: Progress) -> Run:
    """Check signs, order, zeros and stamps."""
    report('checking signs, zeros and stamps', 0, 0, math.nan)
    return replace(run, faults=detect_faults(run.data.excerpt().motions, run.data.settings))


def _fit(run: Run, report: Progress) -> Run:
    """Minimise the likelihood."""
    if 'likelihood' not in run.data.settings.criteria:
        return run
    report('weak: rough parameters', 0, 0, math.nan)
    try:
        composite = fit_composite(run.data, report, effects=run.data.settings.compensate and run.sound)
    except TrajectoryError as error:
        if not run.faults:
            raise
        corrected = corrected_conversion(run.faults)
        words = {} if corrected is None else corrected.words()
        raise TrajectoryError('; '.join(fault.sentence for fault in run.faults), **words) from error
    faults = remaining_faults(run.faults, composite)
    return replace(run, data=composite.data, composite=composite, faults=faults)


def _validate(run: Run, report: Progress) -> Run:
    """Compute the estimate of each criterion, with its prediction of validation data, and check residuals."""
    motions = [Motion.prepare(motion, run.data.smoothing, run.data.hold) for motion in run.validation_motions]
    split = replace(run, folds=() if motions else tuple(folds(run.data.motions)))
    answers = (validated(c, run.data, run.composite, split.folds, motions, report) for c in run.criteria)
    # Zeros of single recordings would compensate a common fault.
    estimates = tuple(answer if run.sound else replace(answer, zeros=None) for answer in answers)
    found = () if run.composite is None else remarks(run.composite, motions, run.sound, {f.name for f in run.faults})
    return replace(split, estimates=estimates, remarks=(*run.remarks, *found))


def _assess(run: Run) -> Identification:
    """Assess each estimate, and select the published one."""
    published = run.criteria.index(max(run.data.settings.criteria, key=run.criteria.index))  # the most accurate is last
    best = run.estimates[published]
    findings = (run.remarks if each is best else run.notes for each in run.estimates)
    pairs = zip(run.estimates, findings, strict=True)
    return Identification(
        settings=run.data.settings,
        estimates=tuple(assess(each, run.data.settings, run.faults, notes) for each, notes in pairs),
        published=published,
        faults=run.faults,
        interval=float(np.median([m.interval for m in run.data.motions])),
        smoothing=run.data.smoothing,
        validation=run.validation,
        link_length=link_length(run.data.motions, best.model, best.effort.delay),
        effects=() if run.composite is None else run.composite.effects,
        unmodelled=None if run.composite is None or run.composite.exact else run.composite.unexplained,
    )
