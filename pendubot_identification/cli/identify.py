# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot identify``: parameters from bags."""

from __future__ import annotations

import argparse
import json
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pendubot_identification.errors import PendubotError, UsageError, sentence, wrong_usage

from .progress import progress_bar
from .report import add_reference, previous, reference, write_failure_report, write_result_report

if TYPE_CHECKING:
    from pendubot_identification.files import OutputFolder
    from pendubot_identification.identify.result import Result
    from pendubot_identification.recordings.datasets import Datasets

    from .report import Beside, Recordings

# The names of core's settings and parameters, again: importing them takes a second, which no --help is worth.
CRITERIA = ('energy', 'weak', 'trajectory')
MODELS = ('viscous', 'coulomb', 'rotor', 'geared', 'auto')
OPTIMIZERS = ('auto', 'mde', 'lsq')
HOLDS = ('auto', 'zero', 'linear')
#: The exit status of a result that is no better than what --fail-on names, and from which level on that is.
FAILED, FAILING = 3, {'warn': 1, 'error': 2, 'never': 3}

DESCRIPTION = """\
Estimate the parameters of a rig from recorded bags and write them to a result file.

BAG is the folder of a bag or its .mcap file, also of one that was never closed; @START:END takes a window of it, in
seconds from its first sample. Of one bag without a window the first half estimates and the second validates, as in the
paper; with a window, the rest of the bag validates, but for parts shorter than a second; several bags without windows
all estimate, and each is predicted from the others.

What lasts longer than ten minutes, or has more than 200 000 samples, is read piece by piece: energy and weak take all
of it, everything else twelve stretches of 8 s in which the rig is driven. An hour at 1 kHz takes less than 300 MB.

Three criteria can be minimised. Each is held against data that it has not seen, by simulation; the one that predicts
them best is published, and the others stand beside it:
  energy      the paper's: the work done equals the energy gained. Quadratic
  weak        the equations of motion times smooth bumps, integrated: no acceleration is needed. Quadratic
  trajectory  simulated motion equals recorded motion, over short segments. The sharpest; starts where weak ends
Four models, each with all of the one before it:
  viscous     P1 to P5, b1, b2: the paper's
  coulomb     and Coulomb friction, Fc1 Fc2
  rotor       and the inertia of the elbow's rotor, J2
  geared      and Stribeck friction and friction under load, Fs1 Fs2 k1 k2
"""
EXAMPLES = """\
examples:
  pendubot identify swing                                     halves of one bag, all criteria, the model chosen
  pendubot identify swing --criterion energy --model viscous --spread 0   as in the paper, all 4000 generations
  pendubot identify swing@0:9 --validate swing@9:18           windows of your own
  pendubot identify a b c --validate d --output result.yaml   several recordings pooled
  pendubot identify swing --criterion energy --sliding 0.3    energy over windows of 0.3 s
  pendubot identify swing --hold linear --delay 0:0.02        a torque that was measured, and late
  pendubot identify swing --report look                       a page with figures, look/report.html
exit status: 0 success, 1 a failure explained in one line, 2 wrong usage, 3 a result of level ERROR (see --fail-on)
"""


