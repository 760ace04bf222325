# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The origin of a result: its recordings, its settings, and the command that repeats the identification."""

import math
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from pendubot_identification.errors import BagError, MissingFileError
from pendubot_identification.identification import DELAYS, SPREAD
from pendubot_identification.identification.settings import Settings
from pendubot_identification.model.parameters import NAMES, SPECIFICATIONS, UNDER_LOAD, Bounds
from pendubot_identification.recordings.bag_reader import BagWindow, read_trajectory
from pendubot_identification.setting import flag
from pendubot_identification.trajectories.conversion import Conversion
from pendubot_identification.trajectories.signals import evenly_stamped
from pendubot_identification.trajectories.trajectory import Trajectory

from .result import Result

#: Suffix of the name of a recording that is no file.
IN_MEMORY = ' (from memory)'


def recordings(result: Result, folder: Path | None = None) -> tuple[list[Trajectory], list[Trajectory]]:
    """Read the bags of a result again, from ``folder`` or from their original one.

    Returns the motions for training and for validation, divided as in the identification.

    Raises:
        PendubotError: a bag is missing or has changed, or its samples cannot be used.
    """
    motions: dict[str, list[Trajectory]] = {'training': [], 'validation': []}
    conversion = Conversion.of(result.reading)
    for source in result.bags:
        if source.bag.endswith(IN_MEMORY):
            raise MissingFileError('the recordings were in memory, in no file; identify again')
        window = BagWindow.parse(source.bag)
        if folder is not None:
            window = replace(window, path=folder / window.path.name)
        if not window.path.exists():
            raise MissingFileError(
                f'there is no bag {window.path}, from which this result was made; name its folder: --bags FOLDER'
            )
        recorded = read_trajectory(window, conversion)
        if recorded.sha256 != source.sha256:
            raise BagError(
                f'{window.path} is not the bag from which this result was made: its SHA-256 begins with '
                f'{recorded.sha256[:12]}, {source.sha256[:12]} is expected; name the original folder: --bags FOLDER'
            )
        motion = recorded.trajectory
        # A bag without a window was halved into training and validation.
        first = 0 if source.role == 'training' else len(motion) - source.samples
        motions[source.role].append(evenly_stamped(motion[first : first + source.samples]))
    return motions['training'], motions['validation']


def settings(result: Result) -> Settings:
    """Return the settings of a result, except the settings of MDE and the start of a search."""
    made, size = result.made_by, len(result.made_by.lower_bounds)
    same = ('model', 'optimizer', 'smoothing', 'hold', 'link_length', 'link_mass', 'seed')
    low, high = made.delays
    return Settings(
        **{name: getattr(made, name) for name in same},
        criteria=tuple(made.criteria),
        sliding=made.sliding_window,
        delays=(low, high),
        bounds=Bounds(np.array(made.lower_bounds), np.array(made.upper_bounds), NAMES[:size]),
        reading=Conversion.of(result.reading),
    )


def hold(result: Result) -> str:
    """Return the hold of the torque between samples; the criterion ``energy`` has none."""
    requested = result.made_by.hold
    holds = [answer.effort.hold for name, answer in result.criteria.items() if name != 'energy']
    return requested if requested != 'auto' else (holds or ['zero'])[0]


def command(result: Result) -> str:
    """Return the command that reproduces this result; empty if the recordings were in memory."""
    if any(source.bag.endswith(IN_MEMORY) for source in result.bags):
        return ''
    made = result.made_by
    training = dict.fromkeys(each.bag for each in result.bags if each.role == 'training')
    validation = [each.bag for each in result.bags if each.bag not in training]
    words = ['pendubot identify', *map(shlex.quote, training)]
    words += ['--validate', *map(shlex.quote, validation)] if validation else []
    defaults, expert = Settings(), {} if made.smoothing is None else {'smoothing': made.smoothing}
    spread: float | None = SPREAD
    for criterion, answer in result.criteria.items():
        if (search := answer.mde) is not None:
            spread = search.spread
            default, runs = defaults.search(criterion, result.model)
            usual = {'runs': runs, 'population': default.population, 'generations': default.generations}
            expert |= {name: getattr(search, name) for name in usual if getattr(search, name) != usual[name]}
            expert |= {'per_vector': True} if default.per_component and not search.per_component else {}
    options = {name: (getattr(made, name), getattr(defaults, name)) for name in ('model', 'optimizer', 'hold', 'seed')}
    options |= {
        'criterion': (','.join(made.criteria), ','.join(defaults.criteria)),
        'delay': ('{:.12g}:{:.12g}'.format(*made.delays), '{:g}:{:g}'.format(*DELAYS)),
        'sliding': (made.sliding_window, None),
        **{name: (getattr(made, name), None) for name in ('link_length', 'link_mass')},
        'spread': (f'{spread or 0:.12g}', f'{SPREAD:g}'),
        'start': ('START.yaml' if made.start else None, None),
    }
    words += [f'{flag(n)}={shlex.quote(str(v))}' for n, (v, default) in options.items() if v not in (None, default)]
    words += [f'--bounds {bound}' for bound in _given_bounds(result)]
    words += Conversion.of(result.reading).options()
    if expert:
        words.append(f' # with --settings, a file with {yaml.safe_dump(expert, default_flow_style=True).strip()}')
    return ' '.join(words)


def _given_bounds(result: Result) -> list[str]:
    """Return the bounds that differ from the default search box, which grows by powers of ten with the rig."""
    made = result.made_by
    box = list(zip(SPECIFICATIONS, made.lower_bounds, made.upper_bounds, strict=False))
    ratios = [high / each.upper for each, _, high in box if each.name not in UNDER_LOAD]
    factor = min((ratio for ratio in ratios if ratio >= 1 and math.log10(ratio).is_integer()), default=1.0)
    given = []
    for each, low, high in box:
        usual = (0.0, each.upper) if each.name in UNDER_LOAD else (factor * each.upper,)
        if low != each.lower or high not in usual:
            given.append(f'{each.name}={low:.12g}' if low == high else f'{each.name}={low:.12g}:{high:.12g}')
    return given
