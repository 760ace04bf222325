# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Identification: parameters with covariance, level and warnings, from trajectories and settings.

The stages of :mod:`.pipeline` are: prepare, check conventions, fit, validate, assess. Here are the options: names,
defaults, ranges and help, for the command line and ROS, without numpy, so that ``--help`` is fast.
"""

from pendubot_identification.model import MODELS
from pendubot_identification.setting import Setting, interval, words

CRITERIA = ('energy', 'weak', 'likelihood')
#: Default search interval of the delay of the effort [s].
DELAYS = (-0.1, 0.1)
#: Relative spread of the population at which a run of MDE stops: its best J is then within 1e-6 of the minimum, and
#: further generations change no printed digit.
SPREAD = 1e-9

CRITERION = Setting(
    'criterion',
    '',
    f'criteria to minimise, of {", ".join(CRITERIA)}, separated by commas; by default likelihood. MDE minimises '
    'energy in every identification',
    choices=CRITERIA,
    optional=True,
    read=lambda value: tuple(dict.fromkeys(words(value))),
)
DELAY = Setting(
    'delay',
    DELAYS,
    'delay of the torque after its stamp (weak and likelihood), estimated between two values, or fixed if they are '
    'equal',
    's',
    -0.5,
    0.5,
    read=lambda value: interval('delay', value, '0:0.02'),
)
START = Setting(
    'start',
    '',
    'result file from whose parameters likelihood starts; by default the estimate by weak',
    optional=True,
    path=True,
)
PER_VECTOR = Setting('per_vector', False, "draw MDE's operator once per vector, as always beyond energy and viscous")
SPREAD_LIMIT = Setting(
    'spread',
    SPREAD,
    'stop a run of MDE when the worst J of its population exceeds the best by no more than this fraction; by default '
    '1e-9, without loss of accuracy; 0 runs all generations, as in the paper',
    '',
    0.0,
    1.0,
    optional=True,
)
CRITERION_OPTIONS = (
    CRITERION,
    Setting(
        'model',
        'auto',
        'set of parameters; auto: the smallest model with a residual at the quantization level, or else the largest',
        choices=('auto', *MODELS),
    ),
)
DATA_OPTIONS = (
    Setting(
        'hold',
        'auto',
        'the torque between its samples: zero, it is held, as the bridge records it; linear, it was measured; auto, '
        'the hold that fits the motion better. energy always uses zero',
        choices=('auto', 'zero', 'linear'),
    ),
    DELAY,
    Setting(
        'sliding', 0.0, 'sliding window of the energy balance; by default cumulative', 's', 1e-3, 3600.0, optional=True
    ),
    Setting(
        'link_length',
        0.0,
        'measured length of link 1, for a check of the data; by default unknown',
        'm',
        1e-3,
        100.0,
        optional=True,
    ),
    Setting(
        'link_mass',
        0.0,
        'weighed mass of link 2, for a check of the unit of the torque; by default unknown',
        'kg',
        1e-4,
        1e4,
        optional=True,
    ),
)
OPTIMISATION_OPTIONS = (
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
#: Options of settings files, the node and Python, but not of the command line.
EXPERT_OPTIONS = (
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
MDE_OPTIONS = (SPREAD_LIMIT, *EXPERT_OPTIONS[1:])
APPLY_REMEDIES = Setting(
    'apply_remedies',
    False,
    'correct reported faults of the recordings by options of the conversion, and identify again; the result lists '
    'these options',
)
OPTIONS = (*CRITERION_OPTIONS, *DATA_OPTIONS, *OPTIMISATION_OPTIONS, *EXPERT_OPTIONS)
