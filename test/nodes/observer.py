# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A node that subscribes to parameters and diagnostics, and calls services."""

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_msgs.msg import Float64MultiArray

from pendubot_identification.nodes.messages import LATCHED
from test.processes import call, spin_until


def values(status):
    """Return the values of a status by name."""
    return {pair.key: pair.value for pair in status.values}


class Observer:
    """Subscribes at construction; ``params`` and ``quality`` are of its namespace, ``statuses`` of all programs."""

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

    def wait(self, future):
        self.until(future.done, 60.0)
        return future.result()

    def status(self, name):
        """Return the last status of a program on /diagnostics, or None."""
        return next((each for each in reversed(self.statuses) if each.name == name), None)

    def reported(self, name):
        """Return the values of the last status of a program, if any."""
        status = self.status(name)
        return {} if status is None else values(status)

    def call(self, kind, name, **request):
        """Call a service; the client is kept because discovery takes longer than the call."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
        return call(self.node, self._clients[name], kind.Request(**request))

    def set(self, node, **given):
        """Set parameters of a node; return the first refusal, or the last result."""
        messages = [Parameter(name, value=value).to_parameter_msg() for name, value in given.items()]
        results = Observer.call(self, SetParameters, f'{node}/set_parameters', parameters=messages).results
        return next((result for result in results if not result.successful), results[-1])

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.node.destroy_node()
