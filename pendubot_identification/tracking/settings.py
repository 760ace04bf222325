# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Settings of the tracker, each with its unit and reason."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TrackerSettings:
    """Thresholds of tests and standard deviations of priors and random walks."""

    # Start.
    first: float = 8.0  #: Duration of the motion that determines delay, smoothing and noise [s].
    longest_first: float = 30.0  #: Longest first motion [s]; of a longer one, the newest part is used.
    pause: float = 2.0  #: Time between two attempts to start [s]; each failure doubles it to limit the cost.
    longest_pause: float = 120.0  #: Longest pause [s]; tracking for longer resets the pause.
    carried_over: float = 0.02  #: Relative deviation of P1 to P5 from a file, by another day or criterion.
    friction_carried_over: float = 0.3  #: Relative deviation of friction from a file.
    #: Factor of the mean square residual that rejects a file on a rig with unmodelled effects. Single recordings of two
    #: real rigs give 1.1 to 6.4 with their own parameters, and 26 to 2100 with the parameters of the other rig.
    rejected: float = 15.0

    # Filter. Random walks are relative to each unknown's scale, per root of a second.
    friction_walk: float = 2e-3  #: Friction changes within minutes, as grease warms.
    inertia_walk: float = 5e-6  #: Other unknowns change by steps only; also the deviation of a known unknown.
    rate_walk: float = 1e-2  #: The rate of a gradual change changes within hours.
    noise_memory: int = 400  #: Number of blocks over which the noise is averaged: about three minutes of motion.

    # Tests.
    false_alarm: float = 1e-9  #: Probability of each test under its null hypothesis: one false alarm in 1e5 h.
    window: int = 8  #: Number of blocks in which a change is searched, 3.2 s; half of them for an unnamed change.
    change: float = 4.0  #: Factor of the gate for the likelihood ratio of a step; a drift explains smaller ones.
    explained: float = 3.0  #: Largest mean square of a window after a step: with noise alone it is up to 2.
    lost: int = 20  #: Number of consecutive unexplained blocks after which tracking restarts: 8 s.

    # Report.
    unmodelled: float = 1.5  #: Ratio of RMS residual to quantization level that shows unmodelled effects.
    #: Number of blocks with a common error on such rigs, 8 s, by which variances are multiplied. Recordings of 6 to
    #: 10 s of two real rigs differ by about this factor more than blocks.
    common: int = 20
    heavy_tails: float = 2.0  #: Factor of the gate on such rigs, whose errors are not normal.
    idle: float = 10.0  #: Time without motion above which it is reported [s].
    tilt: float = 5e-3  #: Tilt above which it is reported [rad]: the accuracy of zeros.
    dead_zone: float = 2e-3  #: Dead zone above which it is reported, as a fraction of the RMS effort: its accuracy.
