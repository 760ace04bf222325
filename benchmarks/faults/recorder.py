# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Fault trials of the recorder and its bags: SIGKILL at any moment, truncated and changed bags, a full disk."""

import os
import random
import shutil
import statistics
import tempfile
import time
from functools import partial
from pathlib import Path
from unittest import mock

import rclpy
from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from pendubot_identification.errors import BagError
from pendubot_identification.recordings.bag_reader import BagReader
from pendubot_identification.recordings.bag_repair import repair
from test.nodes.observer import Observer
from test.processes import Program, parameters, until
from test.recordings import damage
from test.recordings.independent import by_mcap, by_rosbags

from .table import Trial

RATE = 1000  #: Messages a second.
LOSS = 0.1  #: Largest loss at a SIGKILL [s].
ROOM = 20_000_000  #: Free space above the reserve [bytes].


def recorder(output, *topics, session=True, **others):
    """Start a recorder."""
    given = parameters(output=output, topics=f'[{",".join(topics)}]', **others)
    return Program('recorder', *given, session=session)


def wait_for_subscriptions(*publishers):
    until(lambda: all(publisher.get_subscription_count() for publisher in publishers))


def recorded(path):
    """Return the number of messages that a reader finds so far."""
    try:
        return BagReader(path).count
    except BagError:
        return 0


def joint_state(k):
    return JointState(
        header=Header(stamp=Time(sec=1_700_000_000 + k, nanosec=k), frame_id=f'frame{k}'),
        name=['shoulder', 'elbow'][: k % 3],
        position=[0.1 * k, -1e300],
        velocity=[1.0] * (k % 5),
        effort=[float(k), 0.5],
    )


def kills(node, folder, count):
    """Kill a recorder of 1 kHz ``count`` times, at random moments.

    Yields the time from publishing the first lost message to the kill [s], 0 without a loss, and whether a repaired
    copy has all earlier messages in order.
    """
    random_ = random.Random(1)
    for k in range(count):
        path, copy, topic = folder / f'killed{k}', folder / f'repaired{k}', f'/killed{k}'
        with recorder(path, topic, session=False) as program:
            publisher = node.create_publisher(JointState, topic, 1000)
            wait_for_subscriptions(publisher)
            # The first message may come only with the publisher's next heartbeat, seconds later.
            publisher.publish(joint_state(0))
            until(lambda path=path: recorded(path) == 1)
            times = [time.monotonic()]
            end = times[0] + random_.uniform(0.5, 1.5)
            while times[-1] < end:
                time.sleep(max(0.0, times[0] + len(times) / RATE - time.monotonic()))
                times.append(time.monotonic())
                publisher.publish(joint_state(len(times) - 1))
            times.append(time.monotonic())
            program.kill()
        node.destroy_publisher(publisher)
        read = recorded(path)
        repair(path, copy)
        saved = by_mcap(copy)
        stamps = [int.from_bytes(data[8:12], 'little') for _, _, data in saved]
        yield times[-1] - times[read], stamps == list(range(read)) and by_rosbags(copy) == saved


def killed(folder, long):
    """SIGKILL the recorder."""
    with Observer(rclpy) as observer:
        losses, saved = zip(*kills(observer.node, folder, 20 if long else 3), strict=True)
    median, most = statistics.median_low(losses), max(losses)
    wanted = f'at most the last {LOSS * 1e3:.0f} ms lost, {len(losses)} times'
    yield wanted, f'{median * 1e3:.0f} ms in the median, {most * 1e3:.0f} ms at most', most <= LOSS, True
    yield 'all repaired, and read by rosbags and mcap as sent', f'{sum(saved)} of {len(saved)}', all(saved)


def fills_up(folder, _):
    """Record to a disk that fills up to the reserve."""
    # Few other programs write to /dev/shm meanwhile; Fast DDS keeps its segments there, too.
    with tempfile.TemporaryDirectory(dir='/dev/shm' if os.access('/dev/shm', os.W_OK) else folder) as disk:
        path = Path(disk, 'bag')
        reserve = shutil.disk_usage(disk).free - ROOM
        with Observer(rclpy) as observer, recorder(path, '/full', reserve=reserve) as program:
            message = joint_state(0)
            message.header.frame_id = 'x' * 400_000
            publisher = observer.node.create_publisher(JointState, '/full', 10)
            wait_for_subscriptions(publisher)
            sent = 0
            while program.process.poll() is None:
                publisher.publish(message)
                sent += 1
                until(lambda: program.process.poll() is not None or recorded(path) >= sent - 5)  # noqa: B023
            status = program.process.returncode
            until(lambda: 'is closed with all earlier messages: its disk has' in program.output)
            traced = 'Traceback' in program.output
        left, size = shutil.disk_usage(disk).free - reserve, sum(file.stat().st_size for file in path.iterdir())
        info, same = BagReader(path), by_mcap(path) == by_rosbags(path)
    said = f'closed: {info.closed}, {left / 1e6:.1f} MB above the reserve, exit status {status}'
    # Other programs may take a part of the reserve after the bag was closed.
    right = info.closed and (left >= 0 or size <= ROOM) and status == 1 and not traced
    yield 'closed cleanly before the reserve is gone, exit status 1', said, right
    said = f'{info.count} of {sent} sent, those on their way at the end included; the same by both: {same}'
    yield 'all before it read by rosbags and mcap', said, same and info.count >= sent - 6


def damaged(alter, counts, state, folder, long):
    """Truncate or change a bag many times; read and repair the rest."""
    count = counts[long]
    silent = refused = worst = done = 0
    crash = 'no crash'
    try:
        # fsync of this many bags would be slow, and they are temporary.
        with mock.patch.object(os, 'fsync', return_value=None):
            for outcome, left in damage.damaged_bags(folder, count, alter, closed=state == 'closed'):
                done += 1
                silent += outcome.silent
                refused += outcome.refused
                worst = max(worst, left - outcome.saved)
    except Exception as error:
        crash = f'{type(error).__name__}: {error}'
    yield f'no crash in {count}', f'{crash} in {done}', done == count
    yield 'nothing wrong or missing accepted silently', f'{silent} messages', silent == 0
    left = f'at most {worst} messages of {damage.COUNT} not saved; {refused} refused as they were, with a sentence'
    # A wrong length hides the rest of a file without an index.
    if state == 'closed' or alter is damage.cut:
        yield 'intact chunks are read: all but one chunk, of 11 messages here', left, worst <= 11


TRIALS = [
    Trial('kill', 'recorder SIGKILLed at 1 kHz', killed),
    Trial('disk', 'disk full', fills_up),
    *(
        Trial(f'{alter.__name__}-{state}', f'{state} bag, {fault}', partial(damaged, alter, counts, state))
        for alter, fault, counts in (
            (damage.cut, 'cut anywhere', (10, 100)),
            (damage.change, 'a byte changed anywhere', (25, 1000)),
        )
        for state in ('closed', 'killed')
    ),
]
