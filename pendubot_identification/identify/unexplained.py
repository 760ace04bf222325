# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The torque that a model leaves unexplained, when it acted, and what it looks like.

The weak form of the equations of motion gives, for every bump in time, the torque about each joint that no parameters
explain. Bumps at which it is far greater than elsewhere are bursts: a hand, a cable, an end stop. The rest is held
against effects that rigs have and the models lack. Each is a set of columns beside those of the model, and is named
where it is significant, whichever of all is tried, and pays on a part of the data that did not fit it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import fdtrc

from pendubot_identification.criteria.weak import weak_regression
from pendubot_identification.model.dynamics import SIGN_WIDTH
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import encoder_step
from pendubot_identification.trajectories.trajectory import Trajectory

Array = NDArray[np.float64]

#: The bumps' width and stride [s], and the points at which what is integrated under them is evaluated.
WIDTH, STRIDE, POINTS = 0.2, 0.02, 24
#: The model beside which effects are sought; one without elbow torque has no k2.
MODEL = 'geared'
#: Residuals beyond so many robust standard deviations, and beyond this part of the effort, are a burst.
OUTLYING, LEAST_BURST = 8.0, 0.05
#: Where more than this part of the time is outlying, nothing is a burst.
MOST_BURSTS, ROUNDS = 0.3, 5
#: An effect is named that explains this part of what was unexplained, on data that did not fit it too, ...
PAYS = 0.04
#: ... or this one, where samples are farther apart than this [s] and do not show all of a fast motion, ...
PAYS_COARSE, COARSE = 0.3, 0.02
#: ... at this level of significance, of all effects that are tried together.
SIGNIFICANT = 0.001
#: Nothing is named where rounding alone leaves more than this part of the effort unexplained.
NOISIEST = 0.15
#: One that explains so many times more where the encoders round twice is made by their rounding.
GROWS = 1.5
#: An effect of fewer columns is preferred where it explains less by no more than this; no more effects are named.
ALIKE, MOST_EFFECTS = 0.02, 3
#: Fewer recordings than this are cut into so many parts, each of which is left out in turn.
FEWEST_RECORDINGS, FOLDS = 3, 5
#: Where saturation may begin, as a part of the greatest torque; over how many rad/s friction may change its sign.
LIMITS, SIGN_WIDTHS = (0.5, 0.6, 0.7, 0.8, 0.9), (0.01, 0.2, 0.5, 1.5)
#: Cogging repeats at most so often a turn.
MOST_A_TURN = 24
#: Half the time [s] over which a torque is smoothed that twists a shaft.
TWIST = 0.02
#: A change of angles or stamps that is small enough to be linear [rad, s].
SMALL = 1e-5

#: What each effect is, and what to do.
MEANINGS = {
    'saturation': (
        'the torque that acts falls short of the recorded one where that is large',
        'record the torque that the motor gives (its current), or excite with less',
    ),
    'drag': (
        'a joint brakes with the square of its speed',
        'move more slowly, or take b1 and b2 for these speeds alone',
    ),
    'friction': ('dry friction changes with speed otherwise than in the model', 'take Fc and b as they are: rough'),
    'asymmetry': ('friction differs between the two directions', 'take Fc as the mean of both directions'),
    'offset': (
        'a steady torque acts that is not recorded',
        "look at the zero of the torque's sensor or of the motor's current, and at cables",
    ),
    'spring': ('a torque grows with a joint angle: a cable or a spring', 'free the cable, or lead it along the axis'),
    'cogging': ('a torque repeats several times a turn: cogging or a gear', 'take friction as rough; P1 to P5 hold'),
    'drift': ('friction changes with time', 'let the rig warm up, and record again'),
    'shaft': (
        "a shaft or belt gives way between the shoulder's encoder and link 1, or the torque acts later when it changes",
        "put the encoder on the link's side, or excite with slower torques",
    ),
    'eccentric': ("an encoder's error repeats once a turn", 'centre the encoder on its axis'),
    'zero': ('a zero is off by a little', 'let the links swing out before the zeros are set'),
}


