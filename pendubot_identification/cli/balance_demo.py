"""``pendubot demo --balance``: the chain to its end, a virtual rig that is swung up by what was identified of it."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from pendubot_identification.errors import PendubotError

from .demo import counting
from .programs import Programs, interruptible, new_folder, own_ros, parameters

RATE, SAMPLES, DELAY, LIMIT = 200, 2400, 0.004, 2.0
#: It is to be upright within this, and is then held for so long [s].
PATIENCE, HOLD = 20.0, 10.0


def run(args: argparse.Namespace) -> int:
    """Excite, record, identify, swing up, hold, draw."""
    folder = new_folder(args.output)
    with interruptible(folder / 'excitation'), own_ros() as (rclpy, domain):
        print(f'virtual rig in ROS domain {domain}, files in {folder}', flush=True)
        watcher = _balanced(rclpy, folder, args.seed)
    return _show(folder, watcher)


def _balanced(rclpy: Any, folder: Path, seed: int) -> _Watcher:
    """Run the chain in the folder; return who saw the swing-up."""
    from tqdm import tqdm

    port, bag = folder / 'board', folder / 'excitation'
    with Programs(folder) as programs:
        rig = ['--preset', 'balance', '--rate', RATE, '--delay', DELAY, '--torque-limit', LIMIT]
        board = programs.start('virtual_board', '--link', port, *rig)
        programs.wait(board, port.exists, 'opened no port')
        print(f'virtual board: {RATE} Hz, 4000 counts per turn, a motor {1e3 * DELAY:g} ms late, {LIMIT:g} N m')
        programs.start('bridge', *parameters(port=port))
        recording = parameters(output=bag, max_messages=SAMPLES)
        recorder = programs.start('recorder', *recording, finite=True)
        pulses = parameters(
            arm='true', duration=SAMPLES / RATE + 2, amplitude_min=-LIMIT, amplitude_max=LIMIT, seed=seed
        )
        exciter = programs.start('exciter', *pulses, finite=True)
        print(f'exciting and recording for {SAMPLES / RATE:g} s')
        with tqdm(total=SAMPLES, unit=' samples', disable=None, leave=False) as bar:
            programs.wait(recorder, lambda: recorder.ended, 'did not finish its bag', 60.0, counting(rclpy, bar))
        programs.wait(exciter, lambda: exciter.ended, 'did not end')
        result = folder / 'result.yaml'
        asked = parameters(bags=f"['{bag}']", output=result, hold='zero', model='viscous')
        identifier = programs.start('identifier', *asked)
        programs.wait(identifier, result.exists, 'wrote no result', 120.0)
        print('identified')
        balancer = programs.start('balancer', *parameters(torque_limit=LIMIT))
        watcher = _Watcher(rclpy)
        programs.wait(balancer, lambda: watcher.says('ready'), 'was not ready', 60.0, watcher.spin)
        watcher.samples.clear()
        watcher.start()
        print('the balancer knows the rig through /pendubot/params alone; it swings it up')
        programs.wait(balancer, watcher.has_seen_enough, 'did not hold it', PATIENCE + HOLD, watcher.spin)
    return watcher


class _Watcher:
    """Follows the balancer from outside, and starts it."""

    def __init__(self, rclpy: Any) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from sensor_msgs.msg import JointState
        from std_srvs.srv import Trigger

        self._rclpy, self._request = rclpy, Trigger.Request()
        self.samples: list[tuple[float, ...]] = []
        self._message, self.values = '', dict[str, str]()
        self._node = rclpy.create_node('demo_watcher')
        self._node.create_subscription(JointState, '/joint_states', self._on_sample, 1000)
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)
        self._client = self._node.create_client(Trigger, '/balancer/start')

    def spin(self) -> None:
        self._rclpy.spin_once(self._node, timeout_sec=0.1)

    def says(self, word: str) -> bool:
        """Whether the balancer's last diagnosis begins with this."""
        return self._message.startswith(word)

    def has_seen_enough(self) -> bool:
        """Whether it has balanced for as long as is wanted, by its own account, or stopped."""
        held = float(self.values.get('balancing for [s]', 0.0))
        return self.says('stopped') or (self.says('balancing') and held > HOLD)

    def start(self) -> None:
        """Start the balancer.

        Raises:
            PendubotError: it refuses, or does not answer.
        """
        future = self._client.call_async(self._request)
        deadline = time.monotonic() + 10.0
        while not future.done() and time.monotonic() < deadline:
            self.spin()
        if not future.done() or not future.result().success:
            said = future.result().message if future.done() else 'no answer'
            raise PendubotError(f'the balancer did not start: {said}')

    def _on_sample(self, m: Any) -> None:
        stamp = m.header.stamp.sec + m.header.stamp.nanosec * 1e-9
        self.samples.append((stamp, *m.position, m.effort[0]))

    def _on_diagnostics(self, array: Any) -> None:
        for status in array.status:
            if status.name == 'balancer':
                self._message, self.values = status.message, {pair.key: pair.value for pair in status.values}


def _show(folder: Path, watcher: _Watcher) -> int:
    import numpy as np

    from pendubot_identification.control.rehearsal import deviation, held_since
    from pendubot_identification.model.parameters import BALANCE
    from pendubot_identification.report.balance_figure import draw_balance
    from pendubot_identification.results.result_file import read_parameters
    from pendubot_identification.trajectories.trajectory import Trajectory

    t, q1, q2, tau = np.array(watcher.samples).T
    motion = Trajectory(t - t[0], np.column_stack([q1, q2]), np.column_stack([tau, 0 * tau]), name='swing-up')
    picture = folder / 'balance.png'
    draw_balance(picture, motion, LIMIT)
    error = np.abs(read_parameters(folder / 'result.yaml').vector() / BALANCE.vector() - 1)[:5].max()
    print(f'identified within {100 * error:.2g} % of P1 to P5; picture: {picture}')
    since = held_since(motion)
    if not watcher.says('balancing') or since > motion.t[-1] - HOLD / 2:
        raise PendubotError(f'the rig was not held upright; see {picture} and the logs beside it')
    quiet = motion.t > since + 1
    angle, torque = (float(np.sqrt((x[quiet] ** 2).mean())) for x in (deviation(motion.q), tau))
    print(
        f'upright after {since:.1f} s, held for {motion.t[-1] - since:.1f} s: RMS angle {1e3 * angle:.1f} mrad, '
        f'RMS torque {torque:.3f} N m, at most {abs(tau).max():.3f} of {LIMIT:g} N m'
    )
    margins = {key: value for key, value in watcher.values.items() if 'margin' in key}
    print(', '.join(f'{key} {value}' for key, value in margins.items()))
    return 0
