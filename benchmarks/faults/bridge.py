# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The fault trials of the bridge: one measuring function for each row of the table."""

import contextlib
import os
import re
import signal
import struct
import subprocess
import sys
import time
from itertools import pairwise

import numpy as np
import rclpy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from pendubot_identification.link.events import Sample
from pendubot_identification.link.host import Host, HostConfig
from pendubot_identification.link.protocol import encode
from test.nodes.observer import Observer
from test.processes import Program, parameters, repeating, spin_until
from test.recordings.independent import by_rosbags
from test.rig import ARMED, PATIENT, WATCHDOG, Rig
from test.witness import Witness

from .table import Trial
from .wire import CPR, Tap, damage, hello, numbered_state, scrambled

MS = 1_000_000
RADIAN = 2 * np.pi / CPR
WATCHDOG_MS = 100


@contextlib.contextmanager
def running_rig(folder, *board_options, bridge=(), tapped=False):
    """Provide a rig at 1 kHz, with a board and a publishing bridge, and the tap between them, if one is wanted."""
    folder.mkdir(exist_ok=True)
    with Rig(folder, 1000, *board_options) as rig, contextlib.ExitStack() as taps:
        rig.start_board()
        if tapped:
            rig.bridge_port = folder / 'tap'
            rig.tap = taps.enter_context(contextlib.closing(Tap(rig.port, rig.bridge_port)))
        rig.start_bridge(*bridge)
        rig.until_samples(20)
        yield rig


def drive(rig, torque):
    """Arm and command until the motor applies the torque; a busy machine may lose the link in between."""
    deadline = time.monotonic() + 30

    def applied():
        rig.effort(torque)
        return rig.samples[-1][6] == torque

    while not (rig.call('arm').success and spin_until(rig.node, applied, 3.0)):
        assert time.monotonic() < deadline, rig.programs[-1].output


