# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The torque that a model leaves unexplained, when it acted, and what it looks like.

The weak form of the equations of motion gives, for every bump in time, the torque about each joint that no parameters
explain. Bumps at which it is far greater than elsewhere are bursts: a hand, a cable, an end stop. The rest is held
against effects that rigs have and the models lack. Each is a set of columns beside those of the model, and is named
where it is significant, whichever of all is tried, and pays on a part of the data that did not fit it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PPoly
from scipy.special import fdtrc

from pendubot_identification.criteria.weak import WIDTH, weak_regression
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import encoder_step
from pendubot_identification.trajectories.trajectory import MINIMUM_SAMPLES, Trajectory

from .effects import MEANINGS, Effect, Read, Seen, catalogue

Array = NDArray[np.float64]

#: The bumps' stride [s], and the points at which what is integrated under them is evaluated.
STRIDE, POINTS = 0.02, 30
#: The model beside which effects are sought; one without elbow torque has no k2.
MODEL = 'geared'
#: Residuals beyond so many robust standard deviations, and beyond this part of the effort, are a burst.
OUTLYING, LEAST_BURST = 8.0, 0.05
#: Where more than this part of the time is outlying, nothing is a burst.
MOST_BURSTS, ROUNDS = 0.3, 5
#: An effect is named that explains this part of what was unexplained, on data that did not fit it too, ...
PAYS = 0.04
#: ... and this part of what is beyond rounding: on real rigs anything explains a little of all that is unexplained, ...
MAIN = 0.25
#: ... or this one, where samples are farther apart than this [s] and do not show all of a fast motion, ...
PAYS_COARSE, COARSE = 0.3, 0.02
#: ... at this level of significance, of all effects that are tried together.
SIGNIFICANT = 0.001
#: More than this part of the effort, beyond what rounding explains, is said; so many bursts are listed.
MUCH, MOST_SAID = 0.05, 5
#: Nothing is named where rounding alone leaves more than this part of the effort unexplained.
NOISIEST = 0.15
#: One that explains so many times more where the encoders round twice is made by their rounding.
GROWS = 1.5
#: One that changes a parameter by more than this part of it is not identifiable beside the parameters.
TOO_FAR = 0.5
#: An effect of fewer columns is preferred where it explains less by no more than this; no more effects are named.
ALIKE, MOST_EFFECTS = 0.02, 3
#: Fewer recordings than this are cut into so many parts, each of which is left out in turn.
FEWEST_RECORDINGS, FOLDS = 3, 5
#: Parts between bursts that are shorter [s] are left out, too.
SHORTEST_PART = 1.0
#: Half the time [s] over which a torque is smoothed that twists a shaft.
TWIST = 0.02
#: A change of angles or stamps that is small enough to be linear [rad, s].
SMALL = 1e-5


