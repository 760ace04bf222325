# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What is wrong with the conventions of a recording: signs, order, zeros and stamps, from the motion itself.

A recording that breaks a convention is poorly explained by any physical parameters, and well explained once it is put
right. So every known fault is put right on trial, and named where that makes the weak criterion fall markedly, to what
a sound recording leaves. Where nothing does that, all that is said is that the motion fits no pendubot.

What cannot be noticed: an effort through another gear ratio or in other units, which scales all parameters (but for
one a thousand times too large, with which no link could be so small and so heavy); both joints and both efforts
turned round, which is the same rig seen from behind; and a zero that is off by less than the angle at which friction
holds a hanging link.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.criteria.bounded import lowest_between
from pendubot_identification.criteria.energy import Regression
from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.criteria.weak import WIDTH, estimate_delay, weak_regression
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.level import Level
from pendubot_identification.model.dynamics import GRAVITY, Pair
from pendubot_identification.model.parameters import MODELS, NAMES, Bounds, default_bounds
from pendubot_identification.model.simulation import HANGING
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.reading import Affine, Reading
from pendubot_identification.trajectories.signals import SMOOTHING
from pendubot_identification.trajectories.trajectory import Trajectory

from .uncertainty import Blocks, bootstrap_covariance

Array = NDArray[np.float64]
Matrix = tuple[Pair, Pair]
#: Unit vectors of both joints' angles.
JOINTS = np.eye(2)

#: Dry friction and a rotor are allowed for; a richer model would explain faults away.
MODEL = 'rotor'
_BOX = default_bounds().of(MODELS[MODEL])
#: The effort may be in any units.
BOUNDS = Bounds(_BOX.lower, 1e6 * _BOX.upper, _BOX.names)
#: Of the balances of the shoulder, the elbow and energy: smoothing spoils energy, and elbows are small.
WEIGHTS = (1.0, 3.0, 0.1)
#: From bump to bump [s].
STRIDE = 0.03
#: Recordings shorter than this [s] tell nothing.
SHORTEST = 1.0
#: By how much putting it right must lower the unexplained part: a sense or an order, and a zero or a delay.
TURNED, SHIFTED = 2.0, 1.2
#: A motion in degrees is as large [rad]: what is small fits any rig, and little moves as a pendulum in any unit.
AS_DEGREES = 10.0
#: Another sense or order makes the squared effort, work included, at most so many times as large.
OTHER_EFFORT = 2.0
#: By how much a sense must lower what is left of the elbow's own balance, where that is much.
ELBOW = 30.0
#: A zero or an offset that lowers it by so much had made some parameter wrong by a sixth and more, on virtual and real
#: rigs.
GRAVE = 5.0
#: A sound recording leaves no more than this part unexplained, and so must one that is put right: real rigs leave 2 %,
#: 5 % with stamps 20 ms late, and 12 % and more with what cures nothing.
SOUND = 0.1
#: What leaves less than this part has no fault: it is rounding.
FLAWLESS = 1e-6
#: What leaves more than this part, whatever is put right, moves as no pendubot.
UNFIT = 0.3
#: So much of a motion [s], and of either joint [rad], is needed to say that; so much time, too, to tell an offset.
LONG_ENOUGH, FAR_ENOUGH = 3.0, 0.5
#: Link 2 would be so dense [kg/m^3], all its mass in a cube as wide as its centre of mass is far from its joint: those
#: of real rigs are 16 to 80, steel is 7800.
TOO_DENSE = 5000.0
#: A link 2 that is not so dense must leave so many times as much unexplained: of few counts the least squares alone may
#: make P2 nothing.
TOLD = 1.01
#: Remedies that leave up to so many times as much unexplained as the best one are named beside it.
ALIKE = 1.5
#: Another smoothing and hold than were given must leave so many times less, for half an interval looks like a delay.
REREAD = 10.0
#: Remedies that leave up to so many times what the best one does are tried with a second one.
TRIED = 5.0
#: A zero that is off by less [rad] matters little.
LEAST_ZERO = math.radians(2.0)
#: How many times the angle at which friction holds a hanging link a zero must be off; zeros of several recordings are
#: taken to be independent.
FRICTION_ANGLES = 1.3
#: A delay that is off by less [s] matters little.
LEAST_DELAY = 0.01
#: A link's length must be off by so many standard errors and by this part of it.
LENGTH_ERRORS, LENGTH_PART = 5.0, 0.1


