# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Restores the recordings and settings of a result from its file."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from pendubot_identification.errors import BagError, MissingFileError
from pendubot_identification.identification.settings import Settings
from pendubot_identification.model.parameters import NAMES, Bounds
from pendubot_identification.recordings.bag_reader import BagWindow, read_trajectory
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
