"""What a result file says of its own making, read back: the recordings, the settings and the answers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pendubot_identification.core.errors import BagError
from pendubot_identification.core.estimation.evidence import Answer
from pendubot_identification.core.estimation.settings import Settings
from pendubot_identification.core.model.parameters import NAMES, Bounds, Parameters
from pendubot_identification.core.trajectories.long import Long
from pendubot_identification.core.trajectories.signals import evenly_stamped
from pendubot_identification.core.trajectories.trajectory import Trajectory

from .bag_reader import BagWindow, read_recording
from .joint_states import JOINT_NAMES, JOINT_STATES_TOPIC


def recordings(
    result: Mapping[str, Any], folder: Path | None = None
) -> tuple[tuple[Trajectory, ...], tuple[Trajectory, ...]]:
    """Read the bags of a result again, divided as they were.

    Args:
        result: what :func:`.result_file.read_result` returned.
        folder: where the bags lie now, by their own names; None: where they lay.

    Returns:
        Motions that estimate, motions that validate, as they were taken; of long ones the stretches that stand for
        them.

    Raises:
        BagError: a bag is gone, or is another one than it was.
        TrajectoryError: what is read makes no motion.
    """
    found: dict[str, list[Trajectory]] = {'training': [], 'validation': []}
    for source in result['bags']:
        window = BagWindow.parse(source['bag'])
        if folder is not None:
            window = BagWindow(folder / window.path.name, window.start, window.end)
        if not window.path.exists():
            raise BagError(
                f'there is no bag {window.path}, of which this result was made; was it moved, or is this another '
                'folder? --bags FOLDER names where it lies now'
            )
        recorded = read_recording(
            window,
            topic=source.get('topic', JOINT_STATES_TOPIC),
            joint_names=source.get('joint_names', JOINT_NAMES),
        )
        if recorded.sha256 != source['sha256']:
            raise BagError(
                f'{window.path} is not the bag of which this result was made: its SHA-256 begins with '
                f'{recorded.sha256[:12]}, {source["sha256"][:12]} is expected; --bags FOLDER names where that one lies'
            )
        # One bag without a window was halved: the first samples estimate, the last ones validate.
        samples = source['samples']
        motion = recorded.trajectory
        if isinstance(motion, Long):
            taken = source['stretches']
            found[source['role']] += [s for s in motion.stretches if round(float(s.t[0]), 3) in taken]
            continue
        part = slice(samples) if source['role'] == 'training' else slice(len(motion) - samples, None)
        found[source['role']].append(evenly_stamped(motion[part]))
    return tuple(found['training']), tuple(found['validation'])


def settings(result: Mapping[str, Any]) -> Settings:
    """Return with what settings a result was made, but for those of MDE and where a search started."""
    made = result['made_by']
    lower, upper = np.array(made['lower_bounds']), np.array(made['upper_bounds'])
    return Settings(
        criteria=tuple(made['criteria']),
        model=made['model'],
        optimizer=made['optimizer'],
        sliding=made['sliding_window'],
        smoothing=made['smoothing'],
        hold=made['hold'],
        delays=tuple(made['delays']),
        link_length=made['link_length'],
        seed=made['seed'],
        bounds=Bounds(lower, upper, NAMES[: len(lower)]),
    )


def hold(result: Mapping[str, Any]) -> str:
    """Return how a result took the torque between its samples; ``energy`` alone never asks."""
    holds = [entry['effort']['hold'] for name, entry in result['criteria'].items() if name != 'energy']
    asked: str = result['made_by']['hold']
    return asked if asked != 'auto' else (holds or ['zero'])[0]


def answers(result: Mapping[str, Any]) -> dict[str, Answer]:
    """Return every criterion's answer."""
    return {
        name: Answer(
            name,
            result['model'],
            Parameters(**{n: value['value'] for n, value in entry['parameters'].items()}).vector(result['model']),
            entry['effort']['delay'],
        )
        for name, entry in result['criteria'].items()
    }
