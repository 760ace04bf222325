# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""metadata.yaml of a bag, as rosbag2 writes it (version 9)."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from mcap.records import Channel, Schema

from pendubot_identification.files import yaml_text

METADATA = 'metadata.yaml'


@dataclass(frozen=True, slots=True)
class Qos:
    """The quality of service of a topic's publisher, in rosbag2's words."""

    reliability: str = 'reliable'
    durability: str = 'volatile'
    history: str = 'keep_last'
    depth: int = 1000

    def profile(self) -> dict[str, Any]:
        """Return every key of rosbag2's YAML form; deadline, lifespan and lease are infinite."""
        infinite = {'sec': 9223372036, 'nsec': 854775807}
        return {
            'history': self.history,
            'depth': self.depth,
            'reliability': self.reliability,
            'durability': self.durability,
            'deadline': infinite,
            'lifespan': infinite,
            'liveliness': 'automatic',
            'liveliness_lease_duration': infinite,
            'avoid_ros_namespace_conventions': False,
        }


def information(
    file: str, topics: Mapping[int, tuple[Schema, Channel]], counts: Mapping[int, int], first_ns: int, last_ns: int
) -> dict[str, Any]:
    """Return the content of metadata.yaml for a bag of one file.

    Topics and counts of messages are by the channel's number; the times are the first and the last log time [ns].
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
                    'name': channel.topic,
                    'type': schema.name,
                    'serialization_format': channel.message_encoding,
                    'offered_qos_profiles': offered_profiles(channel.metadata['offered_qos_profiles']),
                    'type_description_hash': channel.metadata['topic_type_hash'],
                },
                'message_count': counts.get(number, 0),
            }
            for number, (schema, channel) in topics.items()
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
    """Return the qualities of service of a channel; none if the text is damaged."""
    try:
        profiles = yaml.safe_load(text)
    except yaml.YAMLError:
        return []
    return [each for each in profiles if isinstance(each, dict)] if isinstance(profiles, list) else []


def write_metadata(folder: Path, content: dict[str, Any]) -> None:
    """Replace metadata.yaml atomically, even if the power fails meanwhile."""
    temporary = folder / f'{METADATA}.tmp'
    with temporary.open('w', encoding='utf-8') as file:
        file.write(yaml_text({'rosbag2_bagfile_information': content}))
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, folder / METADATA)
    sync_folder(folder)


def sync_folder(folder: Path) -> None:
    """Put the names of a folder's files on the disk: the fsync of a file omits its name."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
