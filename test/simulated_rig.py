# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A simulated rig with the imperfections of real ones. It shares no code with the package.

It has its own equations of motion, from the positions of the bodies, and its own Runge-Kutta integrator. K motions are
simulated at once. The fields of :class:`Rig` are the size and the imperfections.
"""

from dataclasses import dataclass, field, fields
from functools import partial
from types import SimpleNamespace

import numpy as np

GRAVITY = 9.81
STEP = 0.0005
#: Masses [kg], distances of the centres of mass [m], length of link 1 [m], inertias about the centres [kg m^2].
M1, M2, C1, C2, L1, I1, I2 = 0.4, 0.3, 0.10, 0.11, 0.15, 0.0010, 0.0008
#: Viscous [N m s/rad] and Coulomb friction [N m] of both joints; speed [rad/s] of the change of sign of the latter.
B, FC, WIDTH = (0.003, 0.0008), (0.010, 0.004), 0.05
#: Largest recorded torque [N m].
STRENGTH = 0.35
#: Inertia of a motor behind a shaft or a backlash [kg m^2]; stiffness [N m/rad] and damping [N m s/rad] of contact.
MOTOR, STIFF, DAMPED = 0.001, 60.0, 0.03
#: Mass [kg] and damping ratio of a swaying base.
BASE, BASE_DAMPING = 3.0, 0.05
#: Time constants of friction and of the motor's temperature [s]; time at which a clamp comes off [s].
WARMING, HEATING, LOOSENED = 20.0, 30.0, 20.0
#: Speed of the added Stribeck friction [rad/s]; it is 0.5 in the package's model.
STRIBECK = 0.1
#: Angles of both joints while the rig hangs, and phases of the variation of friction [rad].
HANGING, RUB_PHASES = np.array([[-np.pi / 2], [0.0]]), np.array([[0.5], [1.5]])

TRUE = {
    'P1': M1 * C1**2 + M2 * L1**2 + I1,
    'P2': M2 * C2**2 + I2,
    'P3': M2 * L1 * C2,
    'P4': M1 * C1 + M2 * L1,
    'P5': M2 * C2,
    'b1': B[0],
    'b2': B[1],
    'Fc1': FC[0],
    'Fc2': FC[1],
}


@dataclass(frozen=True)
class Rig:
    """The size of a rig, and its imperfections; the defaults are the package's model."""

    length: float = 1.0  # scale of all lengths
    mass: float = 1.0  # scale of all masses
    strength: float = 1.0  # scale of the torque
    # Effects of the estimator's catalogue.
    saturation: float = np.inf  # largest torque of the motor [N m]
    dead_zone: float = 0.0  # the driver subtracts this much from every torque [N m]
    no_load: float = np.inf  # speed [rad/s] at which back-EMF leaves no torque
    lag: float = 0.0  # time constant between the recorded and the acting torque [s]
    offset: float = 0.0  # unrecorded torque at the shoulder [N m]
    asymmetry: float = 0.0  # of Coulomb friction between the two directions, as a fraction of it
    width: float = WIDTH  # speed over which Coulomb friction changes sign [rad/s]
    stribeck: float = 0.0  # additional Coulomb friction below STRIBECK, as a fraction of it
    drag: float = 0.0  # aerodynamic drag at both joints [N m s^2/rad^2]
    spring1: float = 0.0  # of a cable at the shoulder [N m/rad]
    spring2: float = 0.0  # of a cable at the elbow [N m/rad]
    drift: float = 0.0  # final decrease of friction, as a fraction, with time constant WARMING
    cogging1: tuple = (0.0, 1)  # amplitude [N m] and periods per turn, at the shoulder
    cogging2: tuple = (0.0, 1)  # the same at the elbow
    eccentric: float = 0.0  # error of the elbow's encoder, with one period per turn [rad]
    # Motor.
    heat: float = 0.0  # torque that a hot motor loses, as a fraction, with time constant HEATING
    quantised: float = 0.0  # step of the torque that the driver applies [N m]
    # Gear.
    backlash: float = 0.0  # total backlash between motor and link 1 [rad]; the encoder is on the link
    shaft: float = 0.0  # compliance between motor, with the encoder, and link 1 [rad/(N m)]
    rub: float = 0.0  # variation of friction with one period per turn, as a fraction
    # Mount.
    sway: float = np.inf  # horizontal eigenfrequency of the base [Hz]
    lean: float = 0.0  # tilt of the base in the plane of motion after its zeros were set [rad]
    # Sensors.
    slip: float = 0.0  # angle that the elbow's encoder loses, three times [rad]
    jitter: float = 0.0  # of the stamps, uniform +- [s]; sampling is regular
    # Wiring.
    dropped: float = 0.0  # fraction of missing samples
    swapped: float = 0.0  # fraction of samples swapped with the next sample
    # Handling.
    stop: float = np.inf  # elbow's end stops [rad]
    cable: float = 0.0  # largest torque of a cable that touches link 2 over half a turn [N m]
    loose: float = 0.0  # mass of a clamp until LOOSENED, as a fraction of link 2's mass
    pushes: int = 0  # number of pushes by hand in each recording


