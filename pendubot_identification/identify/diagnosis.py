# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What is wrong with the conventions of a recording: signs, order, zeros and stamps, told from the motion itself.

A recording that breaks a convention is poorly explained by any physical parameters, and well explained once it is put
right. So every fault that we know of is put right on trial, and is named where the weak criterion falls markedly and to
what a sound recording leaves. Where none does that, no fault is named, but that the motion fits no pendubot.

What cannot be noticed: an effort in other units or through another gear ratio scales all parameters but explains as
well; both joints and both efforts turned round are the same rig seen from behind; and a zero that is off by less than
the angle at which friction holds a link that hangs at rest may be how the rig was standing when it was set.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from pendubot_identification.criteria.energy import Regression, Residuals
from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.criteria.weak import WIDTH, estimate_delay, weak_regression
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.level import Level
from pendubot_identification.model.dynamics import GRAVITY, Pair
from pendubot_identification.model.parameters import MODELS, NAMES, Bounds, default_bounds
from pendubot_identification.model.simulation import HANGING
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import SMOOTHING
from pendubot_identification.trajectories.trajectory import Trajectory

from .uncertainty import Blocks, bootstrap_covariance

Array = NDArray[np.float64]

#: Dry friction and a rotor are allowed for; what has more to it would explain faults away.
MODEL = 'rotor'
BOUNDS = default_bounds().of(MODELS[MODEL])
#: Of the balances of the shoulder, the elbow and energy: smoothing spoils energy, and elbows are small.
WEIGHTS = (1.0, 3.0, 0.1)
#: From bump to bump [s]; more of them tell little more.
STRIDE = 0.03
#: Recordings shorter than this [s] tell nothing.
SHORTEST = 1.0
#: By how much putting it right must lower the unexplained part: another sense or order changes everything, a zero or
#: a delay of the least size of interest does not.
TURNED, SHIFTED = 2.0, 1.2
#: A zero or an offset that lowers it by so much when put right had made some parameter wrong by a sixth and more, on
#: virtual and real rigs.
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
#: Of the effort's scale, which is not told: it may be in other units.
ANY_SCALE = 1e6
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
        name: ``sign``, ``order``, ``absolute``, ``zero``, ``offset``, ``delay``, ``length``, or ``motion``: none of
            these, but that the motion fits no pendubot.
        found: what is wrong, in words.
        remedy: what was expected, and what to do.
        level: ERROR where parameters from such recordings are useless, else WARN.
        unexplained: part of the squared effort that is left unexplained as recorded; NaN where nothing was tried.
        put_right: the same with the fault put right.
        delay: of the effort [s], when the fault is put right by it; None for other faults.
    """

    name: str
    found: str
    remedy: str
    level: Level = Level.WARN
    unexplained: float = math.nan
    put_right: float = math.nan
    delay: float | None = None

    @property
    def sentence(self) -> str:
        """What was found, how sure that is, and what to do."""
        shares = ''
        if not math.isnan(self.put_right):
            shares = (
                f': {100 * self.unexplained:.3g} % of the squared effort is left unexplained as recorded and '
                f'{100 * self.put_right:.3g} % with this put right'
            )
        return f'{self.found}{shares}; {self.remedy}'


class _Turn(NamedTuple):
    """A fault of sense or order: what it is, what to do, and what undoes it, for angles from hanging and efforts.

    What undoes it also adds ``shift`` [rad] to the positions: where they were turned about another zero than hanging.
    """

    name: str
    found: str
    remedy: str
    positions: tuple[tuple[float, float], tuple[float, float]]
    efforts: tuple[tuple[float, float], tuple[float, float]] = ((1, 0), (0, 1))
    shift: Pair = (0.0, 0.0)


_AS_IS, _EXCHANGED = ((1, 0), (0, 1)), ((0, 1), (1, 0))
_FIRST, _SECOND, _BOTH = ((-1, 0), (0, 1)), ((1, 0), (0, -1)), ((-1, 0), (0, -1))
_RELATIVE = ((1, 0), (-1, 1))
#: Of angles from the horizontal that were negated, or exchanged, as they stood.
_MIRRORED, _SWAPPED = (math.pi, 0.0), (math.pi / 2, -math.pi / 2)
_SENSE = 'positions and efforts of both joints must be positive in one sense of rotation'
_ORDER = 'shoulder first, elbow second'
_TURNS = (
    _Turn('sign', "the elbow's position has the wrong sign", f"{_SENSE}: negate the elbow's position", _SECOND),
    _Turn(
        'sign',
        'the elbow turns the other way than the shoulder',
        f"{_SENSE}: negate the elbow's position and effort (or the shoulder's)",
        _SECOND,
        _SECOND,
    ),
    _Turn('sign', 'the effort has the wrong sign', f'{_SENSE}: negate the effort (or both positions)', _AS_IS, _BOTH),
    _Turn(
        'sign',
        "the shoulder's position has the wrong sign",
        f"{_SENSE}: negate the shoulder's position (or the elbow's and the effort)",
        _FIRST,
    ),
    _Turn(
        'sign',
        "the shoulder's position has the wrong sign, as measured from the horizontal",
        f"{_SENSE}: negate the shoulder's position, so that hanging is -90 degrees",
        _FIRST,
        shift=_MIRRORED,
    ),
    _Turn(
        'sign', "the shoulder's effort has the wrong sign", f"{_SENSE}: negate the shoulder's effort", _AS_IS, _FIRST
    ),
    _Turn('sign', "the elbow's effort has the wrong sign", f"{_SENSE}: negate the elbow's effort", _AS_IS, _SECOND),
    *(
        _Turn('order', found, f'{_ORDER}: exchange the {what}', _EXCHANGED, efforts, shift)
        for shift in ((0.0, 0.0), _SWAPPED)
        for found, what, efforts in (
            ('the joints are in the wrong order', 'joints', _EXCHANGED),
            ("the joints' positions are in the wrong order", 'positions', _AS_IS),
        )
    ),
    _Turn('order', "the joints' efforts are in the wrong order", f'{_ORDER}: exchange the efforts', _AS_IS, _EXCHANGED),
    *(
        _Turn(
            'absolute',
            "the elbow's position is absolute",
            "it must be relative to link 1: subtract the shoulder's position (import-csv: --elbow absolute)",
            _RELATIVE,
            shift=(0.0, shift),
        )
        for shift in (0.0, math.pi / 2)
    ),
)

#: What the zeros must be.
_ZEROS = (
    'q1 must be 0 where link 1 is horizontal, -90 degrees hanging (import-csv: --zero hanging if it is 0 there)',
    'q2 must be 0 where link 2 continues link 1',
)


def diagnose(
    trajectories: Sequence[Trajectory],
    smoothing: float,
    hold: str,
    model: str,
    delay: float = 0.0,
    expected_link_length: float | None = None,
) -> tuple[Fault, ...]:
    """Name what is wrong with the conventions of recordings.

    A fault is named when the motion tells it clearly: recordings of little motion, or of much friction, may hide a
    zero or a delay. Of several faults at once the first may be taken for another one that explains nearly as well.

    Args:
        trajectories: recordings of one rig; faults that they have in common are found.
        smoothing: the differentiator's window [s].
        hold: of the effort, see :meth:`.motion.Motion.prepare`.
        model: the name of one of :data:`.parameters.MODELS`, for the link's length; all else allows for dry friction
            and a rotor, whatever the model.
        delay: what is known of the effort's delay [s], not what was estimated from these recordings.
        expected_link_length: of link 1 [m], to be compared with the one that the elbow's motion tells.

    Returns:
        None for good recordings, and none where recordings are too short or too quiet to tell. An error is a wrong
        sense or order, a motion that fits no pendubot, and whatever leaves less than a fifth unexplained of what was,
        once it is put right; all else is a warning.
    """
    long = tuple(t for t in trajectories if t.duration >= SHORTEST)
    if not any(t.tau.any() for t in long):
        return ()
    rig = _Rig(long, smoothing, hold, delay)
    cured, left, faults = _cured(rig)
    if faults or left > UNFIT:
        # Of spoiled data smoothing and hold, where these were chosen from them, are spoiled as well.
        other = replace(rig, smoothing=min(smoothing, SMOOTHING), hold='linear' if hold == 'zero' else 'zero')
        if (found := _cured(other))[1] * REREAD < left:
            cured, left, faults = found
    if not faults:
        faults = _unfit(rig)
    if expected_link_length is not None:
        faults += _wrong_length(cured, model, expected_link_length)
    return tuple(faults)


def _cured(rig: _Rig) -> tuple[_Rig, float, list[Fault]]:
    """Return the rig put right by the remedy, or the two, that leave least, what that is, and what was wrong.

    The rig as it is where nothing is wrong, or nothing puts it right.
    """
    kinds = (_turns, _zeros, _offsets, _delays)
    zeros = _Zeros(rig)
    if zeros.as_is < FLAWLESS:
        return rig, zeros.as_is, []
    # Of those that leave the very same only the first: on a pendubot the effort is the shoulder's alone.
    firsts = {remedy.after: remedy for kind in reversed(kinds) for remedy in reversed(kind(rig, zeros))}
    cures: list[tuple[float, _Remedy, _Remedy | None]] = []
    for first in (remedy for after, remedy in firsts.items() if after <= TRIED * min(firsts)):
        others = _Zeros(first.rig)
        seconds = [remedy for kind in kinds[1:] for remedy in kind(first.rig, others)]
        second = min(seconds, key=lambda remedy: remedy.after, default=None)
        if (left := first.after if second is None else second.after) < SOUND:
            # Two faults are less likely than one.
            cures.append((left if second is None else left * ALIKE, first, second))
    if not cures:
        return rig, zeros.as_is, []
    cures.sort(key=lambda cure: cure[0])
    least, first, second = cures[0]
    faults = [_fault([other for score, other, _ in cures if score <= least * ALIKE], zeros.as_is)]
    if second is not None:
        faults.append(_fault([second], first.after))
    last = second or first
    return last.rig, last.after, faults


def _fault(alike: Sequence[_Remedy], before: float) -> Fault:
    best = alike[0]
    grave = best.always_grave or before > GRAVE * best.after
    return Fault(
        name=best.name,
        found=', or '.join(each.found for each in alike),
        remedy=best.remedy,
        level=Level.ERROR if grave else Level.WARN,
        unexplained=before,
        put_right=best.after,
        delay=best.rig.delay if best.name == 'delay' else None,
    )


def _unfit(rig: _Rig) -> list[Fault]:
    """Return that the motion is no pendubot's, whatever the units of its effort."""
    moved = np.max([np.ptp(t.q, axis=0) for t in rig.trajectories], axis=0)
    if sum(t.duration for t in rig.trajectories) < LONG_ENOUGH or moved.min() < FAR_ENOUGH:
        return []
    left = _unexplained(_pooled(rig.regressions()), Bounds(BOUNDS.lower, ANY_SCALE * BOUNDS.upper, BOUNDS.names))
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

    Args:
        motions: states and torques of one rig.
        model: the name of one of :data:`.parameters.MODELS`.
        delay: of the effort [s].

    Returns:
        Both NaN where no motion is as long as the bump: ``energy`` is satisfied with less.
    """
    motions = [motion for motion in motions if motion.end - motion.start > WIDTH + abs(delay)]
    if not motions:
        return math.nan, math.nan
    names = NAMES[: MODELS[model]]
    others = [names.index(name) for name in ('P3', 'P2', 'b2', 'Fc2', 'J2', 'Fs2', 'k2') if name in names]
    parts = []
    for motion in motions:
        balances = weak_regression(motion, model, delay, weights=(1, 1, 1))
        phi, y, t = (values[1::3] for values in (balances.phi, balances.y, balances.t))
        # Gravity, the column that neither smoothing nor noise spoils, in terms of all others divided by P5.
        parts.append(Regression(np.column_stack([phi[:, others], -y]), -phi[:, names.index('P5')], t))
    ratios = Quadratic.pool([Quadratic.reduce(part.phi, part.y) for part in parts]).free_minimum()
    covariance = bootstrap_covariance(_blocks(parts), ratios, np.ones(len(ratios), dtype=bool))
    return float(ratios[0]), math.sqrt(covariance[0, 0])


@dataclass(frozen=True)
class _Rig:
    """Recordings and how they are to be read."""

    trajectories: tuple[Trajectory, ...]
    smoothing: float
    hold: str
    delay: float

    @property
    def motions(self) -> list[Motion]:
        return [Motion.prepare(t, self.smoothing, self.hold) for t in self.trajectories]

    def regressions(self) -> list[Regression]:
        return [weak_regression(m, MODEL, self.delay, weights=WEIGHTS, stride=STRIDE) for m in self.motions]

    def read(self, turn: _Turn) -> _Rig:
        """Return the rig as it is when a fault of sense or order is undone."""
        hanging, shift = np.array(HANGING), np.array(turn.shift)
        positions, efforts = np.transpose(turn.positions), np.transpose(turn.efforts)
        right = (
            replace(t, q=(t.q - hanging) @ positions + hanging + shift, tau=t.tau @ efforts, qd=None)
            for t in self.trajectories
        )
        return replace(self, trajectories=tuple(right))

    def turned_by(self, angles: Pair) -> _Rig:
        """Return the rig with angles [rad] taken from its joints' positions."""
        return replace(self, trajectories=tuple(replace(t, q=t.q - angles, qd=None) for t in self.trajectories))

    def offset_by(self, effort: float) -> _Rig:
        """Return the rig with an effort [N m] added to its shoulder's."""
        return replace(
            self, trajectories=tuple(replace(t, tau=t.tau + np.array([effort, 0.0])) for t in self.trajectories)
        )


