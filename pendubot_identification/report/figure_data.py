# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Data for the figures of a report: simulated motion, residuals, and the effect of each parameter, as arrays."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate

from pendubot_identification.criteria.prediction_error import STEP, Simulations
from pendubot_identification.criteria.weak import WIDTH, weak_regression
from pendubot_identification.identification.catalogue import FoundEffect, catalogue
from pendubot_identification.identification.fitting import standardised_innovations
from pendubot_identification.identification.linear import linear
from pendubot_identification.identification.prediction import HORIZONS, LOST
from pendubot_identification.identification.settings import Settings
from pendubot_identification.level import NORMAL_95
from pendubot_identification.model.parameters import NAMES
from pendubot_identification.results.provenance import Answer
from pendubot_identification.results.result import ReportedEffect
from pendubot_identification.trajectories.motion import Motion

Array = NDArray[np.float64]
#: The name of each recording, times [s], shape (N,), and values at these, shape (N, C).
Parts = Sequence[tuple[str, Array, Array]]

#: Duration of each simulation [s], the longest horizon of the predictions, or as long as the motion allows.
AHEAD = HORIZONS[-1]
#: Longest part of a motion that is shown [s].
SHOWN = 10.0
#: Rows of the regression of the weak criterion.
ROWS: tuple[str, ...] = ('shoulder', 'elbow', 'energy')


@dataclass(frozen=True, slots=True)
class Simulation:
    """A measured motion every :data:`STEP`, and K simulations of it from measured states on.

    Attributes:
        name: of the recording.
        t: times [s], shape (N,).
        measured: q1, q2, q1', q2' [rad, rad/s], smoothed, shape (4, N).
        tau: mean torques [N m] from each time until the next, shape (2, N - 1).
        scale: standard deviations of the states, the unit of the errors, shape (4,).
        simulated: the states of L steps and their start, shape (L + 1, 4, K); NaN after a simulation diverges.
        complete: whether the complete motion is shown, or only its worst part.
    """

    name: str
    t: Array
    measured: Array
    tau: Array
    scale: Array
    simulated: Array
    complete: bool

    @property
    def ahead(self) -> float:
        """Duration of each simulation [s]."""
        return STEP * (len(self.simulated) - 1)


@dataclass(frozen=True, slots=True)
class Residuals:
    """The residuals of a criterion on its training data.

    Attributes:
        names: of the C channels.
        parts: the residuals.
        overlap: residuals nearer than this [s] share data, so they are correlated with any model; infinite if each
            residual contains all data before it.
        lags: [s], shape (M,).
        autocorrelation: at these lags, over all recordings, shape (M, C).
        band: 95 % of the autocorrelations of white residuals lie within plus and minus this.
    """

    criterion: str
    unit: str
    names: tuple[str, ...]
    parts: Parts
    overlap: float
    lags: Array
    autocorrelation: Array
    band: float


def unexplained_torque(motions: Sequence[Motion], answer: Answer) -> tuple[Parts, dict[str, Array]]:
    """Return the torque that an estimate does not explain: the weak-form residuals of both joints.

    Returns:
        The torque of both joints, averaged by the test functions [N m]; by name, the quantities to plot it against, of
        shoulder and elbow, at the times of all K values together, shapes (K, 2).

    Raises:
        TrajectoryError: a recording is shorter than a test function.
    """
    made = [weak_regression(m, answer.model, answer.delay, weights=(1, 1, 1), stride=WIDTH / 4) for m in motions]
    times = [r.t[::3] for r in made]
    torque = [(r.y - r.phi @ answer.theta).reshape(-1, 3)[:, :2] for r in made]
    states = np.concatenate([m.states(t) for m, t in zip(motions, times, strict=True)], axis=1)
    tau = np.concatenate([m.impulse(t - answer.delay, 1) for m, t in zip(motions, times, strict=True)])
    against = {'its angle [rad]': states[:2].T, 'its speed [rad/s]': states[2:].T, 'torque [N m]': tau[:, [0, 0]]}
    return list(zip([m.name for m in motions], times, torque, strict=True)), against


def known_effects(motions: Sequence[Motion], delay: float, listed: Sequence[ReportedEffect]) -> list[FoundEffect]:
    """Return the accepted effects of a result, from the catalogue of its motions."""
    known = {(effect.name, effect.where): effect for effect in catalogue(motions, delay)}
    return [
        FoundEffect(known[e.name, e.where], np.array(e.sizes, dtype=float), np.nan, np.nan, True, np.zeros(5))
        for e in listed
        if e.accepted and (e.name, e.where) in known
    ]


