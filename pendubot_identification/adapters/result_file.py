"""The result of an identification as a YAML file, and as the plain data that ``--json`` prints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, astuple
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from numpy.typing import NDArray

from pendubot_identification import __version__
from pendubot_identification.core.errors import ResultError
from pendubot_identification.core.model.parameters import MODELS, NAMES, UNDER_LOAD, UNITS, Parameters

from .files import write_whole

if TYPE_CHECKING:
    # Not for who only reads parameters: this takes a hundred times as long to import.
    from pendubot_identification.core.estimation.estimate import Estimate
    from pendubot_identification.core.estimation.identification import Identification
    from pendubot_identification.core.estimation.settings import Settings

    from .datasets import Source

Array = NDArray[np.float64]

SCHEMA = 1
#: Generations of which a result file tells the best values.
SHOWN_GENERATIONS = 30
#: What every identification says of itself.
WHOLE = ('parameters', 'level', 'criterion', 'model', 'prediction', 'criteria', 'made_by', 'bags')
REQUIRED = NAMES[: MODELS['viscous']]


def result_data(result: Identification, sources: Sequence[Source]) -> dict[str, Any]:
    """Return a result as plain numbers, strings, lists and dictionaries; what is not a number becomes None.

    The published parameters come first: who looks for a name takes the first that stands there.
    """
    best, settings = result.best, result.settings
    length, error = result.link_length
    return {
        'schema': SCHEMA,
        'parameters': _parameters(best),
        'level': best.level.name,
        'warnings': list(best.warnings),
        'advice': list(best.advice),
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
                    'error': _numbers(score.error),
                    'behind': _number(score.behind[0]),
                    'behind_std_error': _number(score.behind[1]),
                    'exact': score.exact,
                }
                for score in result.models
            ],
        },
        'link_length': {
            'value': _number(length),
            'std_error': _number(error),
            'expected': settings.link_length,
            'unit': 'm',
        },
        'condition_number': _number(best.condition_number),
        'criteria': {
            e.criterion: {
                'parameters': _parameters(e),
                'level': e.level.name,
                'warnings': list(e.warnings),
                'effort': _effort(e, result.interval),
                'J': _J(e),
                'prediction': _prediction(e),
                'condition_number': _number(e.condition_number),
                'unexplained': _number(e.unexplained),
                'zeros': _zeros(e),
                'exact': e.exact,
                'converged': e.converged,
                'steps': list(e.steps),
                'mde': _mde(e, settings),
                'convergence': _convergence(e),
                'uncertainty': e.uncertainty,
                'correlation': _numbers(e.correlation[np.ix_(e.present, e.present)]),
            }
            for e in result.estimates
        },
        'covariance_rank': best.covariance_rank,
        'covariance': _numbers(best.covariance[np.ix_(best.present, best.present)]),
        'made_by': {
            'version': __version__,
            'criteria': list(settings.criteria),
            'model': settings.model,
            'optimizer': settings.optimizer,
            'sliding_window': settings.sliding,
            'smoothing': settings.smoothing,
            'hold': settings.hold,
            'delays': list(settings.delays),
            'start': None if settings.start is None else list(astuple(settings.start)),
            'link_length': settings.link_length,
            'seed': settings.seed,
            'lower_bounds': settings.bounds.lower.tolist(),
            'upper_bounds': settings.bounds.upper.tolist(),
        },
        'bags': [asdict(source) for source in sources],
    }


def _parameters(e: Estimate) -> dict[str, dict[str, Any]]:
    return {
        NAMES[k]: {
            'value': float(e.theta[k]),
            'std_error': _number(e.std_error[k]),
            'interval': _numbers(e.intervals[k]),
            'unit': UNITS[k],
            'on_bound': not e.free[k],
            'determined': bool(e.determined[k]),
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
        'delay_std_error': _number(effort.std_error),
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
            'q1': _number(angles[0, r]),
            'q1_std_error': _number(errors[0, r]),
            'q2': _number(angles[1, r]),
            'q2_std_error': _number(errors[1, r]),
            'unit': 'degree',
        }
        for r, name in enumerate(e.zeros.recordings)
    ]


def _J(e: Estimate) -> dict[str, Any]:
    quadratic = math.isfinite(e.J_exact)
    return {
        'unit': e.unit,
        'training': e.J,
        'training_runs': _numbers(e.J_runs) if quadratic else [e.J],
        'least_squares': _number(e.J_exact),
        'runs_at_least_squares': e.runs_at_minimum if quadratic and e.runs is not None else None,
        'residuals': e.residuals,
        'validation': _number(e.J_validation),
        'validation_runs': _numbers(e.J_validation_runs),
    }


def _prediction(e: Estimate) -> dict[str, Any]:
    """Return simulation errors in standard deviations, and fits in per cent, by horizon [s]."""
    from pendubot_identification.core.estimation.prediction import HORIZONS

    if e.prediction is None:
        return {}
    return {
        'horizons': list(HORIZONS),
        'error': _numbers(e.prediction.error),
        'standing_still': _numbers(e.prediction.standing_still),
        'fit': {
            state: _numbers(fit) for state, fit in zip(('q1', 'q2', 'dq1', 'dq2'), e.prediction.fit.T, strict=True)
        },
        'starts': e.prediction.starts.tolist(),
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
    return {'generations': generations.tolist(), 'best': _numbers(history[generations].T)}


def write_result(path: Path, data: Mapping[str, Any], *, overwrite: bool = False) -> None:
    """Write a result, whole or not at all.

    Raises:
        ResultError: the file exists already, or the system refuses to write it.
    """
    write_whole(path, result_text(data), overwrite=overwrite)


def result_text(data: Mapping[str, Any]) -> str:
    """Return a result as YAML, the way it stands in its file."""
    return yaml.dump(dict(data), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100)


def read_result(path: Path) -> dict[str, Any]:
    """Return what a result file holds, with the parameters in the order of theta and their numbers as floats.

    Raises:
        ResultError: there is no such file, it is no result of this schema, or something stands for a number that is
            none.
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
    if isinstance(entries := data.get('parameters'), dict):
        data['parameters'] = {name: entries[name] for name in NAMES if name in entries} | entries
        for name, entry in entries.items():
            if isinstance(entry, dict):
                entry |= _numbers_of(entry, f'{path}: {name}')
    return data


