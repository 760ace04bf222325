"""The host's rules, each held against a virtual board without any port or clock."""

import math
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.level import Level
from pendubot_identification.link.clock import WRAP
from pendubot_identification.link.health import Health
from pendubot_identification.link.host import Host
from pendubot_identification.link.host_config import HostConfig
from pendubot_identification.link.news import Armed, ArmingFailed, Report, Sample
from pendubot_identification.link.protocol import (
    Command,
    Decoder,
    Hello,
    HelloRequest,
    Mode,
    State,
    Status,
    encode,
)
from pendubot_identification.link.virtual_board import BoardSettings, Faults, VirtualBoard
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import Plant

MS = 1_000_000
HELLO = Hello(0, 0, 77, 1, 500, 4000, 2000, 1_500_000, 10_000, 'test')


def only(events, kind):
    return [event for event in events if isinstance(event, kind)]


class Rig:
    """A host and a virtual board on a perfect cable, a sample every 10 ms; every event and frame is kept."""

    def __init__(self, config=None, settings=None, faults=None):
        self.host = Host(config)
        self.board = VirtualBoard(Plant(PAPER), settings or BoardSettings(), faults)
        self.now = 10**12
        self.events = self.host.opened(self.now)
        self.commands = []
        self.states = []
        self.heard = Decoder(accept=(Command, HelloRequest))
        self.connected = True

    def step(self, samples=1):
        """Let time pass; returns the events."""
        before = len(self.events)
        for _ in range(samples):
            self.deliver()
            data = self.board.advance()
            self.states.append(self.board.last)
            for _ in range(5):
                self.now += 2 * MS
                self.events += self.host.poll(self.now)
            if self.connected:
                self.events += self.host.receive(data, self.now)
        self.deliver()
        return self.events[before:]

    def deliver(self):
        data = self.host.data_to_send()
        self.commands += [(self.now, c) for c in self.heard.feed(data) if isinstance(c, Command)]
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
        self.host = Host(config)
        self.now = 10**12
        self.host.opened(self.now)
        if hello:
            self.host.receive(encode(hello), self.now)

    def state(self, seq, t_us, enc1=0, enc2=0, torque=0, status=0, cmd_seq=0, step=10 * MS):
        self.now += step
        return self.host.receive(encode(State(seq, t_us, enc1, enc2, torque, 0, 2400, cmd_seq, status)), self.now)

    def wait(self, ms):
        self.now += ms * MS
        return self.host.poll(self.now)

    def sent(self):
        return Decoder(accept=(Command, HelloRequest)).feed(self.host.data_to_send())


# Start


def test_hello_is_asked_for_every_200_ms_until_it_came():
    host, now, asked = Host(), 0, []
    host.opened(now)
    for _ in range(500):
        asked += [now] * len(Decoder((HelloRequest,)).feed(host.data_to_send()))
        now += 2 * MS
        host.poll(now)
    assert asked == [k * 200 * MS for k in range(5)]
    host.receive(encode(HELLO), now)
    host.data_to_send()
    for _ in range(49):
        host.poll(now := now + 2 * MS)
    assert host.data_to_send() == b''


def test_samples_before_hello_are_not_published():
    wire = Wire(hello=None)
    assert only(wire.state(0, 0), Sample) == []
    assert wire.host.counters().unscaled == 1


def test_given_counts_per_turn_need_no_hello():
    wire = Wire(HostConfig(counts_per_turn=(1000, 1000)), hello=None)
    (sample,) = only(wire.state(0, 0, enc2=250), Sample)
    assert sample.q == pytest.approx((-math.pi / 2, math.pi / 2))


def test_a_board_without_counts_per_turn_is_reported_once_and_asked_again():
    wire = Wire(hello=None)
    reports = [e for k in range(3) for e in wire.host.receive(encode(replace(HELLO, seq=k, cpr1=0)), wire.now)]
    assert ['0 counts per turn' in report.text for report in reports] == [True]
    wire.sent()
    wire.wait(200)
    assert only(wire.sent(), HelloRequest)
    assert wire.host.condition().level > Level.OK


@pytest.mark.parametrize(
    ('change', 'text'), [({'cpr2': 0}, '0 counts per turn'), ({'torque_limit': -5}, 'torque limit')]
)
def test_a_hello_that_makes_no_sense_is_reported_and_changes_nothing(change, text):
    wire = Wire()
    wire.state(1, 10_000)
    (report,) = wire.host.receive(encode(replace(HELLO, seq=2, **change)), wire.now)
    assert (report.level, text in report.text) == (Level.ERROR, True)
    assert wire.host.hello == HELLO
    assert len(only(wire.state(3, 20_000), Sample)) == 1