@dataclass(frozen=True, slots=True)
class Effect:
    """An effect that explains some of the unexplained torque.

    Attributes:
        name: one of :data:`MEANINGS`.
        where: the joint, and a number that tells it from its kin, in words.
        share: of the unexplained torque's square, what it explains of data that did not fit it.
        moved: by how much each of P1 to P5 changes beside it, as a fraction, shape (5,).
    """

    name: str
    where: str
    share: float
    moved: Array

    @property
    def sentence(self) -> str:
        """What was found, how sure that is, and what to do."""
        found, remedy = MEANINGS[self.name]
        return (
            f'{found} ({self.where}): that explains {100 * self.share:.0f} % of the unexplained torque, and changes P1 '
            f'to P5 by up to {100 * np.abs(self.moved).max():.2g} %; {remedy}'
        )


@dataclass(frozen=True, slots=True)
class Burst:
    """A torque from nowhere: in which recording, from when to when [s since its start], how large [N m], and where."""

    recording: str
    begin: float
    end: float
    torque: float
    joint: str


@dataclass(frozen=True, slots=True)
class Unexplained:
    """The unexplained torque of recordings.

    Attributes:
        times: the bumps' centres in each recording [s], shapes (K,).
        torque: of both joints about which the weak form's residuals speak [N m], shapes (K, 2).
        share: its root mean square over that of the shoulder's effort, of each joint, shape (2,), without bursts.
        noise: what of this the encoders' rounding makes, shape (2,).
        bursts: in the order of time.
        effects: the greatest first.
    """

    times: tuple[Array, ...]
    torque: tuple[Array, ...]
    share: Array
    noise: Array
    bursts: tuple[Burst, ...]
    effects: tuple[Effect, ...]


def unexplained(trajectories: Sequence[Trajectory], smoothing: float, hold: str, delay: float) -> Unexplained:
    """Find what no parameters explain of recordings of one rig.

    Args:
        trajectories: the recordings.
        smoothing: the differentiator's window [s].
        hold: of the effort, see :meth:`.motion.Motion.prepare`.
        delay: of the effort [s].

    Raises:
        TrajectoryError: a recording is shorter than a bump.
    """
    motions = [Motion.prepare(t, smoothing, hold) for t in trajectories]
    balances = _Balances.of(motions, delay)
    again = _Balances.of([_read_again(m, smoothing, hold, seed) for seed, m in enumerate(motions)], delay)
    base, y = balances.phi, balances.y
    effort = float(np.sqrt((y[:, 0] ** 2).mean()))
    beside: list[_Candidate] = []
    for _ in range(2):  # an effect may look like bursts, and bursts hide effects
        columns = np.concatenate([base, *(candidate.columns for candidate in beside)], axis=2)
        noise = again.left(_solved(base, y)) - balances.left(_solved(base, y))
        kept, weight = _without_bursts(columns, y, np.sqrt((noise**2).mean(axis=0)), LEAST_BURST * effort)
        theta = _solved((base * weight)[kept], (y * weight[:, 0])[kept])
        of_one, of_other = (list(_candidates(each, theta)) for each in (balances, again))
        clear = np.sqrt((noise**2).mean(axis=0)).max() < NOISIEST * effort
        named = list(_named(balances, of_one, weight, kept)) if clear else []
        true = _not_noise([(balances, of_one), (again, of_other)], [number for number, _ in named], weight, kept)
        named = named[:true]
        beside = [of_one[number] for number, _ in named]
    left, noise = balances.left(theta), again.left(theta) - balances.left(theta)
    return Unexplained(
        times=tuple(balances.t),
        torque=tuple(balances.by_motion(left)),
        share=np.sqrt((left[kept] ** 2).mean(axis=0)) / effort,
        noise=np.sqrt((noise[kept] ** 2).mean(axis=0)) / effort,
        bursts=tuple(_bursts(balances, kept, left)),
        effects=tuple(effect for _, effect in named),
    )


