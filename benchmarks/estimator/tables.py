# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Outcomes as Markdown tables."""

from collections import Counter
from itertools import pairwise

import numpy as np

from .outcome import FRICTION, PHYSICAL

LEVELS = ('OK', 'WARN', 'ERROR', 'refused')
#: How else effects are named.
ALIASES = {'stribeck': ('friction',), 'width': ('friction',)}


def levels(found):
    """Return how many outcomes have which level."""
    counted = Counter(r['level'] for r in found)
    return '/'.join(str(counted[level]) for level in LEVELS)


def said(found):
    """Return which effects were named, how often; * if compensated."""
    counted = Counter(name + '*' * accepted for r in found for name, accepted in {(n, a) for n, _, a in r['named']})
    return ', '.join(f'{name} {count}' for name, count in counted.most_common())


def share(found, names, level=None):
    """Return the percentage of intervals that hold the truth, of outcomes at a level."""
    inside = [held for r in found if level in (None, r['level']) for n, held in r.get('held', {}).items() if n in names]
    return f'{100 * np.mean(inside):.0f} of {len(inside)}' if inside else ''


def worst(found, of='error'):
    """Return the worst relative error of P1 to P5 of each outcome [%]."""
    return np.array([100 * max(abs(r[of][n]) for n in PHYSICAL) for r in found if of in r])


def numbers(values):
    """Return the median and the largest."""
    return (f'{np.median(values):.2g}', f'{np.max(values):.2g}') if len(values) else ('', '')


def spent(found):
    """Return the median of the times [s]."""
    return f'{np.median([r["seconds"] for r in found]):.2g}'


def grouped(found, *by):
    """Return the outcomes by the values of some keys, in order."""
    groups = {}
    for r in found:
        groups.setdefault(tuple(r[name] for name in by), []).append(r)
    return groups


def differences(found):
    """Return |P_a - P_b| / mean, and whether it is within the root of both half-widths squared, of pairs, (N, 5)."""
    apart, inside = [], []
    for pair in grouped([r for r in found if r.get('pair') is not None], 'group', 'kind', 'pair').values():
        for a, b in pairwise(r for r in pair if 'theta' in r):
            (p, q), (v, w) = (np.array([r[of][:5] for r in (a, b)]) for of in ('theta', 'half_width'))
            apart.append(abs(p - q) / abs(p + q) * 2)
            inside.append(abs(p - q) <= np.hypot(v, w))
    return np.array(apart), np.array(inside)


def repeatability(found):
    """Return the columns of fits that are scored on other recordings."""
    known = [r for r in found if 'theta' in r]
    cells = [str(len(found))]
    if not known:
        return [*cells, *6 * [''], levels(found), '', spent(found)]
    for of in ('prediction', 'prediction_with_effects'):
        cells.append(' / '.join(f'{e:.4f}' for e in np.exp(np.mean(np.log([r[of] for r in known]), axis=0))))
    apart, inside = differences(known)
    cells += [f'{100 * apart.mean():.2f}', f'{100 * apart.max():.1f}'] if apart.size else ['', '']
    cells.append(f'{inside.sum()} of {inside.size}' if inside.size else '')
    widths = np.array(
        [[100 * w / abs(p) for w, p in zip(r['half_width'][:5], r['theta'], strict=False)] for r in known]
    )
    return [*cells, f'{widths.mean():.2g}', levels(found), said(found), spent(found)]


def real(found):
    """Yield a row for each rig and kind of fit, and for both rigs together."""
    yield (
        'rig',
        'fits',
        'n',
        'error .1 / .25 / .5 s',
        'with effects',
        'dP [%]',
        'worst',
        'inside',
        'half-width [%]',
        ('/'.join(LEVELS)),
        'named',
        's',
    )
    for (rig, kind), some in grouped(found, 'group', 'kind').items():
        yield rig, kind, *repeatability(some)
    for (kind,), some in grouped(found, 'kind').items():
        yield 'all', kind, *repeatability(some)
    yield 'all', 'all', *repeatability(found)


def pushes(found):
    """Yield a row for each rig."""
    header, *rows = real(found)
    yield (*header, 'worst of P1-P5 [%]', 'largest', 'P held [%]')
    groups = list(grouped(found, 'group').values())
    for row, some in zip(rows, [*groups, found], strict=False):
        yield (*row, *numbers(worst(some)), share(some, PHYSICAL))


def clean(found):
    """Yield a row for each value of each factor, for all, and for each cell."""
    yield 'rig', 'n', 'P held [%]', 'friction', 'worst of P1-P5 [%]', 'largest', '/'.join(LEVELS), 'named', 's'
    factors = ('size', 'rate', 'counts', 'number')
    units = {'size': '{}', 'rate': '{} Hz', 'counts': '{} counts', 'number': '{} x 10 s'}
    parts = {'all': found}
    for factor in factors:
        parts |= {units[factor].format(*key): some for key, some in grouped(found, factor).items()}
    if len(grouped(found, *factors)) > 1:
        cells = grouped(found, 'size', 'rate', 'counts').items()
        parts |= {'{}, {} Hz, {} counts'.format(*key): some for key, some in cells}
    for name, some in parts.items():
        cells = share(some, PHYSICAL), share(some, FRICTION), *numbers(worst(some)), levels(some), said(some)
        yield name, str(len(some)), *cells, spent(some)


def effects(found):
    """Yield a row for each effect and strength, and one for all."""
    yield (
        *('effect', 'strength', '/'.join(LEVELS), 'named', 'right', 'worst of P1-P5 [%]', 'largest'),
        *('without compensation', 'largest', 'farther', 'P held at OK [%]', 'at WARN', 'friction', 's'),
    )
    for (effect, strength), some in [*grouped(found, 'effect', 'strength').items(), (('all', ''), found)]:
        right = sum(any(right_name(r['effect'], name) for name, *_ in r['named']) for r in some)
        bare = 'error_without_compensation'
        both = [r for r in some if bare in r]
        farther = str((worst(both) > 1.05 * worst(both, bare)).sum()) if both else ''
        yield (
            *(effect, strength, levels(some), said(some), f'{right} of {len(some)}'),
            *(*numbers(worst(some)), *numbers(worst(some, bare)), farther),
            *(share(some, PHYSICAL, 'OK'), share(some, PHYSICAL, 'WARN'), share(some, FRICTION), spent(some)),
        )


def right_name(effect, name):
    """Return whether an effect is named as what it is."""
    kind = effect.split(',')[0].lower()
    return name.lower().replace('_', ' ') in (kind, *ALIASES.get(kind, ()))


TABLES = {
    'real': real,
    'clean': clean,
    'effects': effects,
    'unknown': effects,
    'pushes': pushes,
}


def markdown(command, found):
    """Return the table of a command for a list of outcomes."""
    header, *rows = TABLES[command](found)
    return '\n'.join('| ' + ' | '.join(line) + ' |' for line in (header, ['---'] * len(header), *rows))
