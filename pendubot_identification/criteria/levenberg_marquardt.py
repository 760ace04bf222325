# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Bounded Levenberg-Marquardt for the trajectory criterion, with the segments' initial states condensed out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.model.parameters import LARGEST_COUPLING, Bounds

from .shooting import Comparison

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Damping at the start, and the factors by which it falls and rises (Marquardt 1963).
DAMPING, EASIER, HARDER = 1e-3, 0.2, 5.0
LEAST_DAMPING, MOST_DAMPING = 1e-12, 1e9
#: Segments whose error exceeds the median by this factor count by the error, not by its square.
BEND = 1.5
#: P1 and P2 stay above this fraction of their upper bounds: M(q) is singular where one is 0.
LEAST_INERTIA = 1e-7


@dataclass(frozen=True, slots=True)
class Fit:
    """Where Levenberg-Marquardt came to rest, for L segments and G = D + 1 global unknowns: theta and the delay."""

    theta: Array  #: shape (D,).
    delay: float  #: [s].
    initial: Array  #: the segments' initial states, shape (4, L).
    costs: Array  #: each segment's sum of squared residuals, shape (L,).
    free: Flags  #: which of theta and delay lie on no bound, shape (G,).
    #: Each segment's part of the Gauss-Newton matrix, its initial state condensed out, of theta, delay and both zeros
    #: of its recording, which are held at 0, shape (L, G + 2, G + 2).
    informations: Array
    #: Each segment's part of the gradient, likewise, shape (L, G + 2); they add up to 0 for what is free.
    slopes: Array
    iterations: int  #: how many it took.
    converged: bool  #: whether it stopped because nothing was left to gain, with no motion lost.

    @property
    def cost(self) -> float:
        """The sum of squared residuals."""
        return float(self.costs.sum())


@np.errstate(all='ignore')  # a step too far makes motions that no float can hold; they are not taken
def levenberg_marquardt(
    comparison: Comparison,
    theta: Array,
    delay: float,
    bounds: Bounds,
    delay_bounds: tuple[float, float],
    *,
    robust: bool = False,
    fixed: bool = False,
    iterations: int = 50,
    tolerance: float = 1e-6,
    least: float = 0.0,
    progress: Callable[[float], None] | None = None,
) -> Fit:
    """Minimise the sum of squared residuals over theta, shape (D,), delay [s] and every segment's initial state.

    Args:
        comparison: the residuals.
        theta: where to start.
        delay: where to start.
        bounds: of theta; what they leave is cut down to where M(q) is positive definite for every q.
        delay_bounds: of the delay [s]; equal ones fix it.
        robust: whether a segment that is off by more than 1.5 times the median counts by its distance, no longer by
            its square (Huber 1964): near upright motions are chaotic, and a few such segments would outvote the rest.
        fixed: whether theta and delay stay as they are and the initial states alone are estimated.
        iterations: at most.
        tolerance: stop when a step gains no more than this fraction of the cost, or of ``least`` if that is more.
        least: a cost below which there is nothing to gain.
        progress: called with the cost after every iteration.
    """
    box = _Box(bounds, delay_bounds, fixed)
    z = box.start(theta, delay)
    x = comparison.initial(delay)
    states, residuals = _simulated(comparison, *box.parameters(z), x)
    bend = _bend(residuals) if robust else np.inf
    damping, iteration, normal = DAMPING, 0, None
    bend_is_final, settled, converged = not robust, False, False
    while not settled and iteration < iterations:
        cost = _cost(residuals, bend)
        normal = _Normal(comparison, *box.parameters(z), states, residuals, bend)
        iteration += 1
        gained = 0.0
        while gained <= 0 and damping < MOST_DAMPING:
            new_z, new_x = normal.step(box, z, x, damping)
            new_states, new_residuals = _simulated(comparison, *box.parameters(new_z), new_x)
            gained = 1 - _cost(new_residuals, bend) / cost if cost > 0 else 0.0
            damping *= EASIER if gained > 0 else HARDER
        if gained > 0:
            z, x, states, residuals = new_z, new_x, new_states, new_residuals
        settled = gained * cost <= tolerance * max(cost, least)
        converged = settled and normal.complete
        damping = max(damping, LEAST_DAMPING)
        if settled and not bend_is_final:
            # The median by which segments count is now that of a fit, no longer that of the start.
            bend, bend_is_final, settled, converged = _bend(residuals), True, False, False
            damping = min(damping, DAMPING)
        if progress is not None:
            progress(_cost(residuals, bend))
    if normal is None or not converged:
        normal = _Normal(comparison, *box.parameters(z), states, residuals, bend)
    # Converged, a last step that gained next to nothing leaves the equations before it as good as those after it.
    informations, slopes = normal.condensed(LEAST_DAMPING)
    return Fit(
        *box.parameters(z),
        initial=x,
        costs=np.asarray((residuals**2).sum(axis=1)),
        free=~box.blocked(z, -box.slope(z).T @ slopes.sum(axis=0)[:-2]),
        informations=informations,
        slopes=slopes,
        iterations=iteration,
        converged=converged,
    )


