# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Identifies recordings, on request with corrections, and assembles the result, also in a process that can be stopped.

A thread cannot be stopped: some stages take seconds between two reports of progress.
"""

import math
import os
import pickle
import subprocess
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import astuple, fields, replace
from functools import partial
from subprocess import PIPE
from typing import Any, TypeVar

import numpy as np

from pendubot_identification import __version__
from pendubot_identification.criteria.prediction_error import HORIZONS, Prediction
from pendubot_identification.errors import PendubotError, noting, sentence
from pendubot_identification.identification.conventions import corrected_conversion
from pendubot_identification.identification.estimate import Estimate, Progress
from pendubot_identification.identification.pipeline import Identification, identify
from pendubot_identification.identification.settings import Settings
from pendubot_identification.model.parameters import NAMES, UNDER_LOAD, UNITS
from pendubot_identification.recordings.datasets import Datasets, load_datasets
from pendubot_identification.trajectories.conventions import JOINT_NAMES
from pendubot_identification.trajectories.conversion import Conversion
from pendubot_identification.trajectories.trajectory import Source

from . import result as tree
from .result import Result, known

T = TypeVar('T')
#: Largest number of corrections.
CORRECTIONS = 8
#: The unit of J of each criterion.
UNITS_OF_J = {'energy': 'J^2', 'weak': '(N m)^2', 'likelihood': 'nat per measurement'}


def identify_recordings(
    load: Callable[[Conversion], Datasets],
    settings: Settings,
    progress: Progress | None = None,
    *,
    apply_remedies: bool = False,
) -> tuple[Result, Datasets]:
    """Identify recordings loaded with the settings' conversion; on request, correct it and identify again.

    Raises:
        PendubotError: the recordings cannot be read or are not informative enough, and no correction applies.
    """
    requested = settings.reading.options()
    remaining = CORRECTIONS if apply_remedies else 0
    while True:
        applied = settings.applied
        notes = [f'applied corrections of the recordings: {" ".join(applied)}'] if applied else []
        try:
            data = load(settings.reading)
            with noting(data.notes):
                found = identify(data.training, data.validation, settings, progress, [*data.notes, *notes])
            corrected = corrected_conversion(found.faults)
            if corrected is None or not remaining:
                return assemble_result(found, data.sources), data
        except PendubotError as error:
            if not (remaining and error.remedy):
                raise
            corrected = Conversion.of(settings.reading.words() | error.remedy)
            if corrected == settings.reading:
                raise
        remaining -= 1
        applied = tuple(option for option in corrected.options() if option not in requested)
        settings = replace(settings, reading=corrected, applied=applied)


class Computation:
    """The child process of one identification: one thread runs it, and any thread may stop it."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self.stopped = False  #: whether it was stopped.

    def stop(self) -> None:
        """Kill the process, or prevent its start."""
        self.stopped = True
        if self._process is not None:
            self._process.kill()

    def run(
        self,
        bags: Sequence[str],
        validate: Sequence[str],
        settings: Settings,
        progress: Progress,
        *,
        apply_remedies: bool = False,
    ) -> Result:
        """Identify bags, see :func:`load_datasets`. Raises PendubotError: the identification failed or was stopped."""
        request = partial(load_datasets, bags, validate), settings, apply_remedies
        # The modules of this process, not of the current folder.
        code = f'import sys; sys.path[:] = {sys.path!r}; from {__name__} import main; main()'
        command = [sys.executable, '-c', code, *(['--debug'] if '--debug' in sys.argv else [])]
        # A separate session, so that a Ctrl-C in the terminal reaches the node alone.
        with subprocess.Popen(command, stdin=PIPE, stdout=PIPE, start_new_session=True) as process:
            self._process = process
            assert process.stdin is not None
            assert process.stdout is not None
            if self.stopped:
                process.kill()
            try:
                # Without a buffer, whose flush at the end of the context would fail again if the process was killed.
                os.write(process.stdin.fileno(), pickle.dumps(request))
                while isinstance(answer := pickle.load(process.stdout), tuple):
                    progress(*answer)
            except (EOFError, OSError, pickle.UnpicklingError):
                process.kill()
                answer = f'the process of the identification ended with status {process.wait()}; look at the system log'
        if self.stopped or isinstance(answer, str):
            raise PendubotError('the identification was canceled' if self.stopped else answer)
        return answer


def main() -> None:
    """Read a request; write progress as tuples, then the result or an error message."""
    # Printed text must not mix with the answers.
    answers = os.fdopen(os.dup(1), 'wb')
    os.dup2(2, 1)

    def send(answer: Any) -> None:
        pickle.dump(answer, answers)
        answers.flush()

    load, settings, apply_remedies = pickle.load(sys.stdin.buffer)
    try:
        send(identify_recordings(load, settings, lambda *step: send(step), apply_remedies=apply_remedies)[0])
    except BrokenPipeError:
        os._exit(1)  # the node has ended
    except Exception as error:
        if '--debug' in sys.argv:
            traceback.print_exception(error)
        send(sentence(error))


