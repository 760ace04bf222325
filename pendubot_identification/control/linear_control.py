# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Linear control of the upright pendubot: linearisation, sampling, discrete LQR and Kalman gains, and their margins.

Near upright x = (q - q*, q') [rad, rad/s] obeys x' = A x + B tau. The loop is sampled and has a dead time: the torque
computed from a sample acts D seconds after it. The regulator feeds back the state predicted D ahead, which is the LQR
of the plant augmented by its delay states (Artstein's reduction).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import bisect

from pendubot_identification.arrays import Array
from pendubot_identification.errors import ControlError
from pendubot_identification.model.dynamics import GRAVITY, acceleration_derivatives, mass_matrix
from pendubot_identification.model.parameters import Parameters


@dataclass(frozen=True, slots=True)
class ControlSettings:
    """Weights of the regulator, noise of the estimator, and the search for margins."""

    angle: float = 0.1  #: An angle off by this [rad] costs as much as ...
    #: ... this torque, a fraction of the rig's weight (P4 + P5) g: a smaller one uses less torque.
    torque: float = 0.06
    disturbance: float = 0.15  #: Standard deviation of the unmodelled torque, white at 100 Hz, likewise as a fraction.
    counts_per_turn: int = 4000  #: The quantization of the encoders is the measurement noise.
    largest_gain: float = 100.0  #: Largest gain ...
    longest_delay: float = 0.2  #: ... and longest added delay [s] up to which margins are looked for ...
    grid: int = 81  #: ... first on so many points.


SETTINGS = ControlSettings()
#: The output matrix: encoders measure positions.
_MEASURED = np.eye(2, 4)


def linearise(parameters: Parameters) -> tuple[Array, Array]:
    """Return A and B, each of shape (4, ...), of x' = A x + B tau upright; B of the torques of both joints.

    Dry friction is left out: at rest its slope is so steep that it would describe no motion of any size.
    """
    viscous = replace(parameters, Fc1=0.0, Fc2=0.0, Fs1=0.0, Fs2=0.0, k1=0.0, k2=0.0).vector()
    q, rest = np.array([[math.pi / 2], [0.0]]), np.zeros((2, 1))
    _, slopes = acceleration_derivatives(viscous, q, rest, rest)
    A = np.vstack([np.eye(2, 4, 2), slopes[:, :4, 0]])
    return A, np.vstack([np.zeros((2, 2)), np.linalg.inv(mass_matrix(parameters.vector(), q[:, 0]))])


def sampled(A: Array, B: Array, duration: float) -> tuple[Array, Array]:
    """Return the zero-order-hold model over ``duration`` [s]: Phi, shape (4, 4), and Gamma, of B's shape (4, M)."""
    states, inputs = B.shape
    both = expm(duration * np.vstack([np.hstack([A, B]), np.zeros((inputs, states + inputs))]))[:states]
    return both[:, :states], both[:, states:]


@dataclass(frozen=True, slots=True)
class Loop:
    """The sampled control loop: a torque computed from a sample is applied from the next one on."""

    period: float  #: Between samples [s].
    lag: float = 0.0  #: Delay of the motor behind the board's report [s].
    limit: float = 2.0  #: Largest torque [N m].

    @property
    def delay(self) -> float:
        """Dead time from a sample until the torque computed from it acts [s]."""
        return self.period + self.lag


@dataclass(frozen=True, slots=True)
class Design:
    """Regulator and estimator for a rig and a loop."""

    parameters: Parameters  #: Of the rig.
    theta: tuple[float, ...]  #: The same as plain numbers, which are faster.
    loop: Loop
    K: Array  #: Shape (4,); tau = -K x, x predicted over the dead time.
    L: Array  #: Shape (4, 2); Kalman gain of the positions' innovation.

    @classmethod
    def make(cls, parameters: Parameters, loop: Loop) -> Design:
        """Design the discrete LQR and the steady Kalman filter for physical parameters.

        Raises:
            ControlError: this controller is not for such a rig, or the motor cannot move it.
        """
        if parameters.P5 <= 0 or parameters.P3 <= 0:
            raise ControlError(
                f'link 2 has its centre of mass at the elbow or behind it (P3 = {parameters.P3:.3g}, P5 = '
                f'{parameters.P5:.3g}); this controller needs one that swings out: both above 0'
            )
        A, both = linearise(parameters)
        Phi, pushes = sampled(A, both, loop.period)
        Gamma = pushes[:, :1]
        weight = (parameters.P4 + parameters.P5) * GRAVITY
        Q, R = np.diag([1, 1, 0, 0]) / SETTINGS.angle**2, np.eye(1) / (SETTINGS.torque * weight) ** 2
        disturbance = pushes @ pushes.T * (SETTINGS.disturbance * weight) ** 2 * (0.01 / loop.period)
        noise = np.eye(2) * (2 * math.pi / SETTINGS.counts_per_turn) ** 2 / 12
        try:
            S = solve_discrete_are(Phi, Gamma, Q, R)
            covariance = solve_discrete_are(Phi.T, _MEASURED.T, disturbance, noise)
        except (np.linalg.LinAlgError, ValueError) as error:
            raise ControlError(
                'no controller can be designed for these parameters: the motor hardly moves what has to be balanced; '
                'identify the rig again'
            ) from error
        K = np.linalg.solve(Gamma.T @ S @ Gamma + R, Gamma.T @ S @ Phi)
        L = covariance @ _MEASURED.T @ np.linalg.inv(_MEASURED @ covariance @ _MEASURED.T + noise)
        return cls(parameters, tuple(map(float, parameters.vector())), loop, K[0], L)

    def torque(self, x: tuple[float, ...]) -> float:
        """Return the torque [N m] at a deviation from upright [rad, rad/s]."""
        a, b, c, d = self.K
        return -float(a * x[0] + b * x[1] + c * x[2] + d * x[3])


def closed_loop(design: Design, delay: float | None = None, rig: Parameters | None = None) -> tuple[Array, Array]:
    """Return two matrices F and M: F + g M takes the rig under the regulator over one period.

    It is stable when all eigenvalues have |z| < 1; g multiplies the torque on its way to the rig and, complex, turns
    the loop's phase.

    Args:
        design: of regulator and estimator.
        delay: the rig's dead time [s]; None: as designed.
        rig: its parameters; None: as designed.

    Returns:
        Shapes (8 + N, 8 + N): of the rig's x, its estimate before the measurement, and the torques of N samples.
    """
    loop, delay = design.loop, design.loop.delay if delay is None else delay
    Phi_own, own = _effects(rig or design.parameters, loop.period, delay, loop.period)
    Phi, assumed = _effects(design.parameters, loop.period, loop.delay, loop.period)
    ahead, pending = _effects(design.parameters, loop.period, loop.delay, loop.delay)
    past = max(map(len, (own, assumed, pending))) - 1
    own, assumed, pending = (np.pad(each, ((0, past + 1 - len(each)), (0, 0))) for each in (own, assumed, pending))
    state, estimate, torques = np.split(np.eye(8 + past), [4, 8])
    corrected = estimate + design.L @ _MEASURED @ (state - estimate)
    torque = -design.K @ (ahead @ corrected + pending[1:].T @ torques)
    torques = np.vstack([torque, torques])
    fixed = np.vstack([Phi_own @ state, Phi @ corrected + assumed.T @ torques, torques[:past]])
    moved = np.zeros_like(fixed)
    moved[:4] = own.T @ torques
    return fixed, moved


def _effects(rig: Parameters, period: float, delay: float, span: float) -> tuple[Array, Array]:
    """Return how the state moves over ``span`` [s] after a sample: transition, shape (4, 4), and effects of torques.

    Row j of the effects, shape (N, 4), belongs to the torque that was computed j samples before this one.
    """
    A, both = linearise(rig)
    effects = []
    for j in range(math.ceil(delay / period - 1e-9) + 1):
        begin, end = max(0.0, delay - j * period), min(span, delay - (j - 1) * period)
        effect = np.zeros(4)
        if end > begin:
            effect = (sampled(A, both[:, :1], span - end)[0] @ sampled(A, both[:, :1], end - begin)[1])[:, 0]
        effects.append(effect)
    return sampled(A, both[:, :1], span)[0], np.array(effects)


@dataclass(frozen=True, slots=True)
class Margins:
    """Stability margins: how far the rig may differ from the design, in one respect at a time."""

    gain_down: float  #: Smallest factor of the torque.
    gain_up: float  #: Largest factor of the torque.
    phase: float  #: [rad]
    delay: float  #: Dead time in addition to the designed one [s].


def margins(design: Design, rig: Parameters | None = None) -> Margins:
    """Return the margins of a design on the rig that it was designed for, or another one, by the closed loop's poles.

    Raises:
        ControlError: the loop is unstable.
    """
    loop, (fixed, moved) = design.loop, closed_loop(design, rig=rig)
    if _radius(fixed + moved) >= 1:
        raise ControlError(
            f'a sample every {1e3 * loop.period:g} ms and a dead time of {1e3 * loop.delay:.3g} ms are too slow to '
            'hold this rig upright; sample faster, or shorten the delay'
        )
    up = _edge(lambda power: fixed + math.exp(power) * moved, math.log(SETTINGS.largest_gain))
    down = _edge(lambda power: fixed + math.exp(-power) * moved, math.log(SETTINGS.largest_gain))
    phase = _edge(lambda angle: fixed + complex(math.cos(angle), -math.sin(angle)) * moved, math.pi)
    delay = _edge(lambda more: np.add(*closed_loop(design, loop.delay + more, rig)), SETTINGS.longest_delay)
    return Margins(math.exp(-down), math.exp(up), phase, delay)


def _radius(matrix: Array) -> float:
    """Return the largest size of an eigenvalue; a loop is stable below 1."""
    return float(abs(np.linalg.eigvals(matrix)).max())


def _edge(loop: Callable[[float], Array], furthest: float) -> float:
    """Return the largest value, at most ``furthest``, up to which a loop that is stable at 0 stays stable."""
    grid = np.linspace(0, furthest, SETTINGS.grid)
    outside = next((k for k in range(1, len(grid)) if _radius(loop(grid[k])) >= 1), None)
    if outside is None:
        return furthest
    return float(bisect(lambda at: _radius(loop(at)) - 1, grid[outside - 1], grid[outside], rtol=1e-6))
