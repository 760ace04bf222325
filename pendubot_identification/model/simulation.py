# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A simulated pendubot: its state carried on under torques that are held, and whole simulated trajectories."""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pendubot_identification.arrays import Array
from pendubot_identification.errors import ParameterError, TrajectoryError
from pendubot_identification.trajectories.trajectory import Trajectory

from .dynamics import GRAVITY, SIGN_WIDTH, Pair
from .parameters import Parameters
from .rollout import advance

#: Positions [rad] when hanging.
HANGING: Pair = (-math.pi / 2, 0.0)


@dataclass(frozen=True, slots=True)
class StepSettings:
    """The Runge-Kutta step: its error stays far below one encoder count."""

    longest: float = 1e-3  #: Longest step [s].
    of_swing: float = 0.03  #: Longest step, over the period of the highest frequency [rad/s] of the rig.
    of_decay: float = 0.25  #: Longest step, over the time constant of the highest rate [1/s] of friction.
    stable: float = 2.5  #: Longest step of a coarse simulation, over that time constant: beyond 2.78 it oscillates.
    finest: int = 20  #: Most parts into which a step of a coarse simulation is divided.


SETTINGS = StepSettings()


class Plant:
    """A pendubot at positions q [rad] and velocities qd [rad/s] that moves by intervals of constant torque.

    Raises:
        ParameterError: the parameters are not physical.
    """

    def __init__(self, parameters: Parameters, q: Pair = HANGING, qd: Pair = (0.0, 0.0)) -> None:
        self.become(parameters)
        self._state: tuple[float, ...] = (*q, *qd)

    def become(self, parameters: Parameters) -> None:
        """Go on with other parameters, from the same positions and velocities.

        Raises:
            ParameterError: the parameters are not physical.
        """
        if problems := parameters.unphysical():
            raise ParameterError(f'no rig moves like this: {problems[0]}; give the parameters of a real one')
        self.parameters = parameters
        self._theta = tuple(float(value) for value in parameters.vector())
        self._swing_rate, self._friction_rate, self._load_rate = _step_rates(parameters)

    @property
    def q(self) -> Pair:
        """Joint positions [rad]."""
        return self._state[0], self._state[1]

    @property
    def qd(self) -> Pair:
        """Joint velocities [rad/s]."""
        return self._state[2], self._state[3]

    def place(self, q: Pair, qd: Pair) -> None:
        """Set positions [rad] and velocities [rad/s]."""
        self._state = (*q, *qd)

    def advance(self, tau: Pair, duration: float) -> None:
        """Move on by ``duration`` [s] under constant torques [N m]."""
        friction = self._friction_rate + self._load_rate[0] * abs(tau[0]) + self._load_rate[1] * abs(tau[1])
        steps = max(1, math.ceil(duration * max(self._swing_rate, friction) - 1e-9))
        h = duration / steps
        for _ in range(steps):
            self._state = advance(self._theta, self._state, tau, h, math)


class LatePlant(Plant):
    """A pendubot whose motor obeys late: a torque acts ``delay`` [s] after it was applied, for as long as it was."""

    def __init__(self, parameters: Parameters, delay: float, q: Pair = HANGING, qd: Pair = (0.0, 0.0)) -> None:
        super().__init__(parameters, q, qd)
        self._waiting = deque([((0.0, 0.0), delay)])

    def advance(self, tau: Pair, duration: float) -> None:
        """Move on by ``duration`` [s] under what was applied a delay ago; ``tau`` [N m] acts after the delay."""
        self._waiting.append((tau, duration))
        while duration > 1e-12:
            then, left = self._waiting.popleft()
            part = min(left, duration)
            if part > 1e-12:
                super().advance(then, part)
            duration -= part
            if left - part > 1e-12:
                self._waiting.appendleft((then, left - part))

    def ahead(self, torques: Iterable[Pair], duration: float) -> tuple[Pair, Pair]:
        """Return q and qd when all applied torques, and these [N m] for a duration [s] each, have acted."""
        here = self._state
        for tau, left in (*self._waiting, *((tau, duration) for tau in torques)):
            if left > 1e-12:
                super().advance(tau, left)
        q, qd, self._state = self.q, self.qd, here
        return q, qd


