# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""How each criterion is minimised: quickly, for comparisons, and in full, for a result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.criteria.shooting import LONGEST_STEP
from pendubot_identification.criteria.trajectory_fit import (
    FINEST,
    TrajectoryFit,
    fit_positions,
    fit_states,
    search,
    segment_cost,
)
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.parameters import MODELS
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import choose_smoothing
from pendubot_identification.trajectories.trajectory import Trajectory

from .covariance import correlations, estimated_zeros, scaled_condition_number, trajectory_covariance
from .effects import Found, allowing_for, passed_by, together, with_unit_torques
from .estimate import Effort, Estimate, Progress, Zeros, averaged
from .linear import Linear, estimate_linear, linear
from .prediction import state_scale
from .settings import Settings
from .unexplained import Burst, between_bursts

Array = NDArray[np.float64]
Groups = tuple[tuple[Motion, ...], ...]

#: Below this [s] neither bumps nor segments have room.
SHORTEST = 1.0
#: Segments, length and stride [s], of a fit that only compares, coarser than a result's; of one that starts near its
#: end; and how many iterations each may take.
COMPARING, COMPARING_ITERATIONS = ((0.1, 0.4), (0.25, 0.2), (0.5, 0.2)), 20
NEARBY, NEARBY_ITERATIONS = ((0.5, 0.2),), 8
#: Where a fit starts neither P1 nor P2 is less than this fraction of their sum.
LEAST_SHARE = 0.05
#: A held torque that leaves less than so many times the variance of the encoders' rounding needs no rival.
FULLY = 1.1
#: Lengths of segments [s] over which a model shows whether it is exact, and a torque whether it was held or measured.
EXACT_LADDER = (0.2, 0.5, 1.0, 2.0)
#: A torque is taken as measured, linear between its samples, where that leaves less than this fraction of the errors
#: that a held one leaves. Where samples are no further apart than a simulation step, the difference is a delay of half
#: an interval.
LINEAR = 0.95
#: No effect's torque is larger than so many times its unit.
ANY_SIZE = 1e3
#: A fit has ended in a valley of its own where its J is above so many times that of another answer.
ELSEWHERE = 1.1


