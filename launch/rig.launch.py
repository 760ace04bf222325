# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Bridge, recorder and exciter for a rig, or with virtual:=true for a virtual board in its place.

ros2 launch pendubot_identification rig.launch.py bridge:=bridge.yaml
ros2 launch pendubot_identification rig.launch.py bridge:=bridge.yaml excitation:=exciter.yaml rviz:=true
"""

import os
from pathlib import Path

from pendubot_identification.errors import ParameterError
from pendubot_identification.excitation.excitation import DURATION, PulseTrain, read_exciter
from pendubot_identification.files import refuse_untaken
from pendubot_identification.launching import Program, described, launch_file
from pendubot_identification.resources import resource

VIEW = launch_file('view.launch.py')
ARGUMENTS = {
    'virtual': (False, 'true: start a virtual board and use it instead of a rig'),
    'bridge': ('', 'parameter file of the bridge, your copy of config/bridge.yaml; empty: the file of the package'),
    'port': ('', "the board's serial port; empty: from the parameter file, or with virtual:=true a link in /tmp"),
    'baud': (0, 'baud rate of the port; 0: from the parameter file'),
    'output': ('', 'folder of the bag; empty: named after the time'),
    'arm': (False, 'true: the exciter arms the motor by itself, if the zeros are confirmed. Stand clear of the rig.'),
    'autostart': (True, 'false: bridge and recorder wait for ros2 lifecycle, or for a lifecycle manager'),
    'excitation': ('', 'parameter file of the exciter, from pendubot excite; empty: the following arguments'),
    'duration': (18.0, 'length of the excitation [s]'),
    'amplitude': (1.0, 'largest absolute value of the random torques [N m]'),
    'seed': (1, 'seed of the torques'),
    **VIEW['OPTIONAL'],
}


def start(args):
    """Return bridge, recorder, exciter and view; the exciter arms the motor only after the recorder records."""

    def file(name, argument):
        path = args[argument]
        # The launch library would only warn, and start the program with its defaults.
        if path and not os.path.isfile(path):
            raise ParameterError(f'{argument} is {path}, and there is no such file; name a parameter file of {name}')
        if path:
            refuse_untaken(path, f'{args["namespace"]}/{name}')
        return path or str(resource(f'config/{name}.yaml'))

    # A virtual board does not use the port in the bridge's file, because that may belong to a rig.
    port = args['port'] or ('/tmp/pendubot' if args['virtual'] else '')
    link = {name: value for name, value in (('port', port), ('baud', args['baud'])) if value}
    if args['virtual']:
        link['confirm_zeros'] = False  # the zeros of a virtual board are exact
    waiting = {} if args['autostart'] else {'autostart': False}
    recording = {'output': args['output'], **waiting, **args.get('recorder', {})}
    excitation = file('exciter', 'excitation')
    if args['excitation']:
        read_exciter(Path(excitation))  # refuses invalid values
        train = {}
    else:
        amplitude = abs(args['amplitude'])
        train = {'amplitude_min': -amplitude, 'amplitude_max': amplitude, 'seed': args['seed']}
        PulseTrain(**train)  # refuses invalid values, too
        DURATION.check(args['duration'])
        train['duration'] = args['duration']
    patient = ('--patient',) if args.get('patient') else ()
    moving = {'arm': args['arm'], 'recorded': True} | train
    return [
        *([Program('virtual_board', arguments=('--link', port, *patient))] if args['virtual'] else []),
        Program('bridge', (file('bridge', 'bridge'), link | waiting)),
        Program('recorder', (str(resource('config/recorder.yaml')), recording)),
        Program('exciter', (excitation, moving)),
        *VIEW['start'](args),
    ]


def generate_launch_description():
    """Start all programs, and end them after the excitation or when a program ends earlier."""
    return described(ARGUMENTS, start)
