# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""metadata.yaml of a bag, as rosbag2 writes it (version 9)."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from mcap.records import Channel, Schema
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from pendubot_identification.files import yaml_text

METADATA = 'metadata.yaml'
INFINITE = QosTime(9223372036, 854775807)
#: The default quality of service of a publisher.
RELIABLE = Qos(
    QosHistory.KEEP_LAST,
    1000,
    QosReliability.RELIABLE,
    QosDurability.VOLATILE,
    INFINITE,
    INFINITE,
    QosLiveliness.AUTOMATIC,
    INFINITE,
    False,
)


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
                    'offered_qos_profiles': dump_qos_v9(offered_profiles(channel.metadata['offered_qos_profiles'])),
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
def offered_profiles(text: str) -> list[Qos]:
    """Return the qualities of service in a channel's metadata; none if the text is damaged."""
    with suppress(Exception):  # the parser raises many types
        return parse_qos(text)
    return []


def read_information(folder: Path) -> dict[str, Any]:
    """Return the content of a folder's metadata.yaml; nothing if it is missing or damaged."""
    with suppress(OSError, UnicodeDecodeError, yaml.YAMLError, TypeError, LookupError):
        content = yaml.safe_load((folder / METADATA).read_text(encoding='utf-8'))
        return dict(content['rosbag2_bagfile_information'])
    return {}


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
