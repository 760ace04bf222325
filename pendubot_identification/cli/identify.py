# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot identify``: estimates parameters from recordings."""

import argparse
import json
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from pendubot_identification.errors import UsageError, wrong_usage
from pendubot_identification.files import OutputFolder, refuse_input, refuse_unwritable, write_atomically
from pendubot_identification.identification import APPLY_REMEDIES, MDE_OPTIONS, OPTIONS
from pendubot_identification.identification.settings import Settings
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import MODELS, NAMES
from pendubot_identification.recordings.datasets import load_datasets, windows_of
from pendubot_identification.report.tables import summary
from pendubot_identification.results.checks import check_recordings
from pendubot_identification.results.computation import identify_recordings
from pendubot_identification.results.options import bounds_of, settings_of
from pendubot_identification.results.result import Result, plain, read_result, result_text
from pendubot_identification.trajectories.conventions import CONVERSION

from .arguments import FAILING
from .options import given_options
from .terminal import brief, progress_bar


def run_identify(args: argparse.Namespace) -> int:
    """Identify a rig, and print and write the result."""
    with wrong_usage():
        options = given_options(args, (*OPTIONS, APPLY_REMEDIES, *CONVERSION))
        apply_remedies = APPLY_REMEDIES.parse(options.pop('apply_remedies', False))
        start = Path(str(options['start'])) if 'start' in options else None
        settings = _settings(args, options)
        bags = [window.path for window in windows_of([*args.bags, *args.validate], settings.reading)]
    if args.check:
        if args.output or args.report:
            raise UsageError('--check writes no file; leave out --output and --report')
        return _check(args, settings)
    for target in (args.output, args.report and args.report / 'result.yaml'):
        if target is not None:
            refuse_input(target, [*bags, start, args.settings])
    if start is not None:
        settings = replace(settings, start=read_result(start).theta)
    with nullcontext() if args.report is None else OutputFolder(args.report, overwrite=args.force) as folder:
        if args.output is not None:
            refuse_unwritable(args.output, overwrite=args.force)
        load = partial(load_datasets, args.bags, args.validate)
        with progress_bar(hidden=args.json) as progress:
            result, data = identify_recordings(load, settings, progress, apply_remedies=apply_remedies)
        written = []
        try:
            if args.output is not None:
                write_atomically(args.output, result_text(result), overwrite=args.force)
                written.append(args.output)
            if folder is not None:
                from pendubot_identification.report.page import write_report  # imports matplotlib

                motions = data.training, data.validation
                with progress_bar(hidden=args.json) as progress:
                    written.append(write_report(folder, result, motions, progress=progress, static=args.figures))
        finally:
            # Printed also if the files cannot be written; and last, because a closed pipe ends the program.
            print(json.dumps(plain(result), indent=2) if args.json else _shown(args, result))
    if not args.json:
        for path in written:
            print(f'written to {path}')
    return _status(args, result.level)


def _check(args: argparse.Namespace, settings: Settings) -> int:
    """Print the results of the checks of the recordings."""
    checks = check_recordings(partial(load_datasets, args.bags, args.validate), settings)
    text = '\n'.join(f'{each.level.name:5} {each.check:11} {each.sentence}' for each in checks)
    print(json.dumps([each.plain() for each in checks], indent=2) if args.json else text)
    return _status(args, max(each.level for each in checks))


def _status(args: argparse.Namespace, level: Level) -> int:
    """Return the exit status."""
    return 3 if level >= FAILING[args.fail_on] else 0


def _settings(args: argparse.Namespace, given: dict[str, Any]) -> Settings:
    """Return the settings of all given options except the start.

    Raises:
        PendubotError: an option is invalid, alone or together with the criterion, optimizer or model.
    """
    options = {name: value for name, value in given.items() if name != 'start'}
    settings = settings_of(options, bounds_of(args.bounds))
    if settings.optimizer == 'lsq' and (unused := [option.name for option in MDE_OPTIONS if option.name in options]):
        raise UsageError(f'{unused[0]} belongs to MDE, and --optimizer lsq ignores it; leave one of the two out')
    # With energy alone, a delay would only hide the warning of inconsistent timestamps.
    for name, users in {'delay': ('weak', 'likelihood'), 'start': ('likelihood',)}.items():
        if name in given and not set(users) & set(settings.criteria):
            raise UsageError(
                f'--{name} belongs to {" and ".join(users)}, and --criterion {",".join(settings.criteria)} ignores it; '
                'leave one of the two out'
            )
    for name in (text.partition('=')[0] for text in args.bounds):
        k = NAMES.index(name)
        having = [model for model, size in MODELS.items() if k < size]
        if settings.model not in ('auto', *having):
            raise UsageError(
                f'--bounds {name}: --model {settings.model} does not have this parameter; leave it out, or choose '
                f'--model {having[0]}'
            )
    return settings


def _shown(args: argparse.Namespace, result: Result) -> str:
    """Return the text of a result; without --verbose, a brief text and a hint if the result is not written."""
    if args.verbose:
        return summary(result)
    files = sum(target is not None for target in (args.output, args.report))
    keep = [] if args.output or args.report else ['not saved: add --output RESULT.yaml, or --report DIR for figures']
    return '\n'.join([brief(result, files + len(keep)), *keep])