def times(name, *values):
    """Return rigs with one imperfection, at these strengths."""
    return tuple(Rig(**{name: value}) for value in values)


#: Effects of the estimator's catalogue: weak, medium and strong.
CATALOGUE = {
    'saturation': times('saturation', 0.30, 0.26, 0.22),
    'dead zone': times('dead_zone', 0.005, 0.015, 0.04),
    'back-EMF': times('no_load', 30.0, 20.0, 12.0),
    'lag': times('lag', 0.005, 0.01, 0.02),
    'offset': times('offset', 0.01, 0.02, 0.04),
    'asymmetry': times('asymmetry', 0.3, 0.5, 0.8),
    'width': times('width', 0.015, 0.2, 0.6),
    'stribeck': times('stribeck', 0.5, 1.0, 2.0),
    'drag': times('drag', 0.00005, 0.00012, 0.0003),
    'spring, shoulder': times('spring1', 0.005, 0.012, 0.03),
    'spring, elbow': times('spring2', 0.005, 0.012, 0.03),
    'drift': times('drift', 0.3, 0.5, 0.8),
    'eccentricity': times('eccentric', 0.005, 0.01, 0.02),
    'cogging, shoulder, 7 a turn': times('cogging1', (0.01, 7), (0.02, 7), (0.04, 7)),
    'cogging, shoulder, 18 a turn': times('cogging1', (0.01, 18), (0.02, 18), (0.04, 18)),
    'cogging, elbow, 4 a turn': times('cogging2', (0.002, 4), (0.004, 4), (0.008, 4)),
    'cogging, elbow, 11 a turn': times('cogging2', (0.002, 11), (0.004, 11), (0.008, 11)),
}
#: Imperfections outside the catalogue.
UNKNOWN = {
    'heat': times('heat', 0.05, 0.1, 0.2),
    'quantised torque': times('quantised', 0.01, 0.03, 0.07),
    'backlash': times('backlash', 0.01, 0.02, 0.05),
    'shaft': times('shaft', 0.02, 0.05, 0.1),
    'rub': times('rub', 0.2, 0.5, 0.9),
    'sway': times('sway', 15.0, 8.0, 4.0),
    'lean': times('lean', 0.005, 0.02, 0.06),
    'slip': times('slip', 0.01, 0.03, 0.1),
    'jitter': times('jitter', 0.0005, 0.001, 0.002),
    'dropped': times('dropped', 0.01, 0.05, 0.2),
    'swapped': times('swapped', 0.005, 0.02, 0.05),
    'stop': times('stop', 2.0, 1.6, 1.2),
    'cable': times('cable', 0.005, 0.015, 0.05),
    'loose': times('loose', 0.01, 0.03, 0.1),
    'push': times('pushes', 1, 2, 4),
}
#: Sizes: links of 3, 15 and 50 cm.
SIZES = {'tiny': Rig(length=0.2, mass=0.2, strength=0.14), 'present': Rig(), 'large': Rig(length=10 / 3, mass=3.0)}


def true(rig):
    """Return the parameters of a rig without its imperfections; a motor behind a gear adds its inertia to P1."""
    force = rig.mass * rig.length
    unit = {'P1': force * rig.length, 'P4': force, 'b1': force * rig.length**0.5, 'Fc1': force}
    unit |= {'P2': unit['P1'], 'P3': unit['P1'], 'P5': force, 'b2': unit['b1'], 'Fc2': force}
    values = {name: value * unit[name] for name, value in TRUE.items()}
    return values | {'P1': values['P1'] + (MOTOR if rig.backlash or rig.shaft else 0.0)}