def processor_time(pid):
    """Return the processor time of a process [s]."""
    with open(f'/proc/{pid}/stat') as file:
        fields = file.read().rsplit(')', 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def handles(pid):
    """Return the numbers of descriptors and threads of a process."""
    return len(os.listdir(f'/proc/{pid}/fd')), len(os.listdir(f'/proc/{pid}/task'))


def listened(path):
    """Return the listener's arrivals and stamps [ns], positions and efforts."""
    with open(path, 'rb') as file:
        times, values = np.load(file), np.load(file)
    return times[:, 0], times[:, 1], values[:, :2], values[:, 2]


def number_of(q):
    """Return the number of the sample with these positions."""
    return round((q[0] + np.pi / 2) / RADIAN)


def is_numbered(q, effort):
    """Return whether positions and effort belong to the same numbered sample."""
    n = number_of(q)
    return abs(q[1] + 2 * n * RADIAN) < 1e-6 and round(effort * 1e6) == scrambled(n)


@contextlib.contextmanager
def commander(rng):
    """Arm the bridge as soon as possible, then send 20 random torques per second, so that the rig moves."""
    with Observer(rclpy) as observer:
        publisher = observer.node.create_publisher(Float64, '/pendubot/effort_command', 1)
        observer.until(lambda: observer.call(Trigger, '/bridge/arm').success)
        with repeating(lambda: publisher.publish(Float64(data=rng.uniform(-0.4, 0.4))), 0.05):
            yield


def stream(folder, long, wanted, rate=1000):
    """Stream samples to a second process and the recorder, armed and moving; yield figures without timing.

    Returns stamp errors [us], latencies [ms] and the bridge's share of a core.
    """
    trace, heard, seconds = folder / 'trace.csv', folder / 'heard.npy', 600 if long else 2
    board = Program('virtual_board', '--link', folder / 'board', '--rate', rate, '--trace', trace)
    listener = Program('listener', heard)
    recorder = Program('recorder', *parameters(output=folder / 'bag'))
    bridge = Program('bridge', *parameters(port=folder / 'board', confirm_zeros='false'))
    with board, listener, recorder, bridge:
        listener.wait_for('listening')
        bridge.wait_for('counts per turn')
        with commander(np.random.default_rng(1)):
            # The measurement begins after discovery, which would count as losses.
            listener.wait_for('hearing')
            recorder.wait_for('recording /joint_states')
            time.sleep(0.5)
            begun_ns, begun, used = time.time_ns(), time.monotonic(), processor_time(bridge.process.pid)
            time.sleep(seconds)
            share = (processor_time(bridge.process.pid) - used) / (time.monotonic() - begun)
            ended_ns = time.time_ns()
            time.sleep(0.5)
        bridge.stop()
        recorder.stop()
        listener.stop(signal.SIGTERM, 60)
    arrival, stamp, q, effort = listened(heard)
    measured = (stamp >= begun_ns) & (stamp < ended_ns)
    counts = np.round((q - [-np.pi / 2, 0]) / RADIAN)
    rows = np.column_stack([counts, np.round(effort * 1e6)]).astype(np.int64)[measured]
    arrival, stamp = arrival[measured], stamp[measured]
    truth = np.loadtxt(trace, delimiter=',', skiprows=1, dtype=np.int64, ndmin=2)
    start = place(truth[:, 1:4], rows)
    moving = len(np.unique(rows, axis=0)) > len(rows) // 20
    delivered = 'lost, doubled or altered' if start is None else 'all of them'
    recorded = recorded_stamps(folder / 'bag')
    same = np.array_equal(recorded[(recorded >= begun_ns) & (recorded < ended_ns)], stamp)
    yield wanted, f'{len(stamp)} samples, {delivered}', start is not None and moving
    yield 'the recorder has the same', 'yes' if same else 'no', same
    offset = np.full(1, np.nan) if start is None else stamp - 1000 * truth[start : start + len(stamp), 0]
    return np.abs(offset - np.median(offset)) / 1e3, (arrival - stamp) / 1e6, share


def place(truth, heard):
    """Return the index of the received rows in the truth; None if they are not a contiguous part of it."""
    # The search begins at the first change, because equal rows are ambiguous.
    moving = np.flatnonzero((np.diff(heard, axis=0) != 0).any(axis=1))
    anchor = int(moving[0]) if len(moving) else 0
    for match in np.flatnonzero((truth == heard[anchor]).all(axis=1)):
        start = match - anchor
        if start >= 0 and np.array_equal(truth[start : start + len(heard)], heard):
            return int(start)
    return None


def recorded_stamps(bag):
    """Return the stamps [ns] in a bag, read by rosbags; a JointState's stamp follows the 4 bytes of CDR's header."""
    stamps = [struct.unpack_from('<iI', data, 4) for topic, _, data in by_rosbags(bag) if topic == '/joint_states']
    return np.array([sec * 10**9 + nanosec for sec, nanosec in stamps], dtype=np.int64)


def quiet(folder, long):
    error, latency, share = yield from stream(folder, long, '0 lost, 0 doubled, 0 altered')
    p99, (median, late) = np.percentile(error, 99), np.percentile(latency, [50, 99])
    yield 'stamp error p99 <= 50 us', f'{p99:.0f} us, at most {error.max():.0f}', p99 <= 50, True
    yield 'median latency <= 0.3 ms', f'{median:.2f} ms', median <= 0.3, True
    yield 'p99 of latency <= 1 ms', f'{late:.2f} ms', late <= 1, True
    yield 'bridge <= 15 % of a core', f'{100 * share:.1f} %', share <= 0.15, True


def busy(folder, long):
    burners = [subprocess.Popen([sys.executable, '-c', 'while True: pass']) for _ in range(os.cpu_count())]
    try:
        # More programs than the burners may need the processor beside a short trial.
        _, latency, _ = yield from stream(folder, long, '0 lost', 1000 if long else 200)
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()
    median, late = np.percentile(latency, [50, 99])
    yield '(latency)', f'median {median:.2f} ms, p99 {late:.1f} ms', True, True


def damaged_offline(_, long):
    wanted = 1_000_000 if long else 6_000
    rng = np.random.default_rng(2)
    host = Host(HostConfig(max_speed=1e9))
    host.opened(0)
    host.receive(encode(hello(0xFFFF, 0)), 0)
    wrong = published = longest = 0
    last = -1
    for k in range(3 * wanted):
        frame = encode(numbered_state(k % 2**30))
        # One damaged frame, and two frames to count further losses.
        data = frame if k % 3 else damage(frame, rng)
        cut = int(rng.integers(len(data)))
        for part in (data[:cut], data[cut:]):
            host.receive(part, (k + 1) * MS)
            for event in host.output.take_events():
                if isinstance(event, Sample):
                    n = number_of(event.q)
                    wrong += not (is_numbered(event.q, event.effort) and k - 1 <= n <= k and n > last)
                    longest = max(longest, n - last - 1)
                    last = n
                    published += 1
    yield '0 wrong samples of 1e6 damaged frames', f'{wrong} of {wanted} damaged, {published} published', not wrong
    yield 'at most 2 frames lost per damage', f'{longest}', longest <= 2
    lost = last + 1 - published
    yield 'the lost ones are counted exactly', f'{host.counters.lost} of {lost}', host.counters.lost == lost


def cable(folder, long):
    times = 40 if long else 2
    rng = np.random.default_rng(5)
    heard = folder / 'heard.npy'
    with Program('listener', heard) as listener, running_rig(folder) as rig:
        listener.wait_for('hearing')
        board, bridge = rig.programs
        before = handles(bridge.process.pid)
        detected, back, paths = [], [], []
        disarmed = 0
        for _ in range(times):
            drive(rig, 0.2)
            paths.append(os.readlink(rig.port))
            board.process.send_signal(signal.SIGUSR1)
            out = nanoseconds(board.wait_for('cable out'))
            detected.append((log_time(bridge.wait_for('was lost')) - out) / MS)
            time.sleep(rng.uniform(0.0, 0.3))
            board.process.send_signal(signal.SIGUSR2)
            back.append(nanoseconds(board.wait_for('cable in')))
            rig.until(lambda: rig.samples[-1][1] > back[-1])
            rig.until_samples(20)
            disarmed += not newest(rig.trace_file)[4] & ARMED
        rig.fresh_values()
        after = handles(bridge.process.pid)
        alive = bridge.process.poll() is None
        listener.stop(signal.SIGTERM, 60)
    arrival, stamp, *_ = listened(heard)
    returned = [(arrival[stamp > moment][0] - moment) / MS for moment in back]
    yield f'publishing again {times} of {times}', f'{len(returned)}', alive
    yield 'on another path each time', f'{len(set(paths))} paths', all(a != b for a, b in pairwise(paths))
    yield 'disarmed each time', f'{disarmed} of {times}', disarmed == times
    yield 'no thread or descriptor leaked', f'(descriptors, threads) {before}, then {after}', before == after
    yield 'detected in 10 ms', f'at most {max(detected):.1f} ms', max(detected) <= 10, True
    yield 'publishing 100 ms after it', f'at most {max(returned):.0f} ms', max(returned) <= 100, True


def nanoseconds(line):
    """Return the time at the end of a line of the virtual board [ns]."""
    return int(re.search(r'at (\d+) ns', line)[1])


def log_time(line):
    """Return the time of a line that rclpy logged [ns]."""
    seconds, nanos = re.search(r'\[(\d+)\.(\d{9})\]', line).groups()
    return int(seconds) * 10**9 + int(nanos)


def commands(folder, long):
    """Measure the time from a torque command to the first joint state with it, on each of the bridge's two topics."""
    with running_rig(folder, bridge=PATIENT) as rig:
        for topic, kind in (('effort_command', Float64), ('joint_commands', JointState)):
            publisher, spent = rig.node.create_publisher(kind, f'/pendubot/{topic}', 1), []
            rig.until(lambda publisher=publisher: publisher.get_subscription_count() == 1)
            assert rig.call('arm').success
            for k in range(1000 if long else 20):
                torque = 0.01 * (1 + k % 2)
                names = ['shoulder', 'elbow']
                message = kind(data=torque) if kind is Float64 else kind(name=names, effort=[torque])
                begin = time.perf_counter()
                publisher.publish(message)
                rig.until(lambda torque=torque: rig.samples[-1][6] == torque)
                spent.append(1e3 * (time.perf_counter() - begin))
            rig.disarm()
            rig.node.destroy_publisher(publisher)
            median, late = np.percentile(spent, [50, 99])
            yield f'(latency on {topic})', f'median {median:.2f} ms, p99 {late:.2f} ms', True, True


def watchdog(folder, long):
    """The commander stops, the bridge is stopped, the bridge is killed; the figures are counts of board samples.

    On a busy machine, the watchdog may trip without a cause, and pauses of the machine delay all programs: the trial
    is then repeated.
    """
    late = {'commander stops': [], 'SIGSTOP': [], 'SIGKILL': []}
    still_armed = reported = tripped = stayed = excused = 0
    times, stops = (10, 10) if long else (1, 1)
    with Rig(folder, 1000) as rig, Witness() as witness:
        rig.start_board()
        rig.until(lambda: len(rig.trace()) > 100)
        first = board_start(rig.trace_file)
        bridge = None

        def start():
            nonlocal bridge
            bridge = rig.start_bridge(f'watchdog_ms:={WATCHDOG_MS}')
            rig.until_samples(10)

        def brought_about(event):
            """Cause an event while the motor runs; return the board's samples until torque 0, and the machine's longest
            pause meanwhile [ms]; None if the motor did not run.
            """
            drive(rig, 0.2)
            now = time.monotonic_ns()
            # By the clock: a late board has taken fewer samples than were due.
            begun = (now - first) // MS + 1
            event()
            *_, torque, status = newest(rig.trace_file)
            if not (torque and status & ARMED):
                return None
            end = begun + 2 * WATCHDOG_MS
            rig.until(lambda: newest(rig.trace_file)[0] > 1000 * end and not newest(rig.trace_file)[3])
            return rig.trace()[begun:], witness.longest_pause(now)

        def after(cause, event):
            nonlocal excused
            for _ in range(20):
                if tried := brought_about(event):
                    rows, pause = tried
                    excess = np.count_nonzero(rows[:, 3]) - WATCHDOG_MS
                    if excess <= 2 or pause < excess - 2 or not long:
                        late[cause].append(excess)
                        return rows
                    excused += 1
                bridge.process.send_signal(signal.SIGCONT)
                if bridge.process.poll() is not None:
                    start()
            raise AssertionError(f'{cause}: this machine is too busy to try it')

        for _ in range(times):
            start()
            for _ in range(stops):
                rig.diagnoses.clear()
                still_armed += any(after('commander stops', lambda: rig.effort(0.2))[-1, 4] == ARMED for _ in range(20))
            rig.until(lambda: rig.diagnosed(1, 'no effort command'))
            reported += 1

            rows = after('SIGSTOP', lambda: bridge.process.send_signal(signal.SIGSTOP))
            tripped += (rows[:, 4] & WATCHDOG).any()
            bridge.process.send_signal(signal.SIGCONT)
            begun = len(rig.trace())
            rig.until_samples(300, 0.2)
            stayed += not rig.trace()[begun:, 3].any()

            rows = after('SIGKILL', lambda: bridge.kill())
            tripped += (rows[:, 4] & WATCHDOG).any()
    yield 'commander stops: torque 0, armed', f'{still_armed} of {times * stops}', still_armed == times * stops
    yield 'that is reported', f'{reported} of {times}', reported == times
    yield 'SIGSTOP, SIGKILL: the watchdog trips', f'{tripped} of {2 * times}', tripped == 2 * times
    yield 'after SIGCONT disarmed until armed again', f'{stayed} of {times}', stayed == times
    for cause, n in late.items():
        yield f'{cause}: within the watchdog plus two samples', f'watchdog plus {max(n)}', max(n) <= 2, True
    yield '(tried again, as the machine stood still)', f'{excused} times', True, True


def newest(trace):
    """Return the last sample of a board's trace; reading the complete trace is slow."""
    with open(trace, 'rb') as file:
        file.seek(-200, os.SEEK_END)
        return [int(value) for value in file.read().split(b'\n')[-2].split(b',')]


def board_start(trace):
    """Return the time at which a virtual board took its first sample [ns, time.monotonic_ns].

    A board without processor time takes samples late but never early: the minimum of many estimates counts.
    """
    until = time.monotonic_ns() + 500 * MS
    return min(time.monotonic_ns() - 1000 * newest(trace)[0] for _ in iter(lambda: time.monotonic_ns() < until, False))


TRIALS = [
    Trial('quiet', 'none: 1 kHz to a second process and the recorder', quiet, True),
    Trial('busy', 'all cores saturated by other work, 1 kHz', busy, True),
    Trial('offline', 'bit flips, dropped and doubled bytes, offline', damaged_offline),
    Trial('cable', 'cable out mid-frame, back on another path behind the same link', cable, True),
    Trial('commands', 'none: from a command to its joint state', commands, True),
    Trial('watchdog', 'commander stops; bridge SIGSTOPped or SIGKILLed while armed', watchdog, True),
]
