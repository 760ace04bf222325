# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot info``: describes the content of a recording."""

import argparse
import json
from dataclasses import asdict
from typing import Any

from pendubot_identification.errors import wrong_usage
from pendubot_identification.recordings.bag_reader import BagReader
from pendubot_identification.recordings.joint_states import JOINT_STATE
from pendubot_identification.recordings.survey import as_text, survey_bag, survey_table
from pendubot_identification.recordings.table_reader import TableReader
from pendubot_identification.recordings.tables import is_table

from .options import conversion_of


def run_info(args: argparse.Namespace) -> int:
    """Print the content of a recording."""
    with wrong_usage():
        conversion = conversion_of(args)
    if is_table(args.bag):
        table = survey_table(TableReader(args.bag, conversion))
        print(json.dumps(table, indent=2) if args.json else f'{args.bag}: {as_text(table)}')
        return 0
    bag = BagReader(args.bag)
    topics = survey_bag(bag)
    summary = {
        'bag': str(bag.path),
        'files': [str(bag.path)] if bag.converted else [str(file.path) for file in bag.files],
        'closed': bag.closed,
        'note': f'only its messages of type {JOINT_STATE} are read' if bag.converted else bag.note,
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
        disordered = t['stamped'] and (t['repeated'] or t['backwards'])
        ms = {name: 1e3 * (t[name] or 0.0) for name in ('jitter', 'longest', 'latency', 'latency_max')}
        lines.append(f'  {t["name"]:{width}} {t["messages"]:8d} messages {t["rate"]:9.2f} Hz  {t["type"]}')
        details = {
            f'jitter {ms["jitter"]:.3f} ms, longest interval {ms["longest"]:.3f} ms': t['period'] is not None,
            f'gaps {t["gaps"]}, {t["missing"]} messages, first after {t["first_gap"] or 0:.3f} s': t['gaps'],
            f'latency {ms["latency"]:.3f} ms, at most {ms["latency_max"]:.3f} ms': t['latency'] is not None,
            f'stamps {t["repeated"]} repeat, {t["backwards"]} run back': disordered,
            f'lost {t["lost"]} messages that the recorder had numbered': t['lost'],
        }
        lines += [f'  {"":{width}} {line}' for line, shown in details.items() if shown]
    return '\n'.join(lines)
