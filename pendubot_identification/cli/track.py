# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot track``: a rig followed through recordings of any length."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pendubot_identification.errors import ExcitationError, wrong_usage
from pendubot_identification.level import NORMAL_95
from pendubot_identification.model import MODELS

from .progress import progress_bar
from .reading import add_joints, add_reading, reading_of, save_map

if TYPE_CHECKING:
    from pendubot_identification.identify.estimate import Progress
    from pendubot_identification.recordings.bag_reader import BagWindow
    from pendubot_identification.report.table import Table
    from pendubot_identification.results.track_file import Track
    from pendubot_identification.tracking.events import Start, State
    from pendubot_identification.tracking.tracker import Tracker
    from pendubot_identification.trajectories.conversion import Conversion

#: The exit status of a result of level ERROR, as of ``identify``.
FAILED = 3
#: Between two recordings of one stream [s].
BETWEEN = 10.0
#: Events that are printed.
SHOWN = 20

DESCRIPTION = """\
Follow the parameters of a rig through recordings of any length, one after the other as if they were one: what they are
at the end, how sure that is, and what changed when. Memory does not grow with the length.

The first eight seconds of motion are identified; from then on every 0.4 s of motion adds to what is known. Friction may
drift; inertias and weights stay unless they jump. A change (a payload, a motor that fades) is told from a
disturbance (a push by hand), which is ignored. Last come the informative windows: those with most motion between
two changes.
"""
EPILOG = """\
examples:
  pendubot track day                               a bag of hours
  pendubot track morning.csv evening.csv           two recordings of one rig, one after the other
  pendubot track day --start monday.yaml           beginning with what was identified on Monday
  pendubot track day --output now.yaml --report look   the newest parameters, and a page, look/report.html
exit status: 0 success, 1 a failure explained in one line, 2 wrong usage, 3 a result of level ERROR
"""