@dataclass(frozen=True, slots=True)
class _Balances:
    """The balances of both joints' momentum under K bumps: ``y`` = ``phi`` theta.

    Attributes:
        motions: of which they are.
        delay: of the effort [s].
        t: the bumps' centres in each motion [s].
        phi: columns of the parameters that the motions have anything of, shape (K, 2, D).
        y: shape (K, 2).
    """

    motions: Sequence[Motion]
    delay: float
    t: list[Array]
    phi: Array
    y: Array

    @classmethod
    def of(cls, motions: Sequence[Motion], delay: float) -> _Balances:
        made = [weak_regression(m, MODEL, delay, weights=(1, 1, 1), width=WIDTH, stride=STRIDE) for m in motions]
        phi, y = np.concatenate([r.phi for r in made]), np.concatenate([r.y for r in made])
        # Of shoulder, elbow and energy the third says nothing new. Without an elbow motor there is no k2.
        phi = phi.reshape(-1, 3, phi.shape[1])[:, :2]
        return cls(motions, delay, [r.t[::3] for r in made], phi[:, :, phi.any(axis=(0, 1))], y.reshape(-1, 3)[:, :2])

    def left(self, theta: Array) -> Array:
        """Return the unexplained torque [N m], shape (K, 2)."""
        return np.asarray(self.y - self.phi @ theta)

    def by_motion(self, rows: NDArray[Any]) -> list[NDArray[Any]]:
        return np.split(rows, np.cumsum([len(centres) for centres in self.t])[:-1])

    @property
    def folds(self) -> NDArray[np.intp]:
        """The number of what is left out in turn, shape (K,): a recording or, of few, a part of the time."""
        if len(self.t) >= FEWEST_RECORDINGS:
            return np.repeat(np.arange(len(self.t)), [len(centres) for centres in self.t])
        return np.arange(len(self.y)) * FOLDS // len(self.y)


def _read_again(motion: Motion, smoothing: float, hold: str, seed: int) -> Motion:
    """Return the motion as if its encoders rounded once more."""
    recorded = motion.recorded
    error = np.random.default_rng(seed).uniform(-0.5, 0.5, recorded.q.shape) * encoder_step(recorded.q)
    return Motion.prepare(replace(recorded, q=recorded.q + error), smoothing, hold)


def _without_bursts(base: Array, y: Array, noise: Array, least: float) -> tuple[NDArray[np.bool_], Array]:
    """Return which bumps are no bursts, shape (K,), and the weights of both joints, shape (2, 1)."""
    kept, weight = np.ones(len(y), dtype=bool), np.ones((2, 1))
    for _ in range(ROUNDS):
        theta = _solved((base * weight)[kept], (y * weight[:, 0])[kept])
        residual = np.abs(y - base @ theta)
        sigma = np.maximum(1.4826 * np.median(residual, axis=0), noise) + np.finfo(float).tiny
        weight = (sigma[0] / sigma)[:, None]
        outlying = (residual > np.maximum(OUTLYING * sigma, least)).any(axis=1)
        around = np.convolve(outlying, np.ones(2 * round(WIDTH / STRIDE / 2) + 1), 'same') > 0
        if (around == ~kept).all() or around.mean() > MOST_BURSTS:
            break
        kept = ~around
    return kept, weight


def _solved(phi: Array, y: Array) -> Array:
    """Return the least-squares solution, columns scaled to one."""
    flat = phi.reshape(-1, phi.shape[2])
    scale = np.linalg.norm(flat, axis=0)
    scale[scale == 0] = 1.0
    return np.asarray(np.linalg.lstsq(flat / scale, y.ravel(), rcond=1e-9)[0] / scale)


def _bursts(balances: _Balances, kept: NDArray[np.bool_], left: Array) -> Iterator[Burst]:
    rows = zip(balances.motions, balances.t, balances.by_motion(kept), balances.by_motion(left), strict=True)
    for motion, centres, good, torque in rows:
        outlying = np.flatnonzero(~good)
        for run in np.split(outlying, np.flatnonzero(np.diff(outlying) > 1) + 1):
            if len(run):
                largest, joint = max((float(abs(torque[run, k]).max()), k) for k in (0, 1))
                begin, end = centres[run[[0, -1]]] - motion.start
                yield Burst(motion.name, float(begin), float(end), largest, ('shoulder', 'elbow')[joint])


class _Candidate(NamedTuple):
    """What an effect does to the balances: its columns, shape (K, 2, C), beside the model's."""

    name: str
    where: str
    columns: Array


