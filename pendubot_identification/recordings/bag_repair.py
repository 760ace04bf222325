# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Makes a closed copy of an unclosed, truncated or damaged bag."""

from array import array
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pendubot_identification.errors import BagError

from .bag_reader import BagReader
from .bag_writer import BagWriter, complete_bag
from .mcap_file import Damage, McapFile
from .survey import missing_numbers


@dataclass(frozen=True, slots=True)
class SavedFile:
    """The result of repairing one file of a bag.

    Missing messages are counted by the index or by gaps in the recorder's numbers; the larger count holds. Losses
    after the last saved message are unknown.
    """

    file: str  #: path of the original
    closed: bool = False  #: whether the original had an end and an index
    saved: dict[str, int] = field(default_factory=dict)  #: number of saved messages by topic
    missing: dict[str, int] = field(default_factory=dict)  #: number of missing messages by topic
    damaged: list[Damage] = field(default_factory=list)  #: damaged parts, which are not copied
    unread: str = ''  #: error of an unreadable file, or empty

    @property
    def intact(self) -> bool:
        """Whether nothing had to be repaired."""
        return self.closed and not self.damaged and not self.missing


def repair(path: Path, output: Path, *, overwrite: bool = False) -> list[SavedFile]:
    """Write a closed copy of a bag, in one file, with every intact message; the original stays as it is.

    Messages, their times and numbers, topics, types and qualities of service are copied byte for byte.

    Raises:
        BagError: the bag does not exist or has no intact message, the output exists, or writing fails.
    """
    source, target = Path(path).resolve(), Path(output).resolve()
    if source == target or source in target.parents or target in source.parents:
        raise BagError(f'{output} is the bag itself, inside it or contains it; give another --output')
    bag = BagReader(path)
    if bag.converted:
        raise BagError(
            f'{path} is of ROS 1 or has the storage sqlite3; only .mcap files can be repaired: use rosbag or ros2 bag '
            'reindex'
        )
    if not any(file.channels for file in bag.files):
        raise BagError(f'{path} holds no intact message; copy it again from the recorder')
    with complete_bag(output, overwrite=overwrite) as copy:
        saved = [_copied(file, copy) for file in bag.files]
    return saved + [SavedFile(str(file), unread=why) for file, why in bag.unread.items()]


def _copied(file: McapFile, copy: BagWriter) -> SavedFile:
    """Append the messages of one file to the copy."""
    to = {
        number: copy.add_channel(file.schemas[channel.schema_id], channel)
        for number, channel in sorted(file.channels.items())
        if channel.schema_id in file.schemas
    }
    numbers = {name: array('q') for name in file.topics}
    for messages in file.scan():
        for message in messages:
            if message.channel_id in to:
                copy.write(
                    to[message.channel_id], message.data, message.log_time, message.publish_time, message.sequence
                )
                numbers[file.channels[message.channel_id].topic].append(message.sequence)
    saved = Counter({name: len(found) for name, found in numbers.items()})
    missing = Counter(
        {
            name: max(missing_numbers(np.array(numbers[name], np.int64)), counted - saved[name])
            for name, (_, counted) in file.topics.items()
        }
    )
    return SavedFile(str(file.path), file.closed, dict(+saved), dict(+missing), file.damages)
