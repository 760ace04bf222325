"""An identification as the messages that a controller and a person read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from pendubot_identification.core.identification import Identification
from pendubot_identification.core.parameters import NAMES

#: A subscriber that joins later still receives the last message.
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def parameters_message(result: Identification) -> Float64MultiArray:
    """Return theta; ``layout.dim[0].label`` names its entries, ``P1,P2,...``."""
    theta = result.parameters.vector().tolist()
    message = Float64MultiArray(data=theta)
    message.layout.dim = [MultiArrayDimension(label=','.join(NAMES), size=len(theta), stride=len(theta))]
    return message


def identification_values(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of a result (see :func:`.adapters.result_file.result_data`) under flat names.

    ``P1``, ``P1.std_error``, ``P1.unit``, ``J.training``, ``made_by.criterion``, ``bags.0.bag``, ``warnings.0`` ...
    """
    values: dict[str, Any] = {}
    for name, entry in data['parameters'].items():
        values |= {name: entry['value'], f'{name}.std_error': entry['std_error'], f'{name}.unit': entry['unit']}
    for key, entry in data.items():
        if key != 'parameters':
            values |= _flat(key, entry)
    return values


def _flat(prefix: str, entry: Any) -> dict[str, Any]:
    if isinstance(entry, Mapping):
        return {k: v for key, value in entry.items() for k, v in _flat(f'{prefix}.{key}', value).items()}
    if isinstance(entry, Sequence) and not isinstance(entry, str) and any(isinstance(e, (Mapping, str)) for e in entry):
        return {k: v for index, value in enumerate(entry) for k, v in _flat(f'{prefix}.{index}', value).items()}
    return {prefix: entry}
