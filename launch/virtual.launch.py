# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The virtual rig: what rig.launch.py starts, with a simulated pendubot behind a pseudo-terminal. Nothing moves.

ros2 launch pendubot_identification virtual.launch.py rviz:=true
"""

from pendubot_identification.launching import described, launch_file

RIG = launch_file('rig.launch.py')
ARGUMENTS = {
    **{name: argument for name, argument in RIG['ARGUMENTS'].items() if name != 'virtual'},
    'port': ('/tmp/pendubot', 'the link to its pseudo-terminal that the virtual board makes'),
    'patient': (False, 'true: the virtual board waits when this computer is too busy for it or for the commands'),
    'arm': (True, 'false: the exciter waits until you call /bridge/arm'),
}


def start(given):
    """Return the rig's programs on a virtual board."""
    return RIG['start'](given | {'virtual': True})


def generate_launch_description():
    """Start everything, and end it when the excitation is over or a program ends before."""
    return described(ARGUMENTS, start)
