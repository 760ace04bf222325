# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A simulated rig that has what real rigs have and the package's model lacks. No code of the package is used.

Its own equations of motion (from the positions of both masses), its own Runge-Kutta integrator, and one number or two
for each effect, zero being none. All motions of a batch, shape (K,), are simulated side by side.
"""

from dataclasses import dataclass, field, fields
from types import SimpleNamespace

import numpy as np

GRAVITY = 9.81
STEP = 0.0005
#: Masses [kg], the lengths to their centres [m] and of link 1 [m], inertias about the centres [kg m^2].
M1, M2, C1, C2, L1, I1, I2 = 0.4, 0.3, 0.10, 0.11, 0.15, 0.0010, 0.0008
#: Viscous [N m s/rad] and dry friction [N m] of both joints.
B, FC = (0.003, 0.0008), (0.010, 0.004)
#: Of the motor behind a shaft or a backlash: inertia [kg m^2], stiffness [N m/rad] and damping [N m s/rad] of contact.
MOTOR, STIFF, DAMPED = 0.001, 60.0, 0.03

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
class Effects:
    """What the rig has beyond the model; see :data:`EFFECTS` for sensible sizes."""

    saturation: float = np.inf  # the motor gives no more [N m]
    sag: float = 0.0  # part of the torque that is missing at 0.35 N m, growing with its square
    lag: float = 0.0  # time constant between the recorded and the acting torque [s]
    offset: float = 0.0  # a torque at the shoulder that is not recorded [N m]
    drag: float = 0.0  # of the air, at both joints [N m s^2/rad^2]
    cogging: float = 0.0  # amplitude at the shoulder [N m], seven a turn
    spring: float = 0.0  # of a cable at the elbow [N m/rad]
    asymmetry: float = 0.0  # of dry friction between the two directions, as a part of it
    stribeck: float = 0.0  # more dry friction below 0.1 rad/s, as a part of it
    width: float = 0.05  # of the change of dry friction's sign [rad/s]; 0.05 is the model's
    drift: float = 0.0  # part of the friction that is gone at the end of the day, with 20 s as time constant
    tilt: float = 0.0  # of the plane of motion from the vertical [rad]
    stop: float = np.inf  # elbow's end stops [rad]
    pushes: int = 0  # by a hand, in each recording
    backlash: float = 0.0  # of the motor's gear, in all [rad]; the encoder is the link's
    shaft: float = 0.0  # softness between motor, with the encoder, and link 1 [rad/(N m)]
    eccentric: float = 0.0  # of the elbow's encoder: its error once a turn [rad]
    jitter: float = 0.0  # of the stamps, uniform +- [s]: not of the samples


EFFECTS = {
    'nothing': (Effects(), Effects()),
    'saturation': (Effects(saturation=0.30), Effects(saturation=0.22)),
    'sag': (Effects(sag=0.1), Effects(sag=0.3)),
    'lag': (Effects(lag=0.005), Effects(lag=0.02)),
    'offset': (Effects(offset=0.01), Effects(offset=0.04)),
    'drag': (Effects(drag=0.00005), Effects(drag=0.0003)),
    'cogging': (Effects(cogging=0.01), Effects(cogging=0.04)),
    'spring': (Effects(spring=0.005), Effects(spring=0.03)),
    'asymmetry': (Effects(asymmetry=0.3), Effects(asymmetry=0.8)),
    'stribeck': (Effects(stribeck=0.5), Effects(stribeck=2.0)),
    'width': (Effects(width=0.2), Effects(width=0.6)),
    'drift': (Effects(drift=0.3), Effects(drift=0.8)),
    'tilt': (Effects(tilt=0.05), Effects(tilt=0.17)),
    'stop': (Effects(stop=2.0), Effects(stop=1.2)),
    'push': (Effects(pushes=1), Effects(pushes=4)),
    'backlash': (Effects(backlash=0.01), Effects(backlash=0.05)),
    'shaft': (Effects(shaft=0.02), Effects(shaft=0.1)),
    'eccentric': (Effects(eccentric=0.005), Effects(eccentric=0.02)),
    'jitter': (Effects(jitter=0.0005), Effects(jitter=0.002)),
}


def true(effects):
    """Return the parameters of a rig: a motor behind a shaft or a backlash turns with link 1."""
    return TRUE | {'P1': TRUE['P1'] + (MOTOR if effects.backlash or effects.shaft else 0.0)}


@dataclass
class Recording:
    """What a bag would hold: stamps [s], positions [rad], the shoulder's torque [N m]; shapes (N,), (N, 2), (N,)."""

    t: np.ndarray
    q: np.ndarray
    tau: np.ndarray
    pushed: list = field(default_factory=list)  # begin and end [s] of each push


def accelerations(q1, q2, v1, v2, torque1, torque2, tilt=0.0):
    """Return both accelerations under the sum of torques about each joint (the elbow's acts on link 1 reversed)."""
    # Jacobians of the two centres, J1 = (-C1 s1, C1 c1) and J2 with both joints, and M = sum m J^T J + inertias.
    s1, c1, s12, c12 = np.sin(q1), np.cos(q1), np.sin(q1 + q2), np.cos(q1 + q2)
    x1, y1 = -L1 * s1 - C2 * s12, L1 * c1 + C2 * c12
    x2, y2 = -C2 * s12, C2 * c12
    m11 = M1 * C1**2 + M2 * (x1**2 + y1**2) + I1 + I2
    m12 = M2 * (x1 * x2 + y1 * y2) + I2
    m22 = M2 * (x2**2 + y2**2) + I2
    # What the second centre accelerates by though neither joint does.
    ax = -L1 * c1 * v1**2 - C2 * c12 * (v1 + v2) ** 2
    ay = -L1 * s1 * v1**2 - C2 * s12 * (v1 + v2) ** 2
    g = GRAVITY * np.cos(tilt)
    r1 = torque1 - M2 * (x1 * ax + y1 * (ay + g)) - M1 * g * C1 * c1
    r2 = torque2 - M2 * (x2 * ax + y2 * (ay + g))
    determinant = m11 * m22 - m12**2
    return (m22 * r1 - m12 * r2) / determinant, (m11 * r2 - m12 * r1) / determinant


