# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot repair``: a closed copy of an unclosed, truncated or damaged bag."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict

from pendubot_identification.recordings.bag_repair import repair


def run(args: argparse.Namespace) -> int:
    """Repair, and print the number of saved messages."""
    # The absolute path has a name also if the given one ends with a slash.
    bag = args.bag.absolute()
    output = args.output or bag.parent / f'{bag.stem if bag.is_file() else bag.name}_repaired'
    files = repair(args.bag, output, overwrite=args.force)
    intact = all(file.intact for file in files)
    if args.json:
        print(json.dumps({'output': str(output), 'whole': intact, 'files': [asdict(file) for file in files]}, indent=2))
        return 0
    for file in files:
        print(f'{file.file}: {file.unread or ("closed" if file.closed else "never closed, or truncated")}')
        width = max(map(len, file.saved), default=0)
        for topic, count in file.saved.items():
            lost = file.missing.get(topic)
            print(f'  {topic:{width}} {count:8d} messages saved' + (f', {lost} lost' if lost else ''))
        for damage in file.damaged:
            print(f'  {damage.size} bytes from byte {damage.offset} on are damaged and left out')
    if intact:
        print('nothing was missing or damaged')
    print(f'written to {output}, closed; the original is unchanged')
    return 0