def _candidates(balances: _Balances, theta: Array) -> Iterator[_Candidate]:
    """Return what every effect would add to the balances."""
    motions, delay = balances.motions, balances.delay
    u = (np.arange(POINTS) + 0.5) / POINTS * 2 - 1
    bump = (1 - u**2) ** 3
    times = [centres[:, None] + WIDTH / 2 * u for centres in balances.t]
    q1, q2, v1, v2 = np.concatenate([m.states(at) for m, at in zip(motions, times, strict=True)], axis=1)
    tau = np.concatenate([m.impulse(at - delay, 1)[..., 0] for m, at in zip(motions, times, strict=True)])
    elapsed = np.concatenate(
        [
            at - m.start + sum(other.end - other.start for other in motions[:k])
            for k, (m, at) in enumerate(zip(motions, times, strict=True))
        ]
    )
    elapsed = elapsed / elapsed.max() - 0.5

    def acting(*terms: tuple[int, Array]) -> Array:
        """Return the columns of torques at a joint."""
        columns = np.zeros((len(q1), 2, len(terms)))
        for k, (joint, values) in enumerate(terms):
            columns[:, joint, k] = values @ bump / bump.sum()
        return columns

    def read(change: Callable[[Motion, Array], tuple[Array, Array]]) -> Array:
        """Return the column of angles that were read otherwise than they are."""
        changed = []
        for motion in motions:
            at = motion.smoothed.x
            more = SMALL * np.column_stack(change(motion, at))
            states = motion.smoothed(at) + np.column_stack([more, CubicSpline(at, more)(at, 1)])
            changed.append(replace(motion, smoothed=CubicSpline(at, states)))
        return ((_Balances.of(changed, delay).left(theta) - balances.left(theta)) / SMALL)[:, :, None]

    one, joints = np.ones_like(q1), (('shoulder', q1, v1), ('elbow', q2, v2))
    top = np.abs(tau).max()
    for part in LIMITS:
        beyond = np.sign(tau) * np.maximum(np.abs(tau) - part * top, 0)
        yield _Candidate('saturation', f'from about {part * top:.2g} N m on', acting((0, beyond)))
    yield _Candidate('saturation', 'the more, the larger it is', acting((0, tau**3)))
    sign1, sign2 = (np.tanh(v / SIGN_WIDTH) for v in (v1, v2))
    yield _Candidate(
        'asymmetry', 'shoulder and elbow', acting((0, one), (1, one), (0, np.abs(sign1)), (1, np.abs(sign2)))
    )
    yield _Candidate(
        'drift',
        'shoulder and elbow',
        acting((0, elapsed * v1), (1, elapsed * v2), (0, elapsed * sign1), (1, elapsed * sign2)),
    )
    for joint, (name, q, v) in enumerate(joints):
        yield _Candidate('offset', name, acting((joint, one)))
        yield _Candidate('drag', name, acting((joint, v * np.abs(v))))
        yield _Candidate('spring', name, acting((joint, q), (joint, one)))
        for width in SIGN_WIDTHS:
            yield _Candidate(
                'friction', f'{name}, its sign changes over {width:g} rad/s', acting((joint, np.tanh(v / width)))
            )
        if np.ptp(q) > 1.0:
            for number in range(2, MOST_A_TURN + 1):
                yield _Candidate(
                    'cogging',
                    f'{name}, {number} a turn',
                    acting((joint, np.sin(number * q)), (joint, np.cos(number * q))),
                )

    def eccentric(joint: int, wave: Callable[[Array], Array]) -> Callable[[Motion, Array], tuple[Array, Array]]:
        def change(motion: Motion, at: Array) -> tuple[Array, Array]:
            read = wave(motion.states(at)[joint])
            return (read, 0 * read) if joint == 0 else (0 * read, read)

        return change

    def twisted(motion: Motion, at: Array) -> tuple[Array, Array]:
        low, high = (np.clip(at - delay + side, motion.impulse.x[0], motion.impulse.x[-1]) for side in (-TWIST, TWIST))
        twist = (motion.impulse(high) - motion.impulse(low))[:, 0] / (2 * TWIST)
        return twist, 0 * twist

    for joint, (name, *_) in enumerate(joints):
        waves = [read(eccentric(joint, wave)) for wave in (np.sin, np.cos)]
        yield _Candidate('eccentric', name, np.concatenate(waves, axis=2))
    yield _Candidate(
        'zero', 'shoulder and elbow', np.concatenate([read(eccentric(j, np.ones_like)) for j in (0, 1)], axis=2)
    )
    yield _Candidate('shaft', 'shoulder', read(twisted))