@dataclass(frozen=True, slots=True)
class Fault:
    """A convention that recordings break.

    Attributes:
        name: ``sign``, ``order``, ``absolute``, ``degrees``, ``unit``, ``zero``, ``offset``, ``delay``, ``length``, or
            ``motion``: none of these, but that the motion fits no pendubot.
        found: what is wrong, in words.
        remedy: what was expected, and what to do.
        level: ERROR where parameters from such recordings are useless, else WARN.
        unexplained: part of the squared effort that is left unexplained as recorded; NaN where nothing was tried.
        put_right: the same with the fault put right.
        delay: of the effort [s], when the fault is put right by it; None for other faults.
        change: what is done to the motion to put it right; None where nothing is.
        options: of reading the recordings by which they are put right, as far as that is known.
        mended: how they are then read.
    """

    name: str
    found: str
    remedy: str
    level: Level = Level.WARN
    unexplained: float = math.nan
    put_right: float = math.nan
    delay: float | None = None
    change: Affine | None = None
    options: tuple[str, ...] = ()
    mended: Reading | None = None

    @property
    def sentence(self) -> str:
        """What was found, how sure that is, and what to do."""
        shares = ''
        if not math.isnan(self.put_right):
            shares = (
                f': {100 * self.unexplained:.3g} % of the squared effort is left unexplained as recorded and '
                f'{100 * self.put_right:.3g} % with this put right'
            )
        return f'{self.found}{shares}; {self.remedy}' + (f': {", ".join(self.options)}' if self.options else '')


_AS_IS, _EXCHANGED, _RELATIVE = ((1, 0), (0, 1)), ((0, 1), (1, 0)), ((1, 0), (-1, 1))
_FIRST, _SECOND, _BOTH = ((-1, 0), (0, 1)), ((1, 0), (0, -1)), ((-1, 0), (0, -1))
#: Of angles from the horizontal that were negated, exchanged, or made absolute as they stood.
_MIRRORED, _SWAPPED, _LIFTED = (math.pi, 0.0), (math.pi / 2, -math.pi / 2), (0.0, math.pi / 2)
_WHAT_IS_EXPECTED = {
    'sign': 'positions and efforts of both joints must be positive in one sense of rotation',
    'order': 'shoulder first, elbow second',
    'absolute': 'it must be relative to link 1',
    'degrees': 'positions must be in radians',
}
_NEGATED, _DISORDERED = 'has the wrong sign', 'are in the wrong order'
_RELATIVELY = "subtract the shoulder's position"
_CONVERTED = 'convert them'
_NO_SHIFT = (0.0, 0.0)
_DEGREE = math.pi / 180
_IN_RADIANS = ((_DEGREE, 0.0), (0.0, _DEGREE))
#: Faults of sense or order: name, what is wrong, what to do, and what undoes it: matrices for angles from hanging and
#: for efforts, and what is then added to the positions [rad] where they were turned about another zero than hanging.
_TURNS: tuple[tuple[str, str, str, Matrix, Matrix, Pair], ...] = (
    ('sign', f"the elbow's position {_NEGATED}", "negate the elbow's position", _SECOND, _AS_IS, _NO_SHIFT),
    (
        'sign',
        'the elbow turns the other way than the shoulder',
        "negate the elbow's position and effort (or the shoulder's)",
        *(_SECOND, _SECOND, _NO_SHIFT),
    ),
    ('sign', f'the effort {_NEGATED}', 'negate the effort (or both positions)', _AS_IS, _BOTH, _NO_SHIFT),
    (
        'sign',
        f"the shoulder's position {_NEGATED}",
        "negate the shoulder's position (or the elbow's and the effort)",
        *(_FIRST, _AS_IS, _NO_SHIFT),
    ),
    (
        'sign',
        f"the shoulder's position {_NEGATED}, as measured from the horizontal",
        "negate the shoulder's position, so that hanging is -90 degrees",
        *(_FIRST, _AS_IS, _MIRRORED),
    ),
    ('sign', f"the shoulder's effort {_NEGATED}", "negate the shoulder's effort", _AS_IS, _FIRST, _NO_SHIFT),
    ('sign', f"the elbow's effort {_NEGATED}", "negate the elbow's effort", _AS_IS, _SECOND, _NO_SHIFT),
    ('order', f'the joints {_DISORDERED}', 'exchange the joints', _EXCHANGED, _EXCHANGED, _NO_SHIFT),
    ('order', f"the joints' positions {_DISORDERED}", 'exchange the positions', _EXCHANGED, _AS_IS, _NO_SHIFT),
    ('order', f'the joints {_DISORDERED}', 'exchange the joints', _EXCHANGED, _EXCHANGED, _SWAPPED),
    ('order', f"the joints' positions {_DISORDERED}", 'exchange the positions', _EXCHANGED, _AS_IS, _SWAPPED),
    ('order', f"the joints' efforts {_DISORDERED}", 'exchange the efforts', _AS_IS, _EXCHANGED, _NO_SHIFT),
    ('absolute', "the elbow's position is absolute", _RELATIVELY, _RELATIVE, _AS_IS, _NO_SHIFT),
    ('absolute', "the elbow's position is absolute", _RELATIVELY, _RELATIVE, _AS_IS, _LIFTED),
    ('degrees', 'the positions are in degrees', _CONVERTED, _IN_RADIANS, _AS_IS, ((1 - _DEGREE) * math.pi / 2, 0.0)),
    (
        'degrees',
        'the positions are in degrees from hanging',
        _CONVERTED,
        _IN_RADIANS,
        _AS_IS,
        (-_DEGREE * math.pi / 2, 0.0),
    ),
)
#: What the zeros must be.
_ZEROS = (
    'q1 must be 0 where link 1 is horizontal, -90 degrees hanging',
    'q2 must be 0 where link 2 continues link 1',
)


