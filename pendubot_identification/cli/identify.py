# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot identify``: parameters from recordings."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Sequence
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pendubot_identification.errors import (
    LongRecordingError,
    ParameterError,
    PendubotError,
    TrajectoryError,
    UsageError,
    sentence,
    wrong_usage,
)
from pendubot_identification.identify.options import (
    APPLY_REMEDIES,
    CRITERION,
    DATA,
    DELAY,
    HOW,
    MDE,
    OPTIONS,
    START,
    WHAT,
)
from pendubot_identification.setting import Setting

from .progress import progress_bar
from .reading import add_joints, add_option, add_reading, flag, reading_of, save_map
from .report import add_reference, read_beside

if TYPE_CHECKING:
    from pendubot_identification.files import OutputFolder
    from pendubot_identification.identify.estimate import Progress
    from pendubot_identification.identify.settings import Settings
    from pendubot_identification.model.parameters import Bounds
    from pendubot_identification.report.folder import Recordings
    from pendubot_identification.report.tables import Beside
    from pendubot_identification.results.result import Result
    from pendubot_identification.trajectories.conversion import Conversion

#: The exit status of a result that is no better than what --fail-on names, and from which level on that is.
FAILED, FAILING = 3, {'warn': 1, 'error': 2, 'never': 3}

DESCRIPTION = """\
Estimate the parameters of a rig from its recordings and write them to a result file.

BAG is the folder of a bag or its .mcap file, also of one that was never closed, or a file with columns: .csv, .mat,
.xlsx or .parquet (pendubot import --help says what must be in it, pendubot info what is taken). @START:END
takes a window of it, in seconds from its first sample. Of one bag without a window the first half estimates and the
second validates, as in the paper; with a window, the rest of the bag validates, but for parts shorter than a second;
several bags without windows all estimate, and each is predicted from the others.

At most ten minutes are taken at once, or three of more than 200 000 samples. What is longer is followed, as pendubot
track does, to name the minutes of it that are worth identifying; where the rest of a bag validates and is longer, its
first minute does.

Three criteria can be minimised. The likelihood is published unless others are asked for. MDE minimises the paper's
energy in every identification, and its answer stands beside the published one:
  energy      the paper's: the work done equals the energy gained. Quadratic
  weak        the equations of motion times smooth test functions, integrated. Quadratic
  likelihood  what Kalman filters expect of the next samples, then prediction errors. Starts from weak
Four models, each with all of the one before it:
  viscous     P1 to P5, b1, b2: the paper's
  coulomb     and Coulomb friction, Fc1 Fc2
  rotor       and the inertia of the elbow's rotor, J2
  geared      and Stribeck friction and friction under load, Fs1 Fs2 k1 k2
"""
EXAMPLES = """\
examples:
  pendubot identify swing                                     one half of a bag estimates, the other validates
  pendubot identify swing --criterion energy --model viscous --spread 0   as in the paper, all 4000 generations
  pendubot identify swing@0:9 --validate swing@9:18           windows of your own
  pendubot identify a b c --validate d --output result.yaml   several recordings pooled
  pendubot identify swing --criterion energy --sliding 0.3    energy over windows of 0.3 s
  pendubot identify swing --hold linear --delay 0:0.02        a torque that was measured, and late
  pendubot identify swing --delay 0.004                       a delay that is known
  pendubot identify swing --delay=-0.02:0.02                  before a minus, the = is needed
  pendubot identify run.mat --columns q1=th1,q2=th2,tau1=u --degrees --zero hanging   your own
  pendubot identify run.csv --apply-remedies                  read as its faults ask for, which the result says
  pendubot identify swing --fix b2=0                          a parameter that is known
  pendubot identify swing --report look                       a page with figures, look/report.html
exit status: 0 success, 1 a failure explained in one line, 2 wrong usage, 3 a result of level ERROR (see --fail-on)
"""


def add_parser(subparsers: Any) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser(
        'identify', help='estimate parameters from recordings', description=DESCRIPTION, epilog=EXAMPLES
    )
    parser.add_argument('bags', nargs='+', metavar='BAG[@START:END]', help='bags or files that estimate')
    parser.add_argument('--validate', nargs='+', default=[], metavar='BAG[@START:END]', help='those that only judge')
    what = parser.add_argument_group('what is minimised')
    _add_options(what, WHAT)
    what.add_argument(
        '--bounds',
        action='append',
        default=[],
        metavar='NAME=LOW:HIGH',
        help='search interval of a parameter, such as P1=0:0.5; equal ends hold it; may be repeated; default ones '
        'grow with the rig',
    )
    what.add_argument(
        '--fix',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='hold a parameter at a value, such as b2=0; may be repeated',
    )
    _add_options(parser.add_argument_group('how the data are taken'), (*DATA, APPLY_REMEDIES))
    _add_options(parser.add_argument_group('how it is minimised'), HOW)
    add_reading(parser)
    where = parser.add_argument_group('input and output')
    add_joints(where)
    where.add_argument('--output', type=Path, metavar='RESULT.yaml', help='write the result here')
    where.add_argument(
        '--report', type=Path, metavar='DIR', help='make a report there: a page with figures, and the result beside it'
    )
    where.add_argument('--figures', action='store_true', help='add its figures as SVG and PNG to the report')
    add_reference(where)
    where.add_argument('--force', action='store_true', help='overwrite an existing result or report')
    where.add_argument(
        '--fail-on',
        default='error',
        choices=FAILING,
        help=f'from which level of the result on the exit status is {FAILED} (default %(default)s); the result is '
        'printed and written all the same',
    )
    where.add_argument(
        '--verbose', action='store_true', help='print every table and remark, not the shortest that helps'
    )
    where.add_argument('--json', action='store_true', help='print the result as JSON and nothing else')
    parser.set_defaults(run=run)


