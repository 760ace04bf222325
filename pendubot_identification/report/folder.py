# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A report as a folder: the page, the result file, and on request all figures as SVG and PNG."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from urllib.parse import quote

from markupsafe import escape

from pendubot_identification import __version__
from pendubot_identification.errors import PendubotError
from pendubot_identification.files import OutputFolder
from pendubot_identification.identify.catalogue import compensated
from pendubot_identification.identify.prediction import predict, state_scale
from pendubot_identification.recordings.bag_reader import BagReader, BagWindow
from pendubot_identification.recordings.tables import is_table
from pendubot_identification.results.assemble import predicted
from pendubot_identification.results.provenance import answers, hold, settings
from pendubot_identification.results.result import Predicted, Result
from pendubot_identification.results.result_file import result_text
from pendubot_identification.tracking.events import Event, State
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.trajectory import Trajectory

from . import figure_data, figures, plots, rig
from .page import failure_page, render, result_page
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
    paths: bool = False,
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
        paths: whether the page names the absolute folders of the recordings.

    Raises:
        ResultError: the system refuses to write.
    """
    prepared = Prepared.of(result, *motions) if motions else None
    wanted = [*_of_result(result), *(prepared.pictures() if prepared else [])]
    pictures: list[Picture] = []
    missing = []
    for k, (subject, draw) in enumerate(wanted):
        progress('drawing', k, len(wanted), math.nan)
        try:
            pictures += draw()
        except PendubotError as error:
            missing.append(f'{subject}; {error}')
    compared = prepared.compared(beside) if prepared and beside else {}
    text = result_text(result)
    days = _days(result, bags) if motions else {}
    page = result_page(result, pictures, beside, [*notes, *missing], compared, text, days)
    named = [source.bag for source in result.bags] + ([f'{bags.absolute()}/-'] if bags else [])
    return _write(folder, {'result.yaml': text}, pictures if static else (), page, () if paths else named)


def write_failure(folder: OutputFolder, reason: str, asked: Sequence[str], motions: Recordings | None) -> Path:
    """Write a page that says why there is no result, with the data as far as they could be read; return where it is.

    Raises:
        ResultError: the system refuses to write.
    """
    pictures = [plots.plot_recordings(*motions)] if motions else []
    return _write(folder, {}, (), failure_page(reason, asked, pictures), [reason, *asked])


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
    return _write(folder, {'result.yaml': result} if result else {}, [picture] if static else (), page, bags)


def _of_result(result: Result) -> Iterator[Wanted]:
    yield 'the correlations', lambda: figures.draw_correlation(result)
    for criterion, answer in result.criteria.items():
        if answer.convergence and answer.J.least_squares is not None:
            draw = partial(figures.draw_convergence, criterion, answer.J.least_squares, answer.convergence)
            yield f'the convergence of {criterion}', draw


@dataclass(frozen=True, slots=True)
class Prepared:
    """A result and its recordings, with smoothed states and without the compensated effects."""

    result: Result
    recorded: Recordings
    estimating: Sequence[Motion]
    validating: Sequence[Motion]
    scale: figure_data.Array

    @classmethod
    def of(cls, result: Result, training: Sequence[Trajectory], validation: Sequence[Trajectory]) -> Prepared:
        """Prepare the recordings as the identification did."""
        delay = answers(result)[result.criterion].delay
        estimating, validating = (
            [Motion.prepare(motion, result.smoothing, hold(result)) for motion in recorded]
            for recorded in (training, validation)
        )
        scale = state_scale(estimating)
        effects = figure_data.known_effects(estimating, delay, result.effects)
        estimating, validating = (
            [compensated(motion, effects, delay) for motion in motions] for motions in (estimating, validating)
        )
        return cls(result, (training, validation), estimating, validating, scale)

    def compared(self, beside: Beside) -> dict[str, Predicted]:
        """Return how well another result, and this one, predict the validation data or, without any, all data."""
        best, (other, name) = answers(self.result)[self.result.criterion], beside
        motions, vectors = self.validating or self.estimating, {name: other.theta.vector(), 'identified': best.theta}
        return {title: predicted(predict(motions, theta, best.delay, self.scale)) for title, theta in vectors.items()}

    def pictures(self) -> Iterator[Wanted]:
        """Yield the subject of each picture of the recordings, and the function that draws it."""
        estimates, estimating, validating = answers(self.result), self.estimating, self.validating
        best, asked = estimates[self.result.criterion], settings(self.result)
        timeline = plots.Timeline.of([*self.recorded[0], *self.recorded[1]])

        def unexplained_torque() -> list[Picture]:
            found = figure_data.unexplained_torque(estimating, best)
            return [plots.plot_unexplained_torque(found, timeline), figures.draw_torque_means(found)]

        def simulation() -> list[Picture]:
            found = figure_data.simulate_beside(validating or estimating, best, self.scale)
            return [plots.plot_simulation(found, timeline, validation=bool(validating))]

        def excitation() -> list[Picture]:
            found = figure_data.excitation(estimating, best, self.result.parameters)
            return [figures.draw_excitation(list(self.result.parameters), found)]

        def residuals(criterion: str) -> list[Picture]:
            found = figure_data.residuals(estimating, estimates[criterion], asked)
            return [plots.plot_residuals(found, timeline), figures.draw_whiteness(found)]

        yield 'the data', lambda: [plots.plot_recordings(*self.recorded)]
        yield 'the unexplained torque', unexplained_torque
        yield 'the simulation', simulation
        yield 'the excitation', excitation
        for name in estimates:
            yield f'the residuals of {name}', partial(residuals, name)


def _days(result: Result, folder: Path | None) -> dict[str, str]:
    """Return the day of each bag by its own stamps; files with columns, and motions from memory, have none."""
    days = {}
    for source in result.bags:
        path = BagWindow.parse(source.bag).path
        path = folder / path.name if folder else path
        first_ns = BagReader(path).first_ns if path.exists() and not is_table(path) else 0
        if first_ns > A_YEAR_NS:
            days[source.bag] = datetime.fromtimestamp(first_ns / 1e9, timezone.utc).date().isoformat()
    return days


def _write(
    folder: OutputFolder, files: Mapping[str, str], static: Sequence[Picture], page: str, named: Sequence[str]
) -> Path:
    """Write the page last, without the absolute folders of these names: where it is, all of it is."""
    for part in rig.folders(*named):
        for written in (part, str(escape(part)), quote(part)):
            page = page.replace(written, '')
    drawn = {f'{p.name}.{ending}': content for p in static for ending, content in p.files('svg', 'png').items()}
    folder.write({**files, **drawn, 'report.html': page})
    return (folder.path / 'report.html').absolute()
