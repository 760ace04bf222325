# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot repair``: a closed copy of an unclosed, truncated or damaged bag."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

DESCRIPTION = """\
Write a closed copy of an unclosed, truncated or damaged bag, and print the number of saved messages. The copy has an
index and a metadata.yaml, and ros2 bag, rosbags and mcap read it. It holds every intact message, also those after a
damaged part. The original is only read."""

EPILOG = """\
examples:
  pendubot repair swing                      into swing_repaired
  pendubot repair swing --output whole"""


def add_parser(subparsers: Any) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser(
        'repair',
        help='write a closed copy of an unclosed, truncated or damaged bag',
        description=DESCRIPTION,
        epilog=EPILOG,
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
    bag = args.bag.absolute()
    output = args.output or bag.parent / f'{bag.stem if bag.is_file() else bag.name}_repaired'
    saved = repair(args.bag, output, overwrite=args.force)
    whole = all(file.intact for file in saved)
    if args.json:
        print(json.dumps({'output': str(output), 'whole': whole, 'files': [asdict(file) for file in saved]}, indent=2))
        return 0
    for file in saved:
        print(f'{file.file}: {file.unread or ("closed" if file.closed else "never closed, or truncated")}')
        width = max(map(len, file.saved), default=0)
        for topic, count in file.saved.items():
            lost = file.missing.get(topic)
            print(f'  {topic:{width}} {count:8d} messages saved' + (f', {lost} lost' if lost else ''))
        for damage in file.damaged:
            print(f'  {damage.size} bytes from byte {damage.offset} on are damaged and left out')
    if whole:
        print('nothing was missing or damaged')
    print(f'written to {output}, closed; the original is as it was')
    return 0
