# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The virtual rig: the programs of rig.launch.py with a simulated pendubot on a pseudo-terminal. Nothing real moves.

ros2 launch pendubot_identification virtual.launch.py rviz:=true
"""

from pendubot_identification.launching import described, launch_file

RIG = launch_file('rig.launch.py')
ARGUMENTS = {
    **{name: argument for name, argument in RIG['ARGUMENTS'].items() if name != 'virtual'},
    'port': ('/tmp/pendubot', 'path of the link to the pseudo-terminal of the virtual board'),
    'patient': (False, 'true: the virtual board waits while this computer delays it or its commands'),
    'arm': (True, 'false: the exciter waits until you call /bridge/arm'),
}


def start(args):
    """Return the programs of the rig with a virtual board."""
    return RIG['start'](args | {'virtual': True})


def generate_launch_description():
    """Start all programs, and end them after the excitation or when a program ends earlier."""
    return described(ARGUMENTS, start)