@dataclass(frozen=True, slots=True)
class Data:
    """Motions ready to be explained, and how they are taken.

    Attributes:
        groups: of each recording itself, or the parts of it between bursts.
        whole: the recordings as they were.
        smoothing: the window [s] that made their states.
        hold: how their torque behaves between samples.
        scale: the states' standard deviations, shape (4,).
        settings: what was asked for.
        effects: that the models lack and that are allowed for.
        delay: of the effort [s], with which they were found.
    """

    groups: Groups
    whole: tuple[Motion, ...]
    smoothing: float
    hold: str
    scale: Array
    settings: Settings
    effects: tuple[Found, ...] = ()
    delay: float = 0.0
    _linear: dict[tuple[str, str], Linear] = field(default_factory=dict, init=False, repr=False, compare=False)

    @classmethod
    def prepare(cls, trajectories: Sequence[Trajectory], settings: Settings) -> Data:
        """Choose smoothing and hold, and make the recordings ready.

        Raises:
            TrajectoryError: all are too short for what is asked for.
        """
        longest = max(trajectories, key=lambda t: t.duration)
        if settings.criteria != ('energy',) and longest.duration < SHORTEST:
            raise TrajectoryError(
                f'{longest.name}: {longest.duration:.3f} s are too short for the criteria weak and trajectory, which '
                f'need {SHORTEST:g} s; choose a longer window, or the criterion energy alone'
            )
        smoothing = choose_smoothing(trajectories) if settings.smoothing is None else settings.smoothing

        def taken(hold: str) -> Data:
            motions = tuple(Motion.prepare(t, smoothing, hold) for t in trajectories)
            return cls(tuple((m,) for m in motions), motions, smoothing, hold, state_scale(motions), settings)

        if settings.hold != 'auto':
            return taken(settings.hold)
        held = taken('zero')
        if settings.criteria == ('energy',) or max(m.interval for m in held.motions) <= LONGEST_STEP:
            return held
        blurred, misfit = held._misfit()
        if not blurred and misfit < FULLY:
            return held
        measured = taken('linear')
        blurred_too, misfit_too = measured._misfit()
        better = blurred > blurred_too if blurred != blurred_too else misfit_too < LINEAR * misfit
        return measured if better else held

    def _misfit(self) -> tuple[bool, float]:
        """Return whether more than the encoders' rounding is left unexplained, and how much is."""
        found = self.fit('rotor')
        exact = self.exact('rotor', found) or self.exact('geared', self.fit('geared', near=found))
        return (True, found.fit.cost) if exact is None else (False, exact.variance)

    @property
    def motions(self) -> tuple[Motion, ...]:
        """All of them."""
        return sum(self.groups, ())

    @property
    def recordings(self) -> NDArray[np.intp]:
        """The number of each motion's recording."""
        return np.repeat(np.arange(len(self.groups)), [len(group) for group in self.groups])

    @property
    def started_by_weak(self) -> Data:
        """The same without parameters to start from that were given."""
        return replace(self, settings=replace(self.settings, start=None))

    def only(self, motions: Sequence[Motion]) -> Data:
        """Return some of the motions, measured by the same scale."""
        return replace(self, groups=tuple((motion,) for motion in motions), whole=tuple(motions))

    def allowing_for(self, found: Sequence[Found], delay: float) -> Data:
        """Return the motions with what is left of their torques without effects that the models lack."""
        if not any(each.allowed for each in found):
            return self
        passed = iter(passed_by(self.motions))
        groups = tuple(tuple(allowing_for(m, found, delay, next(passed)) for m in group) for group in self.groups)
        effects = together(self.effects, [each for each in found if each.allowed])
        return replace(self, groups=groups, effects=effects, delay=delay)

    @property
    def with_unit_torques(self) -> tuple[Motion, ...]:
        """The motions with the torques of the effects beside their own, so that their sizes can be estimated."""
        effects = [found.effect for found in self.effects]
        parts = zip(self.motions, passed_by(self.motions), strict=True)
        return tuple(with_unit_torques(motion, effects, self.delay, passed) for motion, passed in parts)

    def without(self, bursts: Sequence[Burst]) -> Data:
        """Return the parts of the recordings that lie between bursts."""
        if not bursts:
            return self
        parts = ([part for m in group for part in between_bursts(m.recorded, bursts)] for group in self.groups)
        groups = [tuple(Motion.prepare(part, self.smoothing, self.hold) for part in group) for group in parts]
        left = [(group, recording) for group, recording in zip(groups, self.whole, strict=True) if group]
        return replace(self, groups=tuple(group for group, _ in left), whole=tuple(recording for _, recording in left))

    def linear(self, criterion: str, model: str) -> Linear:
        """Return a quadratic criterion, with the delay and the weights that suit the motions; it is made once."""
        if (criterion, model) not in self._linear:
            self._linear[criterion, model] = linear(criterion, self.motions, model, self.settings)
        return self._linear[criterion, model]

    def solve_linear(self, criterion: str, model: str, like: Linear | None = None) -> tuple[Array, float]:
        """Return a quadratic criterion's exact theta, and the delay [s], which may be that of ``like``."""
        made = self.linear(criterion, model) if like is None else like
        whole = Quadratic.pool([self._reduced(motion, criterion, model, made) for motion in self.motions])
        return whole.minimum(self.settings.box(model)), made.delay

    def _reduced(self, motion: Motion, criterion: str, model: str, like: Linear) -> Quadratic:
        """Return a motion's part of a criterion, which any others of which it is one share."""
        what = criterion, model, like.delay, *like.weights
        return motion.once(what, lambda: linear(criterion, [motion], model, self.settings, like).criterion)

    def weak_start(self, model: str, like: Linear | None = None) -> tuple[Array, float]:
        """Return the weak criterion's answer, as far as a local optimiser can start from it."""
        theta, delay = self.solve_linear('weak', model, like)
        # On a bound of the inertias nothing moves as a rig does, and no fit finds its way from there.
        theta[:2] = np.maximum(theta[:2], LEAST_SHARE * max(theta[:2].sum(), 1e-6))
        return theta, delay

    def start(self, model: str, like: Linear | None = None) -> tuple[Array, float]:
        """Return where a local optimiser starts: the user's parameters, or the weak criterion's."""
        if self.settings.start is None:
            return self.weak_start(model, like)
        return self.settings.start.vector('geared')[: MODELS[model]], self.settings.least_delay

    def fit(self, model: str, near: TrajectoryFit | None = None, like: Linear | None = None) -> TrajectoryFit:
        """Fit short segments coarsely, from the start (with the delay ``like``) or from where a similar fit ended."""
        ladder: tuple[tuple[float, float], ...] = COMPARING
        iterations = COMPARING_ITERATIONS
        if near is None:
            theta, delay = self.start(model, like)
        else:
            theta, delay = np.pad(near.fit.theta, (0, MODELS[model] - len(near.fit.theta))), near.fit.delay
            ladder, iterations = NEARBY, NEARBY_ITERATIONS
        bounds, delays = self.settings.box(model), self.settings.delays
        return fit_states(
            self.motions, theta, delay, bounds, delays, self.scale, ladder=ladder, iterations=iterations, tolerance=1e-3
        )

    def exact(self, model: str, near: TrajectoryFit) -> TrajectoryFit | None:
        """Fit recorded positions over segments of up to 2 s, if the model leaves but the encoders' rounding."""
        bounds, delays = self.settings.box(model), self.settings.delays
        return fit_positions(self.motions, near.fit.theta, near.fit.delay, bounds, delays, ladder=EXACT_LADDER)


