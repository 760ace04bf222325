# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What is wrong with the conventions of a recording: signs, order, zeros and stamps, from the motion itself.

No physical parameters explain a recording that breaks a convention. So every known correction is applied on trial, the
weak criterion is fitted, and the corrections are ranked by the residual. The best one is named if the residual falls
markedly, to that of a sound recording. If none does, the message says that the motion fits no pendubot.

What cannot be noticed: an effort through another gear ratio or in other units, which scales all parameters (but for
one a thousand times too large, with which no link could be so small and so heavy); both joints and both efforts
turned round, which is the same rig seen from behind; and a zero that is off by less than the angle at which friction
holds a hanging link.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from pendubot_identification.criteria.energy import Regression
from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.criteria.weak import WIDTH, estimate_delay, weak_regression
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.level import Level
from pendubot_identification.model.dynamics import GRAVITY, Pair
from pendubot_identification.model.parameters import MODELS, NAMES, Bounds, default_bounds
from pendubot_identification.model.simulation import HANGING
from pendubot_identification.trajectories.conversion import Affine, Conversion
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import SMOOTHING
from pendubot_identification.trajectories.trajectory import Trajectory

from .uncertainty import regression_covariance

Array = NDArray[np.float64]
Matrix = tuple[Pair, Pair]
#: Dry friction and a rotor are allowed for; a richer model would explain faults away.
MODEL = 'rotor'
_BOX = default_bounds().of(MODELS[MODEL])
#: The effort may be in any units.
BOUNDS = Bounds(_BOX.lower, 1e6 * _BOX.upper, _BOX.names)


@dataclass(frozen=True, slots=True)
class DiagnosisSettings:
    """When a fault is named; fractions are of the squared effort that the model does not explain."""

    #: Of the residuals of shoulder, elbow and energy: smoothing spoils energy, and elbows are small.
    weights: tuple[float, float, float] = (1.0, 3.0, 0.1)
    #: From test function to test function [s].
    stride: float = 0.03
    #: Shorter recordings tell nothing; shorter ones together tell no offset and no motion that fits no rig [s].
    shortest: float = 1.0
    long_enough: float = 3.0
    #: Both joints must move so far [rad] before a motion fits no rig.
    far_enough: float = 0.5
    #: Degrees read as radians move so far [rad]: a small motion fits any rig.
    far_in_degrees: float = 10.0
    #: A correction leaves at most so many times the squared residual: one that makes the effort larger is no better.
    more_effort: float = 2.0
    #: A sound recording leaves less: real rigs leave .02, and .05 with stamps 20 ms late.
    sound: float = 0.1
    #: Quantization alone leaves so much.
    flawless: float = 1e-6
    #: A motion that leaves more, whatever is corrected, fits no rig.
    unfit: float = 0.3
    #: A correction of sense or order, of a zero or a delay, and of the elbow's own equation must divide the fraction
    #: by so much.
    turned: float = 2.0
    shifted: float = 1.2
    elbow: float = 30.0
    #: An offset that explains no more does not matter: it is 1 % of the effort's RMS.
    least_offset: float = 1e-4
    #: A zero or an offset that divides the fraction by so much made some parameter wrong by a sixth and more.
    severe: float = 5.0
    #: Corrections that leave up to so many times as much as the best one are named beside it.
    tied: float = 1.5
    #: Another smoothing and hold than were given must divide the fraction by so much: half an interval looks like a
    #: delay.
    reread: float = 10.0
    #: A zero [rad] and a delay [s] that are off by less matter little.
    least_zero: float = math.radians(2.0)
    least_delay: float = 0.01
    #: How many times the angle at which friction holds a hanging link a zero must be off.
    friction_angles: float = 1.3
    #: Link 2 is no denser [kg/m^3], all its mass in a cube as wide as its centre of mass is far from its joint (real
    #: rigs: 16 to 80, steel: 7800), unless a less dense one leaves no more than so many times as much.
    densest: float = 5000.0
    denser: float = 1.01
    #: A link's length must be off by so many standard errors and by this part of it.
    length_errors: float = 5.0
    length_part: float = 0.1