def diagnose(
    motions: Sequence[Motion],
    smoothing: float,
    hold: str,
    model: str,
    delay: float = 0.0,
    expected_link_length: float | None = None,
) -> tuple[Fault, ...]:
    """Name the faults of convention that recordings of one rig have in common; none where they tell too little.

    A fault is named when the motion tells it clearly: little motion, or much friction, may hide a zero or a delay. Of
    several faults at once the first may be taken for another one that explains nearly as well. An error is a wrong
    sense or order, a motion that fits no pendubot, and whatever leaves less than a fifth unexplained of what was, once
    it is put right; all else is a warning.

    Args:
        motions: of one rig.
        smoothing: the window [s] that made their states.
        hold: of their effort, see :meth:`.motion.Motion.prepare`.
        model: for the link's length alone; all else allows for dry friction and a rotor.
        delay: what is known of the effort's delay [s], not what was estimated from these recordings.
        expected_link_length: of link 1 [m], to be compared with the one that the elbow's motion tells.
    """
    rig = _Rig(tuple(m for m in motions if m.recorded.duration >= SHORTEST), delay)
    if not any(t.tau.any() for t in rig.trajectories):
        return ()
    cured, left, faults = _cured(rig)
    if faults or left > UNFIT:
        # Of spoiled data smoothing and hold, where these were chosen from them, are spoiled as well.
        how = min(smoothing, SMOOTHING), 'linear' if hold == 'zero' else 'zero'
        other = tuple(Motion.prepare(t, *how) for t in rig.trajectories)
        if (found := _cured(_Rig(other, delay)))[1] * REREAD < left:
            cured, left, faults = found
    if not faults:
        faults = _unfit(rig)
    faults += _unit(cured)
    if expected_link_length is not None:
        length, error = link_length(cured.motions, model, cured.delay)
        if abs(length - expected_link_length) > max(LENGTH_ERRORS * error, LENGTH_PART * expected_link_length):
            faults.append(
                Fault(
                    'length',
                    f'the elbow moves as on a link 1 of {length:.3f} +- {error:.3f} m, {expected_link_length:.3f} m is '
                    'expected',
                    'measure from axis to axis, and look at the signs, the zeros, the counts per turn and the stamps '
                    'of both angles',
                )
            )
    return tuple(faults)