class _Zeros:
    """What a rig's motion leaves unexplained when the zeros of its angles are off.

    What depends on a zero is, with the columns of the same motion turned by a right angle, linear in the cosine and
    the sine of the error: P3 in q2's, P4 in q1's, P5 in that of both.
    """

    def __init__(self, rig: _Rig) -> None:
        sides = [rig.turned_by(angles).regressions() for angles in ((0, 0), (math.pi / 2, 0), (0, math.pi / 2))]
        self.parts = [
            Regression(np.column_stack([as_is.phi, second.phi[:, 2], first.phi[:, 3:5]]), as_is.y, as_is.t)
            for as_is, first, second in zip(*sides, strict=True)
        ]
        self._criterion = _pooled(self.parts)
        self.as_is = self.unexplained((0.0, 0.0))

    def theta(self, angles: Pair) -> Array:
        """Return the parameters, shape (D,), when the zeros are off by angles [rad]."""
        return self._criterion.along(_turned(angles)).minimum_in_box(BOUNDS)

    def unexplained(self, angles: Pair) -> float:
        """Return the part of the squared effort that is left unexplained when the zeros are off by angles [rad]."""
        return _unexplained(self._criterion.along(_turned(angles)))

    def least(self, joint: int, low: float, high: float, other: float = 0.0) -> float:
        """Return the angle [rad] between two by which the zero of one joint is most likely off, given the other's."""
        search = minimize_scalar(
            lambda angle: self.unexplained((angle, other) if joint == 0 else (other, angle)),
            bounds=(low, high),
            method='bounded',
            options={'xatol': 1e-4},
        )
        return float(search.x)

    def tolerance(self, joint: int, angles: Pair) -> float:
        """Return by how much a zero [rad] may be off that was set while the rig hung at rest."""
        values = dict(zip(NAMES, self.theta(angles), strict=False))
        weight = GRAVITY * (values['P5'] + (values['P4'] if joint == 0 else 0.0))
        dry = values['Fc1' if joint == 0 else 'Fc2']
        held = math.asin(min(1.0, dry / weight)) if weight > 0 else math.pi / 2
        return max(LEAST_ZERO, FRICTION_ANGLES * held / math.sqrt(len(self.parts)))

    def tolerated(self) -> float:
        """Return what is left unexplained when both zeros are off by no more than their tolerances."""
        first, second = (self.tolerance(joint, (0.0, 0.0)) for joint in (0, 1))
        q1 = self.least(0, -first, first)
        return self.unexplained((q1, self.least(1, -second, second, q1)))

    def std_error(self, joint: int, angles: Pair) -> float:
        """Return the standard error of a zero [rad]: that of the coefficient of what changes with it."""
        theta, free = self.theta(angles), ~BOUNDS.at_bound(self.theta(angles), 1e-6)
        further = (angles[0] + math.pi / 2, angles[1]) if joint == 0 else (angles[0], angles[1] + math.pi / 2)
        turning = [(3, 4), (2, 4)][joint]
        columns = np.column_stack([_turned(angles), _turned(further)[:, turning] @ theta[list(turning)]])
        parts = [Regression(part.phi @ columns, part.y, part.t) for part in self.parts]
        return math.sqrt(bootstrap_covariance(_blocks(parts), np.append(theta, 0.0), np.append(free, True))[-1, -1])


