# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The torque that a model leaves unexplained, when it acted, and what it looks like.

The weak form of the equations of motion gives, for every bump in time, the torque about each joint that no parameters
explain. Bumps at which it is far greater than elsewhere are bursts: a hand, a cable, an end stop. The rest is held
against effects that rigs have and the models lack. Each is a set of columns beside those of the model, and is named
where it is significant, whichever of all is tried, and pays on a part of the data that did not fit it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.criteria.weak import WIDTH, weak_regression
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.piecewise import cubic_spline
from pendubot_identification.trajectories.signals import encoder_step
from pendubot_identification.trajectories.trajectory import MINIMUM_SAMPLES, Trajectory

from .effects import Effect, Found, Read, catalogue_of, passed_by, seen_of
from .hypotheses import folds_of, most_of, products, select, solved, squares

Array = NDArray[np.float64]

#: The bumps' stride [s], and the points at which what is integrated under them is evaluated.
STRIDE, POINTS = 0.02, 30
#: The model beside which effects are sought; one without elbow torque has no k2.
MODEL = 'geared'
#: Residuals beyond so many robust standard deviations, and beyond this part of the effort, are a burst.
OUTLYING, LEAST_BURST = 8.0, 0.05
#: So many times as many, where samples are farther apart than this [s] and do not show all of a fast motion.
TIMES_COARSE, COARSE = 2.0, 0.02
#: What is below so many times the largest that rounding makes, is none: of few counts, slow motion leaves such now and
#: then.
TIMES_ROUNDING = 4.0
#: Where more than this part of the time is outlying, nothing is a burst.
MOST_BURSTS, ROUNDS = 0.3, 5
#: An effect is named that explains this part of what was unexplained, on data that did not fit it too, ...
PAYS = 0.04
#: ... and this part of what is beyond rounding: on real rigs anything explains a little of all that is unexplained, ...
MAIN = 0.25
#: ... or this one, where samples are that far apart.
PAYS_COARSE = 0.3
#: More than this part of the effort, beyond what rounding explains, is said; so many bursts are listed.
MUCH, MOST_SAID = 0.05, 5
#: Nothing is named where rounding alone leaves more than this part of the effort unexplained.
NOISIEST = 0.15
#: One that explains so many times more where the encoders round twice is made by their rounding.
GROWS = 1.3
#: Parts between bursts that are shorter [s] are left out, too.
SHORTEST_PART = 1.0
#: A change of angles or stamps that is small enough to be linear [rad, s].
SMALL = 1e-5


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
        rest: what of it the effects leave that the weak form names, shapes (K, 2).
        share: its root mean square over that of the effort, of each joint, shape (2,), without bursts.
        noise: what of this the encoders' rounding makes, shape (2,).
        bursts: in the order of time.
        effects: the greatest first.
        delay: of the effort [s], with which they were found.
        beyond: how many times the errors of simulated segments are what rounded angles explain; 1 where they are
            noise, or were not looked at.
    """

    times: tuple[Array, ...]
    torque: tuple[Array, ...]
    rest: tuple[Array, ...]
    share: Array
    noise: Array
    bursts: tuple[Burst, ...]
    effects: tuple[Found, ...]
    delay: float
    beyond: float = 1.0

    def sentences(self, told: Collection[str] = ()) -> list[str]:
        """Return what the user should know of it; effects by the names ``told`` are told already."""
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
        said += [found.sentence for found in self.effects if found.effect.name not in told]
        return said

    def rest_sentence(self, exact: bool) -> str | None:
        """Return what the user should know of a large part that looks like no effect; None where it is small.

        Of what an ``exact`` fit leaves the errors of simulated segments tell more than the torque does.
        """
        excess = np.sqrt(np.maximum(self.share**2 - self.noise**2, 0.0))
        if self.effects or (self.beyond == 1 and (exact or excess.max() <= MUCH)):
            return None
        left, rounding = (' and '.join(f'{100 * part:.2g} %' for part in parts) for parts in (self.share, self.noise))
        found = f'{left} of the effort are left unexplained at shoulder and elbow; rounded angles explain {rounding}'
        if exact or excess.max() <= MUCH:
            found = f'simulated segments are off by {self.beyond:.2g} times what rounded angles explain'
        return f'{found}: the rig has what the models lack, and parameters may be farther off than their intervals say'


def unexplained(motions: Sequence[Motion], smoothing: float, hold: str, delay: float) -> Unexplained:
    """Find what no parameters explain of recordings of one rig.

    Args:
        motions: the recordings.
        smoothing: the window [s] that made their states.
        hold: of the effort, see :meth:`.motion.Motion.prepare`.
        delay: of the effort [s].

    Raises:
        TrajectoryError: a recording is shorter than a bump and the delay together.
    """
    balances = _Balances.of(motions, delay)
    again = _Balances.of([_read_again(m, smoothing, hold, seed) for seed, m in enumerate(motions)], delay)
    base, y = balances.phi, balances.y
    effort = float(np.sqrt((y**2).sum(axis=1).mean())) + np.finfo(float).tiny
    # A lag's torques are too short for what bumps are evaluated at.
    effects = [e for e in catalogue_of(motions) if e.name != 'lag']
    named: list[tuple[int, Found]] = []
    beside: list[Array] = []
    coarse = max(m.interval for m in motions) > COARSE
    limits = np.array([OUTLYING, LEAST_BURST * effort]) * (TIMES_COARSE if coarse else 1.0)
    for _ in range(2):  # an effect may look like bursts, and bursts hide effects
        columns = np.concatenate([base, *beside], axis=2)
        noise = again.left(solved(base, y)) - balances.left(solved(base, y))
        size = np.sqrt((noise**2).mean(axis=0))
        kept, weight = _without_bursts(columns, y, noise, limits, balances.recordings)
        theta = solved((base * weight)[kept], (y * weight[:, 0])[kept])
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
    columns = np.concatenate([base, *beside], axis=2)
    rest = y - columns @ solved((columns * weight)[kept], (y * weight[:, 0])[kept])
    return Unexplained(
        times=tuple(balances.t),
        torque=tuple(balances.by_motion(left)),
        rest=tuple(balances.by_motion(rest)),
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
    def of(cls, motions: Sequence[Motion], delay: float, coarse: bool = False) -> _Balances:
        made = [weak_regression(m, MODEL, delay, weights=(1, 1, 1), stride=STRIDE, coarse=coarse) for m in motions]
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
            for motion, centres, passed in zip(self.motions, self.t, passed_by(self.motions), strict=True)
        ]
        made, compared = [], _Balances.of(self.motions, self.delay, coarse=True).left(theta)
        for effect in effects:
            columns = np.zeros((len(self.y), 2, len(effect.acting) + len(effect.read)))
            for k, (joint, torque) in enumerate(effect.acting):
                columns[:, joint, k] = np.concatenate([torque(s) @ bump for s in seen])
            for k, read in enumerate(effect.read):
                columns[:, :, k] = (self._read(read).left(theta) - compared) / SMALL
            made.append(columns)
        return made

    def _read(self, read: Read) -> _Balances:
        """Return the balances of motions that were read otherwise by a little."""
        changed = []
        for motion, passed in zip(self.motions, passed_by(self.motions), strict=True):
            at = motion.smoothed.x
            more = SMALL * np.column_stack(read(seen_of(motion, at, self.delay, passed)))
            states = motion.smoothed(at) + np.column_stack([more, cubic_spline(at, more)(at, 1)])
            changed.append(replace(motion, smoothed=cubic_spline(at, states)))
        return _Balances.of(changed, self.delay, coarse=True)

    def by_motion(self, rows: NDArray[Any]) -> list[NDArray[Any]]:
        return np.split(rows, np.cumsum([len(centres) for centres in self.t])[:-1])

    @property
    def recordings(self) -> NDArray[np.intp]:
        """The number of each bump's recording, shape (K,)."""
        return np.repeat(np.arange(len(self.t)), [len(centres) for centres in self.t])


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