@dataclass(frozen=True, slots=True)
class Found:
    """An effect that explains some of the unexplained torque.

    Attributes:
        effect: which.
        sizes: of its torques or changes, in the catalogue's order [N m, rad and their quotients], shape (C,).
        share: of the unexplained torque's square, what it explains of data that did not fit it.
        moved: by how much each of P1 to P5 changes beside it, as a fraction, shape (5,).
    """

    effect: Effect
    sizes: Array
    share: float
    moved: Array

    @property
    def sentence(self) -> str:
        """What was found, how sure that is, and what to do."""
        found, remedy = MEANINGS[self.effect.name]
        moved = 100 * np.abs(self.moved).max()
        allowed = f'; P1 to P5, which change by up to {moved:.2g} %, allow for it' if self.effect.acting else ''
        if not self.effect.acting:
            allowed = f', and may change P1 to P5 by {moved:.2g} %'
        return f'{found} ({self.effect.where}): {100 * self.share:.0f} % of the unexplained torque{allowed}; {remedy}'


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
        share: its root mean square over that of the effort, of each joint, shape (2,), without bursts.
        noise: what of this the encoders' rounding makes, shape (2,).
        bursts: in the order of time.
        effects: the greatest first.
        delay: of the effort [s], with which they were found.
    """

    times: tuple[Array, ...]
    torque: tuple[Array, ...]
    share: Array
    noise: Array
    bursts: tuple[Burst, ...]
    effects: tuple[Found, ...]
    delay: float

    @property
    def sentences(self) -> list[str]:
        """What the user should know of it."""
        said = []
        if self.bursts:
            some = [
                f'{b.recording} at {b.begin:.1f} to {b.end:.1f} s ({b.joint}, {b.torque:.2g} N m)' for b in self.bursts
            ]
            more = f' and {len(some) - MOST_SAID} more' if len(some) > MOST_SAID else ''
            said.append(
                f'torques from nowhere, left out: {", ".join(some[:MOST_SAID])}{more}; let no hand, cable or end stop '
                'touch the links'
            )
        said += [found.sentence for found in self.effects]
        excess = np.sqrt(np.maximum(self.share**2 - self.noise**2, 0.0))
        if not self.effects and excess.max() > MUCH:
            left, rounding = (
                ' and '.join(f'{100 * part:.2g} %' for part in parts) for parts in (self.share, self.noise)
            )
            said.append(
                f'{left} of the effort are left unexplained at shoulder and elbow; rounded angles explain {rounding}: '
                'the rig has what the models lack, and parameters may be farther off than their intervals say'
            )
        return said


def unexplained(trajectories: Sequence[Trajectory], smoothing: float, hold: str, delay: float) -> Unexplained:
    """Find what no parameters explain of recordings of one rig.

    Args:
        trajectories: the recordings.
        smoothing: the differentiator's window [s].
        hold: of the effort, see :meth:`.motion.Motion.prepare`.
        delay: of the effort [s].

    Raises:
        TrajectoryError: a recording is shorter than a bump and the delay together.
    """
    motions = [Motion.prepare(t, smoothing, hold) for t in trajectories]
    balances = _Balances.of(motions, delay)
    again = _Balances.of([_read_again(m, smoothing, hold, seed) for seed, m in enumerate(motions)], delay)
    base, y = balances.phi, balances.y
    effort = float(np.sqrt((y**2).sum(axis=1).mean())) + np.finfo(float).tiny
    states = np.concatenate([m.smoothed(m.smoothed.x)[:, :2] for m in motions])
    greatest = max(float(np.abs(m.recorded.tau[:, 0]).max()) for m in motions)
    effects = list(catalogue(greatest, tuple(np.ptp(states, axis=0))))
    named: list[tuple[int, Found]] = []
    beside: list[Array] = []
    for _ in range(2):  # an effect may look like bursts, and bursts hide effects
        columns = np.concatenate([base, *beside], axis=2)
        noise = again.left(_solved(base, y)) - balances.left(_solved(base, y))
        size = np.sqrt((noise**2).mean(axis=0))
        kept, weight = _without_bursts(columns, y, size, LEAST_BURST * effort, balances.recordings)
        theta = _solved((base * weight)[kept], (y * weight[:, 0])[kept])
        if size.max() >= NOISIEST * effort:
            break
        candidates = balances.columns(effects, theta)
        rounding = float(((noise * weight[:, 0])[kept] ** 2).sum())
        named = list(_named(balances, effects, candidates, weight, kept, rounding))
        beside = [candidates[number] for number, _ in named]
        if not named:
            break
        twice = again.columns([effects[number] for number, _ in named], theta)
        true = _not_noise([(balances, beside), (again, twice)], weight, kept)
        named, beside = named[:true], beside[:true]
    left, noise = balances.left(theta), again.left(theta) - balances.left(theta)
    return Unexplained(
        times=tuple(balances.t),
        torque=tuple(balances.by_motion(left)),
        share=np.sqrt((left[kept] ** 2).mean(axis=0)) / effort,
        noise=np.sqrt((noise[kept] ** 2).mean(axis=0)) / effort,
        bursts=tuple(_bursts(balances, kept, left)),
        effects=tuple(found for _, found in named),
        delay=delay,
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
        made = [weak_regression(m, MODEL, delay, weights=(1, 1, 1), stride=STRIDE) for m in motions]
        phi, y = np.concatenate([r.phi for r in made]), np.concatenate([r.y for r in made])
        # Of shoulder, elbow and energy the third says nothing new. Without an elbow motor there is no k2.
        phi = phi.reshape(-1, 3, phi.shape[1])[:, :2]
        return cls(motions, delay, [r.t[::3] for r in made], phi[:, :, phi.any(axis=(0, 1))], y.reshape(-1, 3)[:, :2])

    def left(self, theta: Array) -> Array:
        """Return the unexplained torque [N m], shape (K, 2)."""
        return np.asarray(self.y - self.phi @ theta)

    def columns(self, effects: Sequence[Effect], theta: Array) -> list[Array]:
        """Return what each effect of unit size takes from the balances, shape (K, 2, C)."""
        u = (np.arange(POINTS) + 0.5) / POINTS * 2 - 1
        bump = (1 - u**2) ** 3 / ((1 - u**2) ** 3).sum()
        seen = [
            seen_of(motion, centres[:, None] + WIDTH / 2 * u, self.delay, passed)
            for motion, centres, passed in zip(self.motions, self.t, self._passed, strict=True)
        ]
        made = []
        for effect in effects:
            columns = np.zeros((len(self.y), 2, len(effect.acting) + len(effect.read)))
            for k, (joint, torque) in enumerate(effect.acting):
                columns[:, joint, k] = np.concatenate([torque(s) @ bump for s in seen])
            for k, read in enumerate(effect.read):
                columns[:, :, k] = self._read(read, theta)
            made.append(columns)
        return made

    def _read(self, read: Read, theta: Array) -> Array:
        changed = []
        for motion, passed in zip(self.motions, self._passed, strict=True):
            at = motion.smoothed.x
            more = SMALL * np.column_stack(read(seen_of(motion, at, self.delay, passed, TWIST)))
            states = motion.smoothed(at) + np.column_stack([more, CubicSpline(at, more)(at, 1)])
            changed.append(replace(motion, smoothed=CubicSpline(at, states)))
        return (_Balances.of(changed, self.delay).left(theta) - self.left(theta)) / SMALL

    @property
    def _passed(self) -> list[tuple[float, float]]:
        """How much of all data has passed at the start and at the end of each motion, from -0.5 to 0.5."""
        ends = np.cumsum([0.0, *(motion.end - motion.start for motion in self.motions)])
        return list(pairwise((ends / ends[-1] - 0.5).tolist()))

    def by_motion(self, rows: NDArray[Any]) -> list[NDArray[Any]]:
        return np.split(rows, np.cumsum([len(centres) for centres in self.t])[:-1])

    @property
    def recordings(self) -> NDArray[np.intp]:
        """The number of each bump's recording, shape (K,)."""
        return np.repeat(np.arange(len(self.t)), [len(centres) for centres in self.t])

    @property
    def folds(self) -> NDArray[np.intp]:
        """The number of what is left out in turn, shape (K,): a recording or, of few, a part of the time."""
        if len(self.t) >= FEWEST_RECORDINGS:
            return self.recordings
        return np.arange(len(self.y)) * FOLDS // len(self.y)