SETTINGS = DiagnosisSettings()
#: By joint, the numbers of the parameters whose columns depend on its zero: P4 and P5, P3 and P5.
TURNING = ([3, 4], [2, 4])


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
        corrected_conversion: how they are then read.
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
    corrected_conversion: Conversion | None = None

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
_OPPOSITE = (
    'the elbow turns the other way than the shoulder',
    "negate the elbow's position and effort (or the shoulder's)",
)
_TO_HANGING = "negate the shoulder's position, so that hanging is -90 degrees"
_NO_SHIFT = (0.0, 0.0)
_DEGREE = math.pi / 180
_IN_RADIANS = ((_DEGREE, 0.0), (0.0, _DEGREE))
_MIRROR, _FROM_HORIZONTAL = f"the shoulder's position {_NEGATED}", ', as measured from the horizontal'
_JOINTS, _POSITIONS = f'the joints {_DISORDERED}', f"the joints' positions {_DISORDERED}"
_ABSOLUTE = 'absolute', "the elbow's position is absolute", "subtract the shoulder's position"
_DEGREES, _UPRIGHT = 'the positions are in degrees', ((1 - _DEGREE) * math.pi / 2, 0.0)
#: Faults of sense or order: name, what is wrong, what to do, and what undoes it: matrices for angles from hanging and
#: for efforts, and what is then added to the positions [rad] where they were turned about another zero than hanging.
_TURNS: tuple[tuple[str, str, str, Matrix, Matrix, Pair], ...] = (
    ('sign', f"the elbow's position {_NEGATED}", "negate the elbow's position", _SECOND, _AS_IS, _NO_SHIFT),
    ('sign', *_OPPOSITE, _SECOND, _SECOND, _NO_SHIFT),
    ('sign', f'the effort {_NEGATED}', 'negate the effort (or both positions)', _AS_IS, _BOTH, _NO_SHIFT),
    ('sign', _MIRROR, "negate the shoulder's position (or the elbow's and the effort)", _FIRST, _AS_IS, _NO_SHIFT),
    ('sign', _MIRROR + _FROM_HORIZONTAL, _TO_HANGING, _FIRST, _AS_IS, _MIRRORED),
    ('sign', f"the shoulder's effort {_NEGATED}", "negate the shoulder's effort", _AS_IS, _FIRST, _NO_SHIFT),
    ('sign', f"the elbow's effort {_NEGATED}", "negate the elbow's effort", _AS_IS, _SECOND, _NO_SHIFT),
    ('order', _JOINTS, 'exchange the joints', _EXCHANGED, _EXCHANGED, _NO_SHIFT),
    ('order', _POSITIONS, 'exchange the positions', _EXCHANGED, _AS_IS, _NO_SHIFT),
    ('order', _JOINTS, 'exchange the joints', _EXCHANGED, _EXCHANGED, _SWAPPED),
    ('order', _POSITIONS, 'exchange the positions', _EXCHANGED, _AS_IS, _SWAPPED),
    ('order', f"the joints' efforts {_DISORDERED}", 'exchange the efforts', _AS_IS, _EXCHANGED, _NO_SHIFT),
    (*_ABSOLUTE, _RELATIVE, _AS_IS, _NO_SHIFT),
    (*_ABSOLUTE, _RELATIVE, _AS_IS, _LIFTED),
    ('degrees', _DEGREES, 'convert them', _IN_RADIANS, _AS_IS, _UPRIGHT),
    ('degrees', f'{_DEGREES} from hanging', 'convert them', _IN_RADIANS, _AS_IS, (-_DEGREE * math.pi / 2, 0.0)),
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
    rig = _Rig(tuple(m for m in motions if m.recorded.duration >= SETTINGS.shortest), delay)
    if not any(t.tau.any() for t in rig.trajectories):
        return ()
    corrected, left, faults = _corrected(rig)
    if faults or left > SETTINGS.unfit:
        # Of spoiled data smoothing and hold, where these were chosen from them, are spoiled as well.
        how = min(smoothing, SMOOTHING), 'linear' if hold == 'zero' else 'zero'
        other = tuple(Motion.prepare(t, *how) for t in rig.trajectories)
        if (found := _corrected(_Rig(other, delay)))[1] * SETTINGS.reread < left:
            corrected, left, faults = found
    if not faults:
        faults = _unfit(rig)
    faults += _unit(corrected)
    if expected_link_length is not None:
        length, error = link_length(corrected.motions, model, corrected.delay)
        tolerance = max(SETTINGS.length_errors * error, SETTINGS.length_part * expected_link_length)
        if abs(length - expected_link_length) > tolerance:
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


def with_options(faults: Iterable[Fault], reading: Conversion) -> tuple[Fault, ...]:
    """Return faults with the options that put them right, each after those before it, where recordings are read so."""
    said = []
    for fault in faults:
        corrected_conversion = None if fault.change is None else reading.then(fault.change)
        if corrected_conversion is not None:
            added, gone = (
                [option for option in one.options() if option not in other.options()]
                for one, other in ((corrected_conversion, reading), (reading, corrected_conversion))
            )
            words = [f'add {" ".join(added)}'] * bool(added) + [f'leave out {" ".join(gone)}'] * bool(gone)
            fault, reading = (
                replace(fault, options=tuple(words), corrected_conversion=corrected_conversion),
                corrected_conversion,
            )
        said.append(fault)
    return tuple(said)


def _corrected(rig: _Rig) -> tuple[_Rig, float, list[Fault]]:
    """Return the corrected rig, the fraction that it leaves, and what was wrong; the rig as it is if nothing helps.

    The best correction is applied, and the rig diagnosed again, for two faults at most.
    """
    corrected, left, faults = rig, rig.unexplained, list[Fault]()
    for kinds in ((_turns, _zeros, _offsets, _delays), (_zeros, _offsets, _delays)):
        if left < SETTINGS.flawless:
            break
        # Of those that leave the very same only the first: on a pendubot the effort is the shoulder's alone.
        found: dict[float, _Correction] = {}
        for fault, right in chain.from_iterable(kind(corrected) for kind in kinds):
            found.setdefault(fault.put_right, (fault, right))
        # Two faults are less likely than one.
        if not found or (faults and min(found) * SETTINGS.tied > left):
            break
        fault, right = found[min(found)]
        tied = [found[after][0].found for after in sorted(found) if after <= SETTINGS.tied * min(found)]
        severe = fault.name in _WHAT_IS_EXPECTED or left > SETTINGS.severe * fault.put_right
        level = Level.ERROR if severe else Level.WARN
        faults.append(replace(fault, found=', or '.join(tied), level=level, unexplained=left))
        corrected, left = right, fault.put_right
    return (corrected, left, faults) if left < SETTINGS.sound else (rig, rig.unexplained, [])


def _unit(rig: _Rig) -> list[Fault]:
    """Return that the effort is in mN m, where otherwise no link could be as heavy for its length.

    m2 is at least P5^2 / P2, and d2 at most P2 / P5.
    """
    P2, P5 = rig.theta[1], rig.theta[4]
    left, least = rig.unexplained, float((P5**5 / SETTINGS.densest) ** 0.25)
    if not 0 < P2 < least or left > SETTINGS.sound:
        return []
    if _unexplained(rig.criterion, BOUNDS.replaced('P2', least, least)) < SETTINGS.denser * left:
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
    left = rig.unexplained
    if rig.duration < SETTINGS.long_enough or moved.min() < SETTINGS.far_enough or left <= SETTINGS.unfit:
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
    Both are NaN where no motion is as long as the test function: ``energy`` is satisfied with less.
    """
    motions = [motion for motion in motions if motion.end - motion.start > WIDTH + abs(delay)]
    if not motions:
        return math.nan, math.nan
    parts = _elbows_own(motions, model, delay)
    ratios = _pooled(parts).free_minimum()
    _, std_error, *_ = regression_covariance(parts, ratios, np.ones(len(ratios), dtype=bool))
    return float(ratios[0]), float(std_error[0])


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
        """The weak-form residuals of each motion, made once."""
        weights, stride = SETTINGS.weights, SETTINGS.stride
        made = partial(weak_regression, model=MODEL, delay=self.delay, weights=weights, stride=stride, coarse=True)
        return [motion.once(('conventions', self.delay), partial(made, motion)) for motion in self.motions]

    @cached_property
    def criterion(self) -> Quadratic:
        return _pooled(self.regressions)

    @cached_property
    def theta(self) -> Array:
        """The parameters of least residual, shape (D,)."""
        return self.criterion.minimum_in_box(BOUNDS)

    @property
    def effort(self) -> float:
        """The squared effort that is to be explained."""
        return self.criterion.count * float(self.criterion(np.zeros_like(self.theta)))

    @cached_property
    def unexplained(self) -> float:
        """The fraction of the squared effort that the model does not explain."""
        return _unexplained(self.criterion)

    @cached_property
    def elbow(self) -> float:
        """The same of the elbow's own equation, in which a light elbow counts as much as a heavy one."""
        criterion = _pooled(_elbows_own(self.motions, MODEL, self.delay))
        gravity = float(criterion(np.zeros_like(criterion.y)))
        return float(criterion(criterion.free_minimum())) / gravity if gravity > 0 else 0.0

    def changed(self, change: Affine) -> _Rig:
        return replace(self, motions=tuple(m.changed(change) for m in self.motions))

    def turned_by(self, joint: int, angle: float) -> _Rig:
        """Return the rig with an angle [rad] taken from a joint's position."""
        return self.changed(Affine.of(c=-angle * np.eye(2)[joint]))

    @cached_property
    def turned(self) -> list[list[Array]]:
        """For each joint the columns that depend on its zero, of the same motion turned by a right angle."""
        return [
            [part.phi[:, TURNING[joint]] for part in self.turned_by(joint, math.pi / 2).regressions] for joint in (0, 1)
        ]

    def slopes(self, joint: int) -> list[Array]:
        """Return the derivative of what theta explains by the error of a zero, for each motion."""
        return [columns @ self.theta[TURNING[joint]] for columns in self.turned[joint]]

    def tolerance(self, joint: int) -> float:
        """Return by how much a zero [rad] may be off that was set while the rig hung at rest."""
        values = dict(zip(NAMES, self.theta, strict=False))
        weight = GRAVITY * (values['P5'] + (values['P4'] if joint == 0 else 0.0))
        dry = values['Fc1' if joint == 0 else 'Fc2']
        held = math.asin(min(1.0, dry / weight)) if weight > 0 else math.pi / 2
        return max(SETTINGS.least_zero, SETTINGS.friction_angles * held / math.sqrt(len(self.motions)))

    @cached_property
    def tolerated(self) -> float:
        """The fraction that is left when both zeros are off by no more than their tolerances."""
        rows = zip(self.regressions, self.slopes(0), self.slopes(1), strict=True)
        criterion = _pooled(_beside(part, first, second) for part, first, second in rows)
        most = np.array([self.tolerance(0), self.tolerance(1)])
        names = (*BOUNDS.names, 'zero1', 'zero2')
        return _unexplained(criterion, Bounds(np.append(BOUNDS.lower, -most), np.append(BOUNDS.upper, most), names))

    def zero(self, joint: int) -> float:
        """Return the angle [rad] by which the zero of a joint is off: the residual is linear in its cosine and sine."""
        size, turning, step = len(BOUNDS.names), TURNING[joint], math.radians(15)
        criterion = _pooled(map(_beside, self.regressions, self.turned[joint]))

        def unexplained(angle: float) -> float:
            directions = np.eye(size + 2, size)
            directions[turning, turning], directions[[size, size + 1], turning] = math.cos(angle), math.sin(angle)
            return _unexplained(criterion.along(directions))

        nearest = min(np.arange(-math.pi, math.pi, step), key=unexplained)
        around = nearest - step, nearest + step
        return float(minimize_scalar(unexplained, bounds=around, method='bounded', options={'xatol': 1e-4}).x)

    def zero_error(self, joint: int) -> float:
        """Return the standard error of a zero [rad] that is right: of the coefficient of its derivative."""
        residuals = [_beside(part, slope) for part, slope in zip(self.regressions, self.slopes(joint), strict=True)]
        free = np.append(~BOUNDS.at_bound(self.theta, 1e-6), True)
        return float(regression_covariance(residuals, np.append(self.theta, 0.0), free)[1][-1])


#: A fault, and the rig put right.
_Correction = tuple[Fault, _Rig]


def _turns(rig: _Rig) -> Iterator[_Correction]:
    hanging = np.array(HANGING)
    moved = max(float(np.ptp(t.q, axis=0).max()) for t in rig.trajectories)
    for name, found, remedy, positions, efforts, shift in _TURNS:
        if name == 'degrees' and moved < SETTINGS.far_in_degrees:
            continue
        change = Affine.of(positions, hanging + shift - np.array(positions) @ hanging, efforts)
        right = rig.changed(change)
        try:
            after = right.unexplained
            # Of a light elbow a wrong sense changes little of all the effort.
            light = after < rig.tolerated and rig.elbow > SETTINGS.sound and right.elbow * SETTINGS.elbow < rig.elbow
        except TrajectoryError:  # read like this, the rig moves as none can
            continue
        # Where a sense makes more effort, work included, a smaller fraction of it is as much.
        if after * right.effort > SETTINGS.more_effort * rig.tolerated * rig.effort:
            continue
        if after * SETTINGS.turned < rig.tolerated or light:
            expected = f'{_WHAT_IS_EXPECTED[name]}: {remedy}'
            yield Fault(name, found, expected, put_right=after, change=change), right


def _zeros(rig: _Rig) -> Iterator[_Correction]:
    for joint, expected in enumerate(_ZEROS):
        angle = rig.zero(joint)
        right = rig.turned_by(joint, angle)
        after, tolerance = right.unexplained, right.tolerance(joint)
        if after * SETTINGS.shifted < rig.unexplained and abs(angle) > tolerance:
            degrees, error = math.degrees(angle), math.degrees(right.zero_error(joint))
            found = f"q{joint + 1}'s zero is off by {degrees:.1f} +- {error:.1g} degrees"
            remedy = f'{expected}: subtract {degrees:.1f} degrees'
            # A zero that somebody chose, and not one that is off.
            quarter = round(angle / (math.pi / 2)) * math.pi / 2
            chosen = quarter if quarter and abs(angle - quarter) < tolerance else angle
            change = Affine.of(c=-chosen * np.eye(2)[joint])
            yield Fault('zero', found, remedy, put_right=after, change=change), right


def _offsets(rig: _Rig) -> Iterator[_Correction]:
    """Yield what undoes a constant effort [N m] that was recorded at the shoulder and did not act."""

    def by(effort: float) -> _Rig:
        return rig.changed(Affine.of(d=(effort, 0.0)))

    most = max(float(np.abs(t.tau[:, 0]).max()) for t in rig.trajectories)
    if not most > 0 or rig.duration < SETTINGS.long_enough:
        return
    pairs = zip(rig.regressions, by(most).regressions, strict=True)
    criterion = _pooled(_beside(as_is, more.y - as_is.y) for as_is, more in pairs)
    offset = most * float(criterion.minimum_in_box(BOUNDS.beside(('offset',), 1.0))[-1])
    right = by(-offset)
    after = right.unexplained
    # Zeros that dry friction holds off look like a small offset.
    if after * SETTINGS.shifted < rig.tolerated and rig.tolerated - after > SETTINGS.least_offset:
        found = f"the shoulder's effort is off by a constant {offset:.3g} N m"
        remedy = f'it must be 0 where no torque acts: subtract {offset:.3g} N m'
        yield Fault('offset', found, remedy, put_right=after, change=Affine.of(d=(-offset, 0.0))), right


def _delays(rig: _Rig) -> Iterator[_Correction]:
    motions = rig.motions
    try:
        delay = estimate_delay(motions, MODEL, BOUNDS, weights=SETTINGS.weights)
    except TrajectoryError:  # too short for that
        return
    right = replace(rig, delay=delay)
    after = right.unexplained
    # Whether an effort was held or measured makes half an interval of difference, and is not known for certain.
    least = SETTINGS.least_delay + max(motion.interval for motion in motions) / 2
    if abs(delay - rig.delay) >= least and after * SETTINGS.shifted < rig.tolerated:
        late = round(1000 * (rig.delay - delay))
        what = f'is stamped {late} ms later than it acts' if late > 0 else f'acts {-late} ms later than it is stamped'
        remedy = f'each effort must bear the time from which it acts: identify with a delay of {delay:.3f} s'
        yield Fault('delay', f'the effort {what}', remedy, put_right=after, delay=delay), right


def _beside(part: Regression, *columns: Array) -> Regression:
    """Return residuals with more columns."""
    return Regression(np.column_stack([part.phi, *columns]), part.y, part.t)


def _pooled(parts: Iterable[Regression]) -> Quadratic:
    return Quadratic.pool([Quadratic.reduce(part.phi, part.y) for part in parts])


def _unexplained(criterion: Quadratic, bounds: Bounds = BOUNDS) -> float:
    """Return the part of the squared effort that no parameters within their bounds explain."""
    theta = criterion.minimum_in_box(bounds)
    effort = float(criterion(np.zeros_like(theta)))
    return float(criterion(theta)) / effort if effort > 0 else 1.0
