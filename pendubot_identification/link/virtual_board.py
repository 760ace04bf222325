# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The board's side of the protocol with a simulated pendubot, and faults on request.

The simulation advances by one sample period per call, with bytes in and bytes out; the seed determines all randomness.
"""

import math
from dataclasses import asdict, dataclass

import numpy as np

from pendubot_identification.errors import ParameterError
from pendubot_identification.model.parameters import Parameters
from pendubot_identification.model.simulation import HANGING, Plant

from .clock import WRAP
from .limits import LimitMonitor
from .protocol import Arm, Command, Damaged, Decoder, Hello, HelloRequest, Limits, Message, Mode, State, Status, encode

#: A motor with 0.1 N m/A on a 24 V supply: reported only, not part of the simulation.
_MILLIAMPERE_PER_MICRO_NM = 0.01
_TORQUE_CONSTANT = 100_000
_VBUS_10MV = 2400

#: Limits for the paper's rig: about ten turns of the shoulder, twice its gravity torque, 1.5 N m continuous torque.
LIMITS = Limits(
    torque_slew=1_000_000,
    max_speed=100_000,
    max_travel1=60_000,
    max_travel2=300_000,
    stall_torque=500_000,
    stall_ms=500,
    continuous_ma=15_000,
    overload_ms=2000,
    max_vbus=3000,
)


@dataclass(frozen=True, slots=True)
class BoardSettings:
    """Properties of a virtual board. Raises ParameterError: a value outside its range."""

    counts: int = 4000  #: Encoder counts per turn, both joints.
    torque_limit: float = 2.0  #: Largest torque [N m]; commands are clamped to it.
    sample_period_us: int = 10_000
    watchdog_max_ms: int = 500  #: Longest validity of a command [ms].
    clock_start_us: int = 0  #: Clock at the start [us], for example shortly before its wrap; a reset restarts it at 0.
    limits: Limits = LIMITS

    def __post_init__(self) -> None:
        _expect('counts', self.counts, 4, 1 << 24)
        _expect('torque_limit', self.torque_limit, 0, 300)
        for name, value in self.limits._asdict().items():
            short = name in ('stall_ms', 'continuous_ma', 'overload_ms', 'max_vbus')
            _expect(name, value, 0, 65535 if short else 0xFFFFFFFF)


@dataclass(frozen=True, slots=True)
class Faults:
    """Simulated faults: probabilities per frame or sample, and times after the start [s].

    Raises:
        ParameterError: a probability outside 0 to 1, or a time below 0.
    """

    bit_flip: float = 0.0  #: Probability of a flipped bit in a frame to the host.
    glitch: float = 0.0  #: Probability of a shoulder sample that is half a turn off.
    reset_at: float = math.inf  #: Time of a restart of the board.
    stuck_at: float = math.inf  #: Time from which the shoulder's encoder stands still.

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            _expect(name, value, 0, math.inf if name.endswith('_at') else 1)


def _expect(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise ParameterError(f'{name} is {value:g}; a number from {low:g} to {high:g} is expected')


class VirtualBoard:
    """A virtual board that applies its torque to a simulated plant, sample by sample.

    Args:
        seed: seed of the boot_id and the faults.
        held: whether the plant is fixed in its initial position until the motor is first armed.

    Attributes:
        last: the last sample without transmission faults; None before the first.
        armed: whether the motor is armed.
        present: status bits of present faults that the simulation lacks, such as an over-current.
    """

    def __init__(
        self,
        plant: Plant,
        settings: BoardSettings | None = None,
        faults: Faults | None = None,
        seed: int = 0,
        held: bool = False,
    ) -> None:
        self.settings = settings or BoardSettings()
        self.last: State | None = None
        self._plant, self._bare = plant, plant.parameters
        self._due: Parameters | None = None
        self._faults = faults or Faults()
        self._reset_us = self._faults.reset_at * 1e6
        self.present = 0
        self._rng = np.random.default_rng(seed)
        self._elapsed_us = 0
        self._origin = (0, 0)
        self._held = held
        self._first: bytes
        self._boot(1, self.settings.clock_start_us)

    def receive(self, data: bytes) -> None:
        """Process bytes from the host; commands take effect at the next sample."""
        for event in self._decoder.feed(data):
            if isinstance(event, Damaged):
                self._notes |= Status.DAMAGED_FRAME
            elif isinstance(event, HelloRequest):
                self._hellos_due += 1
            elif isinstance(event, Command):
                self._obey(event)
            elif isinstance(event, Arm):
                self._arm(event)

    def carry(self, payload: float) -> None:
        """Replace the payload [kg] on link 2, 0 for none, at the next :meth:`move`. Callable from any thread.

        Raises:
            ParameterError: the plant cannot carry the payload.
        """
        self._due = self._bare.carrying(payload)

    def note_overrun(self) -> None:
        """Set the overrun bit in the next STATE, because bytes could not be sent."""
        self._notes |= Status.OVERRUN

    def sample(self) -> bytes:
        """Take one sample; return the bytes for the host. Call :meth:`move` before the next sample."""
        if self._elapsed_us >= self._reset_us:
            self._origin, self._reset_us = self._encoders(), math.inf
            self._boot(2)
        # The delimiter ends a frame that a restart truncated, so that the first frame is not lost.
        out, self._first = self._first, b''
        while self._hellos_due:
            self._hellos_due -= 1
            out += self._transmit(self._hello())
        self.last = state = self._state()
        if self._chance(self._faults.glitch):
            state = state._replace(enc1=state.enc1 + self.settings.counts // 2)
        return out + self._transmit(state)

    def move(self, late_us: int = 0) -> None:
        """Move the plant until the next sample, which is ``late_us`` late."""
        due, self._due = self._due, None
        if due is not None:
            self._plant.become(due)
        self._held = self._held and not self.armed
        elapsed_us = self.settings.sample_period_us + late_us
        if not self._held and self.last is not None:
            self._plant.advance((self.last.torque / 1e6, 0.0), elapsed_us * 1e-6)
        self._clock_us += elapsed_us
        self._elapsed_us += elapsed_us

    def _boot(self, reset_cause: int, clock_us: int = 0) -> None:
        self._decoder = Decoder(accept=(Command, HelloRequest, Arm))
        self._boot_id = int(self._rng.integers(1, WRAP))
        self._reset_cause = reset_cause
        self._clock_us = clock_us
        self._seq = 0
        self._cmd_seq = 0
        self.armed = False
        self._session = 0
        self._lock = 1
        self._refused = 0
        self._zeroed = False
        self._stuck: int | None = None
        self._latched = 0  # status bits of the disarming's cause, until a mode 0 or the next arming
        self._stopped = 0  # the emergency stop bit, from the press on
        self._wanted = 0
        self._applied = 0  # until the next sample
        self._slewed = 0  # last torque of the slew rate limiter; a disarming sets it to 0
        self._holds_until_us = 0
        self._sampled_us: int | None = None
        self._monitor = LimitMonitor(self.settings.limits, (self.settings.counts,) * 2)
        self._exceeded = 0
        self._notes = 0
        self._hellos_due = 1
        self._first = b'\0'

    def _obey(self, command: Command) -> None:
        if command.mode == Mode.DISARM:
            self._disarm(0)
            self._latched = 0
            self._cmd_seq = command.seq
        elif command.mode == Mode.CONFIRM_ZEROS:
            self._zeroed |= command.session == self._boot_id
        elif command.mode == Mode.TORQUE and (command.session != self._session or not self._session):
            self._refuse()
        elif command.mode == Mode.TORQUE and self.armed and not self._standing_faults():
            self._wanted = command.torque
            self._hold(command)

    def _arm(self, request: Arm) -> None:
        if self.armed and request.session == self._session:
            return  # the same request once more
        fits = (request.boot_id, request.lock) == (self._boot_id, self._lock) and request.session
        if not fits or self.armed or self._standing_faults():
            self._refuse()
            return
        self.armed = True
        self._session = request.session
        self._wanted = 0
        self._latched = 0
        self._hold(request)

    def _hold(self, request: Command | Arm) -> None:
        self._holds_until_us = self._clock_us + 1000 * min(request.watchdog_ms, self.settings.watchdog_max_ms)
        self._cmd_seq = request.seq

    def _disarm(self, reason: int) -> None:
        """Switch off; this invalidates earlier ARMs."""
        self._latched |= reason
        self._lock = (self._lock + 1) & 0xFFFF
        self.armed = False
        self._wanted = self._slewed = 0

    def _refuse(self) -> None:
        self._refused = (self._refused + 1) & 0xFFFF
        self._notes |= Status.REFUSED

    def _standing_faults(self) -> int:
        self._stopped |= self.present & Status.EMERGENCY_STOP
        return self.present | self._exceeded | self._stopped

    def _state(self) -> State:
        period = self.settings.sample_period_us
        elapsed = period if self._sampled_us is None else self._clock_us - self._sampled_us
        self._sampled_us = self._clock_us
        enc1, enc2 = (now - then for now, then in zip(self._encoders(), self._origin, strict=True))
        if self._elapsed_us >= self._faults.stuck_at * 1e6:
            self._stuck = enc1 = enc1 if self._stuck is None else self._stuck
        current = max(-32768, min(32767, round(self._applied * _MILLIAMPERE_PER_MICRO_NM)))
        seq, t_us = self._next_seq(), self._clock_us % WRAP
        measured = State(seq, t_us, enc1, enc2, 0, current, _VBUS_10MV, self._cmd_seq, 0)
        self._exceeded = self._monitor.check(measured, elapsed, self._applied)
        faults = self._standing_faults()
        if self.armed and faults:
            # Disarm, because an intermittent fault would otherwise leave the motor on in between.
            self._disarm(faults)
        elif self.armed and self._clock_us >= self._holds_until_us:
            self._disarm(Status.WATCHDOG)
        limit = round(self.settings.torque_limit * 1e6)
        allowed = max(-limit, min(limit, self._wanted))
        step = self.settings.limits.torque_slew * period // 1000
        slewed = max(self._slewed - step, min(self._slewed + step, allowed))
        torque = slewed if self.settings.limits.torque_slew else allowed
        self._applied = self._slewed = torque
        status = faults | self._latched | self._notes
        status |= Status.ARMED if self.armed else 0
        status |= Status.SATURATED if allowed != self._wanted else 0
        status |= Status.SLEW if torque != allowed else 0
        status |= Status.LATE if 2 * elapsed > 3 * period else 0
        status |= Status.ZEROED if self._zeroed else 0
        self._notes = 0
        return measured._replace(torque=torque, status=status, lock=self._lock, refused=self._refused)

    def _encoders(self) -> tuple[int, int]:
        """Return the encoder counts, 0 while both links hang."""
        per_radian = self.settings.counts / (2 * math.pi)
        first, second = (round((q - hanging) * per_radian) for q, hanging in zip(self._plant.q, HANGING, strict=True))
        return first, second

    def _hello(self) -> Hello:
        s, seq, t_us = self.settings, self._next_seq(), self._clock_us % WRAP
        scales = s.counts, s.counts, round(s.torque_limit * 1e6), s.sample_period_us
        boot = self._boot_id, self._reset_cause, 0, s.watchdog_max_ms
        return Hello(seq, t_us, *boot, *scales, 0, 0, _TORQUE_CONSTANT, s.limits, 'virtual')

    def _next_seq(self) -> int:
        seq, self._seq = self._seq, (self._seq + 1) & 0xFFFF
        return seq

    def _chance(self, probability: float) -> bool:
        return probability > 0.0 and bool(self._rng.random() < probability)

    def _transmit(self, message: Message) -> bytes:
        data = bytearray(encode(message))
        if self._chance(self._faults.bit_flip):
            bit = int(self._rng.integers(8 * len(data)))
            data[bit // 8] ^= 1 << bit % 8
        return bytes(data)
