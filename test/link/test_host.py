# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The host's rules, without a port or a clock.

Damaged frames and their exact counts, glitches of encoders and boards that reset under random losses are in
benchmarks/faults.
"""

import math
import struct
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.level import Level
from pendubot_identification.link.clock import MS, WRAP
from pendubot_identification.link.events import Armed, ArmingFailed, Report, Sample
from pendubot_identification.link.health import Health
from pendubot_identification.link.host import Host, HostConfig
from pendubot_identification.link.protocol import (
    Arm,
    Command,
    Decoder,
    Hello,
    HelloRequest,
    Limits,
    Mode,
    State,
    Status,
    encode,
    frame,
)
from pendubot_identification.link.virtual_board import BoardSettings, Faults, VirtualBoard
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import Plant

HELLO = Hello(0, 0, 77, 1, 500, 4000, 2000, 1_500_000, 10_000, 'test', limits=Limits(max_speed=100_000))
#: Of a rig whose zeros nobody has to confirm.
ASSUMED = HostConfig(confirm_zeros=False)


def only(events, kind):
    return [event for event in events if isinstance(event, kind)]


class Rig:
    """A host and a virtual board on a perfect cable, a sample every 10 ms; every event and frame is kept."""

    def __init__(self, config=None, settings=None, faults=None):
        self.host = Host(config or ASSUMED)
        self.board = VirtualBoard(Plant(PAPER), settings or BoardSettings(), faults)
        self.now = 10**12
        self.events = self.host.opened(self.now)
        self.commands = []
        self.heard = Decoder(accept=(Command, HelloRequest, Arm))
        self.connected = True

    def step(self, samples=1):
        """Let time pass; returns the events."""
        before = len(self.events)
        for _ in range(samples):
            self.deliver()
            data = self.board.advance()
            for _ in range(5):
                self.now += 2 * MS
                self.events += self.host.poll(self.now)
            if self.connected:
                self.events += self.host.receive(data, self.now)
        self.deliver()
        return self.events[before:]

    def deliver(self):
        data = self.host.data_to_send()
        self.commands += [(self.now, c) for c in self.heard.feed(data) if isinstance(c, (Command, Arm))]
        if self.connected:
            self.board.receive(data)

    def armed(self):
        self.step(3)
        self.events += self.host.arm(self.now)
        self.step(3)
        assert self.host.armed
        return self

    def effort(self, torque):
        events = self.host.effort(torque, self.now)
        self.events += events
        self.deliver()
        return events

    def reports(self, level=Level.WARN):
        return [event.text for event in only(self.events, Report) if event.level >= level]


class Wire:
    """A host alone, and frames made by hand."""

    def __init__(self, config=None, hello=HELLO):
        self.host = Host(config or ASSUMED)
        self.now = 10**12
        self.host.opened(self.now)
        if hello:
            self.hear(hello)

    def hear(self, message):
        return self.host.receive(encode(message), self.now)

    def state(self, seq, t_us, enc1=0, enc2=0, torque=0, status=0, cmd_seq=0, step=10 * MS, lock=1, refused=0):
        self.now += step
        return self.hear(State(seq, t_us, enc1, enc2, torque, 0, 2400, cmd_seq, status, lock, refused))

    def wait(self, ms):
        self.now += ms * MS
        return self.host.poll(self.now)

    def sent(self):
        return Decoder(accept=(Command, HelloRequest, Arm)).feed(self.host.data_to_send())


# Start


def test_hello_is_asked_for_every_200_ms_until_it_came_and_silence_is_reported_once():
    wire, asked, reports = Wire(hello=None), [], []
    for k in range(600):
        asked += [2 * k] * len(only(wire.sent(), HelloRequest))
        reports += [(2 * k, report.level) for report in wire.wait(2)]
    assert asked == [0, 200, 400, 600, 800, 1000]
    assert reports == [(998, Level.WARN)]
    wire.hear(HELLO)
    wire.sent()
    for _ in range(49):
        wire.wait(2)
    assert wire.sent() == []


@pytest.mark.parametrize(
    ('given', 'hello', 'q'),
    [
        ((0, 0), None, None),
        ((1000, 1000), None, (0.0, math.pi)),
        ((1000, 0), replace(HELLO, cpr1=0), (0.0, math.pi / 2)),
        ((0, 0), HELLO, (-3 * math.pi / 8, math.pi / 2)),
    ],
)
def test_samples_are_scaled_by_counts_per_turn_given_or_said_and_never_published_without(given, hello, q):
    wire = Wire(HostConfig(counts_per_turn=given), hello)
    samples = only(wire.state(1, 10_000, enc1=250, enc2=500), Sample)
    assert [sample.q for sample in samples] == ([] if q is None else [pytest.approx(q)])
    assert wire.host.counters.unscaled == (q is None)


def test_a_hello_that_makes_no_sense_is_reported_once_asked_for_again_and_changes_nothing():
    wire = Wire(hello=None)
    for k, (change, text) in enumerate([({'cpr1': 0}, '0 counts'), ({'cpr1': 0}, None), ({'torque_limit': -5}, '-5')]):
        reports = only(wire.hear(replace(HELLO, seq=k, **change)), Report)
        assert [(r.level, text in r.text) for r in reports] == ([(Level.ERROR, True)] if text else [])
        assert wire.host.condition(0).level == Level.ERROR
    wire.sent()
    for k in range(3, 24):
        wire.state(k, 10_000 * k)
        wire.wait(0)
    assert len(wire.sent()) == 1
    wire.hear(good := replace(HELLO, seq=24))
    assert wire.hear(replace(HELLO, seq=25)) == [], 'it introduces itself once'
    (report,) = wire.hear(replace(HELLO, seq=26, cpr2=0))
    assert 'counts per turn' in report.text
    assert replace(wire.host.hello, seq=24) == good
    assert len(only(wire.state(27, 270_000), Sample)) == 1
    (report,) = wire.hear(replace(HELLO, seq=28, cpr1=8000))
    assert '8000' in report.text


# Published


def test_positions_velocities_and_effort():
    wire = Wire(HostConfig(sign=(1, -1), zero=(0.5, 0.25)))
    wire.state(1, 10_000)
    noted = Status.DAMAGED_FRAME | Status.OVERRUN
    (sample,) = only(wire.state(2, 20_000, enc1=40, enc2=10, torque=-250_000, status=noted), Sample)
    assert (wire.host.counters.board_damaged, wire.host.counters.board_overruns) == (1, 1)
    assert sample.q == pytest.approx((0.5 + 2 * math.pi * 40 / 4000, 0.25 - 2 * math.pi * 10 / 2000))
    assert sample.qd == pytest.approx((2 * math.pi * 40 / 4000 / 0.01, -2 * math.pi * 10 / 2000 / 0.01))
    assert sample.effort == -0.25


def test_velocity_at_1_khz_is_taken_over_ten_samples():
    wire = Wire()
    for k in range(1, 30):
        (sample,) = only(wire.state(k, 1000 * k, enc1=4 * (k - k % 10), step=MS), Sample)
    assert sample.qd[0] == pytest.approx(2 * math.pi * 4 * 10 / 4000 / 10e-3)


def steady(first, count, t_us=0, step=10):
    """Frames every 10 ms: number, board's clock [us], and how long after the last one they come [ms]."""
    return [((first + k) % 65_536, (t_us + 10_000 * k) % WRAP, step) for k in range(count)]


