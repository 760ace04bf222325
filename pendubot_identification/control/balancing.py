# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What a balancer decides, without ROS: from parameters and samples to a rig that is held upright, and to its end.

It prepares itself by a design and a closed-loop simulation, moves only between :meth:`Balancing.armed` and the first
doubt, and never begins again on its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from pendubot_identification.errors import ControlError, PendubotError
from pendubot_identification.level import Level
from pendubot_identification.model.dynamics import Pair
from pendubot_identification.model.parameters import Parameters

from .closed_loop import deviation, sufficient_limit, swing_up_time
from .control import Controller, Design, Limits, Loop, Mode
from .readiness import Readiness

#: Margins below these are too little for a real rig: factor of the gain, and delay [s], of which a computer that does
#: other things, too, takes as much now and then.
GAIN, DELAY = 1.15, 0.001
#: The bridge has to answer within this [s] whether it is armed.
PATIENCE = 3.0
#: Held within this of upright at rest [rad], it is caught without a swing-up.
NEAR = 0.3


class Phase(Enum):
    """How far it is."""

    IDLE = 'idle'
    ARMING = 'arming'
    RUNNING = 'running'


@dataclass(frozen=True, slots=True)
class Plan:
    """What was prepared for: a design, and how its closed-loop simulation went.

    Attributes:
        design: from the parameters.
        loop: for which it was made.
        swing_up: after how long the rig is upright, in simulation [s]; infinite where it never is, NaN where that was
            not simulated.
        sufficient: a torque limit [N m] with which it would be.
    """

    design: Design
    loop: Loop
    swing_up: float = math.nan
    sufficient: float = math.nan

    @classmethod
    def make(cls, parameters: Parameters, loop: Loop, simulate_closed_loop: bool = True) -> Plan:
        """Design, and simulate the closed loop if wanted, which takes a second or some.

        Raises:
            ControlError: there is no such controller, or it would have no room for error.
        """
        design = Design.make(parameters, loop)
        m = design.margins
        if m.gain_up < GAIN or m.gain_down > 1 / GAIN or m.delay < DELAY:
            raise ControlError(
                f'this rig can hardly be balanced: the gain may be {m.gain_down:.2f} to {m.gain_up:.2f} times what is '
                f'thought and the delay {1e3 * m.delay:.2g} ms longer, and {1 / GAIN:.2f} to {GAIN:.2f} and '
                f'{1e3 * DELAY:g} ms are needed; sample faster, shorten the delay of {1e3 * loop.delay:.3g} ms, or '
                'build a longer link 1'
            )
        if not simulate_closed_loop:
            return cls(design, loop)
        swing_up = swing_up_time(design, loop)
        sufficient = math.nan if math.isfinite(swing_up) else sufficient_limit(design, loop)
        return cls(design, loop, swing_up, sufficient)

    @property
    def simulated(self) -> bool:
        """Whether the swing-up was tried in simulation, well or not."""
        return not math.isnan(self.swing_up)

    def summary(self) -> str:
        """Say what is to be expected."""
        m = self.design.margins
        text = (
            f'gain may be {m.gain_down:.2f} to {m.gain_up:.2f} times what is thought, the phase margin is '
            f'{math.degrees(m.phase):.0f} degrees, the delay margin {1e3 * m.delay:.0f} ms beside '
            f'{1e3 * self.loop.delay:.0f} ms of dead time'
        )
        if math.isfinite(self.swing_up):
            return f'{text}; in simulation it is upright {self.swing_up:.1f} s after hanging'
        return f'{text}; {self.obstacle()}' if self.simulated else text

    def obstacle(self) -> str:
        """Say why there is no swing-up."""
        enough = f'{self.sufficient:.2g} N m would do' if math.isfinite(self.sufficient) else 'neither would more'
        return f'{self.loop.limit:g} N m do not swing this rig up, as a simulation shows; {enough}'


