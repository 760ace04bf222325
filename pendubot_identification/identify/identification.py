# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""From motions to parameters: prepare, choose the model, minimise every criterion, predict, judge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.level import Level
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.reading import Reading
from pendubot_identification.trajectories.signals import evenly_stamped
from pendubot_identification.trajectories.suspicions import suspicions
from pendubot_identification.trajectories.trajectory import Trajectory

from .agreement import contradictions, disagreement
from .diagnosis import Fault, diagnose, link_length, with_options
from .effects import allowing_for, together
from .estimate import Estimate, Progress
from .judgement import judge, require_excitation
from .prediction import Prediction, predict
from .recipes import SHORTEST, Data, estimate
from .selection import TRUST, Comparison, ModelScore
from .settings import Settings
from .trajectory_effects import found_by_trajectory
from .unexplained import Unexplained, unexplained

Array = NDArray[np.float64]

#: How often effects are looked for once more, beside those that were found.
LOOKS = 2
#: How much better, in the logarithm of the error, a criterion must predict than one that is trusted more.
BETTER = 0.02


@dataclass(frozen=True, slots=True)
class Identification:
    """Every criterion's answer, which one is published, and everything that says how far to trust it.

    Attributes:
        settings: what was asked for.
        estimates: one a criterion, in the order of the settings.
        published: the number of the one that predicts the validation data best.
        faults: of the recordings.
        models: what the choice of the model compared; empty where the model was given.
        comparison: in words, by which criterion and how.
        interval: between the training samples [s].
        smoothing: the window [s] that made the states.
        validation: what the predictions are of, in words.
        link_length: P3 / P5 [m] of the elbow's own equation, and its standard error.
        unexplained: the torque that no parameters explain; None where it was not looked at.
    """

    settings: Settings
    estimates: tuple[Estimate, ...]
    published: int
    faults: tuple[Fault, ...]
    models: tuple[ModelScore, ...]
    comparison: str
    interval: float
    smoothing: float
    validation: str
    link_length: tuple[float, float]
    unexplained: Unexplained | None

    @property
    def best(self) -> Estimate:
        """The estimate that is published."""
        return self.estimates[self.published]

    @property
    def mended(self) -> Reading | None:
        """How the recordings are to be read so that their faults are put right; None where no options do that."""
        return next((fault.mended for fault in reversed(self.faults) if fault.mended is not None), None)

    @property
    def level(self) -> Level:
        """How far to trust them."""
        return self.best.level

    @property
    def warnings(self) -> tuple[str, ...]:
        """Why, in sentences for the user."""
        return self.best.warnings


def identify(
    training: Sequence[Trajectory],
    validation: Sequence[Trajectory] = (),
    settings: Settings | None = None,
    progress: Progress | None = None,
    notes: Sequence[str] = (),
) -> Identification:
    """Estimate the parameters of a rig from one or more of its motions.

    Where the stamps of one are evidently false, even ones take their place.

    Args:
        training: the motions that estimate; they are pooled.
        validation: motions that only judge. Without any, each recording of several (or block of time of one or two)
            is predicted from the others in turn; the estimates themselves use all of them.
        settings: see :class:`Settings`.
        progress: called with what is being done, how much of it is done, of how much (0: not known), and the best J.
        notes: warnings that come with the data, such as a bag that was never closed.

    Raises:
        TrajectoryError: a motion that is too short or has gaps.
        ExcitationError: a motion from which some parameters are not identifiable.
    """
    settings = settings or Settings()
    progress = progress or (lambda what, done, of, best: None)
    given = [*training, *validation]
    training, validation = ([evenly_stamped(motion) for motion in part] for part in (training, validation))
    for motion in (*training, *validation):
        motion.require_samples()
    require_excitation(training, settings)
    settings, notes = settings.of_rig(training), [*notes, *suspicions(given)]

    progress('preparing', 0, 0, np.nan)
    data = Data.prepare(training, settings)
    judges = [Motion.prepare(motion, data.smoothing, data.hold) for motion in validation]
    progress('checking signs, zeros and stamps', 0, 0, np.nan)
    low, high = settings.delays
    faults = _diagnosed(data)
    # What is estimated along does not stand in the way, nor does what an effect may explain.
    look = all(f.name in ('offset', 'motion') or (f.delay is not None and low <= f.delay <= high) for f in faults)
    as_is = data
    left, data, comparison = _rid_of_effects(data, progress, look)
    if any(f.name == 'motion' for f in faults):
        again = faults if left is None else _diagnosed(data)
        if any(f.name == 'motion' for f in again):  # what was found then explains nothing
            left, data, comparison = None, as_is, Comparison(as_is, progress)
        else:
            faults = again
    if any(found.effect.name == 'offset' for found in data.effects):
        faults = tuple(replace(f, level=Level.WARN) if f.name == 'offset' else f for f in faults)
    if left is not None:
        notes += left.sentences({fault.name for fault in faults})
        judges = [allowing_for(motion, data.effects, data.delay) for motion in judges]
    models, scores = comparison.choose() if settings.model == 'auto' else ((settings.model,), [])
    model = models[-1]

    estimates = []
    for criterion in settings.criteria:
        weights = comparison.weights(criterion, models)
        answer = estimate(criterion, data, judges, weights, progress)
        parts = [predict([j], answer.theta, answer.effort.delay, data.scale) for j in judges]
        parts = parts or comparison.predicted(criterion, weights)
        estimates.append(replace(answer, prediction=Prediction.pool(parts)))
    published = _best(estimates)
    estimates, differences = disagreement(estimates)
    notes += differences
    if left is not None and (said := left.rest_sentence(any(e.exact for e in estimates))):
        notes.append(said)

    length = link_length(data.motions, model, estimates[published].effort.delay)
    # Recordings that have a grave fault in common seem to contradict each other, too; but not for a delay, which is
    # estimated along.
    spoiled = any(f.level is Level.ERROR and f.name not in ('delay', 'motion') for f in faults)
    if len(data.groups) > 1 and settings.criteria != ('energy',) and not spoiled:
        progress('looking whether recordings agree', 0, 0, np.nan)
        notes += contradictions(data, model, comparison.fit(model), comparison.without(model))
    if faults:
        # Zeros of single recordings would make up for what is wrong with all of them.
        estimates = [replace(e, zeros=None) for e in estimates]
    lost = [
        f'{e.criterion} did not converge, so that it does not confirm what others say: start it elsewhere, or choose '
        'another part of the recording'
        for e in estimates
        if not e.converged
    ]
    return Identification(
        settings=settings,
        estimates=tuple(
            judge(e, settings, length, faults, [*notes, *lost] if e.converged else notes) for e in estimates
        ),
        published=published,
        faults=faults,
        models=tuple(scores),
        comparison=f'{comparison.deciding}, {comparison.method}' if scores else '',
        interval=float(np.median([m.interval for m in data.motions])),
        smoothing=data.smoothing,
        validation='on data that was not used for estimation' if judges else comparison.method,
        link_length=length,
        unexplained=left,
    )