def estimate(
    criterion: str,
    data: Data,
    judges: Sequence[Motion],
    models: Mapping[str, float],
    progress: Progress,
) -> Estimate:
    """Return one criterion's answer, with its J on the motions that judge.

    Of several models, the largest last, it is the average of their answers by these weights.
    """
    *smaller, model = models
    quick = replace(data, settings=replace(data.settings, optimizer='lsq'))
    if criterion == 'trajectory':
        others = [_estimate_trajectory(quick, (), m, progress) for m in smaller]
        found = _estimate_trajectory(data, judges, model, progress)
    else:
        made = data.linear(criterion, model)
        judge = linear(criterion, judges, model, data.settings, like=made) if judges else None
        # With the same delay and weights; the smaller models' criterion is that of some columns alone.
        others = [
            estimate_linear(criterion, made.first(MODELS[m]), m, quick.settings, data.hold, progress, None)
            for m in smaller
        ]
        found = estimate_linear(criterion, made, model, data.settings, data.hold, progress, judge)
    if others:
        found = averaged([*others, found], list(models.values()))
        if criterion == 'trajectory':
            J = _segment_cost(data, found.theta, found.resized, found.effort.delay, model)
            J_validation = _segment_cost(data, found.theta, found.resized, found.effort.delay, model, judges)
        else:
            J, J_validation = (np.nan if each is None else float(each.criterion(found.theta)) for each in (made, judge))
        found = replace(found, J=J, J_validation=J_validation)
    return found


def _segment_cost(
    data: Data, theta: Array, resized: Array, delay: float, model: str, judges: Sequence[Motion] | None = None
) -> float:
    """Return J of the trajectory criterion on the motions that judge, or on the data themselves; NaN without any."""
    box = data.settings.box(model)
    if judges is None:
        wide = box.beside(tuple(f'size {k}' for k in range(len(resized))), ANY_SIZE)
        return segment_cost(data.with_unit_torques, np.append(theta, resized), delay, wide, data.scale)[0]
    return segment_cost(judges, theta, delay, box, data.scale)[0] if judges else np.nan


