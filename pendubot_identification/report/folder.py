# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A report as a folder: the figures as SVG and PNG, the result file, and the page, which shows them all."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import datetime, timezone
from functools import partial
from pathlib import Path

from pendubot_identification.errors import PendubotError
from pendubot_identification.files import OutputFolder
from pendubot_identification.identify.effects import compensated
from pendubot_identification.identify.prediction import state_scale
from pendubot_identification.identify.result import Result
from pendubot_identification.recordings.bag_reader import BagReader, BagWindow
from pendubot_identification.recordings.tables import is_table
from pendubot_identification.results.figure_data import (
    excitation,
    known_effects,
    residuals,
    simulate_beside,
    unexplained_torque,
)
from pendubot_identification.results.provenance import answers, hold, settings
from pendubot_identification.results.result_file import result_text
from pendubot_identification.tracking.events import Event, State
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.trajectory import Trajectory

from . import figures
from .figures import Picture
from .page import Bag, failure_page, result_page, track_page
from .table import Table
from .tables import Beside

#: Stamps below this count from when a computer or a simulation began: they name no day [ns].
A_YEAR_NS = 365 * 24 * 3600 * 10**9
#: The motions that estimate, and those that validate.
Recordings = tuple[Sequence[Trajectory], Sequence[Trajectory]]


def write_report(
    folder: OutputFolder,
    result: Result,
    motions: Recordings | None,
    beside: Beside | None,
    notes: Sequence[str],
    progress: Callable[[str, int, int, float], None],
    bags: Path | None = None,
) -> Path:
    """Draw all that there is to draw of a result, write it, all or nothing, and return where the page is.

    Args:
        folder: to be written to.
        result: of an identification.
        motions: the recordings; None where they cannot be read, and nothing is drawn of them.
        beside: what stands beside the result.
        notes: what the page says that it does not show.
        progress: told what is being done, how much of it is done, and of how much.
        bags: the folder in which the bags lie now; None: where the result says.

    Raises:
        ResultError: the system refuses to write.
    """
    wanted = list(_wanted(result, motions, beside))
    drawn: list[Picture] = []
    notes = list(notes)
    for k, (what, draw) in enumerate(wanted):
        progress('drawing', k, len(wanted), math.nan)
        try:
            found = draw()
            drawn += found if isinstance(found, list) else [found] if found else []
        except PendubotError as error:
            notes.append(f'{what}; {error}')
    named = [_bag(BagWindow.parse(source.bag), bags) for source in result.bags] if motions is not None else []
    page = result_page(result, drawn, beside, notes, named)
    return _write(folder, {'result.yaml': result_text(result)}, drawn, page)


def write_failure(folder: OutputFolder, reason: str, asked: Sequence[str], motions: Recordings | None) -> Path:
    """Write a page that says why there is no result, with the data as far as they could be read; return where it is.

    Raises:
        ResultError: the system refuses to write.
    """
    drawn = [figures.draw_recordings(*motions)] if motions else []
    return _write(folder, {}, drawn, failure_page(reason, asked, drawn))


def write_track(
    folder: OutputFolder,
    track: tuple[Sequence[State], Sequence[Event]],
    table: Table,
    happened: Sequence[str],
    bags: Sequence[str],
    result: str,
) -> Path:
    """Write the page of a rig that was followed, the newest state last, and return where it is.

    ``result``: the text of the result file; empty where there is none at the end.

    Raises:
        ResultError: the system refuses to write.
    """
    picture = figures.draw_track(*track)
    page = track_page(track[0][-1], picture, table, happened, bags, result=bool(result))
    return _write(folder, {'result.yaml': result} if result else {}, [picture], page)


def _wanted(
    result: Result, motions: Recordings | None, beside: Beside | None
) -> Iterator[tuple[str, Callable[[], Picture | list[Picture] | None]]]:
    """Yield of all figures of a result what they are of, and what draws them."""
    yield 'the parameters', partial(figures.draw_parameters, result, beside)
    yield 'the correlations', partial(figures.draw_correlation, result)
    if motions is not None:
        found = answers(result)
        best = found[result.criterion]
        training, validation = (
            [Motion.prepare(motion, result.smoothing, hold(result)) for motion in recorded] for recorded in motions
        )
        at = figures.timeline([*motions[0], *motions[1]])
        scale, asked, known = (
            state_scale(training),
            settings(result),
            known_effects(training, best.delay, result.effects),
        )
        training = [compensated(motion, known, best.delay) for motion in training]
        validation = [compensated(motion, known, best.delay) for motion in validation]

        def simulated() -> Picture:
            shown = simulate_beside(validation or training, best, scale)
            return figures.draw_simulation(shown, at, validation=bool(validation))

        def excited() -> Picture:
            return figures.draw_excitation(list(result.parameters), excitation(training, best, result.parameters))

        def left(criterion: str) -> list[Picture]:
            shown = residuals(training, found[criterion], asked)
            return figures.draw_residuals(shown, [motion.name for motion in training], at)

        def unexplained() -> list[Picture]:
            return figures.draw_unexplained_torque(unexplained_torque(training, best), at)

        yield 'the data', partial(figures.draw_recordings, *motions)
        yield 'the unexplained torque', unexplained
        yield 'the simulation', simulated
        yield 'the excitation', excited
        for criterion in found:
            yield f'the residuals of {criterion}', partial(left, criterion)
    for criterion, answer in result.criteria.items():
        # Without MDE there is none, and results of earlier versions do not hold it, or not its minimum.
        if answer.convergence and answer.J.least_squares is not None:
            drawn = partial(figures.draw_convergence, criterion, answer.J.least_squares, answer.convergence)
            yield f'the convergence of {criterion}', drawn


def _bag(window: BagWindow, folder: Path | None) -> Bag:
    """Return where a bag lies, and the day of its recording by its own stamps; a file with columns has none."""
    path = (folder / window.path.name if folder else window.path).absolute()
    first_ns = 0 if is_table(path) else BagReader(path).first_ns
    day = datetime.fromtimestamp(first_ns / 1e9, timezone.utc).date().isoformat() if first_ns > A_YEAR_NS else ''
    return Bag(str(window), path.as_uri(), day)


def _write(folder: OutputFolder, files: Mapping[str, str], pictures: Iterable[Picture], page: str) -> Path:
    """Write the page last: where it is, all of it is."""
    drawn = {f'{p.name}.{ending}': content for p in pictures for ending, content in (('svg', p.svg), ('png', p.png))}
    folder.write_together({**files, **drawn, 'report.html': page})
    return (folder.path / 'report.html').absolute()