def simulate_beside(motions: Sequence[Motion], answer: Answer, scale: Array) -> Simulation:
    """Simulate recordings from measured states on, and return the worst predicted part of one of them.

    ``scale``: standard deviations of the states, shape (4,), the unit of the errors.

    Raises:
        TrajectoryError: the recordings are too short to be simulated.
    """
    margin = max(abs(answer.delay), 1e-9)
    longest = max(m.end - m.start - m.interval for m in motions) - 2 * margin
    ahead = STEP * int(min(AHEAD, longest) / STEP)
    found = []
    for motion in (m for m in motions if m.end - m.start - 2 * margin >= ahead):
        simulations = Simulations.of([motion], answer.theta, answer.delay, np.zeros(2), (ahead,), ahead)
        with np.errstate(all='ignore'):
            off, states = simulations.errors(answer.theta)
            off = np.nan_to_num(np.abs(off[0] / scale[:, None]), nan=LOST, posinf=LOST)
        errors = (np.minimum(off, LOST) ** 2).mean(axis=0)
        count = min(len(errors), max(1, round(SHOWN / ahead)))
        sums = np.convolve(errors, np.ones(count), mode='valid') / count
        first = int(np.argmax(sums))
        states = states[:: simulations.substeps]
        found.append((float(sums[first]), motion, simulations.t, states, slice(first, first + count)))
    _, motion, starts, states, shown = max(found, key=lambda each: each[0])
    states = np.where(np.isfinite(states), states, np.nan)[:, :, shown]
    steps = (len(states) - 1) * states.shape[2]
    t = starts[shown.start] + STEP * np.arange(steps + 1)
    return Simulation(
        name=motion.name,
        t=t,
        measured=motion.states(t),
        tau=motion.torques(t[:1] - answer.delay, STEP, steps)[:, :, 0],
        scale=scale,
        simulated=states,
        complete=len(motions) == 1 and len(starts) <= shown.stop - shown.start,
    )


def residuals(motions: Sequence[Motion], answer: Answer, settings: Settings) -> Residuals:
    """Return the residuals of an estimate by one criterion of the settings on its training data.

    For ``likelihood``, these are the normalized innovations every 0.05 s.

    Raises:
        TrajectoryError: the recordings are too short.
    """
    if answer.criterion == 'likelihood':
        names: tuple[str, ...] = ('q1', 'q2')
        unit, overlap = 'standard deviations', 0.0
        t, z = standardised_innovations(motions, answer.theta, answer.delay, settings)
        parts = list(zip(t, z, strict=True))
        interval = float(np.median(np.diff(t[0])))
    else:
        names, unit, overlap = ROWS, 'N m', WIDTH
        if answer.criterion == 'energy':
            names, unit, overlap = ('energy',), 'J', settings.sliding or np.inf
        made = linear(answer.criterion, motions, answer.model, settings)
        parts = [(r.t[:: len(names)], (r.y - r.phi @ answer.theta).reshape(-1, len(names))) for r in made.residuals]
        interval = float(np.median(np.concatenate([np.diff(t) for t, _ in parts])))
    lags = int(min(2 * AHEAD / interval, max(len(t) for t, _ in parts) // 2))
    return Residuals(
        criterion=answer.criterion,
        unit=unit,
        names=names,
        parts=[(m.name, *part) for m, part in zip(motions, parts, strict=True)],
        overlap=overlap,
        lags=np.asarray(interval * np.arange(lags + 1)),
        autocorrelation=_autocorrelation([values for _, values in parts], lags),
        band=NORMAL_95 / np.sqrt(max(sum(len(t) for t, _ in parts), 1)),
    )


def _autocorrelation(parts: Sequence[Array], lags: int) -> Array:
    """Return the autocorrelation of residuals of mean 0 at even times, shapes (N, C), as shape (lags + 1, C)."""
    sums = np.zeros((lags + 1, parts[0].shape[1]))
    for part in parts:
        padded = np.pad(part, ((0, lags), (0, 0)))
        sums += np.column_stack([correlate(a, b, 'valid', 'fft') for a, b in zip(padded.T, part.T, strict=True)])
    return np.asarray(sums / np.maximum(sums[0], np.finfo(float).tiny))


def excitation(motions: Sequence[Motion], answer: Answer, names: Collection[str] = NAMES) -> tuple[Array, Array, Array]:
    """Return root mean squares of the effects of D parameters in the rows of ``weak`` on training data [N m, N m, W].

    Returns:
        Each parameter times its column, shape (D, 3); the residual of that after regression on all other columns, shape
        (D, 3); the residual of the criterion, shape (3,).

    Raises:
        TrajectoryError: the recordings are shorter than a test function.
    """
    parts = [weak_regression(m, answer.model, answer.delay, stride=WIDTH / 10) for m in motions]
    shown = np.isin(NAMES[: len(answer.theta)], list(names))
    phi, y = np.concatenate([p.phi[:, shown] for p in parts]), np.concatenate([p.y for p in parts])
    theta = answer.theta[shown]
    term = np.array([_by_row(column) for column in (phi * theta).T])
    # Each row is divided by its largest term, so that all rows have the same weight.
    size = np.max([_by_row(y), *term], axis=0)
    weight = np.tile(1 / np.where(size > 0, size, 1.0), len(y) // 3)
    weighted = phi * weight[:, None]
    own = np.zeros((len(theta), 3))
    for k, value in enumerate(theta):
        others = np.delete(weighted, k, axis=1)
        imitated = others @ np.linalg.lstsq(others, weighted[:, k], rcond=None)[0]
        own[k] = _by_row(value * (weighted[:, k] - imitated) / weight)
    # A parameter without a term in a row has no part of its own there.
    return term, np.minimum(own, term), _by_row(y - phi @ theta)


def _by_row(rows: Array) -> Array:
    return np.asarray(np.sqrt((rows.reshape(-1, 3) ** 2).mean(axis=0)))
