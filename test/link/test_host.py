# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The rules of the host, without a port or a clock; benchmarks/faults counts damaged frames."""

import math
import struct
from dataclasses import replace
from itertools import pairwise

import pytest

from pendubot_identification.level import Level
from pendubot_identification.link.clock import MS, WRAP
from pendubot_identification.link.events import ArmingEnded, Report, Sample
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

HELLO = Hello(0, 0, 77, 1, 0, 500, 4000, 2000, 1_500_000, 10_000, 0, 0, 0, Limits(max_speed=100_000), 'test')
#: Zeros need no confirmation.
ASSUMED = HostConfig(confirm_zeros=False)


def only(events, kind):
    return [event for event in events if isinstance(event, kind)]


def texts(events):
    return [report.text for report in only(events, Report)]


class Wire:
    """A host that receives constructed frames."""

    def __init__(self, config=None, hello=HELLO, **limits):
        self.host = Host(config or ASSUMED)
        self.now, self.seq = 10**12, 0
        self.host.opened(self.now)
        if hello:
            self.receive(hello._replace(limits=hello.limits._replace(**limits)))

    def do(self, action, *values):
        """Call a method of the host; return its events."""
        action(*values, self.now)
        return self.host.output.take_events()

    def receive(self, message):
        return self.do(self.host.receive, encode(message))

    def state(self, seq=None, t_us=None, step=10 * MS, **fields):
        """Receive a STATE, by default 10 ms after the last; return the events."""
        self.seq = self.seq + 1 if seq is None else seq
        t_us = 10_000 * self.seq if t_us is None else t_us
        self.now += step
        values = {'enc1': 0, 'enc2': 0, 'torque': 0, 'current': 0, 'vbus': 2400, 'cmd_seq': 0, 'status': 0, 'lock': 1}
        return self.receive(State(self.seq, t_us, **values | fields))

    def states(self, count, **fields):
        return [event for _ in range(count) for event in self.state(**fields)]

    def obeying(self, **fields):
        """Receive the STATE of an armed, obedient board with some other fields."""
        return self.state(**self.obeyed | fields)

    def wait(self, ms, times=1):
        """Poll every ``ms`` [ms]; return the events."""
        events = []
        for _ in range(times):
            self.now += ms * MS
            events += self.do(self.host.poll)
        return events

    def sent(self, kind=object):
        return only(Decoder(accept=(Command, HelloRequest, Arm)).feed(self.host.output.take_data()), kind)

    def arm(self):
        return self.do(self.host.arm)

    def armed(self, **state):
        """Arm a board with this STATE; ``obeyed`` are the fields of an obedient board's next STATE."""
        self.state(**state)
        self.arm()
        self.obeyed = state | {'status': Status.ARMED, 'cmd_seq': self.sent(Arm)[-1].seq}
        self.state(**self.obeyed)
        assert self.host.armed
        return self

    def command(self, *torques):
        return [event for torque in torques for event in self.do(self.host.motor.effort, torque)]

    def effort(self, torque):
        """Command a torque; return the STATE fields of an obedient board."""
        self.host.motor.effort(torque, self.now)
        return {'cmd_seq': self.sent()[-1].seq, 'torque': round(1e6 * torque), 'status': Status.ARMED}

    def refusal(self):
        return only(self.arm(), ArmingEnded)[0].reason


# Start


def test_hello_is_requested_every_200_ms_until_it_arrives_and_silence_is_reported_once():
    wire, requests, reports = Wire(hello=None), [], []
    for k in range(600):
        requests += [2 * k] * len(wire.sent(HelloRequest))
        reports += [(2 * k, report.level) for report in wire.wait(2)]
    assert requests == [0, 200, 400, 600, 800, 1000]
    assert reports == [(998, Level.WARN)]
    wire.receive(HELLO)
    wire.sent()
    wire.wait(2, times=49)
    assert wire.sent() == []


@pytest.mark.parametrize(
    ('given', 'hello', 'q'),
    [
        ((0, 0), None, None),
        ((1000, 1000), None, (0.0, math.pi)),
        ((1000, 0), HELLO._replace(cpr1=0), (0.0, math.pi / 2)),
        ((0, 0), HELLO, (-3 * math.pi / 8, math.pi / 2)),
    ],
)
def test_samples_are_scaled_by_the_configured_or_reported_counts_per_turn_and_never_published_without(given, hello, q):
    wire = Wire(HostConfig(counts_per_turn=given), hello)
    samples = only(wire.state(enc1=250, enc2=500), Sample)
    assert [sample.q for sample in samples] == ([] if q is None else [pytest.approx(q)])
    assert wire.host.counters.unscaled == (q is None)