def seen_of(
    motion: Motion, at: Array, delay: float, passed: tuple[float, float] = (0.5, 0.5), around: float = 0.0
) -> Seen:
    """Return what is seen of a motion at some times [s], the torque as the mean over so much time before and after."""
    q1, q2, v1, v2 = motion.states(at)
    if around:
        low, high = (
            np.clip(at - delay + side, motion.impulse.x[0], motion.impulse.x[-1]) for side in (-around, around)
        )
        tau = (motion.impulse(high) - motion.impulse(low))[..., 0] / (2 * around)
    else:
        tau = motion.impulse(at - delay, 1)[..., 0]
    return Seen((q1, q2), (v1, v2), tau, np.interp(at, (motion.start, motion.end), passed))


def between_bursts(trajectory: Trajectory, bursts: Sequence[Burst]) -> list[Trajectory]:
    """Return the parts of a recording before, between and after its bursts that are long enough to tell something."""
    edges = [(burst.begin - WIDTH / 2, burst.end + WIDTH / 2) for burst in bursts if burst.recording == trajectory.name]
    if not edges:
        return [trajectory]
    t, parts = trajectory.t - trajectory.t[0], []
    for begin, end in zip([-1.0, *(end for _, end in edges)], [*(begin for begin, _ in edges), t[-1] + 1], strict=True):
        part = trajectory[(t > begin) & (t < end)]
        if len(part) >= MINIMUM_SAMPLES and part.duration >= SHORTEST_PART:
            parts.append(replace(part, name=f'{trajectory.name}, from {part.t[0] - trajectory.t[0]:.1f} s'))
    return parts