def test_another_nonsense_is_reported_too_and_stands_in_the_diagnosis():
    wire = Wire(hello=None)
    for k, change in enumerate([{'cpr1': 0}, {'cpr1': 0}, {'torque_limit': -5}]):
        reports = only(wire.host.receive(encode(replace(HELLO, seq=k, **change)), wire.now), Report)
        assert len(reports) == (k != 1)
        assert ('torque limit' in wire.host.condition().text) == (k == 2)
        assert wire.host.condition().level == Level.ERROR


def test_counts_per_turn_given_for_one_encoder_replace_what_the_board_does_not_know():
    wire = Wire(HostConfig(counts_per_turn=(1000, 0)), replace(HELLO, cpr1=0))
    (sample,) = only(wire.state(1, 10_000, enc1=250, enc2=500), Sample)
    assert sample.q == pytest.approx((0.0, math.pi / 2))


def test_a_board_that_changes_its_counts_per_turn_introduces_itself_again():
    wire = Wire()
    assert wire.host.receive(encode(replace(HELLO, seq=1)), wire.now) == []
    (report,) = wire.host.receive(encode(replace(HELLO, seq=2, cpr1=8000)), wire.now)
    assert '8000' in report.text


def test_a_board_that_does_not_answer_is_reported_once():
    wire = Wire(hello=None)
    reports = [(k, report) for k in range(1, 21) for report in wire.wait(200)]
    assert [(k, report.level) for k, report in reports] == [(5, Level.WARN)]


# Published


def test_positions_velocities_and_effort():
    wire = Wire(HostConfig(sign=(1, -1), zero=(0.5, 0.25)))
    wire.state(1, 10_000)
    (sample,) = only(wire.state(2, 20_000, enc1=40, enc2=10, torque=-250_000), Sample)
    assert sample.q == pytest.approx((0.5 + 2 * math.pi * 40 / 4000, 0.25 - 2 * math.pi * 10 / 2000))
    assert sample.qd == pytest.approx((2 * math.pi * 40 / 4000 / 0.01, -2 * math.pi * 10 / 2000 / 0.01))
    assert sample.effort == -0.25


def test_velocity_at_1_khz_is_taken_over_ten_samples():
    wire = Wire()
    for k in range(1, 30):
        (sample,) = only(wire.state(k, 1000 * k, enc1=4 * k, step=MS), Sample)
    assert sample.qd[0] == pytest.approx(2 * math.pi * 4 / 4000 / 1e-3)


def test_no_frame_is_published_twice_or_out_of_order():
    wire = Wire()
    published = [seq for seq in (1, 2, 2, 4, 3, 5) if only(wire.state(seq, 10_000 * seq), Sample)]
    assert published == [1, 2, 4, 5]
    counters = wire.host.counters()
    assert (counters.lost, counters.duplicates, counters.out_of_order) == (1, 1, 1)


def test_numbers_that_went_more_than_half_round_unheard_are_not_taken_for_old_ones():
    """As after a program was stopped for 40 s at 1 kHz, and reads what the kernel kept before what is new."""
    wire = Wire()
    wire.state(1, 1000)
    assert only(wire.state(40_000, 40_000_000, step=40_000 * MS), Sample)
    assert only(wire.state(40_001, 40_001_000), Sample)
    assert wire.host.counters().lost == 39_998
    assert not only(wire.state(39_999, 39_999_000), Sample)
    assert wire.host.counters().out_of_order == 1


def test_a_late_frame_is_no_restart():
    wire = Wire()
    for seq in (1, 3, 2, 4):
        wire.state(seq, 10_000 * seq)
    assert wire.host.counters().restarts == 0


def test_damage_is_counted_apart_from_loss():
    wire = Wire()
    wire.state(1, 10_000)
    bad = bytearray(encode(State(2, 20_000, 0, 0, 0, 0, 0, 0, 0)))
    bad[9] ^= 4
    assert wire.host.receive(bytes(bad), wire.now) == []
    wire.state(3, 30_000)
    counters = wire.host.counters()
    assert (sum(counters.damaged.values()), counters.lost) == (1, 1)


