# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A report as a folder: the page, the result file, and on request all figures as SVG and PNG."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime, timezone
from functools import partial
from pathlib import Path

from pendubot_identification import __version__
from pendubot_identification.errors import PendubotError
from pendubot_identification.files import OutputFolder
from pendubot_identification.identify.catalogue import compensated
from pendubot_identification.identify.prediction import state_scale
from pendubot_identification.recordings.bag_reader import BagReader, BagWindow
from pendubot_identification.recordings.tables import is_table
from pendubot_identification.results.provenance import answers, hold, settings
from pendubot_identification.results.result import Result
from pendubot_identification.results.result_file import result_text
from pendubot_identification.tracking.events import Event, State
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.trajectory import Trajectory

from . import figure_data, figures, plots
from .page import Bag, failure_page, render, result_page
from .plots import Picture
from .table import Table
from .tables import Beside

#: Stamps below this count from the start of a computer or a simulation: they name no day [ns].
A_YEAR_NS = 365 * 24 * 3600 * 10**9
#: The motions that estimate, and those that validate.
Recordings = tuple[Sequence[Trajectory], Sequence[Trajectory]]
#: The subject of pictures, for messages, and the function that draws them.
Wanted = tuple[str, Callable[[], list[Picture]]]


def write_report(
    folder: OutputFolder,
    result: Result,
    motions: Recordings | None,
    beside: Beside | None,
    notes: Sequence[str],
    progress: Callable[[str, int, int, float], None],
    bags: Path | None = None,
    *,
    static: bool = False,
) -> Path:
    """Draw all pictures of a result, write the report, all or nothing, and return where the page is.

    Args:
        folder: to be written to.
        result: of an identification.
        motions: the recordings; None where they cannot be read.
        beside: another result to be shown beside it.
        notes: further remarks on the page.
        progress: told the activity, how much of it is done, and of how much.
        bags: the folder in which the bags lie now; None: where the result says.
        static: whether all pictures are written as SVG and PNG, too.

    Raises:
        ResultError: the system refuses to write.
    """
    wanted = [*_of_result(result, beside), *(pictures_of_motions(result, *motions) if motions else [])]
    pictures: list[Picture] = []
    missing = []
    for k, (subject, draw) in enumerate(wanted):
        progress('drawing', k, len(wanted), math.nan)
        try:
            pictures += draw()
        except PendubotError as error:
            missing.append(f'{subject}; {error}')
    windows = [BagWindow.parse(source.bag) for source in result.bags] if motions is not None else []
    # A motion may also come from memory.
    named = [_bag(window, bags) for window in windows if _place(window, bags).exists()]
    page = result_page(result, pictures, beside, [*notes, *missing], named)
    return _write(folder, {'result.yaml': result_text(result)}, pictures if static else (), page)


def write_failure(folder: OutputFolder, reason: str, asked: Sequence[str], motions: Recordings | None) -> Path:
    """Write a page that says why there is no result, with the data as far as they could be read; return where it is.

    Raises:
        ResultError: the system refuses to write.
    """
    pictures = [plots.plot_recordings(*motions)] if motions else []
    return _write(folder, {}, (), failure_page(reason, asked, pictures))


def write_track(
    folder: OutputFolder,
    track: tuple[Sequence[State], Sequence[Event]],
    table: Table,
    happened: Sequence[str],
    bags: Sequence[str],
    result: str,
    *,
    static: bool = False,
) -> Path:
    """Write the page of a rig that was tracked, the newest state last, and return where it is.

    ``result``: the text of the result file; empty where there is none at the end. ``static``: as above.

    Raises:
        ResultError: the system refuses to write.
    """
    picture = plots.plot_track(*track)
    about = {'version': __version__, 'state': track[0][-1], 'table': table, 'happened': happened, 'bags': bags}
    page = render('track.html.jinja', [picture], result=bool(result), **about)
    return _write(folder, {'result.yaml': result} if result else {}, [picture] if static else (), page)


def _of_result(result: Result, beside: Beside | None) -> Iterator[Wanted]:
    yield 'the parameters', lambda: [figures.draw_parameters(result, beside)]
    yield 'the correlations', lambda: figures.draw_correlation(result)
    for criterion, answer in result.criteria.items():
        # Without MDE there is none, and results of earlier versions do not hold it, or not its minimum.
        if answer.convergence and answer.J.least_squares is not None:
            draw = partial(figures.draw_convergence, criterion, answer.J.least_squares, answer.convergence)
            yield f'the convergence of {criterion}', draw


def pictures_of_motions(
    result: Result, training: Sequence[Trajectory], validation: Sequence[Trajectory]
) -> Iterator[Wanted]:
    """Yield the subject of each picture of the recordings, and the function that draws it."""
    estimates = answers(result)
    best = estimates[result.criterion]
    timeline = plots.Timeline.of([*training, *validation])
    estimating, validating = (
        [Motion.prepare(motion, result.smoothing, hold(result)) for motion in recorded]
        for recorded in (training, validation)
    )
    scale, asked = state_scale(estimating), settings(result)
    effects = figure_data.known_effects(estimating, best.delay, result.effects)
    estimating, validating = (
        [compensated(motion, effects, best.delay) for motion in motions] for motions in (estimating, validating)
    )

    def unexplained_torque() -> list[Picture]:
        found = figure_data.unexplained_torque(estimating, best)
        return [plots.plot_unexplained_torque(found, timeline), figures.draw_torque_means(found)]

    def simulation() -> list[Picture]:
        found = figure_data.simulate_beside(validating or estimating, best, scale)
        return [plots.plot_simulation(found, timeline, validation=bool(validating))]

    def excitation() -> list[Picture]:
        found = figure_data.excitation(estimating, best, result.parameters)
        return [figures.draw_excitation(list(result.parameters), found)]

    def residuals(criterion: str) -> list[Picture]:
        found = figure_data.residuals(estimating, estimates[criterion], asked)
        return [plots.plot_residuals(found, timeline), figures.draw_whiteness(found)]

    yield 'the data', lambda: [plots.plot_recordings(training, validation)]
    yield 'the unexplained torque', unexplained_torque
    yield 'the simulation', simulation
    yield 'the excitation', excitation
    for name in estimates:
        yield f'the residuals of {name}', partial(residuals, name)


def _place(window: BagWindow, folder: Path | None) -> Path:
    return (folder / window.path.name if folder else window.path).absolute()


def _bag(window: BagWindow, folder: Path | None) -> Bag:
    """Return where a bag lies, and the day of its recording by its own stamps; a file with columns has none."""
    path = _place(window, folder)
    first_ns = 0 if is_table(path) else BagReader(path).first_ns
    day = datetime.fromtimestamp(first_ns / 1e9, timezone.utc).date().isoformat() if first_ns > A_YEAR_NS else ''
    return Bag(str(window), path.as_uri(), day)


def _write(folder: OutputFolder, files: Mapping[str, str], static: Sequence[Picture], page: str) -> Path:
    """Write the page last: where it is, all of it is."""
    drawn = {f'{p.name}.{ending}': content for p in static for ending, content in p.files('svg', 'png').items()}
    folder.write_together({**files, **drawn, 'report.html': page})
    return (folder.path / 'report.html').absolute()