def _add_options(group: argparse._ArgumentGroup, options: Iterable[Setting]) -> None:
    """Add options of an identification; one that is not given is None."""
    spelled: dict[Setting, dict[str, Any]] = {
        CRITERION: {'type': _criteria, 'choices': None, 'metavar': 'NAME[,NAME ...]'},
        DELAY: {'type': _delays, 'metavar': 'LOW:HIGH'},
        START: {'type': Path, 'metavar': 'RESULT.yaml'},
    }
    for option in options:
        add_option(group, option, **spelled.get(option, {}))


def run(args: argparse.Namespace) -> int:
    """Identify, print, write."""
    from pendubot_identification.files import OutputFolder, refuse_input, refuse_unwritable
    from pendubot_identification.recordings.bag_reader import BagWindow
    from pendubot_identification.recordings.datasets import require_files
    from pendubot_identification.results.result import plain
    from pendubot_identification.results.result_file import read_parameters, write_result
    from pendubot_identification.trajectories.conversion import Conversion

    with wrong_usage():
        settings = replace(_settings(args), reading=reading_of(args))
        bags = [BagWindow.parse(text).path for text in (*args.bags, *args.validate)]
        joints(args.joints)
        require_files(settings.reading, bags)
    for target in (args.output, args.save_map, args.report and args.report / 'result.yaml'):
        if target is not None:
            refuse_input(target, [*bags, args.start, args.reference, args.map])
    if args.start is not None:
        settings = replace(settings, start=read_parameters(args.start))
    beside = _beside(args)
    written = [args.output, args.save_map]
    with nullcontext() if args.report is None else OutputFolder(args.report, overwrite=args.force) as folder:
        for target in filter(None, (args.output, args.save_map)):
            refuse_unwritable(target, overwrite=args.force)
        result, motions = _identify(args, settings, folder)
        try:
            if args.output is not None:
                write_result(args.output, result, overwrite=args.force)
            save_map(args, Conversion.of(result.reading))
            if folder is not None:
                from pendubot_identification.report.folder import write_report

                with progress_bar(hidden=args.json) as progress:
                    written.append(write_report(folder, result, motions, beside, (), progress, static=args.figures))
        finally:
            # Also where they cannot be written. Only now, because whoever closes the pipe ends the program.
            print(json.dumps(plain(result), indent=2) if args.json else _shown(args, result))
    if not args.json:
        for path in filter(None, written):
            print(f'written to {path}')
    return FAILED if result.level >= FAILING[args.fail_on] else 0


def _identify(args: argparse.Namespace, settings: Settings, folder: OutputFolder | None) -> tuple[Result, Recordings]:
    """Return the result, and what a report shows of the motions; where it fails, a page says why."""
    from pendubot_identification.recordings.datasets import Datasets, load_datasets
    from pendubot_identification.results.assemble import assemble_result
    from pendubot_identification.results.corrections import identify_recordings

    motions = None

    def load(reading: Conversion) -> Datasets:
        nonlocal motions
        motions = None
        names = joints(args.joints)
        try:
            data = load_datasets(args.bags, args.validate, topic=args.topic, joint_names=names, conversion=reading)
        except LongRecordingError as error:
            raise _with_windows(error, args.topic, names, reading, progress) from error
        motions = data.training, data.validation
        return data

    try:
        with progress_bar(hidden=args.json) as progress:
            found, data = identify_recordings(load, settings, progress, apply_remedies=bool(args.apply_remedies))
        assert motions is not None
        return assemble_result(found, data.sources), motions
    except Exception as error:
        if folder is not None:
            from pendubot_identification.report.folder import write_failure

            asked = [f'estimate from {bag}' for bag in args.bags] + [f'validate on {bag}' for bag in args.validate]
            how = f'criterion {", ".join(settings.criteria)}; model {settings.model}; optimizer {settings.optimizer}'
            page = write_failure(folder, sentence(error), [*asked, how], motions)
            if not args.json:
                print(f'why is also said in {page}')
        raise


def _with_windows(
    error: LongRecordingError, topic: str, names: Sequence[str], reading: Conversion, progress: Progress
) -> PendubotError:
    """Return the error that says which windows to take of what is too long."""
    from pendubot_identification.recordings.bag_reader import BagWindow
    from pendubot_identification.tracking.events import Start

    from .track import follow

    try:
        _, track = follow(Start(), [BagWindow.parse(error.window)], topic, names, reading, progress)
    except PendubotError:
        return error  # what is wrong with it is said of the window that is taken
    if not track.windows:
        return TrajectoryError(
            f'{error.found}, and no minute of it moves without a gap, a change or a push; take windows of it, such as '
            f'{error.first}'
        )
    return TrajectoryError(
        f'{error.found}; take windows of it, such as these of most motion between two changes: pendubot identify '
        f'{" ".join(track.windows)}'
    )