def assemble_result(found: Identification, sources: Sequence[Source]) -> tree.Result:
    """Return the result of an identification of these recordings."""
    best, settings = found.best, found.settings
    answers = {estimate.criterion: _answer(estimate, found) for estimate in found.estimates}
    joints = dict(zip(UNDER_LOAD, JOINT_NAMES, strict=True))
    length, length_error = known(found.link_length)
    return _entry(
        tree.Result,
        answers[best.criterion],
        not_covered=best.not_covered,
        faults=[_entry(tree.DataFault, fault) for fault in found.faults],
        effects=[_entry(tree.ReportedEffect, effect) for effect in found.effects],
        unmodelled=known(found.unmodelled),
        advice=list(best.advice),
        criterion=best.criterion,
        model=best.model,
        not_in_model=[f'{name}, because the effort of the {joints[name]} is always zero' for name in best.absent],
        smoothing=known(found.smoothing),
        prediction=predicted(best.prediction, found.validation),
        link_length=tree.LinkLength(value=length, std_error=length_error, expected=settings.link_length),
        criteria=answers,
        covariance=known(best.covariance[np.ix_(best.present, best.present)]),
        made_by=_entry(
            tree.Provenance,
            settings,
            version=__version__,
            sliding_window=settings.sliding,
            start=None if settings.start is None else list(astuple(settings.start)),
            lower_bounds=known(settings.bounds.lower),
            upper_bounds=known(settings.bounds.upper),
        ),
        reading=settings.reading.words(),
        bags=list(sources),
    )


def _entry(kind: type[T], source: object, **others: Any) -> T:
    """Return an entry of the result with the source's attributes of the same names; ``others`` take precedence."""
    names = {f.name for f in fields(kind)} - others.keys()  # type: ignore[arg-type]
    return kind(**{name: known(getattr(source, name)) for name in names}, **others)


def _answer(e: Estimate, found: Identification) -> tree.CriterionAnswer:
    """Return the entry of one criterion's estimate."""
    effort = e.effort
    search = None
    if e.runs is not None:
        how, runs = found.settings.search(e.criterion, e.model)
        search = _entry(tree.Search, how, runs=runs)
    return _entry(
        tree.CriterionAnswer,
        e,
        parameters=_parameters(e),
        effort=tree.EffortTiming(
            hold=effort.hold,
            delay=known(effort.delay),
            delay_std_error=known(effort.std_error),
            linear_lag=known(effort.delay + (found.interval / 2 if effort.hold == 'zero' else 0.0)),
        ),
        J=tree.CriterionValue(
            unit=UNITS_OF_J[e.criterion],
            training=known(e.J),
            training_runs=known(e.J_runs if math.isfinite(e.J_exact) else [e.J]),
            least_squares=known(e.J_exact),
            residuals=known(e.residuals),
            validation=known(e.J_validation),
        ),
        prediction=predicted(e.prediction, found.validation),
        zeros=_zeros(e),
        mde=search,
        correlation=known(e.correlation[np.ix_(e.present, e.present)]),
    )


def predicted(prediction: Prediction, method: str = '') -> tree.Predicted:
    """Return the entry of a prediction; ``method`` is the validation method."""
    fit = dict(zip(('q1', 'q2', 'dq1', 'dq2'), known(prediction.fit.T), strict=True))
    return _entry(tree.Predicted, prediction, horizons=list(HORIZONS), fit=fit, method=method)


def _parameters(e: Estimate) -> dict[str, tree.Parameter]:
    return {
        NAMES[k]: tree.Parameter(
            value=float(e.theta[k]),
            std_error=known(e.std_error[k]),
            degrees_of_freedom=known(np.broadcast_to(e.freedom, e.theta.shape)[k]),
            interval=tuple(known(e.intervals[k])),
            unit=UNITS[k],
            on_bound=not (e.free[k] or e.fixed[k]),
            determined=None if e.fixed[k] else bool(e.determined[k]),
            fixed=bool(e.fixed[k]),
        )
        for k in np.flatnonzero(e.present).tolist()
    }


def _zeros(e: Estimate) -> list[tree.ZeroError]:
    if e.zeros is None:
        return []
    angles, errors = (known(np.degrees(values)) for values in (e.zeros.angles, e.zeros.std_error))
    columns = zip(e.zeros.recordings, *angles, *errors, strict=True)
    return [
        tree.ZeroError(recording=name, q1=q1, q1_std_error=q1_error, q2=q2, q2_std_error=q2_error)
        for name, q1, q2, q1_error, q2_error in columns
    ]