def test_an_invalid_hello_is_reported_once_and_ignored_and_requested_again():
    wire = Wire(hello=None)
    for k, (change, text) in enumerate([({'cpr1': 0}, '0 counts'), ({'cpr1': 0}, None), ({'torque_limit': -5}, '-5')]):
        reports = only(wire.receive(HELLO._replace(seq=k, **change)), Report)
        assert [(r.level, text in r.text) for r in reports] == ([(Level.ERROR, True)] if text else [])
        assert wire.host.condition(0).level == Level.ERROR
    wire.sent()
    for k in range(3, 24):
        wire.state(k)
        wire.wait(0)
    assert len(wire.sent()) == 1
    wire.receive(HELLO._replace(seq=24))
    assert wire.receive(HELLO._replace(seq=25)) == [], 'an unchanged HELLO must not be reported'
    assert 'counts per turn' in texts(wire.receive(HELLO._replace(seq=26, cpr2=0)))[0]
    assert wire.host.hello.cpr2 == HELLO.cpr2
    assert '8000' in texts(wire.receive(HELLO._replace(seq=27, cpr1=8000)))[0]


# Published


def test_a_sample_has_scaled_positions_velocities_and_effort():
    wire = Wire(HostConfig(sign=(1, -1), zero=(0.5, 0.25)))
    wire.state()
    noted = Status.DAMAGED_FRAME | Status.OVERRUN
    (sample,) = only(wire.state(enc1=40, enc2=10, torque=-250_000, status=noted), Sample)
    assert (wire.host.counters.board_damaged, wire.host.counters.board_overruns) == (1, 1)
    assert sample.q == pytest.approx((0.5 + 2 * math.pi * 40 / 4000, 0.25 - 2 * math.pi * 10 / 2000))
    assert sample.qd == pytest.approx((2 * math.pi * 40 / 4000 / 0.01, -2 * math.pi * 10 / 2000 / 0.01))
    assert sample.effort == -0.25


def test_velocity_at_1_khz_is_computed_over_ten_samples():
    wire = Wire()
    for k in range(1, 30):
        (sample,) = only(wire.state(k, 1000 * k, enc1=4 * (k - k % 10), step=MS), Sample)
    assert sample.qd[0] == pytest.approx(2 * math.pi * 4 * 10 / 4000 / 10e-3)


def steady(first, count, t_us=0, step=10):
    """Return frames every 10 ms: number, board's clock [us], and time since the last arrival [ms]."""
    return [((first + k) % 65_536, (t_us + 10_000 * k) % WRAP, step) for k in range(count)]


#: Frames that were buffered while the process was suspended, across a wrap of the clock.
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
        # The program was suspended for 40 s at 1 kHz: the numbers pass half their range.
        (
            [(100, 0, 1), (40_000, 40_000_000, 40_000), (40_001, 40_001_000, 1), (39_999, 39_999_000, 1)],
            [100, 40_000, 40_001],
            {'lost': 39_899, 'out_of_order': 1},
        ),
        # Numbers and clock pass half their range during a silence, whose frames are not counted as lost.
        ([(1, 10_000, 10), None, (40_000, 2_400_000_000, 2_400_000)], [1, 40_000], {'link_losses': 1}),
        ([*WAITED, (7099, 59_940_000, 0)], [*(seq for seq, *_ in WAITED), 7099], {'lost': 5991}),
    ],
)
def test_frames_are_published_once_in_order_and_missing_frames_are_counted(frames, published, counted):
    wire, seqs = Wire(hello=HELLO._replace(seq=frames[0][0] - 1)), []
    for each in frames:
        if each is None:
            wire.wait(105, times=2)
        else:
            seq, t_us, step = each
            seqs += [seq] * len(only(wire.state(seq, t_us, step=step * MS), Sample))
    assert seqs == published
    c = wire.host.counters
    wanted = {'lost': 0, 'duplicates': 0, 'out_of_order': 0, 'restarts': 0, 'link_losses': 0} | counted
    assert {name: getattr(c, name) for name in wanted} == wanted


