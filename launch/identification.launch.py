# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The identifier: estimates parameters from bags and publishes them latched on /pendubot/params.

ros2 launch pendubot_identification identification.launch.py bags:=swing output:=result.yaml
ros2 launch pendubot_identification identification.launch.py bags:="['swing@0:9', 'swing2']" validate:=swing3
"""

from pendubot_identification.errors import ParameterError
from pendubot_identification.launching import Program, described
from pendubot_identification.recordings.bag_reader import BagWindow
from pendubot_identification.resources import resource

ARGUMENTS = {
    'bags': ([''], "training bags, each BAG or BAG@START:END; several as a list: \"['swing@0:9', 'swing2']\""),
    'validate': ([''], 'validation bags, in the same form'),
    'criterion': ('', 'energy, weak or likelihood, or several of them with commas; empty: likelihood'),
    'model': ('auto', 'viscous, coulomb, rotor, geared, or auto'),
    'output': ('', 'result file to write; empty: none'),
    'force': (False, 'true: overwrite an existing result file'),
    'autostart': (True, 'false: the node waits for ros2 lifecycle, or for a lifecycle manager'),
}


def start(args):
    """Return the identifier; it keeps running, so that later subscribers receive the parameters, too."""
    for bag in filter(None, args['bags'] + args['validate']):
        path = BagWindow.parse(bag).path
        if not path.exists():
            raise ParameterError(f'there is no bag {path}; give the folder of a bag, or a file with columns')
    values = {name: args[name] for name in ARGUMENTS}
    return [Program('identifier', (str(resource('config/identifier.yaml')), values))]


def generate_launch_description():
    """Start the identifier."""
    return described(ARGUMENTS, start)
