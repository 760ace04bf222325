# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The result of an identification as a YAML file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import astuple, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from numpy.typing import NDArray

from pendubot_identification import __version__
from pendubot_identification.errors import ResultError
from pendubot_identification.files import write_whole
from pendubot_identification.identify.result import SCHEMA, Given, Result, Source, plain, structured
from pendubot_identification.model.parameters import MODELS, NAMES, UNDER_LOAD, UNITS, Parameters

if TYPE_CHECKING:
    # Not for who only reads parameters: this takes a hundred times as long to import.
    from pendubot_identification.identify.estimate import Estimate
    from pendubot_identification.identify.identification import Identification
    from pendubot_identification.identify.settings import Settings

Array = NDArray[np.float64]

#: Generations of which a result file tells the best values.
SHOWN_GENERATIONS = 30
REQUIRED = NAMES[: MODELS['viscous']]


def result_of(result: Identification, sources: Sequence[Source]) -> Result:
    """Return what an identification found, made of these bags, by way of what its file holds."""
    best, settings = result.best, result.settings
    length, error = result.link_length
    data = plain(
        {
            'schema': SCHEMA,
            'parameters': _parameters(best),
            'level': best.level,
            'not_covered': best.not_covered,
            'warnings': best.warnings,
            'consequences': best.consequences,
            'faults': [
                {
                    'name': fault.name,
                    'found': fault.found,
                    'remedy': fault.remedy,
                    'unexplained': fault.unexplained,
                    'put_right': fault.put_right,
                }
                for fault in result.faults
            ],
            'advice': best.advice,
            'criterion': best.criterion,
            'model': best.model,
            'not_in_model': _absent(best),
            'effort': _effort(best, result.interval),
            'zeros': _zeros(best),
            'smoothing': result.smoothing,
            'J': _J(best),
            'prediction': {'method': result.validation, **_prediction(best)},
            'models': {
                'by': result.comparison or None,
                'compared': [
                    {
                        'model': score.model,
                        'parameters': int(settings.bounds.of(MODELS[score.model]).present.sum()),
                        'error': score.error,
                        'behind': score.behind[0],
                        'behind_std_error': score.behind[1],
                        'exact': score.exact,
                    }
                    for score in result.models
                ],
            },
            'link_length': {'value': length, 'std_error': error, 'expected': settings.link_length, 'unit': 'm'},
            'condition_number': best.condition_number,
            'criteria': {
                e.criterion: {
                    'parameters': _parameters(e),
                    'level': e.level,
                    'warnings': e.warnings,
                    'consequences': e.consequences,
                    'effort': _effort(e, result.interval),
                    'J': _J(e),
                    'prediction': _prediction(e),
                    'condition_number': e.condition_number,
                    'unexplained': e.unexplained,
                    'zeros': _zeros(e),
                    'exact': e.exact,
                    'converged': e.converged,
                    'steps': e.steps,
                    'mde': _mde(e, settings),
                    'convergence': _convergence(e),
                    'uncertainty': e.uncertainty,
                    'correlation': e.correlation[np.ix_(e.present, e.present)],
                }
                for e in result.estimates
            },
            'covariance': best.covariance[np.ix_(best.present, best.present)],
            'covariance_rank': best.covariance_rank,
            'made_by': {
                'version': __version__,
                'criteria': settings.criteria,
                'model': settings.model,
                'optimizer': settings.optimizer,
                'sliding_window': settings.sliding,
                'smoothing': settings.smoothing,
                'hold': settings.hold,
                'delays': settings.delays,
                'start': None if settings.start is None else astuple(settings.start),
                'link_length': settings.link_length,
                'seed': settings.seed,
                'lower_bounds': settings.bounds.lower,
                'upper_bounds': settings.bounds.upper,
            },
            'bags': sources,
        }
    )
    return structured(Result, data, 'this identification')


def _parameters(e: Estimate) -> dict[str, dict[str, Any]]:
    return {
        NAMES[k]: {
            'value': e.theta[k],
            'std_error': e.std_error[k],
            'interval': e.intervals[k],
            'unit': UNITS[k],
            'on_bound': not e.free[k],
            'determined': e.determined[k],
        }
        for k in np.flatnonzero(e.present)
    }


def _absent(e: Estimate) -> list[str]:
    """Return which parameters the rig cannot have, and why."""
    joints = dict(zip(UNDER_LOAD, ('shoulder', 'elbow'), strict=True))
    return [f'{name}, for the effort of the {joints[name]} is zero throughout' for name in e.absent]


def _effort(e: Estimate, interval: float) -> dict[str, Any]:
    """Return how the effort was taken; ``linear_lag`` is the delay for who interpolates it linearly between samples."""
    effort = e.effort
    return {
        'hold': effort.hold,
        'delay': effort.delay,
        'delay_std_error': effort.std_error,
        'linear_lag': effort.delay + (interval / 2 if effort.hold == 'zero' else 0.0),
        'unit': 's',
    }


def _zeros(e: Estimate) -> list[dict[str, Any]]:
    """Return how far off the zeros of every recording's positions are: what was read minus what is true."""
    if e.zeros is None:
        return []
    angles, errors = np.degrees(e.zeros.angles), np.degrees(e.zeros.std_error)
    return [
        {
            'recording': name,
            'q1': angles[0, r],
            'q1_std_error': errors[0, r],
            'q2': angles[1, r],
            'q2_std_error': errors[1, r],
            'unit': 'degree',
        }
        for r, name in enumerate(e.zeros.recordings)
    ]