def _numbers_of(entry: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return a parameter's numbers as floats: a hand writes 4e-4, which YAML takes for a word.

    Raises:
        ResultError: one is no number.
    """
    numbers = {key: entry[key] for key in ('value', 'std_error', 'interval') if entry.get(key) is not None}
    for key, found in numbers.items():
        try:
            if key == 'interval':
                low, high = found
                numbers[key] = [None if bound is None else _number(float(bound)) for bound in (low, high)]
            else:
                numbers[key] = _number(float(found))
        except (TypeError, ValueError, OverflowError):
            expected = 'two numbers are' if key == 'interval' else 'a number is'
            raise ResultError(f'{where} has the {key} {found!r}; {expected} expected in its place') from None
    return numbers


def read_whole_result(path: Path) -> dict[str, Any]:
    """Return what a result file holds that an identification wrote, not a hand.

    Raises:
        ResultError: there is no such file, or it is no result of this schema, or holds parameters alone, or these are
            no numbers by name.
    """
    data = read_result(path)
    missing = [key for key in WHOLE if not data.get(key)]
    if missing:
        raise ResultError(
            f'{path} does not say {", ".join(missing)}; name a file that pendubot identify wrote, as it wrote it'
        )
    parameters_of(data, path)
    return data


def read_parameters(path: Path) -> Parameters:
    """Return the parameters of a result file.

    Raises:
        ResultError: there is no such file, it is no result of this schema, or its parameters are no numbers by name.
    """
    return parameters_of(read_result(path), path)


def read_estimate(path: Path) -> tuple[Parameters, Array | None]:
    """Return the parameters of a result file, and their standard errors, shape (D,), where it has them all.

    What the file leaves out is 0, and certain.

    Raises:
        ResultError: as :func:`read_parameters`.
    """
    data = read_result(path)
    parameters = parameters_of(data, path)
    entries = [data['parameters'].get(name, {'std_error': 0.0}) for name in NAMES[: len(parameters.vector())]]
    errors = [_value(entry, 'std_error') for entry in entries]
    return parameters, None if None in errors else np.array(errors, dtype=float)


def parameters_of(data: Mapping[str, Any], path: Path) -> Parameters:
    """Return the parameters in the data of a result file.

    Raises:
        ResultError: its parameters are no numbers by name.
    """
    entries = data.get('parameters')
    entries = entries if isinstance(entries, dict) else {}
    values = {str(name): value for name, entry in entries.items() if (value := _value(entry)) is not None}
    named = dict.fromkeys([*REQUIRED, *entries])
    wrong = [str(name) for name in named if name not in NAMES or name not in values]
    if wrong:
        raise ResultError(
            f'{path} has no parameter vector: look at {", ".join(wrong)}; a number each is expected for '
            f'{", ".join(REQUIRED)} and, where they are not 0, for {", ".join(NAMES[len(REQUIRED) :])}'
        )
    return Parameters(**values)


def unphysical(data: Mapping[str, Any], path: Path) -> list[str]:
    """Return why no rig can have the parameters of a result file, in the words of an identification's warnings.

    Raises:
        ResultError: its parameters are no numbers by name.
    """
    return [f'not physical: {problem}' for problem in parameters_of(data, path).unphysical()]


def _value(entry: Any, key: str = 'value') -> float | None:
    """Return the number in an entry ``{value: number, ...}``; None where there is none."""
    try:
        return _number(float(entry[key]))
    except (KeyError, TypeError, ValueError):
        return None


def _numbers(values: Any) -> list[Any]:
    return [_numbers(value) if np.ndim(value) else _number(value) for value in values]


class _Dumper(yaml.SafeDumper):
    """Writes lists of numbers in a line, and what comes twice twice."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def represent_sequence(self, tag: str, sequence: Any, flow_style: bool | None = None) -> yaml.SequenceNode:
        numbers = not any(isinstance(entry, (str, Mapping, list)) for entry in sequence)
        return super().represent_sequence(tag, sequence, flow_style=numbers)


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
