# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What one criterion says of a rig: parameters, how certain, and how well they predict."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.level import NORMAL_95, POOR, Level
from pendubot_identification.model.parameters import NAMES
from pendubot_identification.optimizers.optimizer import OptimizationResult

from .prediction import Prediction

Array = NDArray[np.float64]

#: Called now and then: what is being done, how much of it, of how much (0: not known), and the best J so far.
Progress = Callable[[str, int, int, float], None]

#: A run has found the minimum when its J exceeds the exact one by no more than this fraction.
REACHED = 1e-6
#: An interval that reaches farther to either side, as a fraction of the value, says too little to be relied on.
WIDE = 0.5
#: Below this an eigenvalue of a correlation matrix is 0, but for rounding.
INDEPENDENT = 1e-10
#: With fewer recordings than this, parts of their time take their place.
FEWEST_RECORDINGS = 3
#: Of J.
UNITS_OF_J = {'energy': 'J^2', 'weak': '(N m)^2', 'trajectory': 'variance'}


@dataclass(frozen=True, slots=True)
class Effort:
    """How the recorded effort was taken.

    Attributes:
        hold: ``zero`` or ``linear``, see :class:`.settings.Settings`.
        delay: what acts on the motion at t is the effort recorded at t - delay [s].
        std_error: of the delay [s]; NaN where it was not estimated.
    """

    hold: str
    delay: float = 0.0
    std_error: float = np.nan


@dataclass(frozen=True, slots=True)
class Zeros:
    """How far off the zeros of recordings' positions are: the position that was read minus the true one.

    Attributes:
        recordings: their names.
        angles: of both joints [rad], shape (2, R); NaN where nothing tells it.
        std_error: [rad], shape (2, R).
    """

    recordings: tuple[str, ...]
    angles: Array
    std_error: Array


@dataclass(frozen=True, slots=True)
class Estimate:
    """The answer of one criterion.

    Attributes:
        criterion: ``energy``, ``weak`` or ``trajectory``.
        model: the name of one of :data:`.parameters.MODELS`.
        theta: the estimate, shape (D,).
        free: which parameters lie on no bound, nor are held, shape (D,).
        covariance: shape (D, D); NaN in the rows and columns of parameters on a bound. Scaled so that an interval of
            1.96 standard errors to both sides holds the truth in 95 % of cases, however few the recordings.
        correlation: of the errors by the information matrix at theta, shape (D, D): which parameters the motion tells
            apart. (That of few recordings' differences has only as many directions as there are differences.) NaN in
            the rows and columns of parameters on a bound, and of those that nothing tells.
        std_error: shape (D,); of a parameter on its bound, how far the data would let it off; NaN of one that is not in
            the model.
        uncertainty: in words, how the covariance was found.
        effort: how the effort was taken.
        J: the criterion on the training data, in :attr:`unit`.
        residuals: how many residuals J averages.
        condition_number: of the scaled information.
        converged: whether the optimiser found a minimum.
        steps: in words, what each step of the optimisation came to.
        unexplained: J over what it is with all parameters zero; NaN for ``trajectory``.
        J_exact: the exact minimum of a quadratic criterion within the bounds; NaN for others.
        runs: what the runs of MDE found; None without.
        J_validation: the criterion on validation data, NaN without.
        J_validation_runs: the same for each run of MDE, shape (runs,); empty without.
        prediction: of validation data.
        zeros: of the recordings' positions; None where the criterion does not tell them.
        exact: whether the residuals are those of the encoders alone.
        held: which parameters were held at a value, shape (D,).
        absent: the parameters that are not in the model of this rig; theta has them as 0.
        resized: what is added to the sizes of the effects' torques that were allowed for, where the criterion estimates
            them along, shape (E,).
        level: how far to trust it.
        warnings: why, in sentences for the user.
        consequences: what follows from a grave fault of the recordings that the warnings name.
        advice: what motion would tell the parameters that this one tells poorly.
    """

    criterion: str
    model: str
    theta: Array
    free: NDArray[np.bool_]
    covariance: Array
    correlation: Array
    std_error: Array
    uncertainty: str
    effort: Effort
    J: float
    residuals: int
    condition_number: float
    converged: bool
    held: NDArray[np.bool_]
    steps: tuple[str, ...] = ()
    unexplained: float = np.nan
    J_exact: float = np.nan
    runs: OptimizationResult | None = None
    J_validation: float = np.nan
    J_validation_runs: Array = field(default_factory=lambda: np.empty(0))
    prediction: Prediction = field(default_factory=Prediction.none)
    zeros: Zeros | None = None
    exact: bool = False
    absent: tuple[str, ...] = ()
    resized: Array = field(default_factory=lambda: np.empty(0))
    level: Level = Level.OK
    warnings: tuple[str, ...] = ()
    consequences: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()

    @property
    def unit(self) -> str:
        """Of J."""
        return UNITS_OF_J[self.criterion]

    @property
    def present(self) -> NDArray[np.bool_]:
        """Which of theta are in the model of this rig, shape (D,)."""
        return ~np.isin(NAMES[: len(self.theta)], self.absent)

    @property
    def intervals(self) -> Array:
        """95 % intervals, shape (D, 2), cut where friction or inertia would be negative and the estimate is not."""
        reach = NORMAL_95 * self.std_error
        low = np.where(self.theta >= 0, np.maximum(self.theta - reach, 0.0), self.theta - reach)
        return np.column_stack([low, self.theta + reach])

    @property
    def determined(self) -> NDArray[np.bool_]:
        """Whether this motion determines each parameter: its standard error is below half its value, shape (D,)."""
        return np.asarray(self.free & (self.std_error <= POOR * np.abs(self.theta)))

    @property
    def not_covered(self) -> dict[str, str]:
        """By name, the parameters of which too little is known for the level to say anything of them, and why."""
        found = {}
        for k in np.flatnonzero(self.present & ~self.held):
            value, reach = abs(self.theta[k]), NORMAL_95 * self.std_error[k]
            if not self.free[k]:
                found[NAMES[k]] = 'on its bound'
            elif not np.isfinite(reach):
                found[NAMES[k]] = 'not identifiable from this motion'
            elif reach >= value:
                found[NAMES[k]] = 'its 95 % interval reaches 0'
            elif reach > WIDE * value:
                found[NAMES[k]] = f'its 95 % interval is +-{100 * reach / value:.0f} %'
        return found

    @property
    def covariance_rank(self) -> int:
        """The rank of the covariance of what lies on no bound: of few recordings or blocks, less than its size."""
        variance = np.diag(self.covariance)
        known = np.isfinite(variance) & (variance > 0)
        deviation = np.sqrt(variance[known])
        scaled = self.covariance[np.ix_(known, known)] / deviation / deviation[:, None]
        return int(np.linalg.matrix_rank(scaled, tol=INDEPENDENT, hermitian=True)) if known.any() else 0

    @property
    def J_runs(self) -> Array:
        """J of every run of MDE on the training data, or J alone, shape (runs,)."""
        return np.array([self.J]) if self.runs is None else self.runs.value

    @property
    def runs_at_minimum(self) -> int:
        """How many runs of MDE reached the exact minimum, or each other where none is known, to a relative 1e-6."""
        if self.runs is None:
            return 1
        least = self.J_runs.min() if np.isnan(self.J_exact) else self.J_exact
        return int((self.J_runs <= least * (1 + REACHED)).sum())


