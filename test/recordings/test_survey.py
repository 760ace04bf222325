# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import math
import subprocess
import sys

import numpy as np
import pytest

from pendubot_identification.level import Level
from pendubot_identification.recordings.bag_reader import BagReader
from pendubot_identification.recordings.bag_writer import BagWriter
from pendubot_identification.recordings.flow import Flow, diagnose
from pendubot_identification.recordings.survey import survey_bag

from .bags import START, STEP, samples, write


@pytest.mark.parametrize(
    ('stamp', 'stamped', 'latency'),
    [(lambda k: START + k * STEP, True, 0.003), (lambda k: 0, False, None), (lambda k: 5 + k * STEP, True, None)],
    ids=['set', 'never set', 'of a simulation'],
)
def test_latency_needs_stamps_of_the_same_clock(tmp_path, stamp, stamped, latency):
    (topic,) = survey_bag(BagReader(write(tmp_path / 'bag', samples(100, stamp=stamp))))
    assert [topic[name] for name in ('messages', 'lost', 'stamped', 'period', 'repeated')] == [100, 0, stamped, 0.01, 0]
    assert topic['latency'] == topic['latency_max'] == latency


MEMORY = """
import re, sys
from pendubot_identification.cli.main import main
main(['info', sys.argv[1]])
print(re.search(r'VmHWM:\\s+(\\d+) kB', open('/proc/self/status').read())[1])
"""


def informed(path):
    """Return the output of ``pendubot info`` and the largest memory of its process [kB]."""
    command = [sys.executable, '-c', MEMORY, path]
    output, kilobytes = subprocess.check_output(command, text=True).rstrip().rsplit('\n', 1)
    return output, int(kilobytes)


def test_a_bag_of_40_mb_is_surveyed_in_70_mb(tmp_path):
    with BagWriter(tmp_path / 'bag') as bag:
        channel = bag.add_topic('/image', 'std_msgs/msg/String')
        for k in range(100):
            bag.write(channel, bytes(400_000), START + k * STEP)
    assert (tmp_path / 'bag' / 'bag_0.mcap').stat().st_size > 40e6
    output, kilobytes = informed(tmp_path / 'bag')
    assert '100 messages' in output
    assert kilobytes < 70_000


def test_a_file_of_12_mb_is_surveyed_in_95_mb(tmp_path):
    rows = (f'{k / 1000},{math.sin(k / 300):.17f},{math.sin(k / 200):.17f},0.1' for k in range(250_000))
    (tmp_path / 'run.csv').write_text('\n'.join(['t,q1,q2,tau1', *rows]))
    assert (tmp_path / 'run.csv').stat().st_size > 12e6
    output, kilobytes = informed(tmp_path / 'run.csv')
    assert '250000 samples, 249.999 s' in output
    assert kilobytes < 95_000


def test_messages_out_of_order_are_surveyed_in_the_order_of_log_time(tmp_path):
    order = np.random.default_rng(1).permutation(100)
    stamps = {'stamp': lambda k: START + int(order[k]) * STEP}
    path = write(tmp_path / 'bag', samples(100, **stamps), logged=lambda k: START + int(order[k]) * STEP)
    (topic,) = survey_bag(BagReader(path))
    assert [topic[name] for name in ('period', 'gaps', 'backwards', 'latency_max')] == [0.01, 0, 0, 0]


def flow_of(numbers, lag_ns=0, publishers=1):
    flow = Flow()
    for number in numbers:
        flow.add(number, lag_ns, publishers)
    return flow


@pytest.mark.parametrize(
    ('numbers', 'publishers', 'lost'),
    [((1, 2, 3, 1, 2, 4), 1, 1), ((None, None), 1, 0), ((1, 40, 2, 41, 7), 2, 0)],
    ids=['restarted', 'without numbers', 'several publishers'],
)
def test_losses_of_restarted_unnumbered_and_several_publishers_are_not_overestimated(numbers, publishers, lost):
    assert flow_of(numbers, publishers=publishers).lost == lost


@pytest.mark.parametrize(
    ('flow', 'free', 'sentence'),
    [
        (flow_of([1]), 10**12, 'recording'),
        (flow_of([1, 5], lag_ns=2_500_000_000), 10**12, '/x: 3 messages lost; /x: written 2.5 s late'),
        (Flow(), 150_000_000, '/x: nothing yet; 150 MB left on the disk; the bag is closed at 100'),
    ],
)
def test_losses_delays_and_a_full_disk_are_warnings(flow, free, sentence):
    level, message, values = diagnose({'/x': flow}, 1.0, troubles=(), free=free, reserve=10**8)
    assert (level, message) == (Level.WARN if ';' in sentence else Level.OK, sentence)
    assert {'/x messages', '/x rate [Hz]', '/x lag [s]', '/x lost', 'free [MB]'} <= values.keys()