def longest_step(parameters: Parameters, torque: float) -> float:
    """Return the longest step [s] with which :class:`Plant` simulates under shoulder torques up to this [N m]."""
    swing, friction, load = _step_rates(parameters)
    return 1 / max(swing, friction + load[0] * torque)


def substeps(parameters: Parameters, torques: Array, step: float) -> int:
    """Return into how many parts a Runge-Kutta step [s] is divided, so that it is stable under friction at rest.

    ``torques``: usual ones of both joints [N m], shape (2,).
    """
    if parameters.unphysical():
        return SETTINGS.finest
    _, friction, load = _step_rates(parameters)
    rate = SETTINGS.of_decay * (friction + load[0] * torques[0] + load[1] * torques[1])
    return math.ceil(min(max(step * float(rate) / SETTINGS.stable, 1.0), SETTINGS.finest))


def _step_rates(p: Parameters) -> tuple[float, float, Pair]:
    """Return how many steps a second the rig's swing needs, how many its friction, and how many more per N m of torque.

    No eigenvalue of the inverse of M(q) exceeds trace(M) / det(M), taken where q2 makes them largest and smallest.
    """
    m11, m22 = p.P1 + p.P2 + 2 * abs(p.P3), p.P2 + p.J2
    determinant = p.P1 * p.P2 - p.P3**2 + p.J2 * (p.P1 + p.P2 - 2 * abs(p.P3))
    swing = math.sqrt(GRAVITY * (abs(p.P4) + 2 * abs(p.P5)) * (m11 + m22) / determinant)
    shoulder, elbow = m22 / determinant / SETTINGS.of_decay, m11 / determinant / SETTINGS.of_decay
    # Dry friction is steepest at rest.
    slopes = p.b1 + (p.Fc1 + p.Fs1) / SIGN_WIDTH, p.b2 + (p.Fc2 + p.Fs2) / SIGN_WIDTH
    return (
        max(1 / SETTINGS.longest, swing / SETTINGS.of_swing),
        shoulder * slopes[0] + elbow * slopes[1],
        (shoulder * p.k1 / SIGN_WIDTH, elbow * p.k2 / SIGN_WIDTH),
    )


def simulate(
    parameters: Parameters, t: ArrayLike, tau: ArrayLike, q: Pair = HANGING, qd: Pair = (0.0, 0.0)
) -> Trajectory:
    """Return the motion from q [rad] and qd [rad/s] on at the times t [s], shape (N,), velocities included.

    Torques tau [N m], shape (N, 2), are held from sample to sample.

    Raises:
        ParameterError: the parameters are not physical.
        TrajectoryError: the simulation diverges.
    """
    times, torques = np.asarray(t, dtype=float), np.asarray(tau, dtype=float)
    plant = Plant(parameters, q, qd)
    states = np.empty((len(times), 4))
    states[:1] = (*q, *qd)
    for k, step in enumerate(np.diff(times)):
        try:
            plant.advance((float(torques[k, 0]), float(torques[k, 1])), float(step))
            followed = all(map(math.isfinite, (*plant.q, *plant.qd)))
        except (ValueError, OverflowError, ZeroDivisionError):
            followed = False
        if not followed:
            raise TrajectoryError(
                f'the simulated motion is too fast to be followed {times[k + 1] - times[0]:.3g} s after it began: '
                f'torques of up to {np.abs(torques).max():g} N m are too large for these parameters; give smaller ones'
            )
        states[k + 1] = (*plant.q, *plant.qd)
    return Trajectory(times, states[:, :2], torques, states[:, 2:], name='simulation')


def quantised(trajectory: Trajectory, counts_per_turn: int) -> Trajectory:
    """Return the trajectory as encoders with so many counts per turn, at 0 when hanging, read it; no velocities."""
    zero = np.array(HANGING)
    count = 2 * math.pi / counts_per_turn
    q = np.round((trajectory.q - zero) / count) * count + zero
    return Trajectory(trajectory.t, q, trajectory.tau, name=trajectory.name)