def add_parser(subparsers: Any) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser(
        'identify',
        help='estimate parameters from bags',
        description=DESCRIPTION,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('bags', nargs='+', metavar='BAG[@START:END]', help='bags that estimate')
    parser.add_argument('--validate', nargs='+', default=[], metavar='BAG[@START:END]', help='bags that only judge')
    what = parser.add_argument_group('what is minimised')
    what.add_argument(
        '--criterion',
        type=_criteria,
        default=CRITERIA,
        metavar='NAME[,NAME ...]',
        help=f'of {", ".join(CRITERIA)} (default: all)',
    )
    what.add_argument(
        '--model',
        default='auto',
        choices=MODELS,
        help='auto (default): the smallest that predicts training data left out about as well as any',
    )
    what.add_argument(
        '--bounds',
        action='append',
        default=[],
        metavar='NAME=LOW:HIGH',
        help='search interval of a parameter, such as P1=0:0.5; may be repeated',
    )
    data = parser.add_argument_group('how the data are taken')
    data.add_argument(
        '--hold',
        default='auto',
        choices=HOLDS,
        help='the torque between its samples: zero, it is held, as the bridge records it; linear, it was measured; '
        'auto (default): what explains the motion better. energy always takes it as held',
    )
    data.add_argument(
        '--delay',
        type=_delays,
        metavar='LOW:HIGH',
        help='the torque acts by so much [s] later than it is stamped, estimated between two values or fixed by one '
        '(default: --delay=-0.1:0.1; before a minus, the = is needed). energy knows none',
    )
    data.add_argument(
        '--smoothing',
        type=float,
        metavar='S',
        help="the differentiator's window [s] (default: 0.02 for energy, chosen from the data for the others)",
    )
    data.add_argument(
        '--sliding', type=float, metavar='S', help='sliding window of the energy balance [s]; cumulative without'
    )
    data.add_argument(
        '--link-length', type=float, metavar='M', help='length of link 1 by a ruler [m]: the data are held against it'
    )
    how = parser.add_argument_group('how it is minimised')
    how.add_argument(
        '--optimizer',
        default='auto',
        choices=OPTIMIZERS,
        help="mde: modified differential evolution, the paper's; lsq: the exact least-squares answer for energy and "
        'weak, Levenberg-Marquardt for trajectory; auto (default): lsq for trajectory, mde held against lsq for others',
    )
    how.add_argument(
        '--start',
        type=Path,
        metavar='RESULT.yaml',
        help='parameters from which trajectory starts, instead of the answer of weak',
    )
    how.add_argument('--seed', type=int, default=1, help='same seed, same result (default %(default)s)')
    how.add_argument('--runs', type=int, help='independent runs of MDE (default 10; 1 for trajectory)')
    how.add_argument('--population', type=int, metavar='NP', help='vectors of a run (default 30; 40 for trajectory)')
    how.add_argument('--generations', type=int, help='of a run, at most (default 4000; 120 for trajectory)')
    how.add_argument(
        '--spread',
        type=float,
        metavar='R',
        help='stop a run when the worst J of its population exceeds the best by no more than this fraction (default '
        '1e-9, which loses nothing; 1e-6 for trajectory); 0 takes every generation, as in the paper',
    )
    how.add_argument(
        '--per-vector',
        action='store_true',
        help="draw MDE's operator once per vector; beyond energy and viscous it always is",
    )
    where = parser.add_argument_group('input and output')
    where.add_argument('--topic', default='/joint_states', help='topic with the joint states (default %(default)s)')
    where.add_argument(
        '--joints', default='shoulder,elbow', metavar='SHOULDER,ELBOW', help='their joint names (default %(default)s)'
    )
    where.add_argument('--output', type=Path, metavar='RESULT.yaml', help='write the result here')
    where.add_argument(
        '--report', type=Path, metavar='DIR', help='make a report there: a page with figures, and the result beside it'
    )
    add_reference(where)
    where.add_argument('--force', action='store_true', help='overwrite an existing result or report')
    where.add_argument(
        '--fail-on',
        default='error',
        choices=FAILING,
        help=f'from which level of the result on the exit status is {FAILED} (default %(default)s); the result is '
        'printed and written all the same',
    )
    where.add_argument('--json', action='store_true', help='print the result as JSON and nothing else')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Identify, print, write."""
    from pendubot_identification.files import OutputFolder, refuse_input, refuse_unwritable
    from pendubot_identification.identify.result import plain
    from pendubot_identification.report.tables import whole
    from pendubot_identification.results.result_file import read_parameters, write_result

    with wrong_usage():
        settings, bags = _settings(args), _bags(args)
        joints(args.joints)
    for written in (args.output, args.report and args.report / 'result.yaml'):
        if written is not None:
            refuse_input(written, [*bags, args.start, args.reference])
    if args.start is not None:
        settings = replace(settings, start=read_parameters(args.start))
    beside = _beside(args)
    page: Path | None = None
    with nullcontext() if args.report is None else OutputFolder(args.report, overwrite=args.force) as folder:
        if args.output is not None:
            refuse_unwritable(args.output, overwrite=args.force)
        result, motions = _identify(args, settings, folder)
        try:
            if args.output is not None:
                write_result(args.output, result, overwrite=args.force)
            if folder is not None:
                with progress_bar(hidden=args.json) as progress:
                    page = write_result_report(folder, result, motions, beside, (), progress)
        finally:
            # Also where they cannot be written. Only now, because whoever closes the pipe ends the program.
            print(json.dumps(plain(result), indent=2) if args.json else whole(result))
    for written in (args.output, page):
        if written is not None and not args.json:
            print(f'written to {written}')
    return FAILED if result.level >= FAILING[args.fail_on] else 0


def _identify(args: argparse.Namespace, settings: Any, folder: OutputFolder | None) -> tuple[Result, Recordings]:
    """Return the result, and what a report shows of the motions; where it fails, a page says why."""
    from pendubot_identification.identify.identification import identify
    from pendubot_identification.recordings.datasets import load_datasets
    from pendubot_identification.results.result_file import result_of

    data = None
    try:
        data = load_datasets(args.bags, args.validate, topic=args.topic, joint_names=joints(args.joints))
        with progress_bar(hidden=args.json) as progress:
            found = identify(data.training, data.validation, settings, progress, data.notes)
        return result_of(found, data.sources), _shown(data)
    except Exception as error:
        if folder is not None:
            page = write_failure_report(folder, sentence(error), _asked(args), None if data is None else _shown(data))
            if not args.json:
                print(f'why is also said in {page}')
        raise


def _bags(args: argparse.Namespace) -> list[Path]:
    """Return where the bags are.

    Raises:
        BagError: one is not understood.
    """
    from pendubot_identification.recordings.bag_reader import BagWindow

    return [BagWindow.parse(text).path for text in (*args.bags, *args.validate)]


def _shown(data: Datasets) -> Recordings:
    """Return the motions that a report shows, which of long recordings are stretches."""
    from pendubot_identification.trajectories.long import held_parts

    return held_parts(data.training), held_parts(data.validation)


def _beside(args: argparse.Namespace) -> Beside | None:
    """Return what the report shows beside the result: a reference, or the result that it takes the place of."""
    if args.report is None:
        if args.reference is not None:
            raise UsageError('--reference stands beside a result in its report; add --report DIR')
        return None
    if args.reference is not None:
        return reference(args.reference)
    for earlier in (args.output, args.report / 'result.yaml'):
        if earlier is not None and earlier.exists():
            try:
                return previous(earlier)
            except PendubotError:
                continue  # it is about to be replaced, whatever it is
    return None


def _asked(args: argparse.Namespace) -> list[str]:
    """Return what was asked for, in words."""
    words = [f'estimate from {bag}' for bag in args.bags] + [f'validate on {bag}' for bag in args.validate]
    return [*words, f'criterion {", ".join(args.criterion)}; model {args.model}; optimizer {args.optimizer}']


def _settings(args: argparse.Namespace) -> Any:
    """Return the settings, but for where to start.

    Raises:
        PendubotError: an option makes no sense.
    """
    from pendubot_identification.identify.settings import DELAYS, Settings

    _refuse_what_does_nothing(args)
    mde = {'population': args.population, 'generations': args.generations}
    mde = {name: value for name, value in mde.items() if value is not None}
    if args.per_vector:
        mde['per_component'] = False
    if args.spread is not None:
        if not args.spread >= 0:
            raise UsageError(
                f'--spread is {args.spread:g}; 0, which takes every generation, or a number above it is expected'
            )
        mde['spread'] = args.spread or None
    return Settings(
        criteria=args.criterion,
        model=args.model,
        optimizer=args.optimizer,
        sliding=args.sliding,
        smoothing=args.smoothing,
        hold=args.hold,
        delays=args.delay or DELAYS,
        link_length=args.link_length,
        mde=mde,
        runs=args.runs,
        seed=args.seed,
        bounds=_bounds(args.bounds),
    )


def _refuse_what_does_nothing(args: argparse.Namespace) -> None:
    """Refuse options of one criterion or optimiser, and bounds of one model, where another was asked for.

    Raises:
        UsageError: it names them both.
    """
    from pendubot_identification.model.parameters import MODELS, NAMES

    for option in ('runs', 'population', 'generations', 'spread', 'per_vector'):
        given, name = getattr(args, option), option.replace('_', '-')
        if given is None or given is False:  # of a spread, 0 is something
            continue
        if args.optimizer == 'lsq':
            raise UsageError(f'--{name} is of MDE, and --optimizer lsq does without; leave one of the two out')
        if args.optimizer == 'auto' and args.criterion == ('trajectory',):
            raise UsageError(
                f'--{name} is of MDE, and --criterion trajectory does without unless it is asked for; leave it out, or '
                'add --optimizer mde'
            )
    # Of energy, a delay would but silence what is said of stamps that are off.
    for option, users in (('sliding', ('energy',)), ('delay', ('weak', 'trajectory')), ('start', ('trajectory',))):
        if getattr(args, option) is not None and not set(users) & set(args.criterion):
            raise UsageError(
                f'--{option} is of {" and ".join(users)}, and --criterion {",".join(args.criterion)} does without; '
                'leave one of the two out'
            )
    names = NAMES[: MODELS.get(args.model, len(NAMES))]
    for text in args.bounds:
        name = text.partition('=')[0]
        if name in NAMES and name not in names:
            raise UsageError(
                f'--bounds {text} is of a parameter that --model {args.model} does not have; its parameters are '
                f'{", ".join(names)}'
            )


def _criteria(text: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(name.strip() for name in text.split(',')))
    for name in names:
        if name not in CRITERIA:
            raise argparse.ArgumentTypeError(f'there is no criterion {name!r}; name some of {", ".join(CRITERIA)}')
    return names


def _delays(text: str) -> tuple[float, float]:
    try:
        low, high = map(float, text.split(':') if ':' in text else (text, text))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f'{text!r} is not understood; LOW:HIGH or one number of seconds is expected, such as 0:0.02'
        ) from None
    return low, high


def _bounds(texts: list[str]) -> Any:
    from pendubot_identification.errors import ParameterError
    from pendubot_identification.model.parameters import default_bounds

    bounds = default_bounds()
    for text in texts:
        name, _, interval = text.partition('=')
        try:
            low, high = map(float, interval.split(':'))
        except ValueError:
            raise ParameterError(
                f'--bounds {text!r} is not understood; NAME=LOW:HIGH is expected, such as P1=0:0.5'
            ) from None
        bounds = bounds.replaced(name, low, high)
    return bounds


def joints(text: str) -> list[str]:
    """Return what SHOULDER,ELBOW names.

    Raises:
        ParameterError: it names no two joints.
    """
    from pendubot_identification.errors import ParameterError

    names = [name.strip() for name in text.split(',') if name.strip()]
    if len(names) != 2 or len(set(names)) != 2:
        raise ParameterError(
            f'--joints {text!r} names {len(set(names))} joints; two are expected, such as shoulder,elbow'
        )
    return names
