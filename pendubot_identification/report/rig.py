# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The rig of a result, as the page draws and simulates it, and the command that made the result."""

import math
import re
import shlex
from dataclasses import astuple
from typing import Any

from pendubot_identification.identification.options import DELAYS, SPREAD
from pendubot_identification.identification.settings import Settings
from pendubot_identification.model.parameters import NAMES, SPECIFICATIONS, UNDER_LOAD
from pendubot_identification.results.provenance import IN_MEMORY
from pendubot_identification.results.result import Result
from pendubot_identification.setting import flag
from pendubot_identification.trajectories.conversion import Conversion

from .tables import Beside

#: Largest ratio of the drawn lengths of both links, so that both are visible.
LARGEST_RATIO = 10.0


def proportions(result: Result) -> tuple[float, float, str]:
    """Return the lengths with which both links are drawn, and a sentence on their origin."""
    p, measured = result.theta, result.link_length.expected
    l1, l2 = (measured or p.P3 / p.P5, 1.5 * p.P2 / p.P5) if p.P5 > 0 else (0.0, 0.0)
    if not (l1 > 0 and l2 > 0 and max(l1, l2) <= LARGEST_RATIO * min(l1, l2)):
        return 1.0, 1.0, 'Both links are drawn equally long, because the parameters give no length that can be drawn.'
    origin = 'as measured' if measured else 'P3 / P5'
    return (
        l1,
        l2,
        f'Drawn to scale: link 1 is {100 * l1:.3g} cm long ({origin}), link 2 as a uniform rod {100 * l2:.3g} cm '
        '(3/2 P2 / P5).',
    )


def rig(result: Result, beside: Beside | None = None) -> dict[str, Any]:
    """Return the data for ``page.js``: parameters, intervals and lengths, and the parameters of another result."""
    vectors = {'identified': result.theta, **({beside[1]: beside[0].theta} if beside else {})}
    size = max(len(p.vector(result.model)) for p in vectors.values())
    ends = {name: entry.interval for name, entry in result.parameters.items()}
    *lengths, scale = proportions(result)
    return {
        'names': NAMES[:size],
        'vectors': {name: astuple(p)[:size] for name, p in vectors.items()},
        'intervals': {n: (low, high) for n, (low, high) in ends.items() if None not in (low, high) and low != high},
        'lengths': lengths,
        'scale': scale,
    }


def command(result: Result) -> str:
    """Return the command that reproduces this result; empty if the recordings were in memory."""
    if any(source.bag.endswith(IN_MEMORY) for source in result.bags):
        return ''
    made = result.made_by
    training = dict.fromkeys(each.bag for each in result.bags if each.role == 'training')
    validation = [each.bag for each in result.bags if each.bag not in training]
    words = ['pendubot identify', *map(shlex.quote, training)]
    words += ['--validate', *map(shlex.quote, validation)] if validation else []
    defaults, spreads = Settings(), [answer.mde.spread for answer in result.criteria.values() if answer.mde]
    options = {name: (getattr(made, name), getattr(defaults, name)) for name in ('model', 'optimizer', 'hold', 'seed')}
    options |= {
        'criterion': (','.join(made.criteria), ','.join(defaults.criteria)),
        'delay': ('{:g}:{:g}'.format(*made.delays), '{:g}:{:g}'.format(*DELAYS)),
        'sliding': (made.sliding_window, None),
        **{name: (getattr(made, name), None) for name in ('link_length', 'link_mass')},
        'spread': (next((f'{each:g}' for each in spreads if each is not None), None), f'{SPREAD:g}'),
        'start': ('START.yaml' if made.start else None, None),
    }
    words += [f'{flag(n)}={shlex.quote(str(v))}' for n, (v, default) in options.items() if v not in (None, default)]
    words += [f'--bounds {bound}' for bound in _given_bounds(result)]
    words += Conversion.of(result.reading).options()
    expert = [] if made.smoothing is None else [f'smoothing: {made.smoothing}']
    return ' '.join([*words, *(f' # with --settings, a file with {line}' for line in expert)])


def _given_bounds(result: Result) -> list[str]:
    """Return the bounds that differ from the default search box, which grows by powers of ten with the rig."""
    given = []
    for each, low, high in zip(SPECIFICATIONS, result.made_by.lower_bounds, result.made_by.upper_bounds, strict=False):
        grown = high > 0 and abs(math.log10(high / each.upper) - round(math.log10(high / each.upper))) < 1e-9
        absent = each.name in UNDER_LOAD and high == 0
        if low != each.lower or not (grown or absent):
            given.append(f'{each.name}={low:g}' if low == high else f'{each.name}={low:g}:{high:g}')
    return given


def folders(*texts: str) -> list[str]:
    """Return the absolute folders in texts; each text ends with the name of a recording."""
    found = {folder for text in texts for folder in re.findall(r'(?:^|(?<=\s))/\S(?:.*/)?', text)}
    return sorted((folder for folder in found if folder.endswith('/')), key=len, reverse=True)
