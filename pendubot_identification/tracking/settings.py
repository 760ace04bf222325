# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Settings of the tracker, each with its unit and reason."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TrackerSettings:
    """Thresholds of tests and standard deviations of priors and random walks."""

    # Start.
    first: float = 8.0  #: Motion that delay, smoothing and noise are estimated from [s].
    longest_first: float = 30.0  #: The newest seconds of a longer first motion are used [s].
    pause: float = 2.0  #: Between two attempts to start [s]; each failure doubles it, so that they cost little.
    longest_pause: float = 120.0  #: Longest pause [s]; tracking for longer resets the pause.
    carried_over: float = 0.02  #: Relative deviation of P1 to P5 from a file: of another day or criterion.
    friction_carried_over: float = 0.3  #: Relative deviation of friction from a file.
    #: Factor of the mean square residual that rejects a file on a rig with unmodelled effects: single recordings of two
    #: real rigs give 1.1 to 6.4 with their own parameters, and 26 to 2100 with those of the other.
    rejected: float = 15.0

    # Filter. Random walks are relative to each unknown's scale, per root of a second.
    friction_walk: float = 2e-3  #: Friction changes within minutes, as grease warms.
    inertia_walk: float = 5e-6  #: All else hardly changes, except by steps; also the deviation of a given unknown.
    rate_walk: float = 1e-2  #: The rate of a gradual change changes within hours.
    noise_memory: int = 400  #: Blocks over which the noise is averaged: about three minutes of motion.

    # Tests.
    false_alarm: float = 1e-9  #: Probability of each test under its null hypothesis: one false alarm in 1e5 h.
    window: int = 8  #: Blocks in which a change is searched, 3.2 s; half of them for a change without a name.
    change: float = 4.0  #: Factor of the gate that the ratio of a step exceeds; a drift explains smaller ones.
    explained: float = 3.0  #: Largest mean square that a step leaves in a window: noise leaves up to 2.
    lost: int = 20  #: Consecutive unexplained blocks after which tracking restarts: 8 s.

    # Report.
    unmodelled: float = 1.5  #: RMS residual divided by that of quantization; beyond it a rig has unmodelled effects.
    #: Blocks with a common error on such rigs, by which variances grow: the motion of 8 s. Recordings of 6 to 10 s of
    #: two real rigs differ by about so much more than blocks do.
    common: int = 20
    heavy_tails: float = 2.0  #: Factor of the gate on such rigs, whose errors are not normal.
    idle: float = 10.0  #: Time without motion that is reported [s].
    tilt: float = 5e-3  #: Tilt that is reported [rad]: zeros are hardly set more exactly.
    dead_zone: float = 2e-3  #: Dead zone that is reported, as a part of the RMS effort: it is hardly known better.
