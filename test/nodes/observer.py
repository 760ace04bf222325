# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A node that hears what programs publish of a rig's parameters and of themselves, and calls their services."""

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_msgs.msg import Float64MultiArray

from pendubot_identification.nodes.messages import LATCHED
from test.processes import call, spin_until


def values(status):
    """The values of a status by name."""
    return {pair.key: pair.value for pair in status.values}


class Observer:
    """Joins when it is made; ``params`` and ``quality`` are of its namespace, ``statuses`` of all programs."""

    def __init__(self, ros, namespace=''):
        self.node = ros.create_node('listener', namespace=namespace)
        self.params, self.quality, self.statuses, self._clients = [], [], [], {}
        for kind, topic, take, qos in (
            (Float64MultiArray, 'pendubot/params', self.params.append, LATCHED),
            (DiagnosticArray, 'pendubot/identification', lambda m: self.quality.extend(m.status), LATCHED),
            (DiagnosticArray, '/diagnostics', self._on_diagnostics, 10),
        ):
            self.node.create_subscription(kind, topic, take, qos)

    def _on_diagnostics(self, array):
        self.statuses += array.status

    def until(self, condition, timeout=20.0):
        assert spin_until(self.node, condition, timeout), (self.quality[-1:], self.params[-1:], self.statuses[-3:])

    def status(self, name):
        """The last status of a program on /diagnostics, None if there is none."""
        return next((each for each in reversed(self.statuses) if each.name == name), None)

    def call(self, kind, name, **request):
        """Call a service; its client stays, for to discover the server takes longer than the call."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
        return call(self.node, self._clients[name], kind.Request(**request))

    def set(self, node, **given):
        """Set parameters of a node; return the first answer that refuses, or the last."""
        messages = [Parameter(name, value=value).to_parameter_msg() for name, value in given.items()]
        results = self.call(SetParameters, f'{node}/set_parameters', parameters=messages).results
        return next((result for result in results if not result.successful), results[-1])

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.node.destroy_node()