class _Remedy(NamedTuple):
    """What is wrong, what to do, the rig put right, and what that leaves unexplained."""

    name: str
    found: str
    remedy: str
    rig: _Rig
    after: float
    always_grave: bool = False


def _turns(rig: _Rig, zeros: _Zeros) -> list[_Remedy]:
    before, remedies = zeros.tolerated(), []
    for turn in _TURNS:
        right = rig.read(turn)
        try:
            after = _unexplained(_pooled(right.regressions()))
        except TrajectoryError:  # read like this, the rig moves as none can
            continue
        if after * TURNED < before:
            remedies.append(_Remedy(turn.name, turn.found, turn.remedy, right, after, always_grave=True))
    return remedies


def _zeros(rig: _Rig, zeros: _Zeros) -> list[_Remedy]:
    remedies = []
    for joint, expected in enumerate(_ZEROS):

        def pair(angle: float, joint: int = joint) -> Pair:
            return (angle, 0.0) if joint == 0 else (0.0, angle)

        coarse = np.radians(np.arange(-180, 180, 15))
        nearest = coarse[np.argmin([zeros.unexplained(pair(angle)) for angle in coarse])]
        angle = zeros.least(joint, nearest - math.radians(15), nearest + math.radians(15))
        after = zeros.unexplained(pair(angle))
        if after * SHIFTED < zeros.as_is and abs(angle) > zeros.tolerance(joint, pair(angle)):
            degrees, error = math.degrees(angle), math.degrees(zeros.std_error(joint, pair(angle)))
            found = f"q{joint + 1}'s zero is off by {degrees:.1f} +- {error:.1g} degrees"
            remedy = f'{expected}: subtract {degrees:.1f} degrees'
            remedies.append(_Remedy('zero', found, remedy, rig.turned_by(pair(angle)), after))
    return remedies