def _diagnosed(data: Data) -> tuple[Fault, ...]:
    """Return what is wrong with the recordings' conventions, with the options that put it right."""
    settings, (low, high) = data.settings, data.settings.delays
    model, delay = 'rotor' if settings.model == 'auto' else settings.model, low if low == high else 0.0
    faults = diagnose(data.motions, data.smoothing, data.hold, model, delay, settings.link_length)
    return with_options(faults, settings.reading)


def _rid_of_effects(data: Data, progress: Progress, look: bool) -> tuple[Unexplained | None, Data, Comparison]:
    """Return what no parameters explain, and the data without bursts and without effects that are torques.

    Energy, whose answer is that of the recorded torques, allows for none of these.
    """
    settings = data.settings
    long_enough = [m for m in data.motions if m.end - m.start >= SHORTEST]
    if not look or not long_enough:
        return None, data, Comparison(data, progress)
    energy = settings.criteria == ('energy',)
    seen = data.only(long_enough) if energy else data
    delay = seen.linear('weak', 'rotor').delay
    progress(f'{_so_far(seen)}; looking for what the models lack', 0, 0, np.nan)
    left = unexplained(long_enough, data.smoothing, data.hold, delay)
    if energy:
        left = replace(left, effects=tuple(replace(found, most=False) for found in left.effects))
    data = data.without(left.bursts).allowing_for(left.effects, delay)
    comparison = Comparison(data, progress)
    if comparison.deciding != 'trajectory':
        return left, data, comparison
    for _ in range(LOOKS):
        # Not from a start that the user gave, which may lie far off.
        near = comparison.fit('geared') if settings.start is None else data.started_by_weak.fit('geared')
        more, beyond = found_by_trajectory(data.motions, data.recordings, near, settings.box('geared'), settings.delays)
        left = replace(left, effects=together(left.effects, more), beyond=beyond)
        if not any(found.allowed for found in more):
            break
        data = data.allowing_for(more, delay)
        comparison = Comparison(data, progress)
    return left, data, comparison


def _so_far(data: Data) -> str:
    """Return in words what the weak criterion says of P1 to P5, long before all is done."""
    theta = data.linear('weak', 'rotor').criterion.minimum(data.settings.box('rotor'))
    return 'weak so far: P1 to P5 ' + ' '.join(f'{value:.3g}' for value in theta[:5])


def _best(estimates: Sequence[Estimate]) -> int:
    """Return the number of the estimate to publish: of those that predict best, the most trusted.

    One that leaves nothing but the encoders' rounding predicts as well as can be measured: what then tells predictions
    apart is how well the states are known in which they start.
    """
    if exact := [k for k, e in enumerate(estimates) if e.exact]:
        return exact[0]
    losses = np.array([e.prediction.loss for e in estimates])
    least = min(losses[np.isfinite(losses)], default=np.nan)
    good = [k for k, loss in enumerate(losses) if not loss > least + BETTER]
    return min(good, key=lambda k: TRUST.index(estimates[k].criterion))
