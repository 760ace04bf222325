# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings: bags written by this package and by the MCAP library, and text."""

from mcap.writer import Writer
from rosbags.interfaces import QosDurability

from pendubot_identification.recordings.bag_writer import RELIABLE, BagWriter
from pendubot_identification.recordings.joint_states import JOINT_STATE, encode_joint_state
from pendubot_identification.recordings.message_types import message_definition

START = 1_700_000_000_000_000_000
STEP = 10_000_000
TOPIC = '/joint_states'
JOINTS = ('shoulder', 'elbow')
#: Encapsulation of a Float64.
FLOAT = bytes([0, 1, 0, 0])
LATCHED = RELIABLE._replace(durability=QosDurability.TRANSIENT_LOCAL, depth=1)


def message(k):
    """Return the stamp and the bytes of sample k."""
    stamp = START + k * STEP
    return stamp, encode_joint_state(stamp, JOINTS, [0.1 * k, -k], [1, 2], [k, 0])


def samples(n=1000, **changed):
    """Return n samples, one every 0.01 s; ``changed`` are functions of k that replace entries."""
    entries = {
        'stamp': lambda k: START + k * STEP,
        'names': lambda k: JOINTS,
        'position': lambda k: (0.001 * k, -0.001 * k),
        'velocity': lambda k: (0.1, -0.1),
        'effort': lambda k: (k, 0.0),
    } | changed
    return [tuple(entries[key](k) for key in ('stamp', 'names', 'position', 'velocity', 'effort')) for k in range(n)]


def log(bag, count, topics=(TOPIC,), chunk=100):
    """Write messages on topics in turn, ``chunk`` of them in a chunk; return (topic, stamp, bytes) of each."""
    channels = [bag.add_topic(topic, JOINT_STATE) for topic in topics]
    sent = [(topics[k % len(topics)], *message(k)) for k in range(count)]
    for k, (_, stamp, data) in enumerate(sent):
        bag.write(channels[k % len(topics)], data, stamp, stamp - 1000, sequence=1 + k // len(topics))
        if k % chunk == chunk - 1:
            bag.flush()
    return sent


def write(path, samples, topic=TOPIC, logged=lambda k: START + k * STEP + 3_000_000):
    """Write samples with log times into a bag; return its path."""
    with BagWriter(path) as bag:
        channel = bag.add_topic(topic, JOINT_STATE)
        for k, sample in enumerate(samples):
            bag.write(channel, encode_joint_state(*sample), logged(k), sequence=k + 1)
            if k % 10 == 9:
                bag.flush()
    return path


def foreign(path, messages, chunk_size=4000, **options):
    """Write messages (stamp, bytes) by the MCAP library; return the bytes of the file if it were not closed."""
    with path.open('wb') as file:
        writer = Writer(file, chunk_size=chunk_size, **options)
        writer.start(profile='ros2')
        text = message_definition(JOINT_STATE)[0].encode()
        channel = writer.register_channel(TOPIC, 'cdr', writer.register_schema(JOINT_STATE, 'ros2msg', text))
        for stamp, data in messages:
            writer.add_message(channel, stamp, data, stamp)
        writer.flush()
        size = file.tell()
        writer.finish()
    return path.read_bytes()[:size]


def csv(motion, separator=',', decimal='.', names=('t', 'q1', 'q2', 'tau1'), convert=lambda q: q):
    columns = zip(motion.t, *convert(motion.q).T, motion.tau[:, 0], strict=True)
    rows = [separator.join(f'{value:.12g}'.replace('.', decimal) for value in row) for row in columns]
    return '\n'.join([separator.join(names), *rows])