def test_an_encoder_glitch_is_flagged_and_leaves_no_velocity_spike():
    wire = Wire()
    for k in range(1, 10):
        wire.state(k, 10_000 * k)
    assert only(wire.state(10, 100_000, enc1=2000), Sample) == []
    (sample,) = only(wire.state(11, 110_000), Sample)
    assert sample.qd == (0.0, 0.0)
    assert wire.host.counters().flagged == 1


def test_five_in_a_row_are_believed_and_reported():
    wire = Wire()
    wire.state(1, 10_000)
    events = [wire.state(k, 10_000 * k, enc2=20_000) for k in range(2, 9)]
    assert [len(only(e, Sample)) for e in events] == [0, 0, 0, 0, 0, 1, 1]
    assert [len(only(e, Report)) for e in events] == [0, 0, 0, 0, 1, 0, 0]
    assert only(events[-2], Sample)[0].qd == (0.0, 0.0)


# Arming


def test_nothing_but_arm_arms():
    rig = Rig()
    rig.step(10)
    rig.effort(0.5)
    rig.step(50)
    assert not rig.host.armed
    assert rig.commands == []
    assert not any(s.status & Status.ARMED or s.torque for s in rig.states)
    assert rig.host.counters().discarded == 1


def test_arming_is_mode_0_then_mode_1_without_torque_and_succeeds_once_a_state_says_so():
    rig = Rig()
    rig.step(3)
    events = rig.host.arm(rig.now)
    rig.effort(1.0)
    assert only(events, Armed) == []
    assert only(rig.step(2), Armed) == [Armed()]
    first, second = (command for _, command in rig.commands[:2])
    assert (first.mode, second.mode, second.torque) == (Mode.DISARM, Mode.TORQUE, 0)
    assert not any(command.torque for _, command in rig.commands)


def test_arming_without_a_port_or_board_or_hello_fails_at_once():
    host = Host()
    assert only(host.arm(0), ArmingFailed)
    host.opened(0)
    assert only(host.arm(0), ArmingFailed)
    wire = Wire(hello=None)
    wire.state(0, 0)
    assert 'HELLO' in only(wire.host.arm(wire.now), ArmingFailed)[0].reason


def test_arming_fails_after_half_a_second_and_ends_disarmed():
    wire = Wire()
    wire.state(1, 10_000)
    wire.host.arm(begun := wire.now)
    seq, failed = 2, []
    while not failed:
        wire.host.poll(wire.now)
        failed = only(wire.state(seq, 10_000 * seq), ArmingFailed) + only(wire.host.poll(wire.now), ArmingFailed)
        seq += 1
    assert wire.now - begun == 500 * MS
    assert wire.sent()[-1].mode == Mode.DISARM


def test_a_state_from_before_this_arming_does_not_count():
    wire = Wire()
    wire.state(1, 10_000, status=Status.ARMED, cmd_seq=9999)
    wire.host.arm(wire.now)
    assert only(wire.state(2, 20_000, status=Status.ARMED, cmd_seq=9999), Armed) == []
    mode_1 = next(c for c in wire.sent() if isinstance(c, Command) and c.mode == Mode.TORQUE)
    assert only(wire.state(3, 30_000, status=Status.ARMED, cmd_seq=mode_1.seq), Armed) == [Armed()]


def test_a_board_left_armed_by_somebody_else_is_disarmed():
    wire = Wire()
    wire.sent()
    wire.state(1, 10_000, status=Status.ARMED)
    assert [c.mode for c in wire.sent()] == [Mode.DISARM]


def test_a_standing_fault_refuses_arming_by_name():
    rig = Rig(faults=Faults(emergency_stop_at=0.0))
    rig.step(3)
    (failed,) = only(rig.host.arm(rig.now), ArmingFailed)
    assert 'emergency stop' in failed.reason


# Commanding


def test_at_least_two_commands_for_each_watchdog_period():
    rig = Rig(HostConfig(watchdog_ms=40)).armed()
    begun = len(rig.commands)
    rig.step(200)
    times = [at for at, _ in rig.commands[begun:]]
    assert max(b - a for a, b in pairwise(times)) <= 20 * MS
    assert rig.host.armed


def test_the_boards_shorter_watchdog_counts():
    rig = Rig(HostConfig(watchdog_ms=400), BoardSettings(watchdog_max_ms=30)).armed()
    rig.step(100)
    assert rig.host.armed


def test_a_torque_is_sent_at_once_and_reaches_the_motor():
    rig = Rig().armed()
    rig.effort(0.1234567)
    rig.step(2)
    assert rig.board.last.torque == 123457
    assert only(rig.events, Sample)[-1].effort == pytest.approx(0.123457)