def _J(e: Estimate) -> dict[str, Any]:
    quadratic = math.isfinite(e.J_exact)
    return {
        'unit': e.unit,
        'training': e.J,
        'training_runs': e.J_runs if quadratic else [e.J],
        'least_squares': e.J_exact,
        'runs_at_least_squares': e.runs_at_minimum if quadratic and e.runs is not None else None,
        'residuals': e.residuals,
        'validation': e.J_validation,
        'validation_runs': e.J_validation_runs,
    }


def _prediction(e: Estimate) -> dict[str, Any]:
    """Return simulation errors in standard deviations, and fits in per cent, by horizon [s]."""
    from pendubot_identification.identify.prediction import HORIZONS

    if e.prediction is None:
        return {}
    return {
        'horizons': HORIZONS,
        'error': e.prediction.error,
        'standing_still': e.prediction.standing_still,
        'fit': dict(zip(('q1', 'q2', 'dq1', 'dq2'), e.prediction.fit.T, strict=True)),
        'starts': e.prediction.starts,
    }


def _mde(e: Estimate, settings: Settings) -> dict[str, Any] | None:
    if e.runs is None:
        return None
    how, runs = settings.search(e.criterion, e.model)
    names = ('population', 'generations', 'per_component', 'spread')
    return {'runs': runs, **{name: getattr(how, name) for name in names}}


def _convergence(e: Estimate) -> dict[str, Any] | None:
    """Return each run's best value, a row a run, after ever more generations."""
    if e.runs is None:
        return None
    history = e.runs.history
    generations = np.unique(np.rint(np.geomspace(1, len(history), SHOWN_GENERATIONS)).astype(int)) - 1
    return {'generations': generations, 'best': history[generations].T}


def write_result(path: Path, result: Result, *, overwrite: bool = False) -> None:
    """Write a result, whole or not at all.

    Raises:
        ResultError: the file exists already, or the system refuses to write it.
    """
    write_whole(path, result_text(result), overwrite=overwrite)


def result_text(result: Result) -> str:
    """Return a result as YAML, the way it stands in its file."""
    return yaml.dump(plain(result), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100)


def _read(path: Path) -> dict[str, Any]:
    """Return what a result file holds, as it stands there.

    Raises:
        ResultError: there is no such file, or it is no result of this schema.
    """
    try:
        data = yaml.safe_load(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise ResultError(
            f'{path} cannot be read ({error.strerror}); name a file that pendubot identify wrote'
        ) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ResultError(f'{path} is no YAML file; name a file that pendubot identify wrote') from error
    if not isinstance(data, dict) or data.get('schema') != SCHEMA:
        raise ResultError(f'{path} is no result of schema {SCHEMA}; name a file that pendubot identify wrote')
    return data


def read_result(path: Path) -> Result | Given:
    """Return what a result file says: all of it, or what is taken of one that a hand wrote.

    Raises:
        ResultError: there is no such file, it is no result of this schema, or its parameters are no numbers by name.
    """
    given = _given(data := _read(path), path)
    with suppress(ResultError):
        return _whole(data, given, path)
    return given


def read_whole_result(path: Path) -> Result:
    """Return a result that an identification wrote, not a hand.

    Raises:
        ResultError: there is no such file, or it is no result of this schema, or not all of it.
    """
    data = _read(path)
    return _whole(data, _given(data, path), path)


def read_parameters(path: Path) -> Parameters:
    """Return the parameters of a result file.

    Raises:
        ResultError: as :func:`read_result`.
    """
    return read_result(path).theta


def read_estimate(path: Path) -> tuple[Parameters, Array | None]:
    """Return the parameters of a result file, and their standard errors, shape (D,), where it has them all.

    What the file leaves out is 0, and certain.

    Raises:
        ResultError: as :func:`read_result`.
    """
    given = read_result(path)
    names = NAMES[: len(given.theta.vector())]
    errors = [given.parameters[name].std_error if name in given.parameters else 0.0 for name in names]
    return given.theta, None if None in errors else np.array(errors, dtype=float)


def _whole(data: Mapping[str, Any], given: Given, path: Path) -> Result:
    return replace(structured(Result, data, path), parameters=given.parameters)


def _given(data: Mapping[str, Any], path: Path) -> Given:
    entries = data.get('parameters')
    entries = entries if isinstance(entries, dict) else {}
    wrong = [str(name) for name in dict.fromkeys([*REQUIRED, *entries]) if name not in NAMES or name not in entries]
    if wrong:
        raise ResultError(
            f'{path} has no parameter vector: look at {", ".join(wrong)}; a number each is expected for '
            f'{", ".join(REQUIRED)} and, where they are not 0, for {", ".join(NAMES[len(REQUIRED) :])}'
        )
    ordered = {name: entries[name] for name in NAMES if name in entries}
    return structured(Given, {**data, 'parameters': ordered}, path)


class _Dumper(yaml.SafeDumper):
    """Writes lists of numbers in a line, and what comes twice twice."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def represent_sequence(self, tag: str, sequence: Any, flow_style: bool | None = None) -> yaml.SequenceNode:
        numbers = not any(isinstance(entry, (str, Mapping, list)) for entry in sequence)
        return super().represent_sequence(tag, sequence, flow_style=numbers)


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
