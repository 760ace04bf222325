# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The options of an identification: names, defaults, ranges and help, for the command line and ROS alike.

Nothing heavy is imported here: ``--help`` needs no numpy.
"""

from pendubot_identification.model import MODELS
from pendubot_identification.setting import Setting, interval, words

CRITERIA = ('energy', 'weak', 'likelihood')
#: The effort's delay is searched within these [s].
DELAYS = (-0.1, 0.1)
#: A run of MDE stops when its population has converged this closely: then its best J has long been the minimum to a
#: relative 1e-6, and the rest of 4000 generations changes no printed digit.
SPREAD = 1e-9

CRITERION = Setting(
    'criterion',
    '',
    f'what is minimised, of {", ".join(CRITERIA)}, with commas between them; by default likelihood. MDE minimises '
    'energy in every identification',
    choices=CRITERIA,
    optional=True,
    read=lambda value: tuple(dict.fromkeys(words(value))),
)
DELAY = Setting(
    'delay',
    DELAYS,
    'how much later than stamped the torque acts (of weak and likelihood), estimated between two values, or fixed '
    'where they are equal',
    's',
    -0.5,
    0.5,
    read=lambda value: interval('delay', value, '0:0.02'),
)
START = Setting(
    'start', '', 'result file from whose parameters likelihood starts; by default the answer of weak', optional=True
)
PER_VECTOR = Setting('per_vector', False, "draw MDE's operator once per vector; beyond energy and viscous it always is")
SPREAD_LIMIT = Setting(
    'spread',
    SPREAD,
    'stop a run of MDE when the worst J of its population exceeds the best by no more than this fraction; by default '
    '1e-9, which loses nothing; 0 takes every generation, as in the paper',
    '',
    0.0,
    1.0,
    optional=True,
)
WHAT = (
    CRITERION,
    Setting(
        'model',
        'auto',
        'which parameters there are; auto: the smallest model that is exact, or else the largest',
        choices=('auto', *MODELS),
    ),
)
DATA = (
    Setting(
        'hold',
        'auto',
        'the torque between its samples: zero, it is held, as the bridge records it; linear, it was measured; auto, '
        'what explains the motion better. energy always takes it as held',
        choices=('auto', 'zero', 'linear'),
    ),
    DELAY,
    Setting(
        'sliding', 0.0, 'sliding window of the energy balance; by default cumulative', 's', 1e-3, 3600.0, optional=True
    ),
    Setting(
        'link_length',
        0.0,
        'length of link 1 by a ruler, against which the data are held; by default not known',
        'm',
        1e-3,
        100.0,
        optional=True,
    ),
    Setting(
        'link_mass',
        0.0,
        'mass of link 2 by scales, against which the unit of the torque is held; by default not known',
        'kg',
        1e-4,
        1e4,
        optional=True,
    ),
)
HOW = (
    Setting(
        'optimizer',
        'auto',
        "of energy and weak; mde: modified differential evolution, the paper's; lsq: the exact least-squares answer "
        'alone; auto: mde, compared with lsq',
        choices=('auto', 'mde', 'lsq'),
    ),
    START,
    Setting('seed', 1, 'same seed, same result', '', 0),
    SPREAD_LIMIT,
)
#: Of files of settings, the node and Python, but not of the command line.
EXPERT = (
    Setting(
        'smoothing',
        0.0,
        "the differentiator's window; by default 0.02 for energy, chosen from the data for the others",
        's',
        0.0,
        10.0,
        optional=True,
    ),
    Setting('runs', 0, 'independent runs of MDE; by default 10', '', 1, 100_000, optional=True),
    Setting('population', 0, 'vectors of a run, NP; by default 30', '', 5, 100_000, optional=True),
    Setting('generations', 0, 'generations of a run, at most; by default 4000', '', 1, 10_000_000, optional=True),
    PER_VECTOR,
)
#: The options of MDE alone.
MDE = (SPREAD_LIMIT, *EXPERT[1:])
APPLY_REMEDIES = Setting(
    'apply_remedies',
    False,
    'read the recordings as a fault that is named in them asks for, and identify again; the result says what was '
    'applied',
)
OPTIONS = (*WHAT, *DATA, *HOW, *EXPERT)
