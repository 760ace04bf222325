# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The result of an identification as a YAML file."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import astuple, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pendubot_identification import __version__
from pendubot_identification.errors import ResultError
from pendubot_identification.files import read_yaml, write_atomically, yaml_text
from pendubot_identification.identify.result import (
    SCHEMA,
    EffectFound,
    FaultFound,
    Given,
    Result,
    Source,
    plain,
    structured,
)
from pendubot_identification.model.parameters import MODELS, NAMES, UNDER_LOAD, UNITS, Parameters

if TYPE_CHECKING:
    # Readers of parameters do not wait for these imports.
    from pendubot_identification.identify.estimate import Estimate
    from pendubot_identification.identify.identification import Identification

Array = NDArray[np.float64]

#: Number of generations whose best values a result file holds.
SHOWN_GENERATIONS = 30
REQUIRED = NAMES[: MODELS['viscous']]
#: Fields of a fault and of an effect.
FAULT = [f.name for f in fields(FaultFound)]
EFFECT = [f.name for f in fields(EffectFound)]
#: A key in the first files of this schema, and its present name.
EARLIER = ('standing_still:', 'persistence:')


def result_of(found: Identification, sources: Sequence[Source]) -> Result:
    """Return the result of an identification of these bags."""
    best, settings = found.best, found.settings
    answers = {e.criterion: _answer(e, found) for e in found.estimates}
    joints = dict(zip(UNDER_LOAD, ('shoulder', 'elbow'), strict=True))
    length, error = found.link_length
    data = {
        **answers[best.criterion],
        'not_covered': best.not_covered,
        'faults': [{name: getattr(f, name) for name in FAULT} for f in found.faults],
        'effects': [{name: getattr(e, name) for name in EFFECT} for e in found.effects],
        'unmodelled': found.unmodelled,
        'advice': best.advice,
        'criterion': best.criterion,
        'model': best.model,
        'not_in_model': [f'{name}, for the effort of the {joints[name]} is zero throughout' for name in best.absent],
        'smoothing': found.smoothing,
        'prediction': {'method': found.validation, **answers[best.criterion]['prediction']},
        'link_length': {'value': length, 'std_error': error, 'expected': settings.link_length},
        'criteria': answers,
        'covariance': best.covariance[np.ix_(best.present, best.present)],
        'covariance_rank': best.covariance_rank,
        'made_by': {
            **plain(settings),
            'version': __version__,
            'applied': settings.applied,
            'sliding_window': settings.sliding,
            'start': None if settings.start is None else astuple(settings.start),
            'lower_bounds': settings.bounds.lower,
            'upper_bounds': settings.bounds.upper,
        },
        'reading': settings.reading.words(),
        'bags': sources,
    }
    result: Result = structured(Result, plain(data), 'this identification')
    return result


def _answer(e: Estimate, found: Identification) -> dict[str, Any]:
    """Return the estimate of one criterion, with the keys of :class:`.result.CriterionAnswer`."""
    from pendubot_identification.identify.prediction import HORIZONS

    as_is = 'level warnings consequences condition_number unexplained exact converged steps uncertainty'
    quadratic, prediction, effort = math.isfinite(e.J_exact), e.prediction, e.effort
    zeros: Iterable[tuple[str, Array, Array]] = ()
    if e.zeros is not None:
        zeros = zip(e.zeros.recordings, np.degrees(e.zeros.angles).T, np.degrees(e.zeros.std_error).T, strict=True)
    mde = convergence = None
    if e.runs is not None:
        how, runs = found.settings.search(e.criterion, e.model)
        mde = {**plain(how), 'runs': runs}
        history = e.runs.history
        generations = np.unique(np.rint(np.geomspace(1, len(history), SHOWN_GENERATIONS)).astype(int)) - 1
        convergence = {'generations': generations, 'best': history[generations].T}
    return {
        **{name: getattr(e, name) for name in as_is.split()},
        'parameters': {
            NAMES[k]: {
                'value': e.theta[k],
                'std_error': e.std_error[k],
                'degrees_of_freedom': np.broadcast_to(e.freedom, e.theta.shape)[k],
                'interval': e.intervals[k],
                'unit': UNITS[k],
                'on_bound': not (e.free[k] or e.held[k]),
                'determined': None if e.held[k] else e.determined[k],
                'held': e.held[k],
            }
            for k in np.flatnonzero(e.present)
        },
        'effort': {
            'hold': effort.hold,
            'delay': effort.delay,
            'delay_std_error': effort.std_error,
            'linear_lag': effort.delay + (found.interval / 2 if effort.hold == 'zero' else 0.0),
        },
        'J': {
            'unit': e.unit,
            'training': e.J,
            'training_runs': e.J_runs if quadratic else [e.J],
            'least_squares': e.J_exact,
            'runs_at_least_squares': e.runs_at_minimum if quadratic and e.runs is not None else None,
            'residuals': e.residuals,
            'validation': e.J_validation,
            'validation_runs': e.J_validation_runs,
        },
        'prediction': {
            'horizons': HORIZONS,
            'error': prediction.error,
            'persistence': prediction.persistence,
            'fit': dict(zip(('q1', 'q2', 'dq1', 'dq2'), prediction.fit.T, strict=True)),
            'starts': prediction.starts,
        },
        'zeros': [
            {'recording': name, 'q1': q1, 'q1_std_error': q1_error, 'q2': q2, 'q2_std_error': q2_error}
            for name, (q1, q2), (q1_error, q2_error) in zeros
        ],
        'mde': mde,
        'convergence': convergence,
        'correlation': e.correlation[np.ix_(e.present, e.present)],
    }