@pytest.mark.parametrize(('configured', 'limit'), [(0.3, 300_000), (5.0, 1_200_000)])
def test_torque_is_clamped_to_the_smaller_limit(configured, limit):
    rig = Rig(HostConfig(torque_limit=configured), BoardSettings(torque_limit=1.2)).armed()
    for torque in (10.0, -10.0):
        rig.effort(torque)
        assert rig.commands[-1][1].torque == math.copysign(limit, torque)
    assert rig.host.counters().clamped == 2


def test_a_torque_over_the_limit_is_reported_once_while_it_goes_on():
    rig = Rig(HostConfig(torque_limit=0.3, command_timeout=10.0)).armed()
    for _ in range(200):
        rig.effort(7.0)
        rig.effort(-0.1)
        rig.step(1)
    assert rig.reports() == ['an effort command of 7 N m came; at most 0.3 N m are sent']
    rig.step(101)
    rig.effort(-7.0)
    assert len(rig.reports()) == 2


@pytest.mark.parametrize('torque', [math.nan, math.inf, -math.inf])
def test_a_torque_that_is_not_finite_is_never_sent_disarms_and_is_reported_once(torque):
    rig = Rig().armed()
    rig.effort(0.5)
    for _ in range(3):
        rig.effort(torque)
    assert (rig.commands[-1][1].mode, rig.commands[-1][1].torque) == (Mode.DISARM, 0)
    rig.step(5)
    assert not rig.host.armed
    assert not rig.board.armed
    assert len([text for text in rig.reports() if 'finite' in text]) == 1
    assert rig.host.counters().not_finite == 3
    rig.effort(0.5)
    rig.step(5)
    assert rig.board.last.torque == 0


def test_when_effort_commands_stop_the_torque_is_0_still_armed_and_reported():
    rig = Rig().armed()
    rig.effort(0.5)
    rig.step(9)
    assert rig.board.last.torque == 500_000
    rig.step(5)
    assert rig.board.last.torque == 0
    assert rig.host.armed
    assert rig.host.condition().level == Level.WARN
    rig.step(100)
    assert len([text for text in rig.reports() if 'no effort command' in text]) == 1
    rig.effort(0.5)
    rig.step(2)
    assert rig.board.last.torque == 500_000
    assert rig.host.condition() == Report(Level.OK, 'armed')


@given(
    timeout=st.sampled_from([0.001, 0.004, 0.1, 0.5]),
    pauses=st.lists(st.integers(0, 600 * MS), min_size=1, max_size=4),
)
def test_one_who_polls_only_when_told_takes_the_torque_back_at_its_moment(timeout, pauses):
    # Samples a second apart: nothing else tells the host what time it is.
    hello = replace(HELLO, sample_period_us=1_000_000, watchdog_max_ms=10_000)
    wire = Wire(HostConfig(command_timeout=timeout, watchdog_ms=10_000), hello)
    wire.state(0, 0)
    wire.host.arm(wire.now)
    wire.state(1, 10_000, status=Status.ARMED, cmd_seq=wire.sent()[-1].seq)
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


def test_disarm_disarms():
    rig = Rig().armed()
    rig.effort(0.5)
    rig.host.disarm(rig.now)
    rig.step(2)
    assert not rig.board.armed
    assert rig.board.last.torque == 0
    assert rig.reports() == []


def test_a_silent_link_is_lost_after_100_ms_disarms_and_stays_so():
    rig = Rig().armed()
    rig.connected = False
    rig.step(9)
    assert rig.host.armed
    rig.step(3)
    assert not rig.host.armed
    assert rig.host.link == 'silent'
    rig.step(50)
    rig.connected = True
    published = len(only(rig.events, Sample))
    rig.step(30)
    assert len(only(rig.events, Sample)) == published + 30
    assert not rig.host.armed
    assert not rig.board.armed
    counters = rig.host.counters()
    assert (counters.link_losses, counters.lost) == (1, 62)


def test_a_board_that_answers_but_does_not_sample_is_lost_once():
    wire = Wire()
    wire.state(1, 10_000)
    reports = []
    for seq in range(2, 22):
        for _ in range(20):
            reports += wire.wait(10)
        reports += wire.host.receive(encode(replace(HELLO, seq=seq)), wire.now)
    assert ['link lost' in report.text for report in reports] == [True]
    assert wire.host.condition() == Report(Level.ERROR, 'no valid sample comes from the board')
    events = wire.state(22, 20_000)
    assert [report.text for report in only(events, Report)] == ['the board is heard again']
    assert wire.host.link == 'up'