@dataclass
class Recording:
    """Stamps [s], shape (N,), positions [rad], (N, 2), and the shoulder's torque [N m], (N,)."""

    t: np.ndarray
    q: np.ndarray
    tau: np.ndarray
    pushed: list = field(default_factory=list)  # begin and end [s] of each push


def bodies(length=1.0, mass=1.0, more=0.0):
    """Return the constants of scaled rigs; ``more`` is the added mass of link 2, as a fraction."""
    second = mass * (1 + np.asarray(more))
    inertia = np.asarray(length) ** 2
    return linked(
        L1 * length, M1 * mass, C1 * length, I1 * mass * inertia, M2 * second, C2 * length, I2 * second * inertia
    )


def linked(l1, m1, c1, i1, m2, c2, i2):
    """Return the constants of the equations of motion from those of both links."""
    return SimpleNamespace(
        rods=np.array(np.broadcast_arrays(l1, c2)),  # from the shoulder to the elbow, and on to the centre of link 2
        m1=m1,
        m2=m2,
        moment=m1 * c1,
        m11=m1 * c1**2 + i1 + i2,  # without the distance of link 2's centre from the shoulder
        m22=m2 * c2**2 + i2,
        i2=i2,
    )


def accelerations(q, v, torque, b, gravity=(0.0, GRAVITY), base=None):
    """Return both accelerations under the total torque about each joint (the elbow's acts on link 1 with minus sign).

    ``gravity``: towards -x and -y [m/s^2]. ``base``: mass [kg] of a swaying base and force on it [N]; its acceleration
    is the third return value.
    """
    q1, v1 = q[0], v[0]
    # Link 2's centre lies at (x1, y1) from the shoulder and (x2, y2) from the elbow, and moves at right angles to both:
    # M = sum m (x x + y y) + inertias.
    angles = np.array([q1, q1 + q[1]])
    cosines, sines = np.cos(angles), np.sin(angles)
    x, y = b.rods * cosines, b.rods * sines
    (_, x2), (_, y2) = x, y
    x1, y1 = x[0] + x2, y[0] + y2
    m11 = b.m11 + b.m2 * (x1**2 + y1**2)
    m12 = b.i2 + b.m2 * (x1 * x2 + y1 * y2)
    m22 = b.m22
    # Acceleration of the second centre of mass at constant joint velocities.
    squares = np.array([v1, v1 + v[1]]) ** 2
    centripetal_x, centripetal_y = x * squares, y * squares
    ax, ay = -centripetal_x[0] - centripetal_x[1], -centripetal_y[0] - centripetal_y[1]
    gx, gy = gravity
    fx, fy = b.m2 * (ax + gx), b.m2 * (ay + gy)
    r1 = torque[0] - (x1 * fy - y1 * fx) - b.moment * (gy * cosines[0] - gx * sines[0])
    r2 = torque[1] - (x2 * fy - y2 * fx)
    determinant = m11 * m22 - m12**2
    a1, a2 = (m22 * r1 - m12 * r2) / determinant, (m11 * r2 - m12 * r1) / determinant
    if base is None:
        return a1, a2
    # Base acceleration a0: M a + h a0 = r, and h a + (total mass) a0 = force on the base - inertial force of the links.
    h1, h2 = -b.m2 * y1 - b.moment * sines[0], -b.m2 * y2
    d1, d2 = (m22 * h1 - m12 * h2) / determinant, (m11 * h2 - m12 * h1) / determinant
    heavy, force = base
    exerted = b.m2 * ax - b.moment * cosines[0] * v1**2
    a0 = (force - exerted - h1 * a1 - h2 * a2) / (heavy + b.m1 + b.m2 - h1 * d1 - h2 * d2)
    return a1 - d1 * a0, a2 - d2 * a0, a0


def pulses(rng, samples, rate, strength, shortest, longest):
    """Return a piecewise constant random torque, shape (N,)."""
    held = rng.uniform(shortest, longest, int(samples / rate / shortest) + 2)
    values = rng.uniform(-strength, strength, held.size)
    return values[np.searchsorted(np.cumsum(held), np.arange(samples) / rate, side='right')]


