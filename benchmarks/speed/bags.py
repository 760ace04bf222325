# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Reads a window of a long bag and all of it, compared with rosbags; separate processes show the memory of each."""

import json
import statistics
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.markdown import table
from benchmarks.speed import measure
from benchmarks.speed.measure import REPETITIONS, seconds
from pendubot_identification.recordings.bag_writer import BagWriter
from pendubot_identification.recordings.joint_states import EPOCH_NS, JOINT_NAMES, JOINT_STATE, encode_joint_state
from test.conftest import ROOT

#: A long recording: rate [Hz] and duration [s], 3.6 million messages.
RATE, SECONDS = 1000, 3600
#: rosbags reads one part of this number of parts; its time is extrapolated to the complete bag.
SHARE = 30

#: A program for a separate process: imports, work, and a figure to print beside seconds and the largest memory [MB].
#: getrusage would include the memory of the parent.
PROGRAM = """
import json, sys, time
from pathlib import Path
{0}
clock = {{'wall': time.perf_counter, 'cpu': time.process_time}}[sys.argv.pop()]
begin = clock()
{1}
spent, status = clock() - begin, Path('/proc/self/status').read_text()
print(json.dumps([spent, int(status.split('VmHWM:')[1].split()[0]) / 1024, {2}]))
"""
OURS = PROGRAM.format(
    'from pendubot_identification.recordings.bag_reader import BagReader, BagWindow, Conversion, joint_samples',
    """
window = BagWindow(Path(sys.argv[1]), *map(float, sys.argv[2:]))
count = sum(len(t) for t, _ in joint_samples(BagReader(window.path), window, Conversion()))
""",
    'count',
)
THEIRS = PROGRAM.format(
    'from rosbags.highlevel import AnyReader',
    """
count = 0
with AnyReader([Path(sys.argv[1])]) as reader:
    first = reader.start_time
    for connection, _, data in reader.messages(start=first, stop=first + int(float(sys.argv[2]) * 1e9)):
        reader.deserialize(data, connection.msgtype)
        count += 1
""",
    'count',
)


def write(path, count):
    """Write a bag of a moving rig like the recorder's."""
    t = np.arange(count) / RATE
    columns = np.sin([3 * t, 2 * t]).T, np.cos([3 * t, 2 * t]).T, np.stack([np.sin(7 * t), 0 * t], axis=1)
    message = bytearray(encode_joint_state(EPOCH_NS, JOINT_NAMES, [1, 1], [2, 2], [3, 3]))
    places = [message.index(struct.pack('<d', number)) for number in (1, 2, 3)]
    with BagWriter(path) as bag:
        channel = bag.add_topic('/joint_states', JOINT_STATE)
        for k in range(count):
            stamp = EPOCH_NS + k * (1_000_000_000 // RATE)
            struct.pack_into('<iI', message, 4, *divmod(stamp, 1_000_000_000))
            for first, column in zip(places, columns, strict=True):
                message[first : first + 16] = column[k].tobytes()
            bag.write(channel, bytes(message), stamp, sequence=k)


def run(program, *arguments):
    """Return the printed figures of a program in a separate process."""
    command = [sys.executable, '-c', program, *map(str, arguments), measure.clock.__name__]
    return json.loads(subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True).stdout)


def measured(program, *arguments):
    """Return median seconds, largest memory [MB] and messages of several runs of a program."""
    times, memory, counts = zip(*(run(program, *arguments) for _ in range(REPETITIONS)), strict=True)
    return statistics.median(times), max(memory), counts[0]


def hour():
    table(('part', 'time', 'memory', 'rosbags, the same', 'ratio'), windows())


def windows():
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder, 'hour')
        write(bag, SECONDS * RATE)
        theirs, _, count = measured(THEIRS, bag, SECONDS / SHARE)
        for part, window in (('10 s from the middle', (SECONDS / 2, SECONDS / 2 + 10)), ('all of it', ())):
            spent, memory, read = measured(OURS, bag, *window)
            same = theirs / count * read
            yield f'{part}, {read} messages', seconds(spent), f'{memory:.0f} MB', seconds(same), f'{same / spent:.3g}'
