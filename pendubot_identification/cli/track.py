# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot track``: tracks the parameters of a rig through recordings of any length."""

import argparse
import json
import sys
from contextlib import nullcontext

from pendubot_identification.errors import ExcitationError, wrong_usage
from pendubot_identification.files import OutputFolder, refuse_input, refuse_unwritable, write_atomically
from pendubot_identification.level import NORMAL_95
from pendubot_identification.model.parameters import UNITS
from pendubot_identification.recordings.datasets import windows_of
from pendubot_identification.report.tables import Table, wrapped
from pendubot_identification.results.result import plain, result_text
from pendubot_identification.results.track_file import BETWEEN, Track, start_of, track_recordings, tracked_result
from pendubot_identification.tracking.events import Disturbance, State
from pendubot_identification.tracking.tracker import Tracker

from .options import conversion_of
from .terminal import progress_bar

#: Largest number of printed changes.
SHOWN = 20


def run_track(args: argparse.Namespace) -> int:
    """Track the parameters of a rig, and print and write the result."""
    with wrong_usage():
        conversion = conversion_of(args)
        windows = windows_of(args.bags, conversion)
    for target in (args.output, args.report and args.report / 'result.yaml'):
        if target is not None:
            refuse_input(target, [*(window.path for window in windows), args.start, args.settings])
    with nullcontext() if args.report is None else OutputFolder(args.report, overwrite=args.force) as folder:
        if args.output is not None:
            refuse_unwritable(args.output, overwrite=args.force)
        with progress_bar(hidden=args.json) as progress:
            start = start_of(args.start, args.model)
            tracker, track = track_recordings(start, windows, conversion, progress)
        if tracker.state is None and not track.states:
            failed = f'{", ".join(args.bags)}: no parameters were identified: {tracker.reason}'
            raise ExcitationError('; '.join([failed, *track.notes]))
        last, written = tracker.state or track.states[-1], []
        result = tracked_result(tracker, track, args.bags)
        text = '' if result is None else result_text(result)
        table, happened = _table(last, track), _events(tracker, track)
        try:
            if args.output is not None and text:
                write_atomically(args.output, text, overwrite=args.force)
                written.append(args.output)
            if folder is not None:
                from pendubot_identification.report.page import write_track  # imports matplotlib

                # Long tracks are thinned, so the newest state may be missing.
                states = track.states if track.states[-1] is last else [*track.states, last]
                shown = (states, track.events), table, happened, args.bags, text
                written.append(write_track(folder, *shown, static=args.figures))
        finally:
            # Printed also if the files cannot be written, because the computation may be long.
            if args.json:
                print(json.dumps({'reason': tracker.reason} if result is None else plain(result), indent=2))
            else:
                level = f'level {last.level.name}' + (f': {"; ".join(last.warnings)}' if last.warnings else '')
                print('\n'.join([table.text(), *map(wrapped, [level, *happened])]))
    if not args.json:
        for path in written:
            print(f'written to {path}')
    if args.output is not None and not text:
        print(f'pendubot: {args.output} is not written: no parameters are tracked at the end', file=sys.stderr)
    return 3 if tracker.state is None else 0


def _table(last: State, track: Track) -> Table:
    """Return the last parameters with their intervals, beside the first parameters after the tracker has settled."""
    first = next((state for state in track.states if state.t > track.states[0].t + BETWEEN), last)
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
    return Table(['', f'at {last.t:.0f} s', '95 % ±', 'unit', f'at {first.t:.0f} s'], rows)


def _events(tracker: Tracker, track: Track) -> list[str]:
    """Return a sentence for each change and note, and for the informative windows."""
    changes = [str(event) for event in track.events if not isinstance(event, Disturbance)]
    disturbances = len(track.events) - len(changes)
    happened = changes[:SHOWN] or ['no change']
    if len(changes) > SHOWN:
        happened.append(f'and {len(changes) - SHOWN} more changes')
    if disturbances:
        happened.append(f'{disturbances} disturbances, such as pushes by hand: their motion was not used')
    happened += [f'{note}, {times} times' for note, times in tracker.notes.items()] + track.notes
    if tracker.reason:
        happened.append(f'no parameters are tracked at the end: {tracker.reason}')
    if track.windows:
        happened.append(f'informative windows: {" ".join(track.windows)}')
    return happened