class Balancing:
    """All that a balancer knows and decides.

    Args:
        limit: largest torque that the user allows [N m].
        motor_delay: see :class:`.readiness.Readiness`.
        bounds: where to give up.

    Attributes:
        readiness: what came in.
        phase: how far it is.
        plan: what it is prepared for; None before. While it is idle, always one that was simulated.
        obstacle: why it cannot begin; empty where it can.
        stopped: why it stopped last; empty where it did not or was told to.
    """

    def __init__(self, limit: float, motor_delay: float | None = None, bounds: Limits | None = None) -> None:
        self.readiness = Readiness(limit, motor_delay)
        self.phase = Phase.IDLE
        self.plan: Plan | None = None
        self.obstacle = ''
        self.stopped = ''
        self._bounds = bounds or Limits()
        self._controller: Controller | None = None
        self._coming: Plan | None = None
        self._refused: tuple[Parameters, Loop] | None = None
        self._q: Pair | None = None
        self._heard = self._looked = -math.inf
        self._upright_since: float | None = None
        self._arming_since: float | None = None

    # Preparing

    def to_prepare(self, accept_warn: bool) -> tuple[Parameters, Loop] | None:
        """Return for what it has to be prepared, where it is not yet."""
        try:
            wanted = self.readiness.ready(accept_warn)
        except ControlError as error:
            self.obstacle = str(error)
            if self.phase is Phase.IDLE:
                self.plan = None
            return None
        plan = self._coming or self.plan
        if wanted == self._refused or (plan is not None and wanted == (plan.design.parameters, plan.loop)):
            return None
        if self.phase is not Phase.IDLE and plan is not None:
            # What the loop is like is settled as long as it moves.
            return None if wanted[0] == plan.design.parameters else (wanted[0], plan.loop)
        return wanted

    def prepared(self, plan: Plan) -> None:
        """Take a plan; a controller that runs goes on with it from its next sample.

        Where it is idle, one that was not simulated is of no use: it was made for a motion that has ended meanwhile.
        """
        self._refused, self.obstacle = None, ''
        if self.phase is not Phase.IDLE:
            self._coming = plan
        elif plan.simulated:
            self.plan = plan

    def not_prepared(self, wanted: tuple[Parameters, Loop], reason: str) -> None:
        """Take note that there is no plan for what was wanted."""
        self._refused, self.obstacle = wanted, reason
        if self.phase is Phase.IDLE:
            self.plan = None

    # Moving

    def begin(self) -> None:
        """Begin to arm.

        Raises:
            ControlError: it is not prepared, or cannot swing up and is not near upright.
        """
        if self.phase is not Phase.IDLE:
            raise ControlError(f'it is {self.phase.value} already')
        if self.plan is None or self._q is None:
            raise ControlError(self.obstacle or 'it is preparing itself; try again in a moment')
        near = float(deviation(np.array([self._q]))[0]) < NEAR
        if not near and self.plan.swing_up == math.inf:
            raise ControlError(f'{self.plan.obstacle()}; hold it upright and start again to balance only')
        if not near and not self._bounds.swing_up:
            raise ControlError('swing_up_time is 0; hold it upright, then start again')
        self.phase, self.stopped, self._arming_since = Phase.ARMING, '', None

    def armed(self) -> None:
        """Move from the next sample on."""
        assert self.plan is not None, 'begin() has seen to that'
        self._controller = Controller(self.plan.design, self.plan.loop, self._bounds)
        self._coming, self._upright_since = None, None
        self.phase = Phase.RUNNING

    def stop(self, reason: str = '') -> None:
        """Be idle from now on; ``reason`` is what was wrong, if anything was."""
        self.phase, self.stopped, self._controller = Phase.IDLE, reason, None
        # What came while it moved is looked at anew, as anything before a start.
        self._coming = self._refused = None
        if self.plan is not None and not self.plan.simulated:
            self.plan = None

    def sample(self, t: float, now: float, q: Pair, effort: float, max_age: float) -> float | None:
        """Take a sample; return the torque [N m] that answers it, or None where it is idle.

        Args:
            t: when it was taken [s].
            now: when it was heard [s].
            q: positions [rad].
            effort: torque that is applied from it on [N m].
            max_age: the oldest that is answered [s].

        Raises:
            ControlError: it has stopped; command zero torque and disarm.
        """
        self.silence(now, max_age)
        self.readiness.sample(t)
        self._q, self._heard = q, now
        if self.phase is Phase.IDLE:
            return None
        try:
            if self._controller is None:
                return self._still_arming(t)
            if not now - t <= max_age:
                raise ControlError(f'a sample is {now - t:.3f} s old; at most {max_age:g} s are allowed')
            if self._coming is not None:
                self.plan, self._coming = self._coming, None
                self._controller.adopt(self.plan.design)
            torque = self._controller.step(t, q, effort)
        except ControlError as error:
            self.stop(str(error))
            raise
        if self._controller.mode is Mode.SWING_UP:
            self._upright_since = None
        elif self._upright_since is None:
            self._upright_since = t
        return torque

    def _still_arming(self, t: float) -> float:
        self._arming_since = self._arming_since or t
        if t - self._arming_since > PATIENCE:
            raise ControlError(f'the bridge did not answer within {PATIENCE:g} s whether it is armed; start again')
        return 0.0

    def silence(self, now: float, max_age: float) -> None:
        """Look whether samples come; to be called, samples or not, several times in ``max_age`` [s].

        Raises:
            ControlError: none has come for too long while it moved; it has stopped.
        """
        paused, self._looked = now - self._looked > max_age, now
        if self.phase is Phase.RUNNING and now - self._heard > max_age:
            why = 'the machine paused' if paused else 'look at the bridge'
            self.stop(f'no sample for {now - self._heard:.3f} s: {why}')
            raise ControlError(self.stopped)

    def offer(self, theta: list[float]) -> None:
        """Take a parameter vector.

        Raises:
            ControlError: it is none that a rig can have. Whatever moved has stopped.
        """
        try:
            self.readiness.offer(theta)
        except PendubotError as error:
            self.stop(str(error))
            raise ControlError(str(error)) from error

    # Telling

    def diagnosis(self) -> tuple[Level, str, dict[str, str]]:
        """Return how things stand: a level, a sentence, and figures by name."""
        values = {'phase': self.phase.value, 'mode': 'none'}
        if self._controller is not None:
            values['mode'] = self._controller.mode.value
            values['balancing for [s]'] = f'{self._heard - (self._upright_since or self._heard):.1f}'
            values['transport [samples]'] = str(self._controller.transport)
        if self.plan is not None:
            m, loop = self.plan.design.margins, self.plan.loop
            values |= {
                'period [s]': f'{loop.period:g}',
                'dead time [s]': f'{loop.delay:.4f}',
                'torque limit [N m]': f'{loop.limit:g}',
                'gain margin down': f'{m.gain_down:.3f}',
                'gain margin up': f'{m.gain_up:.3f}',
                'phase margin [deg]': f'{math.degrees(m.phase):.1f}',
                'delay margin [s]': f'{m.delay:.4f}',
                'swing-up in simulation [s]': f'{self.plan.swing_up:.2f}',
            }
        if self.stopped:
            return Level.ERROR, f'stopped: {self.stopped}', values
        if self.phase is Phase.IDLE:
            waiting = self.obstacle or ('' if self.plan else 'it is preparing itself')
            return (Level.WARN, f'waiting: {waiting}', values) if waiting else (Level.OK, 'ready', values)
        return Level.OK, values['mode'] if self._controller else self.phase.value, values