def test_a_jump_of_position_is_accepted_and_reported_after_five_consistent_samples():
    wire = Wire()
    wire.state()
    wire.states(4, enc2=20_000)
    wire.state()
    events = [wire.state(enc2=20_000 + 10 * k) for k in range(7, 14)]
    assert [len(only(e, Sample)) for e in events] == [0, 0, 0, 0, 0, 1, 1]
    assert [len(only(e, Report)) for e in events] == [0, 0, 0, 0, 1, 0, 0]
    assert only(events[-2], Sample)[0].qd == pytest.approx((0.0, 2 * math.pi * 10 / 2000 / 0.01))
    assert (wire.host.counters.flagged, wire.host.counters.jumps) == (9, 1)
    # Continued overspeed is reported once.
    assert not [e for k in range(14, 40) for e in wire.state(enc2=20_000 * k)]


# Arming


def test_arming_fails_at_once_without_port_board_or_hello_and_in_a_fault():
    wire = Wire(hello=None)
    assert 'no board' in wire.refusal()
    wire.do(wire.host.closed, 'it is missing')
    assert 'it is missing' in wire.refusal()
    wire.do(wire.host.opened)
    wire.state()
    assert 'HELLO' in wire.refusal()
    wire.receive(HELLO._replace(seq=2))
    wire.state(3, status=Status.EMERGENCY_STOP)
    wire.arm()
    # The host requests a reset of the fault and waits for the answer.
    events = wire.state(status=Status.EMERGENCY_STOP, cmd_seq=wire.sent()[-1].seq, lock=2)
    assert 'emergency stop' in only(events, ArmingEnded)[0].reason


def test_arming_times_out_after_half_a_second_and_ends_disarmed():
    wire, failed = Wire(), []
    wire.state()
    begun = wire.now
    wire.arm()
    while not failed:
        failed = only(wire.state() + wire.wait(0), ArmingEnded)
    assert wire.now - begun == 500 * MS
    assert wire.sent()[-1].mode == Mode.DISARM


def test_a_state_from_before_this_arming_does_not_count():
    wire = Wire()
    wire.sent()
    wire.state(status=Status.ARMED, cmd_seq=9999)
    (disarm,) = wire.sent()
    assert disarm.mode == Mode.DISARM
    wire.arm()
    assert only(wire.state(status=Status.ARMED, cmd_seq=9999), ArmingEnded) == []
    assert wire.sent() == [], 'the board must be disarmed first'
    wire.state(cmd_seq=disarm.seq, lock=2)
    (request,) = wire.sent(Arm)
    assert (request.lock, request.boot_id) == (2, HELLO.boot_id)
    assert only(wire.state(status=Status.ARMED, cmd_seq=request.seq, lock=2), ArmingEnded) == [ArmingEnded()]
    assert wire.arm() == [ArmingEnded()]


# Ownership of the motor


@pytest.mark.parametrize(
    ('change', 'text'),
    [
        ({'cmd_seq': 40_000}, 'the board executes frame 40000, which this host did not send'),
        ({'lock': 3}, 'another program commands it'),
        ({'torque': 100_000}, 'the board applies 0.1 N m instead of the commanded 0.5 N m'),
        ({'torque': 600_000, 'status': Status.ARMED | Status.SATURATED}, 'the board applies 0.6 N m instead'),
        ({'torque': -1, 'status': Status.ARMED | Status.SLEW}, 'the board applies -1e-06 N m instead of the commanded'),
        ({'status': 0, 'cmd_seq': 40_000, 'lock': 2, 'torque': 0}, 'another program disarmed the board'),
    ],
)
def test_a_state_that_contradicts_the_commands_disarms_at_once(change, text):
    wire = Wire().armed()
    expected = wire.effort(0.5)
    assert not texts(wire.state(**expected))
    reports = only(wire.state(**expected | change), Report)
    assert any(text in report.text and report.level is Level.ERROR for report in reports)
    assert not wire.host.armed
    assert wire.sent()[-1].mode == Mode.DISARM
    assert text in wire.host.condition(wire.now).text


@pytest.mark.parametrize('torque', [0, 200_000, 500_000])
def test_a_slewed_torque_or_the_torque_of_the_previous_command_is_accepted(torque):
    wire = Wire().armed()
    first, second = wire.effort(0.5), wire.effort(0.1)
    for expected in (first, second):
        wire.state(**expected | {'torque': torque, 'status': Status.ARMED | Status.SLEW})
    wire.state(**second)
    assert wire.host.armed