def average(vectors: Sequence[Array], weights: Sequence[float] | Array) -> Array:
    """Return the weighted mean of parameter vectors; what a smaller model lacks is 0."""
    size = max(map(len, vectors))
    return np.asarray(sum(w * np.pad(v, (0, size - len(v))) for w, v in zip(weights, vectors, strict=True)))


def averaged(answers: Sequence[Estimate], weights: Sequence[float]) -> Estimate:
    """Return the average of several models' answers, the largest model's last.

    The variance is the mean of theirs, and that of the answers: what the choice of the model leaves open is a part of
    it. All else, J among it, is the largest model's.
    """
    largest, size = answers[-1], len(answers[-1].theta)
    theta = average([e.theta for e in answers], weights)
    delay = float(np.dot(weights, [e.effort.delay for e in answers]))
    off = np.array([np.pad(e.theta, (0, size - len(e.theta))) - theta for e in answers])
    spread = np.einsum('m,mi,mj->ij', weights, off, off)
    # On its bound in one model alone, a parameter is free in the average.
    free = np.any([np.pad(e.free, (0, size - len(e.free))) for e in answers], axis=0)
    covariance = spread + sum(
        w * np.pad(np.nan_to_num(e.covariance, nan=0.0, posinf=np.inf), (0, size - len(e.theta)))
        for w, e in zip(weights, answers, strict=True)
    )
    covariance[~free], covariance[:, ~free] = np.nan, np.nan
    errors = [np.pad(e.std_error, (0, size - len(e.theta))) for e in answers]
    said = ', '.join(f'{100 * w:.0f} % {e.model}' for w, e in zip(weights, answers, strict=True))
    return replace(
        largest,
        theta=theta,
        free=free,
        covariance=covariance,
        std_error=np.sqrt(np.dot(weights, np.array(errors) ** 2) + np.diag(spread)),
        uncertainty=f'{largest.uncertainty}; and how models differ',
        effort=replace(largest.effort, delay=delay),
        resized=average([e.resized for e in answers], weights),
        converged=all(e.converged for e in answers),
        steps=(*largest.steps, f'average of models, weighted by how they predict: {said}'),
    )
