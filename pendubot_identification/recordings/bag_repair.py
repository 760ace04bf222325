# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Makes a closed copy of an unclosed, truncated or damaged bag."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from pendubot_identification.errors import BagError

from .bag_reader import BagReader
from .bag_writer import BagWriter, complete_bag
from .mcap_file import Damage, McapFile


@dataclass(frozen=True, slots=True)
class SavedFile:
    """The result of repairing one file of a bag.

    Missing messages are counted by the index, or else by gaps in the recorder's numbers. Messages after the last saved
    one are unknown.
    """

    file: str  #: the original's path
    closed: bool  #: whether it had an end and an index
    saved: dict[str, int]  #: messages, by topic
    missing: dict[str, int]  #: messages, by topic
    damaged: list[Damage]  #: parts that were not used

    @property
    def intact(self) -> bool:
        """Whether nothing had to be repaired."""
        return self.closed and not self.damaged and not self.missing


def repair(path: Path, output: Path, *, overwrite: bool = False) -> list[SavedFile]:
    """Write a closed copy of a bag, in one file, with every intact message; the original is only read.

    Messages, their times and numbers, topics, types and qualities of service are copied byte for byte.

    Raises:
        BagError: there is no such bag, nothing of it can be saved, the output is taken or the system refuses to write.
    """
    source, target = Path(path).resolve(), Path(output).resolve()
    if source == target or source in target.parents or target in source.parents:
        raise BagError(f'{output} is the bag itself, or in or around it; give another --output')
    files = BagReader(path).files
    if not any(file.channels for file in files):
        raise BagError(f'{path} holds no intact message; nothing can be saved')
    numbers: Counter[str] = Counter()
    with complete_bag(output, overwrite=overwrite) as bag:
        return [_copied(file, bag, numbers) for file in files]


def _copied(file: McapFile, bag: BagWriter, numbers: Counter[str]) -> SavedFile:
    """Append one file to those before; ``numbers`` are the last message numbers by topic."""
    saved, missing, damaged = Counter[str](), Counter[str](), list[Damage]()
    to = {
        number: bag.add_channel(file.schemas[channel.schema_id], channel)
        for number, channel in sorted(file.channels.items())
        if channel.schema_id in file.schemas
    }
    for part in file.intact_parts(damaged):
        for message in part.messages:
            if message.channel_id not in to:
                continue
            name = file.channels[message.channel_id].topic
            bag.write(to[message.channel_id], message.data, message.log_time, message.publish_time, message.sequence)
            saved[name] += 1
            # Lower numbers are of repeated messages; recorders that do not count leave zeros.
            if message.sequence > numbers[name]:
                missing[name] += message.sequence - numbers[name] - 1 if numbers[name] else 0
                numbers[name] = message.sequence
    for name, (_, counted) in file.topics.items():
        missing[name] = max(missing[name], counted - saved[name])
    return SavedFile(str(file.path), file.closed, dict(saved), dict(+missing), damaged)
