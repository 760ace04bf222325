# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot demo``: the whole chain, live, on the virtual rig; the one subcommand that needs ROS."""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import asdict
from typing import Any

from pendubot_identification.errors import PendubotError

BAG = 'paper_experiment'
SAMPLES = 1800
RATE = 100


def run(args: argparse.Namespace) -> int:
    """Excite, record, identify, receive, and show the parameters beside the truth."""
    if args.balance:
        from . import balance_demo

        return balance_demo.run(args)
    if args.track:
        from . import track_demo

        return track_demo.run(args)
    from pendubot_identification.model.parameters import PAPER
    from pendubot_identification.report import tables
    from pendubot_identification.results.result_file import read_complete_result

    # Of processes; --help needs none.
    from .programs import Programs, interruptible, new_folder, once_more, own_ros, parameters, record_excitation

    folder = new_folder(args.output)
    bag, written = folder / BAG, folder / 'result.yaml'
    with interruptible(bag), own_ros() as (rclpy, domain):
        print(f'virtual rig in ROS domain {domain}, files in {folder}', flush=True)
        print(f'virtual board: {RATE} Hz, 4000 counts per turn, the parameters of the paper')
        once_more(lambda: record_excitation(rclpy, bag, SAMPLES, RATE, seed=args.seed))
        with Programs(folder) as programs:
            # The bridge's torques are held; to find that out from the data would take some seconds more.
            identifier = programs.start('identifier', *parameters(bags=f"['{bag}']", output=written, hold='zero'))
            begin = time.monotonic()
            programs.wait(identifier, written.exists, 'wrote no result', 120.0)
            print(f'identified in {time.monotonic() - begin:.1f} s, start of the node included')
            theta, label = late_subscriber(rclpy)
    result = read_complete_result(written)
    if theta != result.theta.vector(result.model).tolist():
        raise PendubotError(f'/pendubot/params said {theta}, the result file something else; please report this')
    print(f'a subscriber that joined afterwards received /pendubot/params ({label}): {result.criterion}\n')
    compared, runs = tables.comparison_table(result, asdict(PAPER)), tables.run_table(result)
    shown = [compared, tables.prediction_table(result), tables.criterion_table(result), *([runs] if runs else [])]
    print(*(table.text() for table in shown), tables.steps(result), tables.judgement(result), sep='\n\n')
    print(
        f'\nThe first {SAMPLES // 2} samples estimate, the others validate. The errors of energy are its own: encoder\n'
        'counts and central differences move its minimum away from the truth, and MDE finds that minimum exactly.\n'
        f'\ntry: {sys.argv[0]} identify {bag}'
    )
    return 0


def late_subscriber(rclpy: Any) -> tuple[list[float], str]:
    """Join now, after the identification, and return the parameters that were latched."""
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from std_msgs.msg import Float64MultiArray

    received: list[Any] = []
    node = rclpy.create_node('demo_controller')
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(Float64MultiArray, '/pendubot/params', received.append, latched)
    deadline = time.monotonic() + 10.0
    while not received and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    if not received:
        raise PendubotError('a subscriber that joined after the identification received nothing on /pendubot/params')
    return list(received[0].data), received[0].layout.dim[0].label