def _offsets(rig: _Rig, zeros: _Zeros) -> list[_Remedy]:
    """Return what undoes a constant effort [N m] that was recorded at the shoulder and did not act."""
    most = max(float(np.abs(t.tau[:, 0]).max()) for t in rig.trajectories)
    if not most > 0 or sum(t.duration for t in rig.trajectories) < LONG_ENOUGH:
        return []
    parts = [
        Quadratic.reduce(np.column_stack([as_is.phi, more.y - as_is.y]), as_is.y)
        for as_is, more in zip(rig.regressions(), rig.offset_by(most).regressions(), strict=True)
    ]
    names = (*BOUNDS.names, 'offset')
    criterion = Quadratic.pool(parts)
    theta = criterion.minimum_in_box(Bounds(np.append(BOUNDS.lower, -1.0), np.append(BOUNDS.upper, 1.0), names))
    offset = most * float(theta[-1])
    right = rig.offset_by(-offset)
    after = _unexplained(_pooled(right.regressions()))
    # Zeros that dry friction holds off look like a small offset.
    if after * SHIFTED >= zeros.tolerated():
        return []
    found = f"the shoulder's effort is off by a constant {offset:.3g} N m"
    remedy = f'it must be 0 where no torque acts: subtract {offset:.3g} N m'
    return [_Remedy('offset', found, remedy, right, after)]