def record(seeds, rigs, *, seconds=10.0, rate=200.0, counts=4096, begin=0.0, step=STEP):
    """Return one recording for each seed and rig.

    ``counts``: of the encoders, per rig or for all; ``begin``: time for which each rig ran before [s]; ``step``: of the
    integration [s]. It and the time for which a torque is held, 0.1 to 0.5 s, are scaled to the time scale of the rig.
    """
    samples = round(seconds * rate)
    begin = np.broadcast_to(begin, len(seeds))
    e = SimpleNamespace(**{f.name: np.array([getattr(rig, f.name) for rig in rigs]).T for f in fields(Rig)})
    slowness = np.sqrt(e.length)
    every = max(1, int(np.ceil(1 / rate / (step * slowness.min()) - 1e-9)))
    h = 1 / rate / every
    rngs = [np.random.default_rng([seed, 19]) for seed in seeds]
    e.unit = e.mass * e.length
    e.viscous, e.dry = np.outer(B, e.unit * slowness), np.outer(FC, e.unit)
    e.springs = np.array([e.spring1, e.spring2])
    e.cogging = np.array([e.cogging1, e.cogging2]).swapaxes(0, 1)
    shapes = zip(rngs, STRENGTH * e.unit * e.strength, slowness, strict=True)
    tau = np.array([pulses(rng, samples, rate, most, 0.1 * s, 0.5 * s) for rng, most, s in shapes])
    hands, pushed = _pushed(rngs, e, seconds, h, samples * every)
    e.bodies = bodies(e.length, e.mass, e.loose * (begin < LOOSENED))
    e.geared = (e.backlash > 0) | (e.shaft > 0)
    e.stiffness = np.where(e.shaft > 0, 1 / np.where(e.shaft > 0, e.shaft, 1.0), STIFF)
    e.swaying = np.isfinite(e.sway)
    e.base = np.where(e.swaying, BASE, np.inf), 2 * np.pi * np.where(e.swaying, e.sway, 0.0)
    e.gravity = GRAVITY * np.sin(e.lean), GRAVITY * np.cos(e.lean)
    e.any = SimpleNamespace(
        **{f.name: any(getattr(rig, f.name) != f.default for rig in rigs) for f in fields(Rig)},
        geared=e.geared.any(),
        friction=any((rig.stribeck, rig.asymmetry, rig.rub) != (0, 0, 0) for rig in rigs),
    )
    acting = _driven(tau, e, begin, rate)
    x = np.zeros((9, len(seeds)))  # q1 q2 v1 v2, motor angle and speed, acting torque, base position and speed
    x[:2], x[4] = HANGING, HANGING[0]
    read = np.empty((samples, 2, len(seeds)))
    for n in range(samples * every):
        if n % every == 0:
            read[n // every] = np.where(e.shaft > 0, x[4], x[0]), x[1]
        e.worn = 1 - e.drift * (1 - np.exp(-(begin + n * h) / WARMING)) if e.any.drift else 1.0
        hand = hands[:, n] if hands is not None else 0.0
        x = runge_kutta(partial(_slope, wanted=acting[:, n // every], hand=hand, e=e), x, h)
    counts = np.broadcast_to(counts, len(seeds))
    q = np.moveaxis(read, 2, 0)
    motions = zip(rngs, rigs, q, tau, counts, pushed, strict=True)
    return [_sampled(*motion, np.arange(samples) / rate) for motion in motions]


def _pushed(rngs, e, seconds, h, steps):
    """Return the torques of pushes by hand, shape (2, steps, K), None without pushes, and their begins and ends."""
    pushed = []
    hands = np.zeros((2, steps, len(rngs))) if e.pushes.any() else None
    shape = np.sin(np.pi * np.arange(round(0.2 / h)) * h / 0.2)
    for k, rng in enumerate(rngs):
        begins = np.sort(rng.uniform(0.5, seconds - 0.7, e.pushes[k]))
        pushed.append([(at, at + 0.2) for at in begins])
        for at in begins:
            first = round(at / h)
            hands[rng.integers(2), first : first + shape.size, k] += rng.choice([-0.3, 0.3]) * e.unit[k] * shape
    return hands, pushed


def _driven(tau, e, begin, rate):
    """Return the torque that the driver commands for the recorded torque, shape (K, N)."""
    column = SimpleNamespace(**{n: getattr(e, n)[:, None] for n in ('dead_zone', 'quantised', 'heat', 'saturation')})
    acting = np.sign(tau) * np.maximum(abs(tau) - column.dead_zone, 0)
    if e.any.quantised:
        coarse = np.where(column.quantised > 0, column.quantised, 1.0)
        acting = np.where(column.quantised > 0, np.round(acting / coarse) * coarse, acting)
    if e.any.heat:
        heated = np.empty_like(tau)
        warm = 1 - np.exp(-begin / HEATING)
        power = tau**2 / (tau**2).mean(axis=1, keepdims=True)
        for n in range(tau.shape[1]):
            heated[:, n] = warm
            warm = warm + (power[:, n] - warm) / HEATING / rate
        acting = acting * (1 - column.heat * heated)
    return np.clip(acting, -column.saturation, column.saturation)


def _sampled(rng, rig, q, tau, counts, pushed, t):
    """Return the recording of a motion by imperfect sensors and wiring."""
    samples = len(t)
    q = q.copy()
    q[:, 1] += rig.eccentric * np.sin(q[:, 1])
    if rig.slip:
        for at in rng.uniform(0, t[-1], 3):
            q[t > at, 1] += rng.choice([-1, 1]) * rig.slip
    unit = 2 * np.pi / counts
    q = np.round(q / unit) * unit
    if rig.swapped:
        first = rng.choice(samples // 2 - 1, round(rig.swapped * samples), replace=False) * 2
        order = np.arange(samples)
        order[first], order[first + 1] = first + 1, first
        q, tau = q[order], tau[order]
    stamps = t + rng.uniform(-rig.jitter, rig.jitter, samples) if rig.jitter else t
    kept = rng.uniform(size=samples) >= rig.dropped if rig.dropped else slice(None)
    return Recording(stamps[kept], q[kept], tau[kept], pushed)


def runge_kutta(slope, x, h):
    """Return the state after a step h of the classical Runge-Kutta method of order 4."""
    a = slope(x)
    b = slope(x + h / 2 * a)
    c = slope(x + h / 2 * b)
    return x + h / 6 * (a + 2 * b + 2 * c + slope(x + h * c))


def _slope(x, wanted, hand, e):
    q, v, (angle, speed, lagging, place, sway) = x[:2], x[2:4], x[4:]
    used = e.any
    if used.no_load:
        least = -STRENGTH * np.maximum(1 + v[0] / e.no_load, 0)
        wanted = np.clip(wanted, least, STRENGTH * np.maximum(1 - v[0] / e.no_load, 0))
    acting = np.where(e.lag > 0, lagging, wanted) if used.lag else wanted
    torque = hand - _friction(q, v, e)
    if used.spring1 or used.spring2:
        torque -= e.springs * (q - HANGING)
    if used.cogging1 or used.cogging2:
        amplitude, periods = e.cogging
        torque += amplitude * np.sin(periods * q + 1)
    if used.stop:
        beyond = np.sign(q[1]) * np.maximum(abs(q[1]) - e.stop, 0)
        torque[1] -= np.where(beyond != 0, 20.0 * beyond + 0.05 * v[1], 0)
    if used.cable:
        torque[1] -= e.cable * np.maximum(np.sin(q[1] - 1), 0) * (1 + 0.5 * np.tanh(v[1] / 0.2))
    slope = np.zeros_like(x)
    if used.geared:
        twist = np.sign(angle - q[0]) * np.maximum(abs(angle - q[0]) - e.backlash / 2, 0)
        through = e.stiffness * twist + np.where(twist != 0, DAMPED * (speed - v[0]), 0)
        slope[4], slope[5] = speed, np.where(e.geared, (acting - through) / MOTOR, 0)
        acting = np.where(e.geared, through, acting)
    torque[0] += acting + e.offset
    slope[:2] = v
    if used.sway:
        mass, frequency = e.base
        force = -BASE * (frequency**2 * place + 2 * BASE_DAMPING * frequency * sway)
        slope[2], slope[3], slope[8] = accelerations(q, v, torque, e.bodies, e.gravity, (mass, force))
        slope[7] = sway
    else:
        slope[2], slope[3] = accelerations(q, v, torque, e.bodies, e.gravity)
    if used.lag:
        slope[6] = np.where(e.lag > 0, (wanted - lagging) / np.where(e.lag > 0, e.lag, 1), 0)
    return slope


def _friction(q, v, e):
    dry = e.dry
    if e.any.friction:
        dry = dry * (1 + e.asymmetry * np.sign(v) / 2) * (1 + e.stribeck * np.exp(-((v / STRIBECK) ** 2)))
        dry = dry * (1 + e.rub * np.sin(q + RUB_PHASES))
    friction = (e.viscous * v + dry * np.tanh(v / e.width)) * e.worn
    return friction + e.drag * v * abs(v) if e.any.drag else friction
