# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot demo --track``: a virtual rig is followed and balanced while a payload is put on and taken off."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from pendubot_identification.errors import PendubotError

from .balance_demo import DELAY, LAG, LIMIT, RATE, RIG, Watcher
from .programs import LOOK, Program, Programs, interruptible, new_folder, once_more, own_ros, parameters

#: What is put on link 2 [kg]: it makes a fifth of its weight more.
PAYLOAD = 0.024
#: It is followed for so long [s] before that, and after it was noticed; and held so long with it, and without it again.
BEFORE, AFTER, HELD = 8.0, 6.0, 5.0
#: The first motion is identified, the payload noticed, and the rig held within this [s].
PATIENCE = 60.0


def run(args: argparse.Namespace) -> int:
    """Excite, follow, put the payload on, balance, take it off, and show what was said beside the truth."""
    from pendubot_identification.model.parameters import BALANCE, NAMES, UNITS
    from pendubot_identification.report.table import Table

    folder = new_folder(args.output)
    bag = folder / 'followed'
    with interruptible(bag), own_ros() as (rclpy, domain):
        print(f'virtual rig in ROS domain {domain}, files in {folder}', flush=True)
        print(f'virtual board: {RATE} Hz, 4000 counts per turn, a motor {1e3 * DELAY:g} ms late', flush=True)
        attempts = iter((bag, folder / 'once_more'))
        before, after = once_more(lambda: _followed(rclpy, next(attempts), args.seed))
    truths = BALANCE.vector(), BALANCE.carrying(PAYLOAD).vector()
    rows = [
        [name, unit, *(f'{x[k]:.4g}' for x in (truths[0], before, truths[1], after))]
        for k, (name, unit) in enumerate(zip(NAMES[:7], UNITS, strict=False))
    ]
    head = ['', 'unit', 'without payload', 'followed', f'with {PAYLOAD:g} kg', 'followed']
    print('', Table(head, rows).text(), sep='\n')
    print(f'\ntry: pendubot track {bag} --model viscous --report {folder / "look"}')
    return 0


def _followed(rclpy: Any, bag: Path, seed: int) -> tuple[list[float], list[float]]:
    """Return what was published last before the payload was put on, and with it.

    Raises:
        PendubotError: a program ended early, noticed nothing, or the rig was not held.
    """
    with Programs(bag.parent) as programs:
        listener = _Listener(rclpy)
        programs.callback(listener.node.destroy_node)
        programs.start_rig(RATE, *RIG, '--ros-args')
        programs.start('recorder', *parameters(output=bag))
        tracker = programs.start('tracker', *parameters(model='viscous'))
        pulses = {'amplitude_min': -LIMIT, 'amplitude_max': LIMIT, 'seed': seed}
        exciter = programs.start('exciter', *parameters(arm='true', duration=0.0, **pulses), finite=True)
        print('exciting; the tracker waits for motion', flush=True)
        programs.wait(tracker, lambda: bool(listener.params), 'published nothing', PATIENCE, listener.spin)
        print(f'it follows; after {BEFORE:g} s link 2 gets {PAYLOAD:g} kg more', flush=True)
        listener.wait(programs, tracker, BEFORE)
        before = listener.params
        listener.carry(programs, tracker, PAYLOAD)
        programs.wait(tracker, lambda: bool(listener.change), 'noticed no payload', PATIENCE, listener.spin)
        print(f'the tracker: {listener.change}', flush=True)
        watcher = Watcher(rclpy)
        programs.callback(watcher.node.destroy_node)
        balancer = programs.start('balancer', *parameters(torque_limit=LIMIT, max_age=LAG))
        listener.wait(programs, tracker, AFTER)
        programs.wait(balancer, watcher.sees_it_ready, 'was not ready', PATIENCE, watcher.spin)
        after = listener.params
        exciter.end()
        watcher.start()
        print('the balancer knows the rig through the tracker alone; it swings it up', flush=True)
        _hold(programs, balancer, watcher)
        listener.carry(programs, tracker, 0.0)
        watcher.samples.clear()
        _hold(programs, balancer, watcher)
        return before, after


def _hold(programs: Programs, balancer: Program, watcher: Watcher) -> None:
    """Wait until the rig has been held for a while; tell how quietly."""
    import numpy as np

    from pendubot_identification.control.plan import deviation

    def enough() -> bool:
        lasted = watcher.samples[-1][0] - watcher.samples[0][0] if watcher.samples else 0.0
        return min(watcher.held, lasted) > HELD or watcher.message.startswith('stopped')

    programs.wait(balancer, enough, 'did not hold it', PATIENCE, watcher.spin)
    if watcher.message.startswith('stopped'):
        raise PendubotError(f'the balancer {watcher.message}')
    rows = np.array(watcher.samples)
    held = rows[rows[:, 0] > rows[-1, 0] - HELD]
    angle = float(np.sqrt((deviation(held[:, 1:3]) ** 2).mean()))
    print(f'held for {HELD:g} s, RMS angle {1e3 * angle:.1f} mrad', flush=True)


class _Listener:
    """What the tracker says: the newest ``params``, and the last ``change``."""

    def __init__(self, rclpy: Any) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray

        self._rclpy = rclpy
        self.params: list[float] = []
        self.change = ''
        self._now = 0.0
        self.node = rclpy.create_node('demo_listener')
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(Float64MultiArray, '/pendubot/params', self._on_params, latched)
        self.node.create_subscription(DiagnosticArray, '/pendubot/identification', self._on_said, latched)
        self.node.create_subscription(JointState, '/joint_states', self._on_sample, 1000)

    def spin(self) -> None:
        """Listen until there is something new, or for a moment."""
        self._rclpy.spin_once(self.node, timeout_sec=LOOK)

    def wait(self, programs: Programs, tracker: Program, seconds: float) -> None:
        """Listen for so long, by the rig's clock."""
        until = self._now + seconds
        programs.wait(tracker, lambda: self._now > until, 'heard no samples', seconds + PATIENCE, self.spin)

    def carry(self, programs: Programs, tracker: Program, payload: float) -> None:
        """Have link 2 carry a payload [kg], as ``ros2 param set`` does."""
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        client = self.node.create_client(SetParameters, '/virtual_board/set_parameters')
        programs.wait(tracker, client.service_is_ready, 'is ready, but the virtual board is not', PATIENCE, self.spin)
        client.call_async(SetParameters.Request(parameters=[Parameter('payload', value=payload).to_parameter_msg()]))
        print(f'as would: ros2 param set /virtual_board payload {payload:g}', flush=True)

    def _on_params(self, m: Any) -> None:
        self.params = list(m.data)

    def _on_said(self, array: Any) -> None:
        for status in array.status:
            said = {pair.key: pair.value for pair in status.values}.get('last_change', 'none')
            self.change = '' if said == 'none' else said

    def _on_sample(self, m: Any) -> None:
        self._now = m.header.stamp.sec + m.header.stamp.nanosec * 1e-9