def _simulated(comparison: Comparison, theta: Array, delay: float, x: Array) -> tuple[Array, Array]:
    """Return simulated states and residuals, which are finite: a motion beyond floats is lost."""
    states = comparison.segments.roll(theta, x)
    residuals, lost = comparison.residuals(states, delay), comparison.lost
    return states, np.clip(np.where(np.isfinite(residuals), residuals, lost), -lost, lost)


def _bend(residuals: Array) -> float:
    return BEND * float(np.median(np.sqrt((residuals**2).sum(axis=1))))


def _cost(residuals: Array, bend: float) -> float:
    """Return the sum over segments of their sums of squares c up to bend^2, and beyond 2 bend sqrt(c) - bend^2."""
    if bend == np.inf:
        return float((residuals**2).sum())
    size = np.sqrt((residuals**2).sum(axis=1))
    return float(np.where(size <= bend, size**2, bend * (2 * size - bend)).sum())


class _Box:
    """Global unknowns z in which every constraint is a bound: P3 moves as the fraction rho = P3 / sqrt(P1 P2)."""

    def __init__(self, bounds: Bounds, delay_bounds: tuple[float, float], fixed: bool) -> None:
        self._lower = np.append(bounds.lower, delay_bounds[0])
        self._upper = np.append(bounds.upper, delay_bounds[1])
        self._lower[:2] = np.maximum(self._lower[:2], LEAST_INERTIA * self._upper[:2])
        self._fixed = fixed

    def start(self, theta: Array, delay: float) -> Array:
        z = np.append(theta, delay)
        z[:2] = np.clip(z[:2], self._lower[:2], self._upper[:2])
        z[2] /= np.sqrt(z[0] * z[1])
        return self.inside(z)

    def parameters(self, z: Array) -> tuple[Array, float]:
        theta = z[:-1].copy()
        theta[2] *= np.sqrt(z[0] * z[1])
        return theta, float(z[-1])

    def slope(self, z: Array) -> Array:
        """Return the derivative of theta and delay by z, shape (G, G)."""
        root = np.sqrt(z[0] * z[1])
        result = np.eye(len(z))
        # Where P3 itself is held, it does not go with P1 and P2.
        along = 0.0 if self._lower[2] == self._upper[2] else z[2] * root / 2
        result[2, :3] = along / z[0], along / z[1], root
        return result

    def inside(self, z: Array) -> Array:
        return np.clip(z, *self._bounds(z))

    def blocked(self, z: Array, direction: Array) -> Flags:
        """Tell what lies on a bound and would be led beyond it, and what cannot move at all, shape (G,)."""
        lower, upper = self._bounds(z)
        margin = 1e-9 * (upper - lower)
        below, above = (z <= lower + margin) & (direction < 0), (z >= upper - margin) & (direction > 0)
        return np.asarray(below | above | (lower >= upper) | self._fixed)

    def _bounds(self, z: Array) -> tuple[Array, Array]:
        lower, upper = self._lower.copy(), self._upper.copy()
        root = np.sqrt(np.prod(np.clip(z[:2], lower[:2], upper[:2])))
        lower[2], upper[2] = np.clip([lower[2] / root, upper[2] / root], -LARGEST_COUPLING, LARGEST_COUPLING)
        return lower, upper