def allowing_for(motion: Motion, found: Sequence[Found], delay: float) -> Motion:
    """Return the motion with what is left for the model of its torques: without those of the effects."""
    at = motion.impulse.x
    seen = seen_of(motion, np.clip(at + delay, motion.start, motion.end), delay)
    braking = np.zeros((len(at), 2))
    for each in found:
        for (joint, torque), size in zip(each.effect.acting, each.sizes, strict=bool(each.effect.acting)):
            braking[:, joint] += size * torque(seen)
    taken = PPoly(np.array([np.diff(braking, axis=0) / np.diff(at)[:, None], braking[:-1]]), at).antiderivative()
    pieces = np.zeros((3, *taken.c.shape[1:]))
    pieces[-len(motion.impulse.c) :] += motion.impulse.c
    return replace(motion, impulse=PPoly(pieces - taken.c, at))


def _read_again(motion: Motion, smoothing: float, hold: str, seed: int) -> Motion:
    """Return the motion as if its encoders rounded once more."""
    recorded = motion.recorded
    error = np.random.default_rng(seed).uniform(-0.5, 0.5, recorded.q.shape) * encoder_step(recorded.q)
    return Motion.prepare(replace(recorded, q=recorded.q + error), smoothing, hold)


def _without_bursts(
    phi: Array, y: Array, noise: Array, least: float, recordings: NDArray[np.intp]
) -> tuple[NDArray[np.bool_], Array]:
    """Return which bumps are no bursts, shape (K,), and the weights of both joints, shape (2, 1)."""
    kept, weight = np.ones(len(y), dtype=bool), np.ones((2, 1))
    for _ in range(ROUNDS):
        left = np.abs(y - phi @ _solved((phi * weight)[kept], (y * weight[:, 0])[kept]))
        spread = np.maximum(1.4826 * np.median(left, axis=0), noise) + np.finfo(float).tiny
        weight = (spread[0] / spread)[:, None]
        limit = np.maximum(OUTLYING * spread, least)
        outlying = (left > limit).any(axis=1)
        around = np.convolve(outlying, np.ones(2 * round(WIDTH / STRIDE / 2) + 1), 'same') > 0
        if (around == ~kept).all() or around.mean() > MOST_BURSTS:
            break
        kept = ~around
    # Where recordings contradict each other, the rest of one explains what seemed to come from nowhere in it.
    for number in np.unique(recordings[~kept]):
        own = recordings == number
        theta = _solved((phi * weight)[own & kept], (y * weight[:, 0])[own & kept])
        if not (np.abs(y - phi @ theta)[own & ~kept] > limit).any():
            kept |= own
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