def test_a_torque_that_slewed_to_the_previous_command_in_lost_states_is_accepted():
    wire = Wire().armed()
    slewing = {'status': Status.ARMED | Status.SLEW}
    wire.state(**wire.effort(0.5) | slewing | {'torque': 100_000})
    wire.state(wire.seq + 3, **wire.effort(-0.5) | slewing | {'torque': 110_000})
    assert wire.host.armed


@pytest.mark.parametrize('state', [{'status': Status.ARMED, 'cmd_seq': 7}, {'torque': 300_000}])
def test_a_board_that_does_not_obey_the_request_to_disarm_is_reported_until_it_does(state):
    wire, reports = Wire(), []
    wire.sent()
    for _ in range(79):
        reports += wire.state(**state) + wire.wait(0)
    requests = wire.sent()
    assert len(requests) == 16
    assert ['does not confirm' in text for text in texts(reports)] == [False, True]
    assert wire.host.condition(wire.now).level is Level.ERROR
    wire.state(cmd_seq=requests[0].seq)
    assert wire.host.condition(wire.now).level is Level.WARN


def test_a_state_that_was_sent_before_many_torques_that_are_not_finite_is_no_disobedience():
    wire = Wire().armed()
    wire.command(*20 * [math.nan])
    assert texts(wire.obeying()) == []
    (request,) = wire.sent(Command)
    assert request.mode == Mode.DISARM
    wire.state(cmd_seq=request.seq, lock=2)
    wanted = Report(Level.WARN, 'disarmed: an effort command was not finite; arm again when it is safe')
    assert wire.host.condition(wire.now) == wanted


def test_the_host_stays_armed_when_command_numbers_wrap():
    wire = Wire().armed()
    wire.host.output.seq = 65_500
    for _ in range(100):
        wire.state(**wire.effort(0.1))
    assert wire.host.output.seq == 64
    assert wire.host.armed


def test_refused_requests_are_attributed_to_another_program_except_after_a_restart():
    wire, health = Wire(), Health()
    wire.state()
    wire.state(status=Status.REFUSED, refused=3)
    assert wire.host.counters.foreign_requests == 3
    assert health.diagnose(wire.host, wire.now)[0] is Level.WARN
    assert 'another program' in wire.refusal()
    wire.states(108, refused=3)
    assert wire.arm() == []
    wire = Wire().armed()
    wire.receive(HELLO._replace(seq=0, boot_id=78))
    for k in (1, 2):
        wire.state(k, status=Status.REFUSED, refused=2 * k)
    assert wire.host.counters.foreign_requests == 0


@pytest.mark.parametrize('own', [True, False])
def test_a_late_disarm_request_ends_no_arming_unless_another_program_sent_it(own):
    wire = Wire().armed()
    wire.do(wire.host.motor.disarm)
    wire.wait(60)
    first, second = wire.sent()
    wire.state(cmd_seq=first.seq, lock=2)
    wire.arm()
    wire.state(cmd_seq=second.seq if own else 40_000, lock=3)
    assert [request.lock for request in wire.sent(Arm)] == ([2, 3] if own else [2])


def test_an_arming_that_expires_before_the_first_state_shows_it_is_not_attributed_to_another_program():
    wire = Wire()
    wire.state()
    wire.arm()
    ended = wire.state(cmd_seq=wire.sent(Arm)[-1].seq, lock=2, status=Status.WATCHDOG)
    assert only(ended, ArmingEnded) == [ArmingEnded("the board's watchdog tripped")]


def test_a_board_with_an_older_protocol_is_reported_and_not_armed():
    wire = Wire(hello=None)
    data = struct.pack('<BBHIiiihHHH', 1, 1, 1, 10_000, 0, 0, 0, 0, 2400, 0, 0)
    reports = [r for _ in range(3) for r in only(wire.do(wire.host.receive, frame(data)), Report)]
    assert [report.level for report in reports] == [Level.ERROR]
    assert 'version 1 of the protocol, and this bridge version 2: flash' in reports[0].text
    assert 'version 1' in wire.refusal()
    wire.receive(HELLO)
    wire.state()
    assert wire.host.condition(wire.now).level is Level.OK


# Limits, zeros and the clock