def with_options(faults: Iterable[Fault], reading: Reading) -> tuple[Fault, ...]:
    """Return faults with the options that put them right, each after those before it, where recordings are read so."""
    said = []
    for fault in faults:
        mended = None if fault.change is None else reading.then(fault.change)
        if mended is not None:
            added, gone = (
                [option for option in one.options() if option not in other.options()]
                for one, other in ((mended, reading), (reading, mended))
            )
            words = [f'add {" ".join(added)}'] * bool(added) + [f'leave out {" ".join(gone)}'] * bool(gone)
            fault, reading = replace(fault, options=tuple(words), mended=mended), mended
        said.append(fault)
    return tuple(said)


def _cured(rig: _Rig) -> tuple[_Rig, float, list[Fault]]:
    """Return the rig put right by the remedy, or the two, that leave least, what that is, and what was wrong.

    The rig as it is where nothing is wrong, or nothing puts it right.
    """
    as_is = rig.unexplained(np.zeros(2))
    if as_is < FLAWLESS:
        return rig, as_is, []
    # Of those that leave the very same only the first: on a pendubot the effort is the shoulder's alone.
    firsts: dict[float, _Remedy] = {}
    for remedy in (*_turns(rig), *_others(rig)):
        firsts.setdefault(remedy[0].put_right, remedy)
    cures: list[tuple[float, list[_Remedy]]] = []
    for first in (remedy for after, remedy in firsts.items() if after <= TRIED * min(firsts)):
        # Two faults are less likely than one.
        second = min(_others(first[1]), key=lambda remedy: remedy[0].put_right, default=None)
        left = second[0].put_right if second else first[0].put_right
        if left < SOUND:
            cures.append((left * ALIKE, [first, second]) if second else (left, [first]))
    if not cures:
        return rig, as_is, []
    cures.sort(key=lambda cure: cure[0])
    least, steps = cures[0]
    alike = ', or '.join(first.found for score, ((first, _), *_) in cures if score <= least * ALIKE)
    faults, before = [], as_is
    for (fault, _), found in zip(steps, (alike, steps[-1][0].found), strict=False):
        grave = fault.name in _WHAT_IS_EXPECTED or before > GRAVE * fault.put_right
        level = Level.ERROR if grave else Level.WARN
        faults.append(replace(fault, found=found, level=level, unexplained=before))
        before = fault.put_right
    return steps[-1][1], before, faults


def _unit(rig: _Rig) -> list[Fault]:
    """Return that the effort is in mN m, where otherwise no link could be as heavy for its length.

    m2 is at least P5^2 / P2, and d2 at most P2 / P5.
    """
    criterion = _pooled(rig.regressions)
    theta = dict(zip(NAMES, criterion.minimum_in_box(BOUNDS), strict=False))
    P2, P5 = theta['P2'], theta['P5']
    left, least = _unexplained(criterion), float((P5**5 / TOO_DENSE) ** 0.25)
    if not 0 < P2 < least or left > SOUND or _unexplained(criterion, BOUNDS.replaced('P2', least, least)) < TOLD * left:
        return []
    fault = Fault(
        'unit',
        f'link 2 would weigh {P5**2 / P2:.3g} kg or more, within {100 * P2 / P5:.2g} cm of its joint; the effort is as '
        'in mN m',
        'it must be in N m: divide it by 1000',
        Level.ERROR,
        change=Affine.of(T=np.eye(2) / 1000),
    )
    return [fault]


def _unfit(rig: _Rig) -> list[Fault]:
    """Return that the motion is no pendubot's, whatever the units of its effort."""
    moved = np.max([np.ptp(t.q, axis=0) for t in rig.trajectories], axis=0)
    if rig.duration < LONG_ENOUGH or moved.min() < FAR_ENOUGH:
        return []
    left = _unexplained(_pooled(rig.regressions))
    if left <= UNFIT:
        return []
    return [
        Fault(
            'motion',
            f'the motion does not fit any pendubot: {100 * left:.3g} % of the squared effort is left unexplained, and '
            'no known fault put right mends it',
            'check the signs and zeros of both angles, the order of the joints, whether q2 is relative to link 1, '
            'units and counts per turn, the sign and the stamps of the effort, and whether the links moved freely',
            Level.ERROR,
            unexplained=left,
        )
    ]