def _named(
    balances: _Balances, candidates: list[_Candidate], weight: Array, kept: NDArray[np.bool_]
) -> Iterator[tuple[int, Effect]]:
    """Return the effects that are significant and pay on data that did not fit them, and which candidates they are.

    All that is asked of the data are products of columns, by fold.
    """
    base, y, folds = balances.phi * weight, balances.y * weight[:, 0], balances.folds
    columns = np.concatenate([base, *(c.columns * weight for c in candidates), y[:, :, None]], axis=2)[kept]
    scale = np.sqrt((columns**2).sum(axis=(0, 1)))
    columns = columns / np.where(scale > 0, scale, 1.0)
    of_fold = np.array([_products(columns[folds[kept] == fold]) for fold in np.unique(folds[kept])])
    whole = of_fold.sum(axis=0)
    # Bumps overlap: what is independent is every half of one, of each joint.
    independent = 2 * kept.sum() * STRIDE / (WIDTH / 2)
    first = base.shape[2] + np.cumsum([0, *(c.columns.shape[2] for c in candidates)])
    places = [list(range(low, high)) for low, high in pairwise(first)]
    taken, left = list(range(base.shape[2])), list(range(len(candidates)))
    physical = _least(whole, taken)[:5]
    pays = PAYS if max(m.interval for m in balances.motions) <= COARSE else PAYS_COARSE
    for _ in range(MOST_EFFECTS):
        alone, left_out = _squares(whole, taken), _left_out(of_fold, taken)
        found = []
        for c in left:
            size, freedom = len(places[c]), independent - len(taken) - len(places[c])
            rest = _squares(whole, taken + places[c])
            if (
                freedom > 0
                and fdtrc(size, freedom, (alone / rest - 1) * freedom / size) * len(candidates) < SIGNIFICANT
            ):
                found.append((1 - _left_out(of_fold, taken + places[c]) / left_out, c))
        if not found or max(found)[0] < pays:
            return
        # Of those that explain nearly as much, the simplest.
        share, best = min((f for f in found if f[0] > max(found)[0] - ALIKE), key=lambda f: len(places[f[1]]))
        taken = taken + places[best]
        left = [c for c in left if candidates[c].name != candidates[best].name]
        now = _least(whole, taken)[:5]
        yield best, Effect(candidates[best].name, candidates[best].where, float(share), (now - physical) / physical)


def _not_noise(
    readings: list[tuple[_Balances, list[_Candidate]]], numbers: list[int], weight: Array, kept: NDArray[np.bool_]
) -> int:
    """Return how many of the effects, the greatest first, are none that the encoders' rounding makes.

    Noise in angles and speeds makes parameters too small, and what they then leave may look like an effect. That grows
    with the noise: where angles are rounded once more such an effect explains more, while a true one explains the same.
    """
    explained = []
    for balances, candidates in readings:
        parts = [balances.phi, *(candidates[n].columns for n in numbers), balances.y[:, :, None]]
        products = _products((np.concatenate(parts, axis=2) * weight)[kept])
        ends = np.cumsum([part.shape[2] for part in parts[:-1]])
        explained.append(-np.diff([_squares(products, list(range(end))) for end in ends]))
    made = explained[1] > GROWS * explained[0]
    return int(made.argmax()) if made.any() else len(numbers)


def _products(columns: Array) -> Array:
    flat = columns.reshape(-1, columns.shape[2])
    return np.asarray(flat.T @ flat)


def _least(products: Array, which: list[int]) -> Array:
    """Return the least-squares solution of some columns by products of all, the last one being y."""
    return np.asarray(np.linalg.lstsq(products[np.ix_(which, which)], products[which, -1], rcond=1e-12)[0])


def _squares(products: Array, which: list[int]) -> float:
    """Return the sum of squares that some columns leave."""
    x = np.append(_least(products, which), -1.0)
    return float(x @ products[np.ix_([*which, -1], [*which, -1])] @ x)


def _left_out(of_fold: Array, which: list[int]) -> float:
    """Return the sum of squares that is left of each fold by what the others are explained with."""
    whole, total = of_fold.sum(axis=0), 0.0
    for products in of_fold:
        x = np.append(_least(whole - products, which), -1.0)
        own = products[np.ix_([*which, -1], [*which, -1])]
        total += float(x @ own @ x)
    return total