@pytest.mark.parametrize(
    ('config', 'limits', 'text'),
    [
        ({'max_speed': 60.0}, {}, 'max_speed is 60, and the board has a limit of 100'),
        ({}, {'max_speed': 0}, 'max_speed is 100, and the board has no limit'),
        ({'max_travel': (6.0, 0.0)}, {'max_travel1': 7000}, 'max_travel of the shoulder is 6, and'),
        ({'max_travel': (0.0, 9.0)}, {}, 'max_travel of the elbow is 9, and the board has no limit'),
    ],
)
def test_a_board_with_looser_limits_than_the_users_is_not_armed(config, limits, text):
    wire = Wire(replace(ASSUMED, **config), **limits)
    wire.state()
    assert text in wire.refusal()
    assert text in wire.host.condition(wire.now).text


@pytest.mark.parametrize(
    ('limits', 'state', 'named'),
    [
        ({}, lambda k: {'enc1': 700 * k}, 'speed'),
        ({'max_travel2': 3000}, lambda k: {'enc2': 200 * k}, 'travel'),
        ({'stall_torque': 400_000, 'stall_ms': 50}, lambda k: {}, 'stall'),
    ],
)
def test_a_limit_that_the_board_does_not_enforce_disarms(limits, state, named):
    wire, reports, k = Wire(**limits).armed(), [], 0
    obeyed = wire.effort(0.5)
    while wire.host.armed and (k := k + 1) < 20:
        reports += texts(wire.state(**obeyed, **state(k)))
    assert not wire.host.armed
    assert f'a limit is exceeded ({named}), and the board does not switch off' in reports[0]


def test_confirmed_zeros_are_sent_until_acknowledged_and_the_boards_state_counts_for_every_host():
    wire = Wire(HostConfig())
    closed = Host()
    closed.closed('the port x is missing', 0)
    assert closed.confirm_zeros(0) == (False, 'no angle arrives: the port x is missing')
    wire.states(10)
    assert 'were not at rest for a second (q1 = ' in wire.host.confirm_zeros(wire.now)[1]
    wire.states(100)
    wire.sent()
    assert wire.host.confirm_zeros(wire.now)[0]
    wire.states(6)
    wire.states(4, status=Status.ZEROED)
    assert [(c.mode, c.session) for c in wire.sent()] == 2 * [(Mode.CONFIRM_ZEROS, HELLO.boot_id)]
    wire.receive(HELLO._replace(seq=170, boot_id=78))
    wire.state(171, 1000)
    wire.receive(HELLO._replace(seq=172, boot_id=78))
    assert 'let both links hang at rest' in wire.refusal()
    wire.state(173, 21_000, status=Status.ZEROED)
    assert wire.arm() == []


def test_a_wrong_timestamp_is_counted_and_a_wrong_clock_rate_is_reported_within_a_second():
    wire, health = Wire(), Health()
    for k in range(1, 200):
        wire.state(k, 10_000 * k + (65_536 if k in (100, 150) else 0))
    level, message, _ = health.diagnose(wire.host, wire.now)
    assert (level, 'irregular stamps: 2 more' in message) == (Level.WARN, True)
    fast = Wire(hello=HELLO._replace(sample_period_us=10_500))
    (report,) = [r for k in range(1, 100) for r in only(fast.state(k, 10_500 * k), Report)]
    assert "the board's clock runs 4.8 % fast" in report.text
    assert fast.host.condition(fast.now) == Report(Level.WARN, report.text)


# Commanding


@pytest.mark.parametrize(('configured', 'longest'), [(40, 500), (400, 40)])
def test_at_least_two_commands_are_sent_per_watchdog_period_of_the_board_or_the_configuration(configured, longest):
    wire, sent = Wire(replace(ASSUMED, watchdog_ms=configured), HELLO._replace(watchdog_max_ms=longest)).armed(), []
    for _ in range(200):
        for _ in range(5):
            wire.wait(2)
            sent += [wire.now] * len(wire.sent(Command))
        wire.obeying(step=0)
    assert max(b - a for a, b in pairwise(sent)) <= 20 * MS
    assert wire.host.armed