def _named(
    balances: _Balances,
    effects: list[Effect],
    candidates: list[Array],
    weight: Array,
    kept: NDArray[np.bool_],
    rounding: float,
) -> Iterator[tuple[int, Found]]:
    """Return the effects that are significant and pay on data that did not fit them, and which candidates they are.

    All that is asked of the data are products of columns, by fold.
    """
    base, y, folds = balances.phi * weight, balances.y * weight[:, 0], balances.folds
    columns = np.concatenate([base, *(c * weight for c in candidates), y[:, :, None]], axis=2)[kept]
    scale = np.sqrt((columns**2).sum(axis=(0, 1)))
    columns = columns / np.where(scale > 0, scale, 1.0)
    of_fold = np.array([_products(columns[folds[kept] == fold]) for fold in np.unique(folds[kept])])
    whole = of_fold.sum(axis=0)
    # Bumps overlap: what is independent is every half of one, of each joint.
    independent = 2 * kept.sum() * STRIDE / (WIDTH / 2)
    first = base.shape[2] + np.cumsum([0, *(c.shape[2] for c in candidates)])
    places = [list(range(low, high)) for low, high in pairwise(first)]
    taken, left = list(range(base.shape[2])), list(range(len(candidates)))
    physical = _least(whole, taken)[:5]
    pays = PAYS if max(m.interval for m in balances.motions) <= COARSE else PAYS_COARSE
    for _ in range(MOST_EFFECTS):
        alone, left_out = _squares(whole, taken), _left_out(of_fold, taken)
        found = []
        for c in left:
            size, freedom = len(places[c]), independent - len(taken) - len(places[c])
            better = alone / max(_squares(whole, taken + places[c]), np.finfo(float).tiny) - 1
            if freedom > 0 and fdtrc(size, freedom, better * freedom / size) * len(candidates) < SIGNIFICANT:
                rest = _left_out(of_fold, taken + places[c])
                if (rest < left_out).all():  # else it tells a recording from others, or one time from another
                    found.append((1 - rest.sum() / left_out.sum(), c))
        beyond = 1 - rounding / (alone * scale[-1] ** 2)
        if not found or max(found)[0] < max(pays, MAIN * beyond):
            return
        # Of those that explain nearly as much, the simplest.
        share, best = min((f for f in found if f[0] > max(found)[0] - ALIKE), key=lambda f: len(places[f[1]]))
        taken = taken + places[best]
        left = [c for c in left if effects[c].name != effects[best].name]
        solution = _least(whole, taken)
        now = solution[:5]
        if np.abs(now / physical - 1).max() > TOO_FAR:
            return
        sizes = solution[-len(places[best]) :] * scale[-1] / scale[places[best]]
        yield best, Found(effects[best], sizes, float(share), (now - physical) / physical)


def _not_noise(readings: list[tuple[_Balances, list[Array]]], weight: Array, kept: NDArray[np.bool_]) -> int:
    """Return how many of the effects, the greatest first, are none that the encoders' rounding makes.

    Noise in angles and speeds makes parameters too small, and what they then leave may look like an effect. That grows
    with the noise: where angles are rounded once more such an effect explains more, while a true one explains the same.
    """
    explained = []
    for balances, columns in readings:
        parts = [balances.phi, *columns, balances.y[:, :, None]]
        products = _products((np.concatenate(parts, axis=2) * weight)[kept])
        ends = np.cumsum([part.shape[2] for part in parts[:-1]])
        explained.append(-np.diff([_squares(products, list(range(end))) for end in ends]))
    made = explained[1] > GROWS * explained[0]
    return int(made.argmax()) if made.any() else len(made)


def _products(columns: Array) -> Array:
    flat = columns.reshape(-1, columns.shape[2])
    return np.asarray(flat.T @ flat)


def _least(products: Array, which: list[int]) -> Array:
    """Return the least-squares solution of some columns by products of all, the last one being y."""
    return np.asarray(np.linalg.lstsq(products[np.ix_(which, which)], products[which, -1], rcond=1e-12)[0])


def _left_out(of_fold: Array, which: list[int]) -> Array:
    """Return the sum of squares that is left of each fold by what the others are explained with, shape (F,)."""
    whole, left = of_fold.sum(axis=0), []
    for products in of_fold:
        x = np.append(_least(whole - products, which), -1.0)
        left.append(float(x @ products[np.ix_([*which, -1], [*which, -1])] @ x))
    return np.array(left)


def _squares(products: Array, which: list[int]) -> float:
    """Return the sum of squares that some columns leave."""
    x = np.append(_least(products, which), -1.0)
    return float(x @ products[np.ix_([*which, -1], [*which, -1])] @ x)