def add_parser(subparsers: Any) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser(
        'track', help='follow parameters through long recordings', description=DESCRIPTION, epilog=EPILOG
    )
    parser.add_argument('bags', nargs='+', metavar='BAG[@START:END]', help='bags or files, in the order of time')
    parser.add_argument('--start', type=Path, metavar='RESULT.yaml', help='parameters, delay and model to begin with')
    parser.add_argument('--model', choices=list(MODELS), help='default: that of --start, else coulomb')
    add_reading(parser)
    where = parser.add_argument_group('input and output')
    add_joints(where)
    where.add_argument('--output', type=Path, metavar='RESULT.yaml', help='write what is true at the end here')
    where.add_argument(
        '--report', type=Path, metavar='DIR', help='write a page there, report.html, and the result beside it'
    )
    where.add_argument('--figures', action='store_true', help='add its plot as SVG and PNG to the report')
    where.add_argument('--force', action='store_true', help='overwrite an existing result or report')
    where.add_argument('--json', action='store_true', help='print the result as JSON and nothing else')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Follow, print, write.

    Raises:
        PendubotError: a recording or a file that cannot be read, written or followed.
    """
    from pendubot_identification.files import OutputFolder, refuse_input, refuse_unwritable, write_atomically
    from pendubot_identification.recordings.bag_reader import BagWindow
    from pendubot_identification.recordings.datasets import require_files
    from pendubot_identification.report.table import wrapped
    from pendubot_identification.results.result import plain
    from pendubot_identification.results.result_file import result_text
    from pendubot_identification.results.track_file import start_of, tracked_result

    from .identify import joints

    with wrong_usage():
        windows, reading, names = [BagWindow.parse(text) for text in args.bags], reading_of(args), joints(args.joints)
        require_files(reading, [window.path for window in windows])
    for target in (args.output, args.report and args.report / 'result.yaml'):
        if target is not None:
            refuse_input(target, [*(window.path for window in windows), args.start, args.map])
    with nullcontext() if args.report is None else OutputFolder(args.report, overwrite=args.force) as folder:
        if args.output is not None:
            refuse_unwritable(args.output, overwrite=args.force)
        with progress_bar(hidden=args.json) as progress:
            tracker, track = follow(start_of(args.start, args.model), windows, args.topic, names, reading, progress)
        if tracker.state is None and not track.states:
            raise ExcitationError(f'{", ".join(args.bags)}: no parameters were found: {tracker.reason}')
        written = []
        result = tracked_result(tracker, track, args.bags) if tracker.state is not None else None
        text = '' if result is None else result_text(result)
        last = tracker.state or track.states[-1]
        table, happened = _summary(last, tracker, track)
        try:
            save_map(args, reading)
            if args.output is not None and text:
                write_atomically(args.output, text, overwrite=args.force)
                written.append(args.output)
            if folder is not None:
                from pendubot_identification.report.folder import write_track

                # Of many states some are forgotten, the newest perhaps.
                states = track.states if track.states[-1] is last else [*track.states, last]
                shown = (states, track.events), table, happened, args.bags, text
                written.append(write_track(folder, *shown, static=args.figures))
        finally:
            # Also where it cannot be written: hours may have been followed.
            if args.json:
                print(json.dumps({'reason': tracker.reason} if result is None else plain(result), indent=2))
            else:
                level = f'level {last.level.name}' + (f': {"; ".join(last.warnings)}' if last.warnings else '')
                print('\n'.join([table.text(), *map(wrapped, [level, *happened])]))
    if not args.json:
        for path in written:
            print(f'written to {path}')
    return FAILED if tracker.state is None or tracker.state.level.name == 'ERROR' else 0


def follow(
    start: Start,
    windows: Sequence[BagWindow],
    topic: str,
    names: Sequence[str],
    reading: Conversion,
    progress: Progress,
) -> tuple[Tracker, Track]:
    """Follow a rig through recordings, one after the other.

    Raises:
        PendubotError: a recording cannot be read or followed.
    """
    from pendubot_identification.recordings.bag_reader import BagWindow, open_recording, stream_samples
    from pendubot_identification.results.track_file import Track
    from pendubot_identification.tracking.events import State
    from pendubot_identification.tracking.tracker import Tracker
    from pendubot_identification.tracking.windows import InformativeWindows

    tracker, track, base = Tracker(start), Track(), 0.0
    for window in windows:
        reader, until, informative = open_recording(window.path, reading), base, InformativeWindows()
        if reader.note:
            track.notes.append(f'{window}: {reader.note}')
        for samples in stream_samples(reader, window, topic, names, reading):
            informative.add(samples)
            samples[:, 0] += base
            until = max(until, float(samples[-1, 0]))
            progress(f'following {window}', round(until - base), 0, math.nan)
            for event in tracker.feed(samples):
                track.add(event)
                if not isinstance(event, State):
                    informative.happened(event, base)
        if until > base and (cut := window.cut(until - base)):
            track.notes.append(cut)
        track.windows += [str(BagWindow(window.path, *found)) for found in informative.best()]
        base = until + BETWEEN
    return tracker, track


def _summary(last: State, tracker: Tracker, track: Track) -> tuple[Table, list[str]]:
    """Return what a person reads at the end: the parameters, and what happened."""
    from pendubot_identification.model.parameters import UNITS
    from pendubot_identification.report.table import Table
    from pendubot_identification.tracking.events import Disturbance

    # The first one with a band worth showing.
    first = next((s for s in track.states if s.t > track.states[0].t + BETWEEN), last)
    rows = [
        [name, f'{value:.4g}', f'{NORMAL_95 * error:.2g}', unit, f'{before:.4g}']
        for name, value, error, unit, before in zip(
            [*last.names, 'delay'],
            [*last.theta.tolist(), last.delay],
            [*last.std_error.tolist(), last.delay_std_error],
            [*UNITS[: len(last.names)], 's'],
            [*first.theta.tolist(), first.delay],
            strict=True,
        )
    ]
    head = ['', f'at {last.t:.0f} s', '95 % +-', 'unit', f'at {first.t:.0f} s']
    disturbances = sum(isinstance(event, Disturbance) for event in track.events)
    changes = [str(event) for event in track.events if not isinstance(event, Disturbance)]
    happened = [
        *(changes[:SHOWN] or ['no change']),
        *([f'and {len(changes) - SHOWN} changes more'] if len(changes) > SHOWN else []),
        *([f'{disturbances} disturbances, such as pushes by hand: their motion was not used'] if disturbances else []),
        *(f'{what}, {times} times' for what, times in tracker.notes.items()),
        *track.notes,
        *([f'at the end nothing is followed: {tracker.reason}'] if tracker.reason else []),
        *([f'worth identifying: {" ".join(track.windows)}'] if track.windows else []),
    ]
    return Table(head, rows), happened