def _delays(rig: _Rig, zeros: _Zeros) -> list[_Remedy]:
    try:
        delay = estimate_delay(rig.motions, MODEL, BOUNDS, weights=WEIGHTS)
    except TrajectoryError:  # too short for that
        return []
    right = replace(rig, delay=delay)
    after = _unexplained(_pooled(right.regressions()))
    # Whether an effort was held or measured makes half an interval of difference, and is not known for certain.
    least = LEAST_DELAY + max(motion.interval for motion in rig.motions) / 2
    if abs(delay - rig.delay) < least or after * SHIFTED >= zeros.tolerated():
        return []
    late = round(1000 * (rig.delay - delay))
    what = f'is stamped {late} ms later than it acts' if late > 0 else f'acts {-late} ms later than it is stamped'
    remedy = f'each effort must bear the time from which it acts: identify with a delay of {delay:.3f} s'
    return [_Remedy('delay', f'the effort {what}', remedy, right, after)]


def _wrong_length(rig: _Rig, model: str, expected: float) -> list[Fault]:
    length, error = link_length(rig.motions, model, rig.delay)
    if abs(length - expected) <= max(LENGTH_ERRORS * error, LENGTH_PART * expected):
        return []
    return [
        Fault(
            'length',
            f'the elbow moves as on a link 1 of {length:.3f} +- {error:.3f} m, {expected:.3f} m is expected',
            'measure from axis to axis, and look at the signs, the zeros, the counts per turn and the stamps of both '
            'angles',
        )
    ]


def _turned(angles: Pair) -> Array:
    """Return directions in which theta counts when zeros are off by angles [rad], shape (D + 3, D)."""
    size = len(BOUNDS.names)
    directions = np.eye(size + 3)[:, :size]
    for k, angle in ((2, angles[1]), (3, angles[0]), (4, angles[0] + angles[1])):
        directions[k, k], directions[size + k - 2, k] = math.cos(angle), math.sin(angle)
    return directions


def _pooled(parts: Sequence[Regression]) -> Quadratic:
    return Quadratic.pool([Quadratic.reduce(part.phi, part.y) for part in parts])


def _unexplained(criterion: Quadratic, bounds: Bounds = BOUNDS) -> float:
    """Return the part of the squared effort that no parameters within their bounds explain."""
    theta = criterion.minimum_in_box(bounds)
    effort = float(criterion(np.zeros_like(theta)))
    return float(criterion(theta)) / effort if effort > 0 else 1.0


def _blocks(parts: Sequence[Regression]) -> Blocks:
    return Blocks.of([Residuals.of(part) for part in parts])