@pytest.mark.parametrize(('configured', 'limit'), [(0.3, 300_000), (5.0, 1_200_000)])
def test_torque_is_clamped_to_the_smaller_limit_and_clamping_is_reported_once(configured, limit):
    wire = Wire(replace(ASSUMED, torque_limit=configured), HELLO._replace(torque_limit=1_200_000)).armed()
    health, reports = Health(), []
    for k in range(200):
        reports += texts(wire.command((-1) ** k * 10.0))
        assert wire.sent()[-1].torque == (-1) ** k * limit
        wire.state(**wire.effort(-0.1))
    assert reports == [f'an effort command is 10 N m; at most {limit / 1e6:g} N m are sent']
    level, _, values = health.diagnose(wire.host, wire.now)
    assert (level, values['clamped']) == (Level.WARN, '200')
    assert values['torque limit [N m]'] == f'{limit / 1e6:g}'
    wire.command(0.1234567)
    assert wire.sent()[-1].torque == 123_457


@pytest.mark.parametrize('pause', [0, 300_000, 7 * MS, 600 * MS])
@pytest.mark.parametrize('timeout', [0.001, 0.004, 0.1, 0.5])
def test_polling_only_at_next_poll_ends_the_torque_exactly_at_the_command_timeout(timeout, pause):
    # Samples a second apart, so that only polls advance the host's time.
    hello = HELLO._replace(sample_period_us=1_000_000, watchdog_max_ms=10_000)
    wire = Wire(replace(ASSUMED, command_timeout=timeout, watchdog_ms=10_000), hello).armed()
    poll, commanded, torque = wire.now, wire.now + pause, 0
    wire.now = commanded
    while not torque or 0 not in (command.torque for command in wire.sent(Command)):
        poll += wire.host.motor.next_poll(poll)
        if poll >= commanded and not torque:
            torque = wire.effort(0.5)['torque']
        wire.host.poll(poll)
    assert poll == commanded + round(timeout * 1e9)


# Causes of disarming


@pytest.mark.parametrize(
    ('event', 'text', 'counted'),
    [
        (lambda wire: wire.wait(10, times=12), 'link lost', {'link_losses': 1}),
        (lambda wire: wire.obeying(status=Status.WATCHDOG), "disarmed: the board's watchdog tripped", {'trips': 1}),
        (lambda wire: wire.obeying(status=Status.OVER_CURRENT), 'the board reports a fault: over current', {}),
        (lambda wire: wire.command(*3 * [math.nan]), 'an effort command is nan', {'not_finite': 3}),
        (lambda wire: wire.command(-math.inf), 'an effort command is -inf', {'not_finite': 1}),
        (
            lambda wire: wire.receive(HELLO._replace(seq=2, boot_id=78)),
            'the board restarted',
            {'restarts': 1, 'lost': 0},
        ),
    ],
)
def test_the_host_disarms_reports_once_and_stays_disarmed_until_the_next_call_to_arm(event, text, counted):
    wire = Wire().armed()
    wire.sent()
    events = event(wire)
    assert not wire.host.armed
    disarm = next(command for command in wire.sent(Command) if command.mode == Mode.DISARM)
    events += wire.command(0.5) + wire.states(60, cmd_seq=disarm.seq, lock=2)
    assert not wire.host.armed
    assert Mode.TORQUE not in [command.mode for command in wire.sent(Command)]
    assert len([report for report in texts(events) if report.startswith(text)]) == 1
    assert {name: getattr(wire.host.counters, name) for name in counted} == counted
    wire.armed(cmd_seq=disarm.seq, lock=2)


SLOW = HELLO._replace(sample_period_us=1_000_000)


