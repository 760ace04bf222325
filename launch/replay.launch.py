# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Playback and display of a bag: the motion of a rig without the rig. It ends with the bag.

With parameters, a simulated rig with these parameters moves beside it as a ghost, under the recorded torque.

ros2 launch pendubot_identification replay.launch.py bag:=swing rviz:=true
ros2 launch pendubot_identification replay.launch.py bag:=swing rviz:=true parameters:=result.yaml
"""

from pendubot_identification.errors import ParameterError
from pendubot_identification.launching import Program, described, launch_file
from pendubot_identification.recordings.bag_reader import BagReader, BagWindow

VIEW = launch_file('view.launch.py')
ARGUMENTS = {
    'bag': ('', 'folder of the bag, or its .mcap file; BAG@START:END: only these seconds'),
    'rate': (1.0, 'speed relative to real time'),
    **VIEW['OPTIONAL'],
}


def start(args):
    """Return the player, whose end at the end of the bag ends all programs, and the view."""
    if not args['bag']:
        raise ParameterError('bag is empty; give the folder of a bag: bag:=FOLDER')
    BagReader(BagWindow.parse(args['bag']).path)  # refuses a bag that is missing
    values = {'bag': args['bag'], 'rate': args['rate'], 'ghost': args['parameters']}
    return [Program('player', (values,)), *VIEW['start'](args | {'ghost': args['parameters']})]


def generate_launch_description():
    """Start the player and the view."""
    return described(ARGUMENTS, start)