def _estimate_trajectory(data: Data, judges: Sequence[Motion], model: str, progress: Progress) -> Estimate:
    """Fit smoothed states from a rough start, and then recorded positions where these say more."""
    settings, motions, scale, bounds = data.settings, data.with_unit_torques, data.scale, data.settings.box(model)
    size, number, runs = MODELS[model], count(1), None
    sizes = tuple(f'{f.effect.name} {k}' for f in data.effects for k in range(len(f.effect.acting)))
    wide = bounds.beside(sizes, ANY_SIZE)

    def tell(cost: float) -> None:
        progress('trajectory: Levenberg-Marquardt', next(number), 0, cost)

    def cost(theta: Array, delay: float) -> tuple[float, int]:
        return segment_cost(motions, theta, delay, wide, scale)

    if settings.optimizer == 'mde':
        mde, several = settings.search('trajectory', model)

        def report(generation: int, best: float) -> None:
            progress('trajectory: MDE', generation, mde.generations, best)

        runs = search(data.motions, bounds, scale, mde, several, settings.seed, report)
        theta, delay = runs.x[runs.best], settings.least_delay
        steps = [
            f'MDE from anywhere within the bounds: {several} runs, up to {int(runs.generations.max())} '
            f'generations, bounded error {runs.value.min():.4g} (worst run {runs.value.max():.4g})'
        ]
    else:
        theta, delay = data.start(model)
        steps = ['start: ' + ("the weak criterion's answer" if settings.start is None else 'given parameters')]
    theta = np.append(theta, np.zeros(len(sizes)))
    found = fit_states(motions, theta, delay, wide, settings.delays, scale, progress=tell)
    J, residuals = cost(found.fit.theta, found.fit.delay)
    steps.append(
        f'Levenberg-Marquardt on states over {found.length:.2g} s: J = {J:.4g}, {found.fit.iterations} iterations'
    )
    sharper = fit_positions(motions, found.fit.theta, found.fit.delay, wide, settings.delays, progress=tell)
    zeros = None
    if sharper is None:
        zeros = Zeros(tuple(m.name for m in motions), *estimated_zeros(found, len(motions)))
    else:
        found = sharper
        J, residuals = cost(found.fit.theta, found.fit.delay)
        left = f'{found.variance:.3f} times the variance of their rounding'
        if not found.rounded:
            left = f'{np.sqrt(found.variance) * FINEST:.2g} rad are left'
        steps.append(f'Levenberg-Marquardt on recorded positions over {found.length:.3g} s: {left}')
    fit = found.fit
    converged = fit.converged
    if settings.start is not None and settings.optimizer != 'mde' and not found.exact:
        # A valley of its own may hold what began far away; that another point is lower shows it.
        theta, delay = data.weak_start(model)
        elsewhere, _ = cost(np.append(theta, np.zeros(len(sizes))), delay)
        if ELSEWHERE * elsewhere < J:
            converged = False
            steps.append(f"the weak criterion's answer has J = {elsewhere:.4g}: lower, without any search")
    covariance, std_error, uncertainty = trajectory_covariance(found)
    return Estimate(
        criterion='trajectory',
        model=model,
        theta=fit.theta[:size],
        resized=fit.theta[size:],
        free=fit.free[:size],
        covariance=covariance[:size, :size],
        correlation=correlations(fit.informations.sum(axis=0)[:-2, :-2], fit.free)[:size, :size],
        std_error=np.where(bounds.held, 0.0, np.where(bounds.present, std_error[:size], np.nan)),
        uncertainty=uncertainty,
        effort=Effort(data.hold, fit.delay, float(std_error[-1]) if fit.free[-1] else np.nan),
        J=J,
        residuals=residuals,
        condition_number=scaled_condition_number(found),
        converged=converged,
        steps=tuple(steps),
        runs=runs,
        J_validation=_segment_cost(data, fit.theta[:size], fit.theta[size:], fit.delay, model, judges),
        zeros=zeros,
        exact=found.exact,
        absent=bounds.absent,
        held=bounds.held,
    )