def test_a_frame_that_comes_again_after_a_silence_is_not_published_twice():
    wire = Wire()
    wire.state(1, 10_000)
    wire.wait(200)
    wire.wait(10)
    assert wire.host.link == 'silent'
    assert only(wire.state(1, 10_000), Sample) == []
    assert len(only(wire.state(9, 300_000), Sample)) == 1
    counters = wire.host.counters()
    assert (counters.published, counters.duplicates, counters.lost) == (2, 1, 7)


def test_a_slow_board_may_be_silent_for_five_periods():
    wire = Wire(hello=replace(HELLO, sample_period_us=100_000))
    for _ in range(49):
        wire.wait(10)
    assert wire.host.link == 'up'
    for _ in range(3):
        wire.wait(10)
    assert wire.host.link == 'silent'


def test_a_virtual_rig_may_be_silent_for_as_long_as_its_host_is_told():
    rig = Rig(HostConfig(watchdog_ms=2000, link_timeout=1.0)).armed()
    rig.connected = False
    rig.step(99)
    assert rig.host.armed
    rig.step(3)
    assert not rig.host.armed


def test_a_program_that_was_held_up_reads_first_before_it_calls_the_link_lost():
    rig = Rig().armed()
    data = b''.join(rig.board.advance() for _ in range(50))
    rig.now += 500 * MS
    rig.events += rig.host.poll(rig.now)
    rig.events += rig.host.receive(data, rig.now)
    assert rig.host.counters().link_losses == 0
    assert rig.host.counters().lost == 0


def test_a_closed_port_disarms_and_needs_a_new_hello():
    rig = Rig().armed()
    rig.events += rig.host.closed('the port was lost', rig.now)
    assert rig.host.condition() == Report(Level.ERROR, 'the port was lost')
    assert rig.host.data_to_send() == b''
    rig.events += rig.host.opened(rig.now)
    rig.events += rig.host.receive(rig.board.advance(), rig.now)
    assert rig.host.counters().unscaled == 1
    rig.step(3)
    assert rig.host.link == 'up'
    assert not rig.host.armed
    assert rig.host.counters().lost == 0


def test_a_port_that_fails_again_and_again_is_said_once():
    wire = Wire()
    wire.state(1, 10_000)
    reports = [report for _ in range(20) for report in only(wire.host.closed('it was lost', wire.now), Report)]
    for _ in range(20):
        wire.host.opened(wire.now)
        reports += only(wire.host.closed('it was lost', wire.now), Report)
    assert [report.text for report in reports] == ['it was lost']
    wire.host.opened(wire.now)
    wire.state(2, 20_000)
    assert only(wire.host.closed('it was lost', wire.now), Report)
    assert wire.host.counters().link_losses == 2
    # Silent before it is lost: once more the same words, and news.
    wire.host.opened(wire.now)
    wire.state(3, 30_000)
    wire.wait(10)
    assert 'link lost' in only(wire.wait(40) + wire.wait(40) + wire.wait(40), Report)[0].text
    assert only(wire.host.closed('it was lost', wire.now), Report)


def test_a_board_that_is_still_armed_when_the_cable_is_back_is_disarmed_at_once():
    rig = Rig().armed()
    rig.effort(0.5)
    rig.host.closed('the port was lost', rig.now)
    rig.host.opened(rig.now)
    assert rig.board.armed
    rig.step(1)
    assert not rig.board.armed


def test_a_watchdog_trip_disarms_until_told_again():
    rig = Rig().armed()
    rig.connected = False
    rig.step(9)
    rig.board.advance()
    rig.board.advance()
    rig.connected = True
    rig.step(1)
    rig.step(50)
    assert not rig.host.armed
    assert not rig.board.armed
    assert rig.host.counters().trips == 1
    assert any('watchdog' in text for text in rig.reports())
    rig.armed()


def test_a_fault_disarms_until_told_again():
    rig = Rig(faults=Faults(over_current_at=0.2)).armed()
    rig.step(50)
    assert not rig.host.armed
    assert any('over current' in text for text in rig.reports(Level.ERROR))
    rig.armed()


def test_a_fault_that_chatters_is_one_occurrence():
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


