# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot repair``: a closed copy of a bag that was killed, cut or damaged."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pendubot_identification.recordings.bag_repair import SavedFile

DESCRIPTION = """\
Write a closed copy of a bag whose recording was killed, or whose file was cut or damaged, and say what was saved. The
copy has an index and a metadata.yaml, and ros2 bag, rosbags and mcap read it. Every message is copied that is whole,
also those after a damaged place. The original is only read."""

EPILOG = """\
examples:
  pendubot repair swing                      into swing_repaired
  pendubot repair swing --output whole"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser(
        'repair',
        help='write a closed copy of a bag that was killed, cut or damaged',
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('bag', metavar='BAG', type=Path, help='a bag folder or a .mcap file, closed or not')
    parser.add_argument(
        '--output', metavar='COPY', type=Path, help="the copy's folder, which is made; without it: BAG_repaired"
    )
    parser.add_argument('--force', action='store_true', help='replace a bag of the name of the copy')
    parser.add_argument('--json', action='store_true', help='print JSON, for programs')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Repair, and say what was saved.

    Raises:
        BagError: the bag cannot be read, or the copy not be written.
    """
    from pendubot_identification.recordings.bag_repair import repair

    # Of a single file, beside it; a name that ends with a slash has none of its own.
    bag = Path(args.bag)
    output = args.output or bag.absolute().parent / f'{bag.absolute().stem if bag.is_file() else bag.name}_repaired'
    saved = repair(bag, output, overwrite=args.force)
    summary = summarise(output, saved)
    print(json.dumps(summary, indent=2) if args.json else as_text(summary))
    return 0


def summarise(output: Path, saved: list[SavedFile]) -> dict[str, Any]:
    """Return what ``--json`` prints: messages saved and known to be lost, and damaged places in bytes."""
    return {
        'output': str(output),
        'whole': all(file.whole for file in saved),
        'files': [
            {
                'file': str(file.path),
                'closed': file.closed,
                'saved': file.counts,
                'missing': {topic: count for topic, count in file.missing.items() if count},
                'damaged': [{'offset': damage.offset, 'size': damage.size} for damage in file.damages],
            }
            for file in saved
        ],
    }


def as_text(summary: dict[str, Any]) -> str:
    """Return the summary for people."""
    lines = []
    for file in summary['files']:
        lines.append(f'{file["file"]}: {"closed" if file["closed"] else "never closed, or cut"}')
        width = max(map(len, file['saved']), default=0)
        for topic, count in file['saved'].items():
            lost = file['missing'].get(topic, 0)
            lines.append(f'  {topic:{width}} {count:8d} messages saved' + (f', {lost} lost' if lost else ''))
        lines += [f'  {d["size"]} bytes from byte {d["offset"]} on are damaged and left out' for d in file['damaged']]
    if summary['whole']:
        lines.append('nothing was missing or damaged')
    return '\n'.join([*lines, f'written to {summary["output"]}, closed; the original is as it was'])