def _shown(args: argparse.Namespace, result: Result) -> str:
    """Return what people read of a result; in brief, with what keeps it if nothing does."""
    if args.verbose:
        from pendubot_identification.report.tables import summary

        return summary(result)
    from .brief import brief

    files = sum(target is not None for target in (args.output, args.save_map, args.report))
    keep = [] if args.output or args.report else ['kept nowhere: add --output RESULT.yaml, or --report DIR for figures']
    return '\n'.join([brief(result, files + len(keep)), *keep])


def _beside(args: argparse.Namespace) -> Beside | None:
    """Return what the report shows beside the result: a reference, or the result that it takes the place of."""
    if args.report is None:
        if args.reference is not None:
            raise UsageError('--reference stands beside a result in its report; add --report DIR')
        return None
    if args.reference is not None:
        return read_beside(args.reference, 'reference')
    for earlier in (args.output, args.report / 'result.yaml'):
        if earlier is not None and earlier.exists():
            with suppress(PendubotError):  # it is about to be replaced, whatever it is
                return read_beside(earlier, 'earlier result')
    return None


def _settings(args: argparse.Namespace) -> Settings:
    """Return the settings, but for where to start.

    Raises:
        PendubotError: an option makes no sense, alone or where another criterion, optimiser or model was asked for.
    """
    from pendubot_identification.identify.settings import Settings
    from pendubot_identification.model.parameters import MODELS, NAMES

    given = {option.name: value for option in OPTIONS if (value := getattr(args, option.name)) is not None}
    chosen = {name: value for name, value in given.items() if name != 'start'}
    settings = Settings.of(bounds=_bounds(args.bounds, args.fix), **chosen)
    criteria = ','.join(settings.criteria)
    without = None
    if settings.optimizer == 'lsq':
        without = '--optimizer lsq does without; leave one of the two out'
    for option in MDE:
        if without and option.name in given:
            raise UsageError(f'{flag(option.name)} is of MDE, and {without}')
    # Of energy, a delay would but silence what is said of stamps that are off.
    for name, users in (('delay', ('weak', 'likelihood')), ('start', ('likelihood',))):
        if name in given and not set(users) & set(settings.criteria):
            raise UsageError(
                f'--{name} is of {" and ".join(users)}, and --criterion {criteria} does without; leave one of the two '
                'out'
            )
    names = NAMES[: MODELS.get(settings.model, len(NAMES))]
    for given_as, text in [('--bounds', text) for text in args.bounds] + [('--fix', text) for text in args.fix]:
        if text.partition('=')[0] not in names:
            raise UsageError(
                f'{given_as} {text} is of a parameter that --model {settings.model} does not have; its parameters are '
                f'{", ".join(names)}'
            )
    for name, low, high in zip(NAMES, settings.bounds.lower, settings.bounds.upper, strict=True):
        # The smallest model has none of the friction that the larger ones add: there it is 0.
        if settings.model not in MODELS and name not in NAMES[: MODELS['viscous']] and not low <= 0 <= high:
            having = next(model for model, size in MODELS.items() if name in NAMES[:size])
            raise UsageError(
                f'{name} from {low:g} to {high:g} is of models that have it, and without --model the smallest that is '
                f'exact is taken; add --model {having}, or another that has it'
            )
    return settings


def _criteria(text: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name.strip() for name in text.split(',')))


def _delays(text: str) -> tuple[float, float]:
    try:
        low, high = map(float, text.split(':') if ':' in text else (text, text))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f'{text!r} is not understood; LOW:HIGH or one number of seconds is expected, such as 0:0.02'
        ) from None
    return low, high


def _bounds(intervals: list[str], fixed: list[str]) -> Bounds:
    from pendubot_identification.model.parameters import default_bounds

    bounds = default_bounds()
    for given, expected, texts in (
        ('--bounds', 'NAME=LOW:HIGH is expected, such as P1=0:0.5', intervals),
        ('--fix', 'NAME=VALUE is expected, such as b2=0', fixed),
    ):
        for text in texts:
            name, _, value = text.partition('=')
            try:
                low, high = map(float, value.split(':') if given == '--bounds' else (value, value))
            except ValueError:
                raise ParameterError(f'{given} {text!r} is not understood; {expected}') from None
            bounds = bounds.replaced(name, low, high)
    return bounds


def joints(text: str) -> list[str]:
    """Return what SHOULDER,ELBOW names.

    Raises:
        ParameterError: it names no two joints.
    """
    names = [name.strip() for name in text.split(',') if name.strip()]
    if len(names) != 2 or len(set(names)) != 2:
        raise ParameterError(
            f'--joints {text!r} names {len(set(names))} joints; two are expected, such as shoulder,elbow'
        )
    return names
