# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Seeded trials with truncated and corrupted bags; every message is accounted for."""

import random
from dataclasses import dataclass

from pendubot_identification.errors import BagError
from pendubot_identification.recordings.bag_reader import BagReader
from pendubot_identification.recordings.bag_repair import repair
from pendubot_identification.recordings.bag_writer import BagWriter

from .bags import log
from .independent import by_mcap, by_rosbags

#: Number of messages, and of messages in a chunk.
COUNT, CHUNK = 400, 11
TOPICS = ('/joint_states', '/other')


def write(path, *, closed=True):
    """Write a bag of two topics, closed or as after SIGKILL. Return its messages."""
    with BagWriter(path) as bag:
        sent = log(bag, COUNT, TOPICS, CHUNK)
        bag.flush()
        unclosed = bag.file.read_bytes()
    if not closed:
        bag.file.write_bytes(unclosed)
        (path / 'metadata.yaml').unlink()
    return sent


@dataclass
class Outcome:
    """The result of reading and repairing a damaged bag."""

    silent: int = 0  #: messages accepted though never sent, or missing without a report.
    read: int = 0  #: messages of the reader.
    saved: int = 0  #: messages in a repaired copy.
    refused: bool = False  #: whether the bag was refused in one sentence.


def examine(path, copy, sent):
    """Read and repair a bag that may be damaged; only a BagError is accepted."""
    outcome, known = Outcome(), set(sent)
    try:
        reader = BagReader(path)
        for name in TOPICS:
            messages = [(name, message.log_time, message.data) for part in reader.messages([name]) for message in part]
            outcome.silent += sum(each not in known for each in messages)
            outcome.read += len(messages)
        if reader.closed and not reader.note:
            outcome.silent += abs(len(sent) - outcome.read)
    except BagError:
        outcome.refused = True
    try:
        files = repair(path, copy)
    except BagError:
        return outcome
    saved = by_mcap(copy)
    assert by_rosbags(copy) == saved
    outcome.saved = len(saved)
    outcome.silent += sum(each not in known for each in saved)
    # Losses are reported.
    if len(saved) < len(sent):
        outcome.silent += all(file.intact for file in files)
    return outcome


def cut(data, random_):
    """Return data truncated at a random byte."""
    return data[: random_.randrange(len(data))]


def change(data, random_):
    """Return data with a random byte changed."""
    changed = bytearray(data)
    changed[random_.randrange(len(data))] ^= random_.randrange(1, 256)
    return bytes(changed)


def flip(file, at, bits=1):
    """Change a byte of a file."""
    data = bytearray(file.read_bytes())
    data[at] ^= bits
    file.write_bytes(data)


def damaged_bags(folder, trials, alter, *, closed=True, seed=1):
    """Yield the outcome of each trial, and the number of messages before the end of the damaged file."""
    random_ = random.Random(seed)
    path = folder / 'bag'
    sent = write(path, closed=closed)
    file = path / 'bag_0.mcap'
    intact = file.read_bytes()
    ends = [intact.index(data) + len(data) for _, _, data in sent]
    for k in range(trials):
        data = alter(intact, random_)
        file.write_bytes(data)
        yield examine(path, folder / f'copy{k}', sent), sum(end <= len(data) for end in ends)
