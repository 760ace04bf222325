# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot info``: what is in a bag."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pendubot_identification.recordings.bag_reader import BagReader
    from pendubot_identification.recordings.bag_survey import TopicTimes
    from pendubot_identification.recordings.mcap_file import Damage

DESCRIPTION = """\
Say what is in a bag: its topics, how many messages of each, how often and how regularly, how long it lasts, whether
its recording came to an end, and what is damaged or missing. The .mcap files are read themselves, from the beginning to
the end, so this is also right where metadata.yaml is missing or stale.

Of each topic:
  rate       messages per second, from its first to its last
  jitter     by how much 99 of 100 intervals differ from the usual one at most
  gaps       intervals longer than 1.5 usual ones, how many messages would fill them, and when the first begins
  latency    from the stamp to the recorder: usually, and at most
  stamps     that repeat or run back
  lost       messages that the recorder numbered and that are not there any more
Intervals are those of header.stamp, and of the log time where a type has none."""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser(
        'info',
        help='say what is in a bag',
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('bag', metavar='BAG', type=Path, help='a bag folder or a .mcap file, closed or not')
    parser.add_argument('--json', action='store_true', help='print JSON, for programs')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print what is in the bag.

    Raises:
        BagError: it cannot be read.
    """
    from pendubot_identification.recordings.bag_reader import BagReader
    from pendubot_identification.recordings.bag_survey import survey

    reader = BagReader(args.bag)
    summary = summarise(reader, *survey(reader.files))
    print(json.dumps(summary, indent=2) if args.json else as_text(summary))
    return 0


def summarise(bag: BagReader, topics: dict[str, TopicTimes], damages: dict[str, list[Damage]]) -> dict[str, Any]:
    """Return what ``--json`` prints: times in seconds or, where the name says so, nanoseconds; rates in Hz."""
    return {
        'bag': str(bag.path),
        'files': [str(file.path) for file in bag.files],
        'closed': bag.closed,
        'note': bag.note,
        'damaged': [
            {'file': name, 'offset': damage.offset, 'size': damage.size}
            for name, found in damages.items()
            for damage in found
        ],
        'start_ns': bag.first_ns if bag.count else None,
        'duration': bag.duration,
        'messages': sum(len(topic.logged) for topic in topics.values()),
        'topics': [_of_topic(name, type_name, topics[name]) for name, (type_name, _) in bag.topics.items()],
    }


def _of_topic(name: str, type_name: str, times: TopicTimes) -> dict[str, Any]:
    import numpy as np

    from pendubot_identification.recordings.regularity import regularity

    stamped = len(times.stamps) > 0
    at = times.stamps if stamped else times.logged
    found = regularity(at)
    span = float(np.ptp(times.logged)) / 1e9 if len(at) else 0.0
    latency = (times.logged[: len(times.stamps)] - times.stamps) / 1e9
    return {
        'name': name,
        'type': type_name,
        'messages': len(at),
        'lost': times.lost,
        'rate': (len(at) - 1) / span if span else 0.0,
        'stamped': stamped,
        # JSON has no NaN.
        **{key: None if value != value else value for key, value in asdict(found).items()},
        'latency': float(np.median(latency)) if len(latency) else None,
        'latency_max': float(latency.max()) if len(latency) else None,
    }


def as_text(summary: dict[str, Any]) -> str:
    """Return the summary for people."""
    lines = [
        f'bag       {summary["bag"]}',
        *([f'files     {len(summary["files"])}'] if len(summary['files']) > 1 else []),
        f'closed    {"yes" if summary["closed"] else "no: pendubot repair makes a closed copy"}',
        *([f'note      {summary["note"]}'] if summary['note'] else []),
        *(f'damaged   {d["size"]} bytes from byte {d["offset"]} of {d["file"]} on' for d in summary['damaged']),
        f'duration  {summary["duration"]:.3f} s',
        f'messages  {summary["messages"]}',
    ]
    width = max((len(topic['name']) for topic in summary['topics']), default=0)
    for topic in summary['topics']:
        counted = f'{topic["messages"]:8d} messages {topic["rate"]:9.2f} Hz'
        lines.append(f'  {topic["name"]:{width}} {counted}  {topic["type"]}')
        lines += [f'  {"":{width}} {line}' for line in _details(topic)]
    return '\n'.join(lines)


def _details(topic: dict[str, Any]) -> list[str]:
    details = []
    if topic['period'] is not None:
        details.append(f'jitter {1e3 * topic["jitter"]:.3f} ms, longest interval {1e3 * topic["longest"]:.3f} ms')
    if topic['gaps']:
        details.append(f'gaps {topic["gaps"]}, {topic["missing"]} messages, first after {topic["first_gap"]:.3f} s')
    if topic['latency'] is not None:
        details.append(f'latency {1e3 * topic["latency"]:.3f} ms, at most {1e3 * topic["latency_max"]:.3f} ms')
    if topic['stamped'] and (topic['repeated'] or topic['backwards']):
        details.append(f'stamps {topic["repeated"]} repeat, {topic["backwards"]} run back')
    if topic['lost']:
        details.append(f'lost {topic["lost"]} messages that the recorder had numbered')
    return details