def _read_again(motion: Motion, smoothing: float, hold: str, seed: int) -> Motion:
    """Return the smoothed motion as encoders whose counts lie elsewhere would read it, smoothed in its turn.

    So what smoothing bends is bent once more, too; and where a joint moves by less than a count from sample to sample,
    errors of neighbours are alike as they are in what was recorded.
    """
    recorded = motion.recorded
    step, true = encoder_step(recorded.q), motion.smoothed(recorded.t)[:, :2]
    counts = np.where(step > 0, step, 1.0)
    elsewhere = np.random.default_rng(seed).uniform(-0.5, 0.5, 2)
    read = (np.round(true / counts + elsewhere) - elsewhere) * counts
    return Motion.prepare(replace(recorded, q=np.where(step > 0, read, true)), smoothing, hold)


def _without_bursts(
    phi: Array, y: Array, noise: Array, limits: Array, recordings: NDArray[np.intp]
) -> tuple[NDArray[np.bool_], Array]:
    """Return which bumps are no bursts, shape (K,), and the weights of both joints, shape (2, 1).

    ``noise``: what rounding makes, shape (K, 2); ``limits``: of residuals, in robust standard deviations and in N m.
    """
    size, least = np.sqrt((noise**2).mean(axis=0)), np.maximum(limits[1], TIMES_ROUNDING * np.abs(noise).max(axis=0))
    kept, weight = np.ones(len(y), dtype=bool), np.ones((2, 1))
    for _ in range(ROUNDS):
        left = np.abs(y - phi @ solved((phi * weight)[kept], (y * weight[:, 0])[kept]))
        spread = np.maximum(1.4826 * np.median(left, axis=0), size) + np.finfo(float).tiny
        weight = (spread[0] / spread)[:, None]
        limit = np.maximum(limits[0] * spread, least)
        outlying = (left > limit).any(axis=1)
        around = np.convolve(outlying, np.ones(2 * round(WIDTH / STRIDE / 2) + 1), 'same') > 0
        if (around == ~kept).all() or around.mean() > MOST_BURSTS:
            break
        kept = ~around
    # Where recordings contradict each other, the rest of one explains what seemed to come from nowhere in it.
    for number in np.unique(recordings[~kept]):
        own = recordings == number
        theta = solved((phi * weight)[own & kept], (y * weight[:, 0])[own & kept])
        if not (np.abs(y - phi @ theta)[own & ~kept] > limit).any():
            kept |= own
    return kept, weight


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
    """Return the effects that are significant and pay on data that did not fit them, and which candidates they are."""
    base, y = (balances.phi * weight)[kept], (balances.y * weight[:, 0])[kept]
    theta = solved(base, y)
    left = float(((y - base @ theta) ** 2).sum())
    beyond = 1 - rounding / max(left, np.finfo(float).tiny)
    pays = PAYS if max(m.interval for m in balances.motions) <= COARSE else PAYS_COARSE
    chosen = select(
        effects,
        base,
        y,
        [(c * weight)[kept] for c in candidates],
        folds_of(balances.recordings)[kept],
        # Bumps overlap: what is independent is every half of one, of each joint.
        independent=2 * kept.sum() * STRIDE / (WIDTH / 2),
        pays=max(pays, MAIN * beyond),
        physical=theta[:5],
    )
    for choice in chosen:
        effect, most = effects[choice.number], choice.share >= beyond * most_of(len(balances.t))
        yield choice.number, Found(effect, choice.sizes, choice.share, choice.moved / theta[:5], most=most)


def _not_noise(readings: list[tuple[_Balances, list[Array]]], weight: Array, kept: NDArray[np.bool_]) -> int:
    """Return how many of the effects, the greatest first, are none that the encoders' rounding makes.

    Noise in angles and speeds makes parameters too small, and what they then leave may look like an effect. That grows
    with the noise: where angles are rounded once more such an effect explains more, while a true one explains the same.
    """
    explained = []
    for balances, columns in readings:
        parts = [balances.phi, *columns, balances.y[:, :, None]]
        of_all = products((np.concatenate(parts, axis=2) * weight)[kept])
        ends = np.cumsum([part.shape[2] for part in parts[:-1]])
        explained.append(-np.diff([squares(of_all, list(range(end))) for end in ends]))
    made = explained[1] > GROWS * explained[0]
    return int(made.argmax()) if made.any() else len(made)
