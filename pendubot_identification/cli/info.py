"""``pendubot info``: what is in a bag."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pendubot_identification.adapters.bag_reader import BagInfo

DESCRIPTION = """\
Say what is in a bag: its topics, how many messages of each and how often, how long it lasts, and whether its recording
came to an end. The .mcap files are read themselves, so this is also right where metadata.yaml is missing or stale."""


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
    from pendubot_identification.adapters.bag_reader import BagReader

    info = BagReader(args.bag).info
    summary = summarise(info)
    print(json.dumps(summary, indent=2) if args.json else as_text(summary))
    return 0


def summarise(info: BagInfo) -> dict[str, Any]:
    """Return what ``--json`` prints: times in seconds or, where the name says so, nanoseconds; rates in Hz."""
    return {
        'bag': str(info.path),
        'files': [str(file) for file in info.files],
        'closed': info.closed,
        'note': info.note,
        'start_ns': info.first_ns,
        'duration': info.duration,
        'messages': info.count,
        'topics': [
            {
                'name': topic.name,
                'type': topic.type_name,
                'messages': topic.count,
                'rate': (topic.count - 1) / info.duration if info.duration and topic.count else 0.0,
            }
            for topic in info.topics
        ],
    }


def as_text(summary: dict[str, Any]) -> str:
    """Return the summary for people."""
    lines = [
        f'bag       {summary["bag"]}',
        f'closed    {"yes" if summary["closed"] else "no"}',
        *([f'note      {summary["note"]}'] if summary['note'] else []),
        f'duration  {summary["duration"]:.3f} s',
        f'messages  {summary["messages"]}',
    ]
    width = max((len(topic['name']) for topic in summary['topics']), default=0)
    for topic in summary['topics']:
        counted = f'{topic["messages"]:8d} messages {topic["rate"]:9.2f} Hz'
        lines.append(f'  {topic["name"]:{width}} {counted}  {topic["type"]}')
    return '\n'.join(lines)