def link_length(motions: Sequence[Motion], model: str, delay: float = 0.0) -> tuple[float, float]:
    """Return P3 / P5 = l1, the length of link 1 [m], and its standard error, from the elbow's own balance alone.

    On a pendubot that equation contains no torque and tells ratios only; so does this estimate on any rig. A length
    that is not the one of a ruler means that signs, zeros or stamps of the angles are wrong, not the motor's constant.
    Both are NaN where no motion is as long as the bump: ``energy`` is satisfied with less.
    """
    motions = [motion for motion in motions if motion.end - motion.start > WIDTH + abs(delay)]
    if not motions:
        return math.nan, math.nan
    parts = _elbows_own(motions, model, delay)
    ratios = _pooled(parts).free_minimum()
    covariance = bootstrap_covariance(Blocks.of(parts), ratios, np.ones(len(ratios), dtype=bool))
    return float(ratios[0]), math.sqrt(covariance[0, 0])


def _elbows_own(motions: Sequence[Motion], model: str, delay: float) -> list[Regression]:
    """Return the elbow's own balance: P3 and others over P5 from gravity's column, which nothing spoils."""
    names = NAMES[: MODELS[model]]
    others = [names.index(name) for name in ('P3', 'P2', 'b2', 'Fc2', 'J2', 'Fs2', 'k2') if name in names]
    parts = []
    for motion in motions:
        balances = weak_regression(motion, model, delay, weights=(1, 1, 1))
        phi, y, t = (values[1::3] for values in (balances.phi, balances.y, balances.t))
        parts.append(Regression(np.column_stack([phi[:, others], -y]), -phi[:, names.index('P5')], t))
    return parts