#: As after a process stood still: a wrap among what waited.
WAITED = [*steady(1000, 100, WRAP - 1_050_000), (1100, WRAP - 50_000, 60_000), *steady(1101, 7, WRAP - 40_000, step=0)]


@pytest.mark.parametrize(
    ('frames', 'published', 'counted'),
    [
        (
            [(seq, 10_000 * seq, 10) for seq in (1, 2, 2, 4, 3, 5)],
            [1, 2, 4, 5],
            {'lost': 1, 'duplicates': 1, 'out_of_order': 1},
        ),
        (steady(65_500, 100), [(65_500 + k) % 65_536 for k in range(100)], {}),
        # The program was stopped for 40 s at 1 kHz: numbers go more than half round, unheard.
        (
            [(100, 0, 1), (40_000, 40_000_000, 40_000), (40_001, 40_001_000, 1), (39_999, 39_999_000, 1)],
            [100, 40_000, 40_001],
            {'lost': 39_899, 'out_of_order': 1},
        ),
        # A frame that comes again after a silence, and the next when numbers and clock are more than half round.
        (
            [(1, 10_000, 10), None, (1, 10_000, 10), (40_000, 2_400_000_000, 2_400_000)],
            [1, 40_000],
            {'lost': 39_998, 'duplicates': 1, 'link_losses': 1},
        ),
        (WAITED, [seq for seq, *_ in WAITED], {}),
        ([*WAITED, (7099, 59_940_000, 0)], [*(seq for seq, *_ in WAITED), 7099], {'lost': 5991}),
    ],
)
def test_frames_are_published_once_in_order_and_what_is_missing_is_counted(frames, published, counted):
    wire, found = Wire(hello=replace(HELLO, seq=frames[0][0] - 1)), []
    for each in frames:
        if each is None:
            wire.wait(200)
            wire.wait(10)
        else:
            seq, t_us, step = each
            found += [seq] * len(only(wire.state(seq, t_us, step=step * MS), Sample))
    assert found == published
    c = wire.host.counters
    wanted = {'lost': 0, 'duplicates': 0, 'out_of_order': 0, 'restarts': 0, 'link_losses': 0} | counted
    assert {name: getattr(c, name) for name in wanted} == wanted