class _Normal:
    """The Gauss-Newton equations at a point: of each segment's initial state (4), the rest (G + 2), and both.

    The rest is the global unknowns and both zeros of the segment's recording, which are held.
    """

    def __init__(
        self, comparison: Comparison, theta: Array, delay: float, states: Array, residuals: Array, bend: float
    ) -> None:
        jacobian = comparison.jacobian(theta, states, delay)
        transposed = jacobian.transpose(0, 2, 1)
        matrix, gradient = transposed @ jacobian, (transposed @ residuals[:, :, None])[:, :, 0]
        # A motion whose sensitivities are beyond floats, though it is not, says nothing of where to go.
        lost = ~np.isfinite(matrix).all(axis=(1, 2)) | (np.abs(residuals) >= comparison.lost).any(axis=1)
        self.complete = not lost.any()
        matrix[lost], gradient[lost] = 0.0, 0.0
        weights = np.minimum(1.0, bend / np.maximum(np.sqrt((residuals**2).sum(axis=1)), 1e-300))
        matrix, gradient = matrix * weights[:, None, None], gradient * weights[:, None]
        self._local, self._mixed, self._shared = matrix[:, :4, :4], matrix[:, :4, 4:], matrix[:, 4:, 4:]
        self._local_gradient, self._gradient = gradient[:, :4], gradient[:, 4:]

    def condensed(self, damping: float) -> tuple[Array, Array]:
        """Return informations, shape (L, G + 2, G + 2), and slopes, shape (L, G + 2)."""
        gain, rest = self._local_answer(damping)
        back = self._mixed.transpose(0, 2, 1)
        return self._shared - back @ gain, self._gradient - (back @ rest[:, :, None])[:, :, 0]

    def step(self, box: _Box, z: Array, x: Array, damping: float) -> tuple[Array, Array]:
        """Return the end of the step in which global unknowns and initial states are damped: new z and x."""
        information, slope = (part.sum(axis=0) for part in self.condensed(damping))
        turn = box.slope(z)
        information, slope = turn.T @ information[:-2, :-2] @ turn, turn.T @ slope[:-2]
        weight = np.diag(turn.T @ self._shared.sum(axis=0)[:-2, :-2] @ turn)
        information[np.diag_indices_from(information)] += damping * np.where(weight > 0, weight, 1.0)
        step, free = np.zeros_like(z), ~box.blocked(z, -slope)
        while free.any():
            step[:] = 0.0
            scale = np.sqrt(np.diag(information)[free])
            scaled = information[np.ix_(free, free)] / scale / scale[:, None]
            step[free] = -np.linalg.lstsq(scaled, slope[free] / scale, rcond=None)[0] / scale
            leaving = free & box.blocked(z, step)
            if not leaving.any():
                break
            free &= ~leaving
        new_z = box.inside(z + step)
        moved = np.append(*box.parameters(new_z)) - np.append(*box.parameters(z))
        gain, rest = self._local_answer(damping)
        return new_z, x - (rest + gain[:, :, :-2] @ moved).T

    def _local_answer(self, damping: float) -> tuple[Array, Array]:
        """Return how the initial states follow the rest, (L, 4, G + 2), and their own step, (L, 4)."""
        local = self._local + (damping * self._local + 1e-300) * np.eye(4)
        answer = np.linalg.solve(local, np.concatenate([self._mixed, self._local_gradient[:, :, None]], axis=2))
        return answer[:, :, :-1], answer[:, :, -1]
