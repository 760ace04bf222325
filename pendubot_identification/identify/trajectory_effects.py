# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What the models lack, by the errors of simulated segments.

The weak form sees torques through the noise of differentiated angles. Simulated segments meet the angles as they were
read, so that an effect which moves the parameters by a part of what the weak form can see shows in their errors.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.criteria.levenberg_marquardt import levenberg_marquardt
from pendubot_identification.criteria.shooting import AgainstPositions, Segments
from pendubot_identification.criteria.trajectory_fit import (
    NOISIEST,
    SHORT_STEP,
    TrajectoryFit,
    longest_segment,
    readings_together,
    rounding_of,
)
from pendubot_identification.model.parameters import Bounds
from pendubot_identification.trajectories.motion import Motion

from .effects import Effect, Found, catalogue_of, passed_by, seen_of, with_unit_torques
from .estimate import FEWEST_RECORDINGS
from .hypotheses import folds_of, most_of, select

Array = NDArray[np.float64]

#: Length of the segments [s] whose errors are explained.
LENGTH = 0.5
#: An effect must explain this part of what is beyond rounding, and this part of everything.
PAYS, LEAST = 0.25, 0.005
#: Where errors are far greater than rounding, parts of one or two recordings have more in common than with any other:
#: then it must explain this part.
PAYS_ALONE = 0.5
#: Where errors are far greater than rounding, one of two readings nearer than this [s] is independent.
CORRELATED = 0.15
#: Errors of segments are the model's where they exceed the variance of rounding by more than this factor, and more than
#: so many readings, one after the other, tell as much as one that is independent. Without model errors they are at most
#: 1 and 1.5.
BEYOND, LASTING = 1.3, 2.0
#: What an effect explains a share of.
ERRORS = 'errors of simulated segments'
#: Segments whose error exceeds the median by this factor count by the error, not by its square.
BEND = 3.0
#: Readings nearer than this [s] are averaged before they are explained: else memory is what many effects take.
SPACING = 0.004
#: The torques of so many effects are simulated side by side.
TOGETHER = 8