def test_five_in_a_row_are_believed_and_reported():
    wire = Wire()
    wire.state(1, 10_000)
    for k in range(2, 6):
        wire.state(k, 10_000 * k, enc2=20_000)
    wire.state(6, 60_000)
    events = [wire.state(k, 10_000 * k, enc2=20_000 + 10 * k) for k in range(7, 14)]
    assert [len(only(e, Sample)) for e in events] == [0, 0, 0, 0, 0, 1, 1]
    assert [len(only(e, Report)) for e in events] == [0, 0, 0, 0, 1, 0, 0]
    assert only(events[-2], Sample)[0].qd == pytest.approx((0.0, 2 * math.pi * 10 / 2000 / 0.01))
    assert (wire.host.counters.flagged, wire.host.counters.jumps) == (9, 1)
    # A joint that goes on too fast is reported once.
    assert not [e for k in range(14, 40) for e in wire.state(k, 10_000 * k, enc2=20_000 * k)]


# Arming


def test_arming_is_a_request_and_succeeds_once_a_state_says_so():
    rig = Rig()
    rig.step(3)
    events = rig.host.arm(rig.now)
    rig.effort(1.0)
    assert only(events, Armed) == []
    assert only(rig.step(2), Armed) == [Armed()]
    assert rig.host.arm(rig.now) == [Armed()]
    _, request = rig.commands[0]
    assert (type(request), request.boot_id, request.lock) == (Arm, rig.host.hello.boot_id, 1)
    assert request.session
    assert not any(command.torque for command in only([c for _, c in rig.commands], Command))
    assert rig.host.counters.discarded == 1


def test_arming_fails_at_once_without_port_board_or_hello_and_in_a_fault():
    host, wire = Host(), Wire(hello=None)
    assert only(host.arm(0), ArmingFailed)
    host.opened(0)
    assert only(host.arm(0), ArmingFailed)
    wire.state(0, 0)
    assert 'HELLO' in only(wire.host.arm(wire.now), ArmingFailed)[0].reason
    wire.hear(replace(HELLO, seq=1))
    wire.state(2, 20_000, status=Status.EMERGENCY_STOP)
    wire.host.arm(wire.now)
    # It asked the board to forget a fault that may be over, and waits for the answer.
    events = wire.state(3, 30_000, status=Status.EMERGENCY_STOP, cmd_seq=wire.sent()[-1].seq, lock=2)
    assert 'emergency stop' in only(events, ArmingFailed)[0].reason


def test_arming_fails_after_half_a_second_and_ends_disarmed():
    wire = Wire()
    wire.state(1, 10_000)
    wire.host.arm(begun := wire.now)
    seq, failed = 2, []
    while not failed:
        failed = only(wire.state(seq, 10_000 * seq), ArmingFailed) + only(wire.host.poll(wire.now), ArmingFailed)
        seq += 1
    assert wire.now - begun == 500 * MS
    assert wire.sent()[-1].mode == Mode.DISARM


def test_a_state_from_before_this_arming_does_not_count():
    wire = Wire()
    wire.sent()
    wire.state(1, 10_000, status=Status.ARMED, cmd_seq=9999)
    (disarm,) = wire.sent()
    assert disarm.mode == Mode.DISARM, 'a board that somebody else left armed'
    wire.host.arm(wire.now)
    assert only(wire.state(2, 20_000, status=Status.ARMED, cmd_seq=9999), Armed) == []
    assert wire.sent() == [], 'the board has to be disarmed first'
    wire.state(3, 30_000, cmd_seq=disarm.seq, lock=2)
    (request,) = only(wire.sent(), Arm)
    assert request.lock == 2
    assert only(wire.state(4, 40_000, status=Status.ARMED, cmd_seq=request.seq, lock=2), Armed) == [Armed()]


# Who owns the motor


def armed_wire(**config):
    """A host that has armed."""
    wire = Wire(replace(ASSUMED, **config))
    wire.state(1, 10_000)
    wire.host.arm(wire.now)
    seq = only(wire.sent(), Arm)[-1].seq
    wire.state(2, 20_000, status=Status.ARMED, cmd_seq=seq)
    assert wire.host.armed
    return wire


@pytest.mark.parametrize(
    ('change', 'said'),
    [
        ({'cmd_seq': 40_000}, 'the board obeys frame 40000, which this host did not send'),
        ({'lock': 3}, 'another program moves the motor'),
        ({'torque': 100_000}, 'the board gives 0.1 N m where 0.5 N m were commanded'),
        ({'torque': 600_000, 'status': Status.ARMED | Status.SATURATED}, 'the board gives 0.6 N m where'),
        ({'torque': -1, 'status': Status.ARMED | Status.SLEW}, 'the board gives -1e-06 N m where 0.5'),
        ({'status': 0, 'cmd_seq': 40_000, 'lock': 2, 'torque': 0}, 'another program disarmed the board'),
    ],
)
def test_a_state_that_differs_from_what_was_sent_disarms_at_once(change, said):
    wire = armed_wire()
    wire.host.effort(0.5, wire.now)
    expected = {'cmd_seq': wire.sent()[-1].seq, 'torque': 500_000, 'status': Status.ARMED}
    assert not only(wire.state(3, 30_000, **expected), Report)
    reports = only(wire.state(4, 40_000, **expected | change), Report)
    assert any(said in report.text and report.level is Level.ERROR for report in reports)
    assert not wire.host.armed
    assert wire.sent()[-1].mode == Mode.DISARM
    assert said in wire.host.condition(wire.now).text


