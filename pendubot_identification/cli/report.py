# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot report``: a result as a page to look at; ``pendubot identify --report`` makes the same."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pendubot_identification.errors import PendubotError

from .progress import Progress, progress_bar

if TYPE_CHECKING:
    from pendubot_identification.files import OutputFolder
    from pendubot_identification.identify.evidence import Answer
    from pendubot_identification.identify.result import Given, Result
    from pendubot_identification.report.figures import Picture
    from pendubot_identification.trajectories.trajectory import Trajectory

    Recordings = tuple[Sequence[Trajectory], Sequence[Trajectory]]
    #: Other parameters, to stand beside a result's, and what to call them.
    Beside = tuple[Result | Given, str]

MOTION, TELLS = 'Recorded and simulated motion', 'What the motion tells of the parameters'
LEFT, SEARCH = 'What is left unexplained', 'The search'

DESCRIPTION = """\
Make a report of a result: one HTML page that needs no network and prints well, and its figures as SVG and PNG.

It shows the data with their windows, measured beside simulated motion, the residuals of every criterion, the
convergence of MDE, the parameters with their intervals, what the motion tells apart and excites, all warnings, and
where everything comes from. With each figure stands what a good one looks like.

The bags that the result names are read again; where one has been moved or changed, the report says so and leaves out
what would have been drawn from it.
"""
EPILOG = """\
examples:
  pendubot report result.yaml                                 into the folder result_report
  pendubot report result.yaml --reference last_week.yaml      last week's parameters beside these
  pendubot report result.yaml --bags ~/recordings --output there
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser(
        'report',
        help='a page with figures from a result',
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('result', type=Path, metavar='RESULT.yaml', help='a file that pendubot identify wrote')
    parser.add_argument(
        '--output', type=Path, metavar='DIR', help='folder of the report (default: RESULT_report beside the result)'
    )
    parser.add_argument(
        '--bags', type=Path, metavar='FOLDER', help='where the bags lie now (default: where the result says)'
    )
    add_reference(parser)
    parser.add_argument('--force', action='store_true', help='write into a folder that holds something already')
    parser.set_defaults(run=run)


def add_reference(parser: Any) -> None:
    """Add the option that sets other parameters beside the result's."""
    parser.add_argument(
        '--reference',
        type=Path,
        metavar='RESULT.yaml',
        help='parameters that the report shows beside the estimated ones: an earlier result, or values by hand',
    )


def run(args: argparse.Namespace) -> int:
    """Read a result and its bags, draw, write.

    Raises:
        PendubotError: there is no such result, or the folder cannot be written.
    """
    from pendubot_identification.files import OutputFolder, refuse_input
    from pendubot_identification.results.provenance import recordings
    from pendubot_identification.results.result_file import read_whole_result

    result = read_whole_result(args.result)
    beside = reference(args.reference)
    path = args.output or args.result.with_name(f'{args.result.stem}_report')
    refuse_input(path / 'result.yaml', [args.reference])
    motions, notes = None, []
    with OutputFolder(path, overwrite=args.force) as folder:
        try:
            motions = recordings(result, args.bags)
        except PendubotError as error:
            notes = [f'what is drawn from the recordings; {error}']
            print(f'pendubot: left out {notes[0]}', file=sys.stderr)
        with progress_bar() as progress:
            page = write_result_report(folder, result, motions, beside, notes, progress)
    print(f'written to {page}')
    return 0


def reference(path: Path | None) -> Beside | None:
    """Return the parameters of a file to stand beside a result's, and what to call them.

    Raises:
        ResultError: there is no such file, or it holds no parameters.
    """
    return None if path is None else (_with_parameters(path), 'reference')


def previous(path: Path) -> Beside:
    """Return the same of a result that is about to be replaced."""
    return _with_parameters(path), 'earlier result'


def _with_parameters(path: Path) -> Result | Given:
    from pendubot_identification.results.result_file import read_result

    result = read_result(path)
    for problem in result.unphysical():
        print(f'pendubot: {path}: {problem}', file=sys.stderr)
    return result


