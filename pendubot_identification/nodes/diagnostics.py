"""A status as diagnostic_msgs has it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from pendubot_identification.level import Level


def diagnostics_message(
    stamp: Time, name: str, level: Level, summary: str, values: Mapping[str, Any], hardware_id: str = ''
) -> DiagnosticArray:
    """Return one status with its values by name; numbers keep their full precision."""
    status = DiagnosticStatus(
        level=bytes([level]),
        name=name,
        message=summary,
        hardware_id=hardware_id,
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
    )
    message = DiagnosticArray(status=[status])
    message.header.stamp = stamp
    return message
