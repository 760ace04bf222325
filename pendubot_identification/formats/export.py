# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Exports a result for simulators, MATLAB, C, Python and ROS. Numbers keep every digit."""

from pathlib import Path

import yaml

from pendubot_identification.errors import ParameterError
from pendubot_identification.model.parameters import MODELS, NAMES, SPECIFICATIONS
from pendubot_identification.results.result import Parameter, PartialResult

from .code import Entry, c, matlab, python
from .robots import TIME_STEP, limits, mjcf, rig_of, urdf

ROBOTS = ('mjcf', 'urdf')
LANGUAGES = {'m': matlab, 'h': c, 'py': python}
#: Smallest input delay that is reported [s]; estimates from exact data are smaller.
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
    """Return the text of a file, and sentences for its user, which the file contains as comments.

    ``format`` is one of :data:`FORMATS`. For simulators, ``link_length`` [m] is of link 1, see :func:`.robots.rig_of`,
    and ``torque_limit`` [N m] of the motor; ``revolute`` is for :func:`.robots.urdf`.

    Raises:
        ParameterError: no real masses give these parameters, or the limit is no number above 0.
    """
    require_limit(torque_limit)
    entries, remarks = _entries(result), _outside_model(result, format)
    if format in ROBOTS:
        rig = rig_of(result.theta, link_length)
        remarks = [*rig.choices, *limits(rig.parameters, armature=format == 'mjcf'), *remarks]
        comments = [*provenance(result), *(f'{e.name} = {e.value!r} {e.meaning}' for e in entries), *remarks]
        if format == 'mjcf':
            return mjcf(rig, comments, torque_limit, result.effort.delay), remarks
        return urdf(rig, comments, torque_limit, revolute=revolute), remarks
    if format == 'yaml':
        # For --params-file of any node.
        comments = [*provenance(result), *(f'{e.name}: {e.meaning}' for e in entries)]
        content = {'/**': {'ros__parameters': {e.name: e.value for e in entries}}}
        return ''.join(f'# {line}\n' for line in comments) + yaml.safe_dump(content, sort_keys=False), []
    return LANGUAGES[format](entries, [*provenance(result), *remarks]), remarks


def format_of(path: Path) -> str:
    """Return the format of a file's suffix. Raises ParameterError: the suffix is unknown."""
    if path.suffix not in SUFFIXES:
        raise ParameterError(f'{path} has no suffix that names a format; {", ".join(SUFFIXES)} are expected')
    return SUFFIXES[path.suffix]


def require_limit(torque: float | None) -> None:
    """Raise ParameterError for a torque limit [N m] that is no number above 0."""
    if torque is not None and not 0 < torque < float('inf'):
        raise ParameterError(f'the torque limit is {torque:g} N m; a number above 0 is expected')


def provenance(result: PartialResult) -> list[str]:
    """Return lines with the origin, level and warnings of a result; never an empty list."""
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


def _outside_model(result: PartialResult, format: str) -> list[str]:
    """Return sentences on the input delay and the compensated effects, which the model does not contain."""
    delay = result.effort.delay
    remarks = []
    if format == 'mjcf' and delay >= TIME_STEP:
        remarks.append(
            f'the motor has the input delay of {delay:.4g} s, which needs MuJoCo 3.5 or later; with a smaller '
            'timestep, raise nsample to delay / timestep + 1'
        )
    elif abs(delay) >= NEGLIGIBLE:
        remarks.append(f'this model does not contain the input delay of {delay:.4g} s')
    effects = [f'{e.name} ({e.where})' for e in result.effects if e.accepted]
    if effects:
        remarks.append(f'this model does not contain {", ".join(effects)}; its friction was estimated beside these')
    return remarks


def _entries(result: PartialResult) -> list[Entry]:
    """Return the parameters of the model in the order of theta; 0 if absent from the result."""
    last = max(NAMES.index(name) for name in result.parameters)
    size = min(size for size in MODELS.values() if size > last)
    entries = []
    for name in NAMES[:size]:
        entry = result.parameters.get(name, Parameter(value=0.0))
        about = [*MEANINGS[name], *([] if entry.std_error is None else [f'standard error {entry.std_error:.2g}'])]
        entries.append(Entry(name, entry.value, entry.std_error, '; '.join(about)))
    return entries
