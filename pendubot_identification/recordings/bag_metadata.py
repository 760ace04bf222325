# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""metadata.yaml of a bag, as rosbag2 writes it (version 9)."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml

METADATA = 'metadata.yaml'


@dataclass(frozen=True, slots=True)
class Qos:
    """What a topic's publisher offered, in rosbag2's words."""

    reliability: str = 'reliable'
    durability: str = 'volatile'
    history: str = 'keep_last'
    depth: int = 1000

    def profile(self) -> dict[str, Any]:
        """Return every key of rosbag2's YAML form; deadline, lifespan and lease are infinite."""

        def infinite() -> dict[str, int]:
            return {'sec': 9223372036, 'nsec': 854775807}

        return {
            'history': self.history,
            'depth': self.depth,
            'reliability': self.reliability,
            'durability': self.durability,
            'deadline': infinite(),
            'lifespan': infinite(),
            'liveliness': 'automatic',
            'liveliness_lease_duration': infinite(),
            'avoid_ros_namespace_conventions': False,
        }


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic as a bag describes it: name, type, how it is written, and what its publishers offered.

    Attributes:
        name: such as ``/joint_states``.
        type_name: such as ``sensor_msgs/msg/JointState``.
        definition: the type's text with that of every type it uses.
        type_hash: ``RIHS01_...``, or empty.
        profiles: rosbag2's YAML list of the qualities of service offered, or empty.
        encoding, definition_encoding: of the messages and of the definition.
    """

    name: str
    type_name: str
    definition: bytes
    type_hash: str
    profiles: str
    encoding: str = 'cdr'
    definition_encoding: str = 'ros2msg'

    def channel_metadata(self) -> dict[str, str]:
        """Return what a channel of this topic says beside its name and type."""
        return {'offered_qos_profiles': self.profiles, 'topic_type_hash': self.type_hash}


def information(
    file: str, topics: Iterable[Topic], counts: Mapping[str, int], first_ns: int, last_ns: int
) -> dict[str, Any]:
    """Return everything that metadata.yaml says of a bag of one file, under its one key's value.

    Args:
        file: its name.
        topics: in it.
        counts: how many messages of each there are.
        first_ns: log time of its first message [ns since the epoch].
        last_ns: of its last.
    """
    span = {
        'starting_time': {'nanoseconds_since_epoch': first_ns},
        'duration': {'nanoseconds': last_ns - first_ns},
        'message_count': sum(counts.values()),
    }
    return {
        'version': 9,
        'storage_identifier': 'mcap',
        **span,
        'topics_with_message_count': [
            {
                'topic_metadata': {
                    'name': topic.name,
                    'type': topic.type_name,
                    'serialization_format': topic.encoding,
                    'offered_qos_profiles': offered_profiles(topic.profiles),
                    'type_description_hash': topic.type_hash,
                },
                'message_count': counts.get(topic.name, 0),
            }
            for topic in topics
        ],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [file],
        'files': [{'path': file, **span}],
        'custom_data': None,
        'ros_distro': 'jazzy',
    }


@cache
def offered_profiles(text: str) -> list[dict[str, Any]]:
    """Return the qualities of service that a channel names, none where the text is damaged."""
    try:
        profiles = yaml.safe_load(text)
    except yaml.YAMLError:
        return []
    return [each for each in profiles if isinstance(each, dict)] if isinstance(profiles, list) else []


def as_yaml(document: Any) -> str:
    """Return it as text without anchors, which are YAML, but not every reader's."""
    return yaml.dump(document, Dumper=_Dumper, sort_keys=False)


def write_metadata(folder: Path, content: dict[str, Any]) -> None:
    """Put metadata.yaml in its place at once, or leave the one that is there: also when the power fails meanwhile."""
    temporary = folder / f'{METADATA}.tmp'
    with temporary.open('w', encoding='utf-8') as file:
        file.write(as_yaml({'rosbag2_bagfile_information': content}))
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, folder / METADATA)
    sync_folder(folder)


def sync_folder(folder: Path) -> None:
    """Put a folder's list of names on the disk: a file's own fsync leaves its name out."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


#: A fifth of the time, where it was built: a recording that runs is described every second.
_Fast: Any = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)


class _Dumper(_Fast):
    def ignore_aliases(self, data: Any) -> bool:
        return True