@dataclass(frozen=True)
class _Rig:
    """Recordings, how they are to be read, and what of their squared effort is left unexplained."""

    motions: tuple[Motion, ...]
    delay: float

    @property
    def trajectories(self) -> list[Trajectory]:
        return [m.recorded for m in self.motions]

    @property
    def duration(self) -> float:
        return sum(t.duration for t in self.trajectories)

    @cached_property
    def regressions(self) -> list[Regression]:
        return [self._regression(motion) for motion in self.motions]

    def _regression(self, motion: Motion) -> Regression:
        """Return the balances of a motion, which are made once."""
        what = 'conventions', self.delay
        return motion.once(
            what, lambda: weak_regression(motion, MODEL, self.delay, weights=WEIGHTS, stride=STRIDE, coarse=True)
        )

    @cached_property
    def effort(self) -> float:
        """The squared effort that is to be explained."""
        return sum(float((part.y**2).sum()) for part in self.regressions)

    def leaves_more_than(self, squares: float) -> bool:
        """Tell, mostly by the first recordings, whether more is left: together they leave what each alone does."""
        for motion in self.motions:
            criterion = _pooled([self._regression(motion)])
            squares -= criterion.count * float(criterion(criterion.minimum_in_box(BOUNDS)))
            if squares < 0:
                return True
        return False

    def changed(self, change: Affine) -> _Rig:
        return replace(self, motions=tuple(m.changed(change) for m in self.motions))

    def turned_by(self, angles: Array) -> _Rig:
        """Return the rig with angles [rad] taken from its joints' positions."""
        return self.changed(Affine.of(c=-angles))

    @cached_property
    def elbow(self) -> float:
        """What is left unexplained of the elbow's own balance, in which a light elbow counts as much as a heavy one."""
        criterion = _pooled(_elbows_own(self.motions, MODEL, self.delay))
        gravity = float(criterion(np.zeros_like(criterion.y)))
        return float(criterion(criterion.free_minimum())) / gravity if gravity > 0 else 0.0

    @cached_property
    def turned(self) -> list[Regression]:
        """The regressions with more columns, those of the same motion turned by a right angle.

        In both together what depends on a zero is linear in the cosine and the sine of its error: P3 in q2's, P4 in
        q1's, P5 in that of both.
        """
        first, second = (self.turned_by(math.pi / 2 * joint).regressions for joint in JOINTS)
        return [
            Regression(np.column_stack([as_is.phi, other.phi[:, 2], one.phi[:, 3:5]]), as_is.y, as_is.t)
            for as_is, one, other in zip(self.regressions, first, second, strict=True)
        ]

    @cached_property
    def _criterion(self) -> Quadratic:
        return _pooled(self.turned)

    def theta(self, angles: Array) -> Array:
        """Return the parameters, shape (D,), when the zeros are off by angles [rad]."""
        return self._criterion.along(_turned(angles)).minimum_in_box(BOUNDS)

    def unexplained(self, angles: Array) -> float:
        """Return the part of the squared effort that is left unexplained when the zeros are off by angles [rad]."""
        return _unexplained(self._criterion.along(_turned(angles)))

    def zero(self, joint: int, low: float, high: float, others: Array | float = 0.0) -> float:
        """Return the angle [rad] between two by which the zero of one joint is most likely off, given the other's."""
        return lowest_between(lambda angle: self.unexplained(angle * JOINTS[joint] + others), low, high, 1e-4)

    def tolerance(self, joint: int, angles: Array) -> float:
        """Return by how much a zero [rad] may be off that was set while the rig hung at rest."""
        values = dict(zip(NAMES, self.theta(angles), strict=False))
        weight = GRAVITY * (values['P5'] + (values['P4'] if joint == 0 else 0.0))
        dry = values['Fc1' if joint == 0 else 'Fc2']
        held = math.asin(min(1.0, dry / weight)) if weight > 0 else math.pi / 2
        return max(LEAST_ZERO, FRICTION_ANGLES * held / math.sqrt(len(self.motions)))

    @cached_property
    def tolerated(self) -> float:
        """What is left unexplained when both zeros are off by no more than their tolerances."""
        first, second = (self.tolerance(joint, np.zeros(2)) for joint in (0, 1))
        q1 = self.zero(0, -first, first) * JOINTS[0]
        return self.unexplained(q1 + self.zero(1, -second, second, q1) * JOINTS[1])

    def std_error(self, joint: int, angles: Array) -> float:
        """Return the standard error of a zero [rad]: that of the coefficient of what changes with it."""
        theta = self.theta(angles)
        turning = [(3, 4), (2, 4)][joint]
        further = _turned(angles + math.pi / 2 * JOINTS[joint])
        columns = np.column_stack([_turned(angles), further[:, turning] @ theta[list(turning)]])
        blocks = Blocks.of([Regression(part.phi @ columns, part.y, part.t) for part in self.turned])
        free = np.append(~BOUNDS.at_bound(theta, 1e-6), True)
        return math.sqrt(bootstrap_covariance(blocks, np.append(theta, 0.0), free)[-1, -1])


#: A fault, and the rig put right.
_Remedy = tuple[Fault, _Rig]


def _turns(rig: _Rig) -> Iterator[_Remedy]:
    hanging = np.array(HANGING)
    moved = max(float(np.ptp(t.q, axis=0).max()) for t in rig.trajectories)
    for name, found, remedy, positions, efforts, shift in _TURNS:
        if name == 'degrees' and moved < AS_DEGREES:
            continue
        change = Affine.of(positions, hanging + shift - np.array(positions) @ hanging, efforts)
        right = rig.changed(change)
        try:
            if right.leaves_more_than(OTHER_EFFORT * rig.tolerated * rig.effort):
                continue
            after = _unexplained(_pooled(right.regressions))
            # Of a light elbow a wrong sense changes little of all the effort.
            elbow = after < rig.tolerated and rig.elbow > SOUND and right.elbow * ELBOW < rig.elbow
        except TrajectoryError:  # read like this, the rig moves as none can
            continue
        if after * TURNED < rig.tolerated or elbow:
            expected = f'{_WHAT_IS_EXPECTED[name]}: {remedy}'
            yield Fault(name, found, expected, put_right=after, change=change), right


def _others(rig: _Rig) -> Iterator[_Remedy]:
    for kind in (_zeros, _offsets, _delays):
        yield from kind(rig)


