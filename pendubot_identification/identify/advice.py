# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Which parameters a motion excites poorly, and what motion would tell them."""

from __future__ import annotations

import numpy as np

from pendubot_identification.model.parameters import NAMES

from .estimate import Estimate

#: A standard error above this fraction of the value: the motion says little of the parameter.
POORLY = 0.1
#: Above this fraction it says nothing.
NOT_AT_ALL = 100.0
#: A correlation from here on is worth naming: what one parameter gains the other one loses.
TOGETHER = 0.95

#: What shows each parameter: where it stands in the equations of motion, made large by a torque at the shoulder.
HELP = {
    'P1': 'make the shoulder speed up and slow down harder: torques that change their sign every tenth of a second',
    'P2': 'make the elbow speed up and slow down harder: short, strong pulses at the shoulder',
    'P3': 'bend the elbow by a quarter turn and more while the shoulder moves: there the links push each other',
    'P4': 'lift link 1 to the horizontal and beyond, and let it fall: longer pulses',
    'P5': "swing link 2 to the horizontal and beyond: pulses in time with the elbow's own swing",
    'b1': 'turn the shoulder fast for longer',
    'b2': 'let the elbow swing freely, far out, and come to rest: pauses of seconds between the pulses',
    'Fc1': 'turn the shoulder to and fro, slowly and fast: only slow motion tells dry friction from viscous friction',
    'Fc2': 'let the elbow swing out between pulses: only slow motion tells dry friction from viscous friction',
    'J2': 'make the elbow speed up against the shoulder: it shows where both do not turn together',
    'Fs1': 'start and stop the shoulder slowly, below 0.5 rad/s',
    'Fs2': 'let the elbow come to rest again and again, from below 0.5 rad/s',
    'k1': 'turn the shoulder at one speed under small and under large torques',
    'k2': 'turn the elbow at one speed under small and under large torques',
}


def advise(estimate: Estimate) -> tuple[str, ...]:
    """Return a sentence for each parameter that the motion tells poorly, the worst first; empty where there is none."""
    size = np.abs(estimate.theta)
    with np.errstate(all='ignore'):
        relative = np.where(estimate.free & (size > 0), estimate.std_error / size, 0.0)
        correlation = np.nan_to_num(np.abs(estimate.correlation - np.eye(len(size))))
    sentences = []
    for k in (k for k in np.argsort(-relative) if relative[k] > POORLY):
        said = f'its standard error is {100 * relative[k]:.0f} % of it' if relative[k] < NOT_AT_ALL else 'not at all'
        partner = int(np.argmax(correlation[k]))
        if correlation[k, partner] > TOGETHER:
            said += f', hardly apart from {NAMES[partner]} (correlation {estimate.correlation[k, partner]:.2f})'
        sentences.append(f'this motion tells little of {NAMES[k]} ({said}); what helps: {HELP[NAMES[k]]}')
    return tuple(sentences)