def pulses(rng, samples, rate, strength, shortest, longest):
    """Return a torque that takes a new random value every so often, as its samples, shape (N,)."""
    held = rng.uniform(shortest, longest, int(samples / rate / shortest) + 2)
    values = rng.uniform(-strength, strength, held.size)
    return values[np.searchsorted(np.cumsum(held), np.arange(samples) / rate, side='right')]


def record(
    seeds, effects, *, seconds=10.0, rate=200.0, counts=4096, strength=0.35, held=(0.1, 0.5), begin=0.0, delay=0.0
):
    """Return one recording for each seed and its effects; ``begin`` [s] is how long each rig ran before (see drift)."""
    samples, every = round(seconds * rate), max(1, round(1 / rate / STEP))
    step, rngs = 1 / rate / every, [np.random.default_rng([seed, 19]) for seed in seeds]
    tau = np.array([pulses(rng, samples, rate, strength, *held) for rng in rngs])
    hands, pushed = np.zeros((2, samples * every, len(seeds))), []
    for k, (rng, rig) in enumerate(zip(rngs, effects, strict=True)):
        times = np.sort(rng.uniform(0.5, seconds - 0.7, rig.pushes))
        pushed.append([(at, at + 0.2) for at in times])
        for at in times:
            first = round(at / step)
            shape = np.sin(np.pi * np.arange(round(0.2 / step)) * step / 0.2)
            hands[rng.integers(2), first : first + shape.size, k] += rng.choice([-0.3, 0.3]) * shape
    e = SimpleNamespace(**{f.name: np.array([getattr(rig, f.name) for rig in effects]) for f in fields(Effects)})
    e.geared = (e.backlash > 0) | (e.shaft > 0)
    e.stiffness = np.where(e.shaft > 0, 1 / np.where(e.shaft > 0, e.shaft, 1.0), STIFF)
    x = np.zeros((7, len(seeds)))  # q1 q2 v1 v2, the motor's angle and speed, and the acting torque
    x[0] = x[4] = -np.pi / 2
    read = np.empty((samples, 2, len(seeds)))
    behind = round(delay / step)
    for n in range(samples * every):
        if n % every == 0:
            read[n // every] = np.where(e.shaft > 0, x[4], x[0]), x[1]
        recorded = tau[:, (n - behind) // every] if n >= behind else np.zeros(len(seeds))
        x = _advance(x, recorded, hands[:, n], e, np.asarray(begin) + n * step, step)
    q = np.moveaxis(read, 2, 0)
    q[:, :, 1] += e.eccentric[:, None] * np.sin(q[:, :, 1])
    unit = 2 * np.pi / counts
    q = np.round(q / unit) * unit
    t = np.arange(samples) / rate
    stamps = [t + rng.uniform(-rig.jitter, rig.jitter, samples) for rng, rig in zip(rngs, effects, strict=True)]
    return [Recording(*each) for each in zip(stamps, q, tau, pushed, strict=True)]


def _advance(x, recorded, hand, e, now, h):
    a = _slope(x, recorded, hand, e, now)
    b = _slope(x + h / 2 * a, recorded, hand, e, now)
    c = _slope(x + h / 2 * b, recorded, hand, e, now)
    d = _slope(x + h * c, recorded, hand, e, now)
    return x + h / 6 * (a + 2 * b + 2 * c + d)


def _slope(x, recorded, hand, e, now):
    q1, q2, v1, v2, angle, speed, lagging = x
    wanted = np.clip(recorded * (1 - e.sag * (recorded / 0.35) ** 2), -e.saturation, e.saturation)
    late = e.lag > 0
    acting = np.where(late, lagging, wanted)
    worn = 1 - e.drift * (1 - np.exp(-now / 20))
    loss = [_friction(v, k, e) * worn + e.drag * v * abs(v) for k, v in enumerate((v1, v2))]
    beyond = np.sign(q2) * np.maximum(abs(q2) - e.stop, 0)
    on2 = hand[1] - loss[1] - e.spring * q2 - np.where(beyond != 0, 20.0 * beyond + 0.05 * v2, 0)
    on1 = hand[0] - loss[0] + e.offset + e.cogging * np.sin(7 * q1 + 1)
    twist = np.sign(angle - q1) * np.maximum(abs(angle - q1) - e.backlash / 2, 0)
    through = e.stiffness * twist + np.where(twist != 0, DAMPED * (speed - v1), 0)
    drive = np.where(e.geared, through, acting)
    a1, a2 = accelerations(q1, q2, v1, v2, on1 + drive, on2, e.tilt)
    motor = np.where(e.geared, (acting - through) / MOTOR, a1)
    return np.array([v1, v2, a1, a2, speed, motor, np.where(late, (wanted - lagging) / np.where(late, e.lag, 1), 0)])


def _friction(v, joint, e):
    rest = FC[joint] * (1 + e.asymmetry * np.sign(v) / 2) * (1 + e.stribeck * np.exp(-((v / 0.1) ** 2)))
    return B[joint] * v + rest * np.tanh(v / e.width)