def found_by_trajectory(
    motions: Sequence[Motion],
    recordings: NDArray[np.intp],
    near: TrajectoryFit,
    bounds: Bounds,
    delays: tuple[float, float],
) -> tuple[tuple[Found, ...], float]:
    """Return the effects that explain errors of simulated segments, and what the models lack, explained or not.

    That is how many times the errors are what rounded angles explain, in root mean squares, where they also last, as
    those of noise do not; else 1.

    Args:
        motions: the recordings, or parts of them, rid of what is known already.
        recordings: the number of each motion's recording.
        near: a fit of them, from which the segments' starts.
        bounds: of the fit's parameters.
        delays: bounds of the effort's delay [s].
    """
    theta, delay = near.fit.theta, near.fit.delay
    rounding = rounding_of(motions)
    if not (rounding > 0).all():
        return (), 1.0
    margin = max(map(abs, delays)) + 1e-6
    length = min(LENGTH, longest_segment(motions, margin))
    coarse = Segments.cut(motions, length, length, margin)
    rough = AgainstPositions(coarse, rounding, delay=delay)
    fit = levenberg_marquardt(rough, theta, delay, bounds, delays, robust=True, iterations=20, tolerance=1e-3)
    segments, comparison = coarse, rough
    if np.median(fit.costs) <= NOISIEST * rough.count / len(coarse):
        # What a simulation errs with longer steps, or where torques change within a step, looks like a lag or friction.
        finest = min(SHORT_STEP, *(m.interval for m in motions))
        segments = coarse.finer(math.ceil(coarse.step / finest - 1e-9))
        comparison = AgainstPositions(segments, rounding, delay=delay, initial=fit.initial)
        fit = levenberg_marquardt(
            comparison, fit.theta, fit.delay, bounds, delays, robust=True, iterations=8, tolerance=1e-4
        )
    theta, delay = fit.theta, fit.delay
    states = segments.roll(theta, fit.initial)
    residuals = comparison.residuals(states, delay)
    jacobian = comparison.jacobian(theta, states, delay)
    finite = np.isfinite(residuals).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2))
    folds, several = folds_of(recordings[segments.group[finite]]), recordings[-1] + 1
    if len(np.unique(folds)) < 2:
        return (), 1.0

    effects = catalogue_of(motions)

    # What the segments' initial states explain is explained.
    local = np.linalg.qr(jacobian[finite, :, :4])[0]
    weight = np.sqrt(np.minimum(1.0, BEND * np.median(fit.costs) ** 0.5 / np.maximum(fit.costs**0.5, 1e-300)))

    def apart(rows: Array) -> Array:
        rows = rows[finite]
        if not np.isfinite(rows).all():  # of an effect that no simulation survives
            rows = np.zeros_like(rows)
        return np.asarray((rows - local @ (local.transpose(0, 2, 1) @ rows)) * weight[finite, None, None])

    free = np.flatnonzero(fit.free | (np.arange(len(fit.free)) < 5))
    base, y = apart(jacobian[:, :, 4:][:, :, free]), -apart(residuals[:, :, None])[:, :, 0]
    count, unknowns = y.size - 4 * len(y), len(free)
    variance = float((y**2).sum()) / max(count - unknowns, 1)
    together = readings_together(residuals[finite].reshape(len(y), -1, 2))
    independent, pays, most = count / together, PAYS * (1 - 1 / max(variance, 1.0)), 0.0
    if variance > NOISIEST:
        most = most_of(several)
        independent = round(2 * len(y) * length / CORRELATED)
        pays = PAYS if several >= FEWEST_RECORDINGS else PAYS_ALONE
    apiece = max(1, round(SPACING * y.shape[1] / 2 / length))

    def averaged(rows: Array) -> Array:
        """Return rows of shape (L, M, C) with neighbouring readings as one: effects are smooth."""
        by_reading = rows.reshape(len(rows), -1, 2, rows.shape[2])
        first = np.arange(0, by_reading.shape[1], apiece)
        means = np.add.reduceat(by_reading, first, axis=1) / apiece
        return np.asarray(means.reshape(len(rows), -1, rows.shape[2]))

    chosen = select(
        effects,
        averaged(base),
        averaged(y[:, :, None])[:, :, 0],
        [averaged(apart(c)) for c in _columns(rough, effects, theta, delay, fit.initial)],
        folds,
        independent=independent,
        pays=max(pays, LEAST),
        physical=theta[:5],
    )
    found = tuple(
        Found(effects[c.number], c.sizes, c.share, c.moved / theta[:5], ERRORS, c.share >= most) for c in chosen
    )
    return found, math.sqrt(variance) if variance > BEYOND and together > LASTING else 1.0


def _columns(
    comparison: AgainstPositions,
    effects: Sequence[Effect],
    theta: Array,
    delay: float,
    initial: Array,
) -> Iterator[Array]:
    """Return the derivative of the residuals, shape (L, M), by the sizes of each effect, shapes (L, M, C)."""
    segments = comparison.segments
    states = segments.roll(theta, initial)
    passed = passed_by(segments.motions)
    seen = [
        seen_of(m, comparison.times[:, segments.group == k], delay, p)
        for k, (m, p) in enumerate(zip(segments.motions, passed, strict=True))
    ]
    # Of some effects at a time: all effects' torques at all times are large.
    for some in (effects[k : k + TOGETHER] for k in range(0, len(effects), TOGETHER)):
        units = [
            with_unit_torques(m, some, delay, p).unit_torques(
                segments.start[segments.group == k], segments.step, segments.steps
            )
            for k, (m, p) in enumerate(zip(segments.motions, passed, strict=True))
        ]
        moved = comparison.moved(segments.moved_by(np.concatenate(units, axis=3), theta, states), delay)
        by_unit = iter(np.moveaxis(moved, 2, 0))
        for effect in some:
            columns = [next(by_unit) for _ in effect.acting]
            for read in effect.read:
                # What is read is the position and the change: the position read, without it, is what is compared.
                change = np.concatenate([np.stack(read(s), axis=1) for s in seen], axis=2)
                columns.append((change / comparison.noise[:, None]).reshape(-1, len(segments)).T)
            yield np.stack(columns, axis=2)
