# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A result in the format of who uses it: simulators, MATLAB, C, Python, ROS. Numbers keep every digit."""

from pathlib import Path

import yaml

from pendubot_identification.errors import ParameterError
from pendubot_identification.model.parameters import MODELS, NAMES, SPECIFICATIONS
from pendubot_identification.results.result import Parameter, PartialResult

from .code import Entry, c, matlab, python
from .masses import rig_of
from .robots import limits, mjcf, urdf

ROBOTS = ('mjcf', 'urdf')
LANGUAGES = {'m': matlab, 'h': c, 'py': python}
#: An input delay [s] of no importance, as an estimate from exact data leaves it.
NEGLIGIBLE = 1e-5
FORMATS = (*ROBOTS, 'yaml', *LANGUAGES)
SUFFIXES = {f'.{name}': name for name in FORMATS if name != 'mjcf'} | {'.xml': 'mjcf', '.yml': 'yaml'}
MEANINGS = {s.name: (s.unit, s.meaning) for s in SPECIFICATIONS}


def export(
    result: PartialResult,
    format: str,
    link_length: float | None = None,
    torque_limit: float | None = None,
    *,
    revolute: bool = False,
) -> tuple[str, list[str]]:
    """Return the text of a file, and in sentences what its user must know of it, which also stand in it.

    ``format`` is one of :data:`FORMATS`. For simulators, ``link_length`` [m] is of link 1, see :func:`.masses.rig_of`,
    and ``torque_limit`` [N m] of the motor; ``revolute`` is of :func:`.robots.urdf`.

    Raises:
        ParameterError: no real masses give these parameters, or the limit is no number above 0.
    """
    require_limit(torque_limit)
    parameters = _vector(result)
    if format in ROBOTS:
        rig = rig_of(result.theta, link_length)
        said = [*rig.choices, *limits(rig.parameters, armature=format == 'mjcf'), *_beside(result)]
        named = [f'{name} = {entry.value!r} {_described(name, entry)}' for name, entry in parameters.items()]
        comments = [*provenance(result), *named, *said]
        if format == 'mjcf':
            return mjcf(rig, comments, torque_limit), said
        return urdf(rig, comments, torque_limit, revolute=revolute), said
    if format == 'yaml':
        return _yaml(parameters, provenance(result)), []
    entries = [Entry(name, e.value, e.std_error, _described(name, e)) for name, e in parameters.items()]
    return LANGUAGES[format](entries, [*provenance(result), *_beside(result)]), _beside(result)


def format_of(path: Path) -> str:
    """Return the format that the suffix of a file names. Raises ParameterError: it names none."""
    if path.suffix not in SUFFIXES:
        raise ParameterError(f'{path} has no suffix that names a format; {", ".join(SUFFIXES)} are expected')
    return SUFFIXES[path.suffix]


def require_limit(torque: float | None) -> None:
    """Raise ParameterError for a torque limit [N m] that is no number above 0."""
    if torque is not None and not 0 < torque < float('inf'):
        raise ParameterError(f'the torque limit is {torque:g} N m; a number above 0 is expected')


def provenance(result: PartialResult) -> list[str]:
    """Return, line by line, where the numbers come from and how far to trust them; never an empty list."""
    criterion, model = result.criterion or 'not known', result.model or 'not known'
    lines = [
        'Parameters of a pendubot, SI units; q1 is measured from the horizontal, q2 relative to link 1',
        f'made by pendubot_identification {result.made_by.version}; criterion {criterion}, model {model}',
        *(f'{bag.role}: {bag.bag}, sha256 {bag.sha256}' for bag in result.bags),
        f'level: {"not known" if result.level is None else result.level.name}',
        *(f'warning: {warning}' for warning in result.warnings),
        *(f'{name} is not covered by the level: {why}' for name, why in result.not_covered.items()),
    ]
    return [' '.join(str(line).split()) for line in lines]


def _beside(result: PartialResult) -> list[str]:
    """Return what acts on the rig beside the model: a delay, and effects that were estimated together with it."""
    delay = result.effort.delay
    said = []
    if delay and abs(delay) >= NEGLIGIBLE:
        said.append(f'torques act {delay:.4g} s later than they are stamped, which is not in this model')
    effects = [f'{e.name} ({e.where})' for e in result.effects if e.accepted]
    if effects:
        said.append(f'estimated together with {", ".join(effects)}, not in this model; its friction holds beside that')
    return said


def _yaml(parameters: dict[str, Parameter], comments: list[str]) -> str:
    """Return parameters for ``--params-file`` of any node: P1, P2, ... under ``/**``."""
    described = (f'{name}: {_described(name, entry)}' for name, entry in parameters.items())
    values = {name: entry.value for name, entry in parameters.items()}
    content = yaml.safe_dump({'/**': {'ros__parameters': values}}, sort_keys=False)
    return ''.join(f'# {line}\n' for line in (*comments, *described)) + content


def _vector(result: PartialResult) -> dict[str, Parameter]:
    """Return the entries in the order of theta; 0 for those that a hand left out, as far as the model goes."""
    last = max(NAMES.index(name) for name in result.parameters)
    size = min(size for size in MODELS.values() if size > last)
    return {name: result.parameters.get(name, Parameter(value=0.0)) for name in NAMES[:size]}


def _described(name: str, entry: Parameter) -> str:
    """Return unit, meaning, and how certain."""
    return '; '.join(MEANINGS[name]) + ('' if entry.std_error is None else f'; standard error {entry.std_error:.2g}')
