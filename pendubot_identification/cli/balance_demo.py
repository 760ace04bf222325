# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot demo --balance``: the chain to its end, a virtual rig that is swung up by what was identified of it."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from pendubot_identification.errors import PendubotError

from .programs import (
    LOOK,
    Programs,
    interruptible,
    new_folder,
    once_more,
    own_ros,
    parameters,
    record_excitation,
)

RATE, SAMPLES, DELAY, LIMIT = 200, 2400, 0.004, 2.0
RIG = ('--preset', 'balance', '--delay', DELAY, '--torque-limit', LIMIT)
#: It is to be held for so long [s], and may take so much longer: where the computer pauses, it falls in between.
HOLD, PATIENCE = 10.0, 40.0
#: A patient rig's clock stays behind by every pause, and so do its samples, by so much at most [s].
LAG = 10.0


def run(args: argparse.Namespace) -> int:
    """Excite, record, identify, swing up, hold, draw."""
    folder = new_folder(args.output)
    bag, result = folder / 'excitation', folder / 'result.yaml'
    pulses = {'amplitude_min': -LIMIT, 'amplitude_max': LIMIT, 'seed': args.seed}
    with interruptible(bag), own_ros() as (rclpy, domain):
        print(f'virtual rig in ROS domain {domain}, files in {folder}', flush=True)
        print(f'virtual board: {RATE} Hz, 4000 counts per turn, a motor {1e3 * DELAY:g} ms late, {LIMIT:g} N m')
        once_more(lambda: record_excitation(rclpy, bag, SAMPLES, RATE, RIG, **pulses))
        with Programs(folder) as programs:
            asked = parameters(bags=f"['{bag}']", output=result, hold='zero', model='viscous')
            identifier = programs.start('identifier', *asked)
            programs.wait(identifier, result.exists, 'wrote no result', 120.0)
            print('identified', flush=True)
            watcher = once_more(lambda: _swung_up(rclpy, folder))
    return _show(folder, watcher)


def _swung_up(rclpy: Any, folder: Path) -> Watcher:
    """Have a rig at rest swung up by the parameters that are published; return who saw it.

    Raises:
        PendubotError: the balancer stopped, or did not hold it in time.
    """
    with Programs(folder) as programs:
        watcher = Watcher(rclpy)
        programs.callback(watcher.node.destroy_node)
        programs.start_rig(RATE, *RIG)
        balancer = programs.start('balancer', *parameters(torque_limit=LIMIT, max_age=LAG))
        programs.wait(balancer, watcher.sees_it_ready, 'was not ready', 60.0, watcher.spin)
        watcher.start()
        print('the balancer knows the rig through /pendubot/params alone; it swings it up', flush=True)
        programs.wait(balancer, watcher.has_seen_enough, 'did not hold it', HOLD + PATIENCE, watcher.spin)
        if watcher.message.startswith('stopped'):
            raise PendubotError(f'the balancer {watcher.message}')
    return watcher


class Watcher:
    """Follows rig and balancer from outside, and starts it.

    ``samples`` since the start are each t [s], q1, q2 [rad], torque [N m]; ``message`` and ``values`` are what the
    balancer said last of itself.
    """

    def __init__(self, rclpy: Any) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from sensor_msgs.msg import JointState
        from std_srvs.srv import Trigger

        self._rclpy, self._request = rclpy, Trigger.Request()
        self.samples: list[tuple[float, ...]] = []
        self.values = dict[str, str]()
        self.message = ''
        self._fallen = 0.0
        self.node = rclpy.create_node('demo_watcher')
        self.node.create_subscription(JointState, '/joint_states', self._on_sample, 1000)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)
        self._client = self.node.create_client(Trigger, '/balancer/start')

    def spin(self) -> None:
        """Listen until there is something new, or for a moment."""
        self._rclpy.spin_once(self.node, timeout_sec=LOOK)

    def sees_it_ready(self) -> bool:
        """Whether the balancer may be started."""
        return self.message == 'ready'

    @property
    def held(self) -> float:
        """For how long the rig is held [s]."""
        return self.samples[-1][0] - self._fallen if self.samples else 0.0

    def has_seen_enough(self) -> bool:
        """Whether the rig has been held for as long as is wanted, or the balancer has stopped."""
        return self.held > HOLD or self.message.startswith('stopped')

    def start(self) -> None:
        """Start the balancer.

        Raises:
            PendubotError: it refuses, or does not answer.
        """
        self.samples.clear()
        future = self._client.call_async(self._request)
        deadline = time.monotonic() + 10.0
        while not future.done() and time.monotonic() < deadline:
            self.spin()
        if not future.done() or not future.result().success:
            said = future.result().message if future.done() else 'no answer'
            raise PendubotError(f'the balancer did not start: {said}')

    def _on_sample(self, m: Any) -> None:
        import numpy as np

        from pendubot_identification.control.plan import HELD, deviation

        stamp = m.header.stamp.sec + m.header.stamp.nanosec * 1e-9
        if not self.samples or deviation(np.array([m.position[:2]]))[0] > HELD:
            self._fallen = stamp
        self.samples.append((stamp, *m.position[:2], m.effort[0]))

    def _on_diagnostics(self, array: Any) -> None:
        for status in array.status:
            if status.name == 'balancer':
                self.message, self.values = status.message, {pair.key: pair.value for pair in status.values}


def _show(folder: Path, watcher: Watcher) -> int:
    import numpy as np

    from pendubot_identification.control.plan import deviation, held_since
    from pendubot_identification.model.parameters import BALANCE
    from pendubot_identification.report.plots import draw_balance
    from pendubot_identification.results.result_file import read_parameters
    from pendubot_identification.trajectories.trajectory import Trajectory

    t, q1, q2, tau = np.array(watcher.samples).T
    motion = Trajectory(t - t[0], np.column_stack([q1, q2]), np.column_stack([tau, 0 * tau]), name='swing-up')
    picture = folder / 'balance.png'
    draw_balance(picture, motion, LIMIT)
    error = np.abs(read_parameters(folder / 'result.yaml').vector() / BALANCE.vector() - 1)[:5].max()
    print(f'identified within {100 * error:.2g} % of P1 to P5; picture: {picture}')
    since = held_since(motion)
    quiet = motion.t > since + 1
    angle, torque = (float(np.sqrt((x[quiet] ** 2).mean())) for x in (deviation(motion.q), tau))
    print(
        f'upright after {since:.1f} s, held for {motion.t[-1] - since:.1f} s: RMS angle {1e3 * angle:.1f} mrad, '
        f'RMS torque {torque:.3f} N m, at most {abs(tau).max():.3f} of {LIMIT:g} N m'
    )
    margins = {key: value for key, value in watcher.values.items() if 'margin' in key}
    print(', '.join(f'{key} {value}' for key, value in margins.items()))
    return 0
