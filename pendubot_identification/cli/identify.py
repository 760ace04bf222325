"""``pendubot identify``: parameters from bags."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

DESCRIPTION = """\
Estimate the parameters of a rig from recorded bags and write them to a result file.

BAG is the folder of a bag or its .mcap file, also of one that was never closed; @START:END takes a window of it, in
seconds from its first sample. Of one bag without a window the first half estimates and the second validates, as in the
paper; with a window, the rest of the bag validates; several bags without windows all estimate, and each is foreseen
from the others.
"""
EXAMPLES = """\
examples:
  pendubot identify swing                                     the paper's way: halves of one bag
  pendubot identify swing@0:9 --validate swing@9:18           windows of your own
  pendubot identify a b c --validate d --output result.yaml   several recordings pooled
  pendubot identify swing --sliding 0.3 --optimizer lsq       energy over windows of 0.3 s, least squares alone
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
    what.add_argument('--criterion', default='energy', choices=['energy'], help="the paper's energy balance (default)")
    what.add_argument('--model', default='viscous', choices=['viscous'], help='the seven parameters (default)')
    what.add_argument(
        '--sliding', type=float, metavar='S', help='sliding window of the energy balance [s]; cumulative without'
    )
    what.add_argument(
        '--smoothing',
        type=float,
        default=0.02,
        metavar='S',
        help="the differentiator's window [s] (default %(default)s)",
    )
    what.add_argument(
        '--bounds',
        action='append',
        default=[],
        metavar='NAME=LOW:HIGH',
        help='search interval of a parameter, such as P1=0:0.5; may be repeated',
    )
    how = parser.add_argument_group('how')
    how.add_argument('--optimizer', default='mde', choices=['mde', 'lsq'], help='default: %(default)s')
    how.add_argument('--runs', type=int, default=10, help='independent runs (default %(default)s)')
    how.add_argument('--seed', type=int, default=1, help='same seed, same result (default %(default)s)')
    how.add_argument('--population', type=int, default=30, metavar='NP', help='vectors of a run (default %(default)s)')
    how.add_argument('--generations', type=int, default=4000, help='default: %(default)s')
    how.add_argument('--per-vector', action='store_true', help="draw MDE's operator once per vector, not per component")
    where = parser.add_argument_group('input and output')
    where.add_argument('--topic', default='/joint_states', help='topic with the joint states (default %(default)s)')
    where.add_argument(
        '--joints', default='shoulder,elbow', metavar='SHOULDER,ELBOW', help='their joint names (default %(default)s)'
    )
    where.add_argument('--output', type=Path, metavar='RESULT.yaml', help='write the result here')
    where.add_argument('--force', action='store_true', help='overwrite an existing result')
    where.add_argument('--json', action='store_true', help='print the result as JSON and nothing else')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Identify, print, write."""
    from tqdm import tqdm

    from pendubot_identification.adapters.datasets import load_datasets
    from pendubot_identification.adapters.result_file import refuse_existing, result_data, write_result
    from pendubot_identification.core.identification import identify
    from pendubot_identification.core.mde import MDESettings
    from pendubot_identification.core.settings import Settings
    from pendubot_identification.report.tables import whole

    settings = Settings(
        criterion=args.criterion,
        model=args.model,
        optimizer=args.optimizer,
        sliding=args.sliding,
        smoothing=args.smoothing,
        mde=MDESettings(args.population, args.generations, per_component=not args.per_vector),
        runs=args.runs,
        seed=args.seed,
        bounds=_bounds(args.bounds),
    )
    if args.output is not None and not args.force:
        refuse_existing(args.output)
    data = load_datasets(args.bags, args.validate, topic=args.topic, joint_names=_joints(args.joints))
    with tqdm(
        total=args.generations, unit='gen', desc='MDE', disable=None if not args.json else True, leave=False
    ) as bar:

        def progress(generation: int, best: float) -> None:
            bar.set_postfix_str(f'J = {best:.4e}', refresh=False)
            bar.update(generation - bar.n)

        result = identify(data.training, data.validation, settings, progress, data.notes)
    plain = result_data(result, data.sources)
    if args.output is not None:
        write_result(args.output, plain, overwrite=args.force)
    if args.json:
        print(json.dumps(plain, indent=2))
        return 0
    print(whole(plain))
    if args.output is not None:
        print(f'written to {args.output}')
    return 0


def _bounds(texts: list[str]) -> Any:
    from pendubot_identification.core.errors import ParameterError
    from pendubot_identification.core.parameters import default_bounds

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


def _joints(text: str) -> list[str]:
    from pendubot_identification.core.errors import ParameterError

    names = [name.strip() for name in text.split(',') if name.strip()]
    if len(names) != 2 or len(set(names)) != 2:
        raise ParameterError(
            f'--joints {text!r} names {len(set(names))} joints; two are expected, such as shoulder,elbow'
        )
    return names
