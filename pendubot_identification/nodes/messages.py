# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""An identification as the messages that a controller and a person read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from pendubot_identification.errors import ControlError
from pendubot_identification.model.parameters import NAMES
from pendubot_identification.results.result import Result, plain

#: A subscriber that joins later still receives the last message.
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def parameters_message(result: Result) -> Float64MultiArray:
    """Return theta of the published model; ``layout.dim[0].label`` names its 7, 9, 10 or 14 entries, ``P1,P2,...``.

    A parameter that the rig cannot have keeps its place, with 0.
    """
    return vector_message(result.theta.vector(result.model))


def vector_message(theta: NDArray[np.float64]) -> Float64MultiArray:
    """Return a parameter vector, shape (D,), as such a message."""
    names = ','.join(NAMES[: len(theta)])
    message = Float64MultiArray(data=theta.tolist())
    message.layout.dim = [MultiArrayDimension(label=names, size=len(theta), stride=len(theta))]
    return message


def joint_sample(m: JointState, names: Sequence[str]) -> tuple[float, tuple[float, float], float]:
    """Return when a sample was taken [s], shoulder's and elbow's position [rad], and the shoulder's effort [N m].

    Raises:
        ControlError: it lacks one of these.
    """
    try:
        shoulder, elbow = (list(m.name).index(name) for name in names)
        q, effort = (m.position[shoulder], m.position[elbow]), m.effort[shoulder]
    except (ValueError, IndexError):
        raise ControlError(
            f'joint_states has {list(m.name)}; positions of {list(names)} and the effort of the first are expected: '
            'look at joint_names'
        ) from None
    return m.header.stamp.sec + m.header.stamp.nanosec * 1e-9, q, effort


def identification_values(result: Result) -> dict[str, Any]:
    """Return the entries of a result under flat names.

    ``P1``, ``P1.std_error``, ``P1.unit``, ``J.training``, ``prediction.error``, ``criterion``, ``bags.0.bag``,
    ``warnings.0``, ``criteria.energy.P1`` ... Matrices and single runs are left to the result file.
    """
    data, values = plain(result), {}
    for name, entry in data['parameters'].items():
        values[name] = entry['value']
        values |= flat(name, {key: value for key, value in entry.items() if key != 'value'})
    for key, entry in data.items():
        if key not in ('parameters', 'criteria', 'covariance', 'covariance_rank'):
            values |= flat(key, entry)
    for name, answer in data['criteria'].items():
        J = {which: answer['J'][which] for which in ('training', 'validation', 'unit')}
        brief = {'level': answer['level'], 'J': J, 'error': answer['prediction']['error']}
        values |= flat(f'criteria.{name}', brief | {n: entry['value'] for n, entry in answer['parameters'].items()})
    return values


def flat(prefix: str, entry: Any) -> dict[str, Any]:
    """Return what is nested in an entry under flat names."""
    if isinstance(entry, Mapping):
        kept = ((key, value) for key, value in entry.items() if not key.endswith('_runs'))
        return {k: v for key, value in kept for k, v in flat(f'{prefix}.{key}', value).items()}
    if isinstance(entry, Sequence) and not isinstance(entry, str) and any(isinstance(e, (Mapping, str)) for e in entry):
        return {k: v for index, value in enumerate(entry) for k, v in flat(f'{prefix}.{index}', value).items()}
    return {prefix: entry}