def _zeros(rig: _Rig) -> Iterator[_Remedy]:
    coarse, step = np.radians(np.arange(-180, 180, 15)), math.radians(15)
    for joint, expected in enumerate(_ZEROS):
        nearest = coarse[np.argmin([rig.unexplained(angle * JOINTS[joint]) for angle in coarse])]
        angle = rig.zero(joint, nearest - step, nearest + step)
        angles = angle * JOINTS[joint]
        after = rig.unexplained(angles)
        if after * SHIFTED < rig.unexplained(np.zeros(2)) and abs(angle) > rig.tolerance(joint, angles):
            degrees, error = math.degrees(angle), math.degrees(rig.std_error(joint, angles))
            found = f"q{joint + 1}'s zero is off by {degrees:.1f} +- {error:.1g} degrees"
            remedy = f'{expected}: subtract {degrees:.1f} degrees'
            # A zero that somebody chose, and not one that is off.
            right = round(angle / (math.pi / 2)) * math.pi / 2
            chosen = right * JOINTS[joint] if right and abs(angle - right) < rig.tolerance(joint, angles) else angles
            change = Affine.of(c=-chosen)
            yield Fault('zero', found, remedy, put_right=after, change=change), rig.turned_by(angles)


def _offsets(rig: _Rig) -> Iterator[_Remedy]:
    """Yield what undoes a constant effort [N m] that was recorded at the shoulder and did not act."""

    def by(effort: float) -> _Rig:
        return rig.changed(Affine.of(d=(effort, 0.0)))

    most = max(float(np.abs(t.tau[:, 0]).max()) for t in rig.trajectories)
    if not most > 0 or rig.duration < LONG_ENOUGH:
        return
    criterion = _pooled(
        Regression(np.column_stack([as_is.phi, more.y - as_is.y]), as_is.y, as_is.t)
        for as_is, more in zip(rig.regressions, by(most).regressions, strict=True)
    )
    box = Bounds(np.append(BOUNDS.lower, -1.0), np.append(BOUNDS.upper, 1.0), (*BOUNDS.names, 'offset'))
    offset = most * float(criterion.minimum_in_box(box)[-1])
    right = by(-offset)
    after = _unexplained(_pooled(right.regressions))
    # Zeros that dry friction holds off look like a small offset.
    if after * SHIFTED < rig.tolerated:
        found = f"the shoulder's effort is off by a constant {offset:.3g} N m"
        remedy = f'it must be 0 where no torque acts: subtract {offset:.3g} N m'
        yield Fault('offset', found, remedy, put_right=after, change=Affine.of(d=(-offset, 0.0))), right


def _delays(rig: _Rig) -> Iterator[_Remedy]:
    motions = rig.motions
    try:
        delay = estimate_delay(motions, MODEL, BOUNDS, weights=WEIGHTS)
    except TrajectoryError:  # too short for that
        return
    right = replace(rig, delay=delay)
    after = _unexplained(_pooled(right.regressions))
    # Whether an effort was held or measured makes half an interval of difference, and is not known for certain.
    least = LEAST_DELAY + max(motion.interval for motion in motions) / 2
    if abs(delay - rig.delay) >= least and after * SHIFTED < rig.tolerated:
        late = round(1000 * (rig.delay - delay))
        what = f'is stamped {late} ms later than it acts' if late > 0 else f'acts {-late} ms later than it is stamped'
        remedy = f'each effort must bear the time from which it acts: identify with a delay of {delay:.3f} s'
        yield Fault('delay', f'the effort {what}', remedy, put_right=after, delay=delay), right


def _turned(angles: Array) -> Array:
    """Return directions in which theta counts when zeros are off by angles [rad], shape (D + 3, D)."""
    size = len(BOUNDS.names)
    directions = np.eye(size + 3)[:, :size]
    for k, angle in ((2, angles[1]), (3, angles[0]), (4, angles[0] + angles[1])):
        directions[k, k], directions[size + k - 2, k] = math.cos(angle), math.sin(angle)
    return directions


def _pooled(parts: Iterable[Regression]) -> Quadratic:
    return Quadratic.pool([Quadratic.reduce(part.phi, part.y) for part in parts])


def _unexplained(criterion: Quadratic, bounds: Bounds = BOUNDS) -> float:
    """Return the part of the squared effort that no parameters within their bounds explain."""
    theta = criterion.minimum_in_box(bounds)
    effort = float(criterion(np.zeros_like(theta)))
    return float(criterion(theta)) / effort if effort > 0 else 1.0