@pytest.mark.parametrize('torque', [0, 200_000, 500_000])
def test_a_torque_that_is_slewed_or_of_a_command_before_is_as_expected(torque):
    wire = armed_wire()
    wire.host.effort(0.5, wire.now)
    wire.host.effort(0.1, wire.now)
    *_, first, second = (command.seq for command in wire.sent())
    wire.state(3, 30_000, torque=torque, status=Status.ARMED | Status.SLEW, cmd_seq=first)
    wire.state(4, 40_000, torque=torque, status=Status.ARMED | Status.SLEW, cmd_seq=second)
    wire.state(5, 50_000, torque=100_000, status=Status.ARMED, cmd_seq=second)
    assert wire.host.armed


@pytest.mark.parametrize('state', [{'status': Status.ARMED, 'cmd_seq': 7}, {'torque': 300_000}])
def test_a_board_that_another_program_armed_or_that_gives_torque_is_disarmed_and_told(state):
    wire = Wire()
    wire.sent()
    reports = only(wire.state(1, 10_000, **state), Report)
    assert 'armed by another program' in reports[0].text
    assert reports[0].level is Level.ERROR
    (first,) = wire.sent()
    # It is repeated until it was obeyed; a board that goes on is said to.
    for k in range(2, 80):
        reports += only(wire.state(k, 10_000 * k, **state) + wire.host.poll(wire.now), Report)
    assert len(wire.sent()) == 15
    assert ['does not obey' in report.text for report in reports] == [False, True]
    assert wire.host.condition(wire.now).level is Level.ERROR
    wire.state(80, 800_000, cmd_seq=first.seq)
    assert wire.host.condition(wire.now).level is Level.WARN


def test_it_stays_armed_when_the_numbers_of_commands_wrap():
    wire = armed_wire()
    numbers = []
    for k in range(3, 7000):
        for _ in range(10):
            wire.host.effort(0.1, wire.now)
        numbers += [command.seq for command in only(wire.sent(), Command)]
        wire.state(k, 1000 * k, torque=100_000, status=Status.ARMED, cmd_seq=numbers[-1], step=MS)
    assert numbers[-1] < numbers[0] + 5000, 'they have wrapped'
    assert wire.host.armed


def test_requests_of_others_that_the_board_refuses_are_counted_and_told_and_keep_it_from_being_armed():
    wire, health = Wire(), Health()
    wire.state(1, 10_000)
    reports = only(wire.state(2, 20_000, status=Status.REFUSED, refused=3), Report)
    assert 'another program sends commands' in reports[0].text
    assert wire.host.counters.foreign_requests == 3
    assert health.diagnose(wire.host, wire.now).level is Level.WARN
    assert 'another program' in only(wire.host.arm(wire.now), ArmingFailed)[0].reason
    for k in range(3, 110):
        wire.state(k, 10_000 * k, refused=3)
    assert wire.host.arm(wire.now) == []
    # While it goes on beside an armed motor, every diagnosis says so.
    wire, health = armed_wire(), Health()
    for k in range(3, 400):
        wire.host.effort(0.0, wire.now)
        (command,) = only(wire.sent(), Command)
        status = Status.ARMED | Status.REFUSED
        wire.state(k, 10_000 * k, status=status, cmd_seq=command.seq, refused=k)
        if k % 100 == 0:
            assert health.diagnose(wire.host, wire.now).level is Level.WARN
    assert wire.host.armed
    # What it sent itself before the board restarted is not foreign.
    wire = armed_wire()
    wire.hear(replace(HELLO, seq=0, boot_id=78))
    wire.state(1, 10_000, status=Status.REFUSED, refused=2)
    wire.state(2, 20_000, status=Status.REFUSED, refused=4)
    assert wire.host.counters.foreign_requests == 0


def test_a_mode_0_that_comes_late_ends_no_arming_and_that_of_another_does():
    for own in (True, False):
        wire = armed_wire()
        wire.host.disarm(wire.now)
        wire.wait(60)
        first, second = wire.sent()
        wire.state(3, 80_000, cmd_seq=first.seq, lock=2)
        wire.host.arm(wire.now)
        wire.state(4, 90_000, cmd_seq=second.seq if own else 40_000, lock=3)
        assert [request.lock for request in only(wire.sent(), Arm)] == ([2, 3] if own else [2])


