# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot info``: what is in a recording."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pendubot_identification.errors import UsageError, wrong_usage

from .reading import add_reading, reading_of, save_map

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
Intervals are those of header.stamp, and of the log time where a type has none or it was never set.

Of a file with columns (pendubot import --help says which there are) it says what is taken of it, as it is read: ranges,
first and last values, and what looks as if it were in other units."""


def add_parser(subparsers: Any) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser('info', help='say what is in a recording', description=DESCRIPTION)
    parser.add_argument(
        'bag', metavar='BAG', type=Path, help='a bag folder or a .mcap file, closed or not, or a file with columns'
    )
    add_reading(parser)
    parser.add_argument('--json', action='store_true', help='print JSON, for programs')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print what is in the bag: times in seconds or, where the name says so, nanoseconds; rates in Hz.

    Raises:
        BagError: it cannot be read.
    """
    from pendubot_identification.recordings.bag_reader import BagReader
    from pendubot_identification.recordings.survey import as_text, survey_bag, survey_table
    from pendubot_identification.recordings.tables import is_table

    with wrong_usage():
        reading = reading_of(args)
    if is_table(args.bag):
        from pendubot_identification.recordings.table_reader import TableReader

        found = survey_table(TableReader(args.bag, reading))
        save_map(args, reading)
        print(json.dumps(found, indent=2) if args.json else f'{args.bag}: {as_text(found)}')
        return 0
    if words := reading.options():
        raise UsageError(
            f'{args.bag} is a bag, of which info says what is in it, not what it means; leave out {" ".join(words)}'
        )
    bag = BagReader(args.bag)
    topics = survey_bag(bag)
    summary = {
        'bag': str(bag.path),
        'files': [str(file.path) for file in bag.files],
        'closed': bag.closed,
        'note': bag.note,
        'damaged': [{'file': file.path.name} | asdict(damage) for file in bag.files for damage in file.damages],
        'start_ns': bag.first_ns if bag.count else None,
        'duration': bag.duration,
        'messages': sum(topic['messages'] for topic in topics),
        'topics': topics,
    }
    print(json.dumps(summary, indent=2) if args.json else _as_text(summary))
    return 0


def _as_text(summary: dict[str, Any]) -> str:
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
    for t in summary['topics']:
        ms = {name: 1e3 * (t[name] or 0.0) for name in ('jitter', 'longest', 'latency', 'latency_max')}
        turned = t['stamped'] and (t['repeated'] or t['backwards'])
        details = {
            f'{t["messages"]:8d} messages {t["rate"]:9.2f} Hz  {t["type"]}': True,
            f'jitter {ms["jitter"]:.3f} ms, longest interval {ms["longest"]:.3f} ms': t['period'] is not None,
            f'gaps {t["gaps"]}, {t["missing"]} messages, first after {t["first_gap"] or 0:.3f} s': t['gaps'],
            f'latency {ms["latency"]:.3f} ms, at most {ms["latency_max"]:.3f} ms': t['latency'] is not None,
            f'stamps {t["repeated"]} repeat, {t["backwards"]} run back': turned,
            f'lost {t["lost"]} messages that the recorder had numbered': t['lost'],
        }
        first, *others = [line for line, shown in details.items() if shown]
        lines += [f'  {t["name"]:{width}} {first}', *(f'  {"":{width}} {line}' for line in others)]
    return '\n'.join(lines)