@pytest.mark.parametrize(
    ('config', 'hello', 'armed_samples', 'longest_ms'),
    [
        (HostConfig(), HELLO, 0, 100),
        (HostConfig(), HELLO._replace(sample_period_us=100_000), 0, 500),
        (HostConfig(link_timeout=1.0), HELLO, 0, 1000),
        # An armed link is lost after 500 ms for any period in HELLO; after ten samples the measured period counts.
        (ASSUMED, SLOW, 2, 500),
        (ASSUMED, SLOW, 13, 100),
    ],
)
def test_a_link_is_lost_after_100_ms_five_periods_or_the_configured_time_and_an_armed_one_after_500_ms(
    config, hello, armed_samples, longest_ms
):
    wire = Wire(config, hello)
    if armed_samples:
        wire.armed().states(armed_samples - 2, **wire.obeyed)
    wire.wait(10, times=longest_ms // 10)
    assert (wire.host.link, wire.host.armed) == ('up', armed_samples > 0)
    wire.wait(10)
    assert (wire.host.link, wire.host.armed) == ('silent', False)
    assert not armed_samples or wire.sent(Command)[-1].mode == Mode.DISARM


def test_a_board_that_answers_without_samples_is_reported_lost_once():
    wire, reports = Wire(), []
    wire.state()
    for seq in range(2, 22):
        reports += wire.wait(10, times=20)
        reports += wire.receive(HELLO._replace(seq=seq))
    assert ['link lost' in report.text for report in reports] == [True]
    assert wire.host.condition(0) == Report(Level.ERROR, 'no valid sample arrives from the board')
    assert texts(wire.state(22, 20_000)) == ['the board sends again']
    assert wire.host.link == 'up'


def test_a_suspended_program_reads_buffered_frames_before_it_reports_a_lost_link():
    wire = Wire().armed()
    wire.wait(0)
    wire.wait(500)
    frames = [State(k, 10_000 * k, 0, 0, 0, 0, 2400, wire.obeyed['cmd_seq'], Status.ARMED, 1) for k in range(3, 53)]
    wire.host.receive(b''.join(map(encode, frames)), wire.now)
    assert (wire.host.counters.link_losses, wire.host.counters.lost, wire.host.armed) == (0, 0, True)


@pytest.mark.parametrize('boot_id', [HELLO.boot_id, 78])
def test_a_closed_port_disarms_and_requires_a_new_hello(boot_id):
    """The same boot is still armed; another boot identifier is a board that lost power meanwhile."""
    wire, restarted = Wire().armed(), boot_id != HELLO.boot_id
    wire.do(wire.host.closed, 'the port was lost')
    assert wire.host.condition(0) == Report(Level.ERROR, 'the port was lost')
    assert wire.sent() == []
    wire.do(wire.host.opened)
    assert not only(wire.state(50, **{} if restarted else wire.obeyed), Sample)
    (disarm,) = wire.sent(Command)
    assert disarm.mode == Mode.DISARM
    wire.receive(HELLO._replace(seq=51, boot_id=boot_id))
    wire.state(52, cmd_seq=disarm.seq, lock=2)
    assert (wire.host.counters.restarts, wire.host.counters.lost) == (restarted, 0)
    assert wire.host.condition(0) == Report(Level.WARN, 'disarmed: the link was lost; arm again when it is safe')
    wire.armed(cmd_seq=disarm.seq, lock=2)
    assert wire.host.condition(0) == Report(Level.OK, 'armed')


def test_the_first_request_is_decoded_after_an_unfinished_frame_of_an_earlier_host():
    host, board = Host(), Decoder(accept=(Command, HelloRequest))
    board.feed(encode(Command(1, 0, Mode.TORQUE, 100, 0))[:-5])
    host.opened(0)
    assert isinstance(board.feed(host.output.take_data())[-1], HelloRequest)


def test_repeated_failures_of_a_port_are_reported_once_until_a_frame_arrives():
    wire = Wire()
    reports = texts(wire.do(wire.host.closed, 'it was lost'))
    for received in (*20 * (False,), True):
        wire.do(wire.host.opened)
        if received:
            wire.state()
        reports += texts(wire.do(wire.host.closed, 'it was lost'))
    assert reports == 2 * ['it was lost']
    assert wire.host.counters.link_losses == 2


def test_an_intermittent_fault_is_reported_once():
    wire, reports = Wire(), []
    for k in range(1, 400):
        reports += texts(wire.state(status=Status.UNDERVOLTAGE * (k % 2) | Status.ENCODER_1 * (k == 101)))
    assert [text.split(': ')[1] for text in reports] == ['undervoltage', 'encoder 1']
    reports += texts(wire.states(110) + wire.state(status=Status.UNDERVOLTAGE))
    assert len(reports) == 3


@pytest.mark.parametrize('before_us', [50_000, 9_000_000, WRAP - 2_400_000_000])
def test_a_restart_is_not_mistaken_for_a_wrap_of_the_clock(before_us):
    wire = Wire(hello=HELLO._replace(seq=39_999))
    wire.state(40_000, WRAP - before_us - 10_000, enc1=3000)
    wire.state(40_001, WRAP - before_us, enc1=3000)
    wire.state(1, 100)
    assert wire.host.counters.restarts == 1
    # The counters were reset, too.
    wire.receive(HELLO._replace(seq=2))
    assert len(only(wire.state(3, 20_100), Sample)) == 1