@pytest.mark.parametrize('hello_arrives', [True, False])
def test_a_restart_disarms_asks_for_hello_and_begins_anew(hello_arrives):
    rig = Rig(faults=Faults(reset_at=0.5)).armed()
    while rig.board.last.t_us < 490_000:
        rig.step()
    data = rig.board.advance()
    frames = [part + b'\0' for part in data.split(b'\0')[:-1]]
    assert len(frames) == 2
    rig.now += 10 * MS
    rig.events += rig.host.receive(data if hello_arrives else frames[1], rig.now)
    assert not rig.host.armed
    assert any(isinstance(e, HelloRequest) for e in Decoder((Command, HelloRequest)).feed(rig.host.data_to_send()))
    rig.events += rig.host.poll(rig.now)
    rig.step(30)
    counters = rig.host.counters()
    assert (counters.restarts, counters.lost, counters.duplicates, counters.out_of_order) == (1, 0, 0, 0)
    assert len([text for text in rig.reports() if text.startswith('the board restarted')]) == 1
    stamps = [sample.stamp_ns for sample in only(rig.events, Sample)]
    assert all(a < b for a, b in pairwise(stamps))
    assert not rig.board.armed
    rig.armed()


def test_a_restart_long_after_boot_is_no_wrap():
    wire = Wire(hello=replace(HELLO, seq=39_999))
    wire.state(40_000, 2_400_000_000)
    wire.state(1, 10_000)
    assert wire.host.counters().restarts == 1


@pytest.mark.parametrize('before_us', [50_000, 1_000_000, 9_000_000])
def test_a_restart_shortly_before_the_clock_would_wrap_is_no_wrap(before_us):
    wire = Wire(hello=replace(HELLO, seq=39_999))
    wire.state(40_000, WRAP - before_us - 10_000)
    wire.state(40_001, WRAP - before_us)
    wire.state(1, 100)
    assert wire.host.counters().restarts == 1


@pytest.mark.parametrize('held_up_ms', [400, 60_000])
def test_a_wrap_among_samples_that_waited_and_were_lost_is_no_restart(held_up_ms):
    """A process that stood still reads what its buffer took, and then what comes now."""
    wire = Wire(hello=replace(HELLO, seq=999))
    for k in range(100):
        wire.state(1000 + k, WRAP - 1_050_000 + 10_000 * k)
    wire.now += held_up_ms * MS
    for k in range(100, 105):
        wire.state(1000 + k, (WRAP - 1_050_000 + 10_000 * k) % WRAP, step=0)
    wire.state(1099 + held_up_ms // 10, held_up_ms * 1000 - 60_000, step=0)
    assert wire.host.counters().restarts == 0


def test_a_wrap_of_the_clock_is_no_restart():
    rig = Rig(settings=BoardSettings(clock_start_us=2**32 - 500_000))
    rig.step(100)
    assert rig.host.counters().restarts == 0
    stamps = [sample.stamp_ns for sample in only(rig.events, Sample)]
    assert stamps == [stamps[0] + k * 10 * MS for k in range(100)]


def test_after_seq_wraps_nothing_is_lost():
    rig = Wire()
    for k in range(1, 70_000):
        rig.state(k % 65536, 1000 * k, step=MS)
    assert rig.host.counters().lost == 0


# Diagnosis


def test_what_is_reported_stands_in_the_next_diagnosis_only():
    rig = Rig().armed()
    health = Health()
    for event in rig.effort(math.nan):
        if isinstance(event, Report):
            health.note(event)
    first = health.diagnose(rig.host, rig.now)
    assert first.level == Level.ERROR
    assert 'nan' in first.message
    rig.step(5)
    second = health.diagnose(rig.host, rig.now)
    assert (second.level, second.message) == (Level.OK, 'disarmed')
    assert second.values['rate [Hz]'] == '100.0'
    assert second.values['not_finite'] == '1'


def test_growing_losses_are_a_warning():
    wire = Wire()
    wire.state(1, 10_000)
    health = Health()
    health.diagnose(wire.host, wire.now)
    wire.state(5, 50_000)
    diagnosis = health.diagnose(wire.host, wire.now)
    assert diagnosis.level == Level.WARN
    assert 'lost: 3 more' in diagnosis.message


def test_torques_that_go_on_beyond_the_limit_stay_a_warning():
    rig = Rig(HostConfig(torque_limit=0.3)).armed()
    health = Health()
    levels = []
    for _ in range(3):
        rig.effort(7.0)
        rig.step(5)
        levels.append(health.diagnose(rig.host, rig.now).level)
    assert levels == [Level.WARN] * 3