def write_result_report(
    folder: OutputFolder,
    result: Result,
    motions: Recordings | None,
    beside: Beside | None,
    notes: Sequence[str],
    progress: Progress,
) -> Path:
    """Draw all that there is to draw of a result, write it, and return where the page is."""
    from pendubot_identification.report.page import result_page
    from pendubot_identification.results.result_file import result_text

    sections, left_out = _sections(result, motions, beside, progress)
    other, name = beside or (None, '')
    files = _files(picture for section in sections.values() for picture in section)
    page = result_page(result, sections.pop(MOTION), sections, other, name, [*notes, *left_out, *_between(result)])
    return _write(folder, page, {'result.yaml': result_text(result)} | files)


def _between(result: Result) -> list[str]:
    """Return what no figure shows of long recordings."""
    return [
        f'what lies between {len(source.stretches)} stretches of {source.bag}, {source.duration:.0f} s; the '
        'figures, and the residuals in them, are of these stretches alone'
        for source in result.bags
        if source.stretches
    ]


def write_failure_report(folder: OutputFolder, reason: str, asked: Sequence[str], motions: Recordings | None) -> Path:
    """Write a page that says why there is no result, with the data as far as they could be read."""
    from pendubot_identification.report.figures import draw_recordings
    from pendubot_identification.report.page import failure_page

    pictures = [draw_recordings(*motions)] if motions is not None else []
    return _write(folder, failure_page(reason, asked, pictures), _files(pictures))


def _files(pictures: Iterable[Picture]) -> dict[str, str | bytes]:
    files: dict[str, str | bytes] = {}
    for picture in pictures:
        files[f'{picture.name}.svg'], files[f'{picture.name}.png'] = picture.svg, picture.png
    return files


def _write(folder: OutputFolder, page: str, files: Mapping[str, str | bytes]) -> Path:
    """Write the page last: where it is, all of it is."""
    folder.write_together({**files, 'report.html': page})
    return (folder.path / 'report.html').absolute()


def _sections(
    result: Result,
    motions: Recordings | None,
    beside: Beside | None,
    progress: Progress,
) -> tuple[dict[str, list[Picture]], list[str]]:
    """Return the figures under their headings, and why any of them is missing."""
    from pendubot_identification.identify.evidence import excitation, residuals, simulate_beside
    from pendubot_identification.identify.prediction import state_scale
    from pendubot_identification.report import figures
    from pendubot_identification.results.provenance import answers, hold, settings
    from pendubot_identification.trajectories.motion import Motion

    found = answers(result)
    best, other = found[result.criterion], beside or (None, '')
    wanted: list[tuple[str, str, Callable[[], Picture | None]]] = []
    wanted += [(TELLS, 'the parameters', partial(figures.draw_parameters, result, *other))]
    wanted += [(TELLS, 'the correlations', partial(figures.draw_correlation, result))]
    if motions is not None:
        training, judges = (
            [Motion.prepare(motion, result.smoothing, hold(result)) for motion in recorded] for recorded in motions
        )
        scale = state_scale(training)

        def simulated() -> Picture:
            shown = simulate_beside(judges or training, best, scale)
            return figures.draw_simulation(shown, validation=bool(judges))

        def excited() -> Picture:
            return figures.draw_excitation(list(result.parameters), excitation(training, best, result.parameters))

        def left(answer: Answer) -> Picture:
            return figures.draw_residuals(residuals(training, answer, settings(result), result.smoothing, scale))

        wanted += [(MOTION, 'the data', partial(figures.draw_recordings, *motions))]
        wanted += [(MOTION, 'the simulation', simulated), (TELLS, 'the excitation', excited)]
        wanted += [(LEFT, f'the residuals of {name}', partial(left, answer)) for name, answer in found.items()]
    for name, entry in result.criteria.items():
        # Without MDE there is none, and results of earlier versions do not hold it.
        if entry.convergence:
            wanted += [
                (
                    SEARCH,
                    f'the convergence of {name}',
                    partial(figures.draw_convergence, name, entry.J, entry.convergence),
                )
            ]
    sections: dict[str, list[Picture]] = {MOTION: [], TELLS: [], LEFT: [], SEARCH: []}
    left_out = []
    for k, (section, what, draw) in enumerate(wanted):
        progress('drawing', k, len(wanted), math.nan)
        try:
            picture = draw()
        except PendubotError as error:
            left_out.append(f'{what}; {error}')
        else:
            sections[section] += [picture] if picture is not None else []
    return sections, left_out
