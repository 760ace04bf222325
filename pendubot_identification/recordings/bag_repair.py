# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A closed copy of a bag that was killed, cut or damaged."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from pendubot_identification.errors import BagError

from .bag_metadata import Topic
from .bag_reader import BagReader
from .bag_writer import BagWriter, whole_bag
from .mcap_file import Damage, McapFile


@dataclass(frozen=True, slots=True)
class SavedFile:
    """What became of one file of a bag.

    Attributes:
        path: of the original.
        closed: whether it had an end and an index.
        counts: messages saved, by topic.
        missing: messages that are known to be lost, by topic: of those that the index counts, or else of the recorder's
            numbers between the first and the last that were saved. What came after the last is not known.
        damages: what could not be used.
    """

    path: Path
    closed: bool
    counts: dict[str, int]
    missing: dict[str, int]
    damages: tuple[Damage, ...]

    @property
    def whole(self) -> bool:
        """Whether nothing had to be repaired."""
        return self.closed and not self.damages and not any(self.missing.values())


def repair(path: Path, output: Path, *, overwrite: bool = False) -> list[SavedFile]:
    """Write a closed copy of a bag, of one file, with every message that is whole; the original is only read.

    Messages, their times and numbers, topics, types and qualities of service are copied byte for byte.

    Raises:
        BagError: there is no such bag, nothing of it can be saved, the output is taken or the system refuses to write.
    """
    source, target = Path(path).resolve(), Path(output).resolve()
    if source == target or source in target.parents or target in source.parents:
        raise BagError(f'{output} is the bag itself, or in or around it; give another --output')
    files = BagReader(path).files
    if not any(file.channels for file in files):
        raise BagError(f'{path} holds no message that is whole; nothing can be saved')
    channels: dict[Topic, int] = {}
    numbers: dict[str, int] = {}
    with whole_bag(output, overwrite=overwrite) as bag:
        return [_copy(file, bag, channels, numbers) for file in files]


def _copy(file: McapFile, bag: BagWriter, channels: dict[Topic, int], numbers: dict[str, int]) -> SavedFile:
    to: dict[int, int] = {}
    for number, channel in sorted(file.channels.items()):
        if (schema := file.schemas.get(channel.schema_id)) is None:
            continue
        topic = Topic(
            channel.topic,
            schema.name,
            schema.data,
            channel.metadata.get('topic_type_hash', ''),
            channel.metadata.get('offered_qos_profiles', ''),
            channel.message_encoding,
            schema.encoding,
        )
        if topic not in channels:
            channels[topic] = bag.add_channel(topic)
        to[number] = channels[topic]
    counts: Counter[str] = Counter()
    missing: Counter[str] = Counter()
    damages: list[Damage] = []
    for part in file.whole_parts(damages):
        for message in part.messages:
            if message.channel_id not in to:
                continue
            bag.write(to[message.channel_id], message.data, message.log_time, message.publish_time, message.sequence)
            name = file.channels[message.channel_id].topic
            counts[name] += 1
            # Lower numbers are of messages that come again; recorders that do not count leave zeros.
            last = numbers.get(name, 0)
            if message.sequence > last:
                missing[name] += message.sequence - last - 1 if last else 0
                numbers[name] = message.sequence
    for name, (_, counted) in file.topics.items():
        missing[name] = max(missing[name], counted - counts[name])
    return SavedFile(file.path, file.closed, dict(counts), dict(missing), tuple(damages))