def test_an_older_board_is_named_and_not_armed():
    wire = Wire(hello=None)
    data = struct.pack('<BBHIiiihHHH', 1, 1, 1, 10_000, 0, 0, 0, 0, 2400, 0, 0)
    reports = [r for _ in range(3) for r in only(wire.host.receive(frame(data), wire.now), Report)]
    assert [report.level for report in reports] == [Level.ERROR]
    assert 'version 1 of the protocol, and this bridge version 2: flash' in reports[0].text
    assert 'version 1' in only(wire.host.arm(wire.now), ArmingFailed)[0].reason
    wire.hear(HELLO)
    wire.state(2, 20_000)
    assert wire.host.condition(wire.now).level is Level.OK


# Limits, zeros and the clock


@pytest.mark.parametrize(
    ('config', 'limits', 'said'),
    [
        ({'max_speed': 60.0}, Limits(max_speed=100_000), 'max_speed is 60, and the board has a limit of 100'),
        ({}, Limits(), 'max_speed is 100, and the board has no limit'),
        ({'max_travel': (6.0, 0.0)}, Limits(max_speed=1000, max_travel1=7000), 'max_travel of the shoulder is 6, and'),
        (
            {'max_travel': (0.0, 9.0)},
            Limits(max_speed=1000),
            'max_travel of the elbow is 9, and the board has no limit',
        ),
    ],
)
def test_a_board_with_looser_limits_than_the_users_is_not_armed(config, limits, said):
    wire = Wire(replace(ASSUMED, **config), replace(HELLO, limits=limits))
    wire.state(1, 10_000)
    assert said in only(wire.host.arm(wire.now), ArmingFailed)[0].reason
    assert said in wire.host.condition(wire.now).text


@pytest.mark.parametrize(
    ('limits', 'state', 'named'),
    [
        ({}, lambda k: {'enc1': 700 * k}, 'speed'),
        ({'max_travel2': 3000}, lambda k: {'enc2': 200 * k}, 'travel'),
        ({'stall_torque': 400_000, 'stall_ms': 50}, lambda k: {}, 'stall'),
    ],
)
def test_a_limit_that_the_board_does_not_keep_disarms(limits, state, named):
    hello = replace(HELLO, limits=Limits(max_speed=100_000, **limits))
    wire = Wire(hello=hello)
    wire.state(1, 10_000)
    wire.host.arm(wire.now)
    wire.state(2, 20_000, status=Status.ARMED, cmd_seq=only(wire.sent(), Arm)[-1].seq)
    wire.host.effort(0.5, wire.now)
    seq, reports = wire.sent()[-1].seq, []
    for k in range(1, 20):
        if wire.host.armed:
            reports += only(
                wire.state(2 + k, 20_000 + 10_000 * k, torque=500_000, status=Status.ARMED, cmd_seq=seq, **state(k)),
                Report,
            )
    assert not wire.host.armed
    assert f'a limit is exceeded ({named}), and the board does not switch off' in reports[0].text


def test_zeros_are_confirmed_at_rest_once_for_every_boot():
    wire = Wire(HostConfig())
    assert wire.host.confirm_zeros(0) == (False, 'no angle comes from the board; look at the bridge')
    for k in range(1, 60):
        wire.state(k, 10_000 * k, enc1=10 * (k < 30), enc2=k % 3)
    assert 'let both links hang at rest' in only(wire.host.arm(wire.now), ArmingFailed)[0].reason
    confirmed, said = wire.host.confirm_zeros(wire.now)
    assert (confirmed, 'the rig moves (q1 = -1.5708 rad' in said) == (False, True)
    for k in range(60, 160):
        wire.state(k, 10_000 * k)
    wire.sent()
    assert wire.host.confirm_zeros(wire.now)[0]
    # The board is told until it says that it keeps it.
    for k in range(160, 170):
        wire.state(k, 10_000 * k, status=Status.ZEROED * (k > 165))
    assert {(c.mode, c.session) for c in wire.sent()} == {(Mode.CONFIRM_ZEROS, HELLO.boot_id)}
    assert wire.host.arm(wire.now) == []
    wire.hear(replace(HELLO, seq=170, boot_id=78))
    wire.state(171, 1000)
    wire.hear(replace(HELLO, seq=172, boot_id=78))
    assert 'confirm_zeros' in only(wire.host.arm(wire.now), ArmingFailed)[0].reason
    # Another bridge confirmed them.
    wire.state(173, 21_000, status=Status.ZEROED)
    assert wire.host.arm(wire.now) == []


def test_a_hello_whose_period_contradicts_the_samples_is_an_error_and_not_armed():
    wire = Wire(hello=replace(HELLO, sample_period_us=1_000_000))
    for k in range(1, 15):
        wire.state(k, 10_000 * k)
    said = 'a sample every 1000 ms, and its samples are 10 ms apart'
    assert said in only(wire.host.arm(wire.now), ArmingFailed)[0].reason
    assert wire.host.condition(wire.now).level is Level.ERROR