def write_result(path: Path, result: Result, *, overwrite: bool = False) -> None:
    """Write a complete result file, or none.

    Raises:
        ResultError: the file exists already, or the system refuses to write it.
    """
    write_atomically(path, result_text(result), overwrite=overwrite)


def result_text(result: Result | Mapping[str, Any]) -> str:
    """Return a result as the YAML text of its file."""
    return yaml_text(plain(result))


def _read(path: Path) -> dict[str, Any]:
    """Return the content of a result file, its parameters in the order of theta.

    Raises:
        ResultError: there is no such file, it has another schema, or it has no parameter vector.
    """
    data = read_yaml(path, 'name a file that pendubot identify wrote', replaced=EARLIER)
    if not isinstance(data, dict) or data.get('schema') != SCHEMA:
        raise ResultError(f'{path} is no result of schema {SCHEMA}; name a file that pendubot identify wrote')
    entries = data.get('parameters')
    entries = entries if isinstance(entries, dict) else {}
    wrong = [str(name) for name in dict.fromkeys([*REQUIRED, *entries]) if name not in NAMES or name not in entries]
    if wrong:
        raise ResultError(
            f'{path} has no parameter vector: check {", ".join(wrong)}; one number each is expected for '
            f'{", ".join(REQUIRED)} and, if they are not 0, for {", ".join(NAMES[len(REQUIRED) :])}'
        )
    return {**data, 'parameters': {name: entries[name] for name in NAMES if name in entries}}


def read_result(path: Path) -> Result | Given:
    """Return a result file: all of it, or the parameters and known entries of a hand-written file.

    Raises:
        ResultError: there is no such file, it is no result of this schema, or its parameters are no numbers by name.
    """
    given: Given = structured(Given, data := _read(path), path)
    with suppress(ResultError):
        complete: Result = structured(Result, data, path)
        return complete
    return given


def read_complete_result(path: Path) -> Result:
    """Return a result file that an identification wrote.

    Raises:
        ResultError: there is no such file, or it is no result of this schema, or not all of it.
    """
    result: Result = structured(Result, _read(path), path)
    return result


def read_parameters(path: Path) -> Parameters:
    """Return the parameters of a result file.

    Raises:
        ResultError: as :func:`read_result`.
    """
    return read_result(path).theta


def read_estimate(path: Path) -> tuple[Parameters, Array | None]:
    """Return the parameters of a result file, and their standard errors, shape (D,), where it has them all.

    Parameters that are absent from the file are exactly 0.

    Raises:
        ResultError: as :func:`read_result`.
    """
    given = read_result(path)
    names = NAMES[: len(given.theta.vector())]
    errors = [given.parameters[name].std_error if name in given.parameters else 0.0 for name in names]
    return given.theta, None if None in errors else np.array(errors, dtype=float)