@pytest.mark.parametrize(('samples', 'longest_ms'), [(2, 500), (13, 100)])
def test_an_armed_link_is_not_silent_for_long_whatever_hello_says(samples, longest_ms):
    """After ten samples the period is the one that they show."""
    wire = Wire(hello=replace(HELLO, sample_period_us=1_000_000))
    wire.state(1, 10_000)
    wire.host.arm(wire.now)
    seq = only(wire.sent(), Arm)[-1].seq
    for k in range(2, samples + 1):
        wire.state(k, 10_000 * k, status=Status.ARMED, cmd_seq=seq)
    for _ in range(longest_ms // 10):
        wire.wait(10)
    assert wire.host.armed
    wire.wait(10)
    assert not wire.host.armed
    assert only(wire.sent(), Command)[-1].mode == Mode.DISARM


def test_one_wrong_time_moves_no_stamp_and_is_counted_and_a_wrong_rate_is_told_within_a_second():
    wire, health = Wire(), Health()
    stamps = []
    for k in range(1, 200):
        wrong = 65_536 if k in (100, 150) else 0
        stamps += [s.stamp_ns for s in only(wire.state(k, 10_000 * k + wrong), Sample)]
    assert {b - a for a, b in pairwise(stamps)} == {10 * MS}
    assert wire.host.counters.irregular_stamps == 2
    diagnosis = health.diagnose(wire.host, wire.now)
    assert (diagnosis.level, 'irregular stamps: 2 more' in diagnosis.message) == (Level.WARN, True)
    fast = Wire(hello=replace(HELLO, sample_period_us=10_500))
    reports = [r.text for k in range(1, 100) for r in only(fast.state(k, 10_500 * k), Report)]
    assert len(reports) == 1
    assert "the board's clock runs 4.8 % fast" in reports[0]
    assert fast.host.condition(fast.now) == Report(Level.WARN, reports[0]), 'as long as it is so'


# Commanding


@pytest.mark.parametrize(('wanted', 'longest'), [(40, 500), (400, 40)])
def test_at_least_two_commands_for_each_watchdog_period_the_boards_or_the_configured(wanted, longest):
    rig = Rig(replace(ASSUMED, watchdog_ms=wanted), BoardSettings(watchdog_max_ms=longest)).armed()
    begun = len(rig.commands)
    rig.step(200)
    times = [at for at, _ in rig.commands[begun:]]
    assert max(b - a for a, b in pairwise(times)) <= 20 * MS
    assert rig.host.armed


@pytest.mark.parametrize(('configured', 'limit'), [(0.3, 300_000), (5.0, 1_200_000)])
def test_torque_is_clamped_to_the_smaller_limit_and_that_is_reported_once_while_it_goes_on(configured, limit):
    rig, health = Rig(replace(ASSUMED, torque_limit=configured), BoardSettings(torque_limit=1.2)).armed(), Health()
    for k in range(200):
        rig.effort((-1) ** k * 10.0)
        assert rig.commands[-1][1].torque == (-1) ** k * limit
        rig.effort(-0.1)
        rig.step(1)
        diagnosis = health.diagnose(rig.host, rig.now)
        assert diagnosis.level == Level.WARN
    assert rig.host.counters.clamped == 200
    assert diagnosis.values['clamped'] == '200'
    assert diagnosis.values['torque limit [N m]'] == f'{limit / 1e6:g}'
    assert rig.reports() == [f'an effort command of 10 N m came; at most {limit / 1e6:g} N m are sent']
    rig.step(101)
    rig.effort(10.0)
    assert len([text for text in rig.reports() if 'at most' in text]) == 2


def test_the_torque_limit_is_lowered_at_once_and_not_raised_while_armed():
    rig = Rig(ASSUMED).armed()
    rig.effort(0.5)
    rig.host.set_torque_limit(0.2, rig.now)
    rig.step(1)
    assert rig.commands[-1][1].torque == 200_000
    rig.host.set_torque_limit(1.0, rig.now)
    rig.effort(0.5)
    assert rig.commands[-1][1].torque == 200_000


def test_a_torque_is_sent_at_once_and_when_commands_stop_it_is_0_still_armed_and_reported():
    rig = Rig().armed()
    rig.effort(0.1234567)
    rig.step(9)
    assert rig.board.last.torque == 123_457
    assert only(rig.events, Sample)[-1].effort == pytest.approx(0.123457)
    rig.step(5)
    assert rig.board.last.torque == 0
    assert rig.host.armed
    assert rig.host.condition(0).level == Level.WARN
    rig.step(100)
    assert len([text for text in rig.reports() if 'no effort command' in text]) == 1
    rig.effort(0.5)
    rig.step(2)
    assert rig.board.last.torque == 500_000
    assert rig.host.condition(0) == Report(Level.OK, 'armed')


@given(
    timeout=st.sampled_from([0.001, 0.004, 0.1, 0.5]),
    pauses=st.lists(st.integers(0, 600 * MS), min_size=1, max_size=4),
)
def test_one_who_polls_only_when_told_takes_the_torque_back_at_its_moment(timeout, pauses):
    # Samples a second apart: nothing else tells the host what time it is.
    hello = replace(HELLO, sample_period_us=1_000_000, watchdog_max_ms=10_000)
    wire = Wire(replace(ASSUMED, command_timeout=timeout, watchdog_ms=10_000), hello)
    wire.state(1, 0)
    wire.host.arm(wire.now)
    wire.state(2, 10_000, status=Status.ARMED, cmd_seq=wire.sent()[-1].seq)
    poll = wire.now
    for pause in pauses:
        commanded = wire.now
        wire.host.effort(0.5, commanded)
        assert wire.sent()[-1].torque == 500_000
        expected = [commanded + round(timeout * 1e9)] if timeout * 1e9 <= pause else []
        zeroed = []
        while poll <= commanded + pause:
            wire.host.poll(poll)
            zeroed += [poll for command in wire.sent() if command.torque == 0 and not zeroed]
            poll += round(wire.host.next_poll(poll) * 1e9)
        assert zeroed == expected
        wire.now = commanded + pause


# What disarms


def unheard(samples):
    """Let the board go on without the host, for so many samples."""

    def happens(rig):
        rig.connected = False
        rig.step(samples)
        rig.connected = True

    return happens


def trips(rig):
    """The board, which the host does not hear: it is back before the link is lost."""
    unheard(9)(rig)
    for _ in range(2):
        rig.board.advance()


@pytest.mark.parametrize(
    ('faults', 'happens', 'told', 'counted'),
    [
        ({}, unheard(12), 'link lost', {'link_losses': 1, 'lost': 12}),
        ({}, unheard(62), 'link lost', {'link_losses': 1, 'lost': 62}),
        ({}, trips, "the board's watchdog tripped", {'trips': 1}),
        ({'over_current_at': 0.2}, lambda rig: rig.step(50), 'the board reports a fault: over current', {}),
        ({}, lambda rig: [rig.effort(math.nan) for _ in range(3)], 'an effort command of nan', {'not_finite': 3}),
        ({}, lambda rig: rig.effort(-math.inf), 'an effort command of -inf', {'not_finite': 1}),
        ({'reset_at': 0.5}, lambda rig: rig.step(60), 'the board restarted', {'restarts': 1, 'lost': 0}),
    ],
)
def test_it_disarms_reports_once_and_stays_disarmed_until_told_again(faults, happens, told, counted):
    rig = Rig(faults=Faults(**faults)).armed()
    happens(rig)
    rig.step(60)
    assert not rig.host.armed
    assert not rig.board.armed
    assert len([text for text in rig.reports() if text.startswith(told)]) == 1
    assert {name: getattr(rig.host.counters, name) for name in counted} == counted
    stamps = [sample.stamp_ns for sample in only(rig.events, Sample)]
    assert all(a < b for a, b in pairwise(stamps))
    assert rig.now - stamps[-1] <= 20 * MS
    rig.armed()


@pytest.mark.parametrize(
    ('config', 'hello', 'longest_ms'),
    [
        (HostConfig(), HELLO, 100),
        (HostConfig(), replace(HELLO, sample_period_us=100_000), 500),
        (HostConfig(link_timeout=1.0), HELLO, 1000),
    ],
)
def test_a_link_may_be_silent_for_100_ms_five_periods_or_as_configured(config, hello, longest_ms):
    wire = Wire(config, hello)
    for _ in range(longest_ms // 10):
        wire.wait(10)
    assert wire.host.link == 'up'
    wire.wait(10)
    assert wire.host.link == 'silent'


def test_a_board_that_answers_but_does_not_sample_is_lost_once():
    wire = Wire()
    wire.state(1, 10_000)
    reports = []
    for seq in range(2, 22):
        for _ in range(20):
            reports += wire.wait(10)
        reports += wire.hear(replace(HELLO, seq=seq))
    assert ['link lost' in report.text for report in reports] == [True]
    assert wire.host.condition(0) == Report(Level.ERROR, 'no valid sample comes from the board')
    events = wire.state(22, 20_000)
    assert [report.text for report in only(events, Report)] == ['the board is heard again']
    assert wire.host.link == 'up'


def test_a_program_that_was_held_up_reads_first_before_it_calls_the_link_lost():
    rig = Rig().armed()
    data = b''.join(rig.board.advance() for _ in range(50))
    rig.now += 500 * MS
    rig.events += rig.host.poll(rig.now)
    rig.events += rig.host.receive(data, rig.now)
    assert (rig.host.counters.link_losses, rig.host.counters.lost) == (0, 0)


@pytest.mark.parametrize('restarts', [True, False])
def test_a_closed_port_disarms_and_needs_a_new_hello(restarts):
    """Of the board that was there before, which is still armed, or of one that had no power meanwhile."""
    rig = Rig(faults=Faults(reset_at=0.27 if restarts else math.inf)).armed()
    rig.effort(0.5)
    rig.step(20)
    rig.host.effort(0.5, rig.now)
    rig.events += rig.host.closed('the port was lost', rig.now)
    rig.host.disarm(rig.now)
    assert rig.host.condition(0) == Report(Level.ERROR, 'the port was lost')
    assert rig.host.data_to_send() == b''
    for _ in range(3):
        rig.board.advance()
    rig.events += rig.host.opened(rig.now)
    rig.events += rig.host.receive(rig.board.advance(), rig.now)
    assert rig.host.counters.unscaled == 1
    rig.step(1)
    assert not rig.board.armed
    rig.step(3)
    assert rig.host.link == 'up'
    assert not rig.host.armed
    assert (rig.host.counters.restarts, rig.host.counters.lost) == ((1, 0) if restarts else (0, 3))
    assert rig.host.condition(0) == Report(Level.WARN, 'disarmed: the link was lost; arm again when it is safe')
    rig.armed()
    assert rig.host.condition(0) == Report(Level.OK, 'armed')


def test_the_first_request_is_heard_whatever_the_host_before_left_unfinished():
    host, heard = Host(), Decoder(accept=(Command, HelloRequest))
    heard.feed(encode(Command(1, 0, Mode.TORQUE, 100, 0))[:-5])
    host.opened(0)
    assert isinstance(heard.feed(host.data_to_send())[-1], HelloRequest)


@pytest.mark.parametrize(('boot_id', 'lost'), [(HELLO.boot_id, 498), (HELLO.boot_id + 1, 0)])
def test_what_is_missing_after_the_port_was_closed_was_lost_if_the_board_is_the_same(boot_id, lost):
    wire = Wire()
    wire.state(1, 10_000)
    wire.host.closed('it was lost', wire.now)
    wire.host.opened(wire.now)
    wire.state(500, 5_000_000)
    wire.hear(replace(HELLO, seq=501, boot_id=boot_id))
    wire.hear(replace(HELLO, seq=0, boot_id=9))
    assert wire.host.counters.lost == lost


def test_a_port_that_fails_again_and_again_is_said_once():
    wire, health = Wire(), Health()
    wire.state(1, 10_000)
    reports = [report for _ in range(20) for report in only(wire.host.closed('it was lost', wire.now), Report)]
    health.note(reports[0])
    assert health.diagnose(wire.host, wire.now).message == 'it was lost'
    for _ in range(20):
        wire.host.opened(wire.now)
        reports += only(wire.host.closed('it was lost', wire.now), Report)
    assert [report.text for report in reports] == ['it was lost']
    wire.host.opened(wire.now)
    wire.state(2, 20_000)
    assert only(wire.host.closed('it was lost', wire.now), Report)
    assert wire.host.counters.link_losses == 2
    # Silent before it is lost: the same words again, but another loss.
    wire.host.opened(wire.now)
    wire.state(3, 30_000)
    wire.wait(10)
    assert 'link lost' in only(wire.wait(40) + wire.wait(40) + wire.wait(40), Report)[0].text
    assert only(wire.host.closed('it was lost', wire.now), Report)


def test_a_fault_that_comes_and_goes_is_reported_once():
    wire = Wire()
    reports = []
    for k in range(1, 400):
        status = Status.UNDERVOLTAGE * (k % 2) | Status.ENCODER_1 * (k == 101)
        reports += only(wire.state(k, 10_000 * k, status=int(status)), Report)
    assert [r.text.split(': ')[1] for r in reports] == ['undervoltage', 'encoder 1']
    for k in range(400, 510):
        reports += only(wire.state(k, 10_000 * k), Report)
    reports += only(wire.state(510, 5_100_000, status=int(Status.UNDERVOLTAGE)), Report)
    assert len(reports) == 3


@pytest.mark.parametrize('before_us', [50_000, 9_000_000, WRAP - 2_400_000_000])
def test_a_restart_is_no_wrap_however_near_the_clock_was_to_it(before_us):
    wire = Wire(hello=replace(HELLO, seq=39_999))
    wire.state(40_000, WRAP - before_us - 10_000, enc1=3000)
    wire.state(40_001, WRAP - before_us, enc1=3000)
    wire.state(1, 100)
    assert wire.host.counters.restarts == 1
    # The counts began anew, too.
    wire.hear(replace(HELLO, seq=2))
    assert len(only(wire.state(3, 20_100), Sample)) == 1
