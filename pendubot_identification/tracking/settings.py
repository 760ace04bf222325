# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Settings of the tracker, each with its unit and reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TrackerSettings:
    """Thresholds and drift rates; a ratio is twice the gain of the log likelihood."""

    # The beginning.
    first: float = 8.0  #: Motion that delay, smoothing and noise are chosen from [s].
    longest_first: float = 30.0  #: At most so much of it is used, the newest [s].
    pause: float = 2.0  #: Between two attempts to begin [s]; each doubles it, so that they never cost much for ever.
    longest_pause: float = 120.0  #: Longest pause [s]; who follows for longer begins with the shortest again.
    carried_over: float = 0.02  #: Further uncertainty of P1 to P5 from a file: of another day or criterion.
    friction_carried_over: float = 0.3  #: The same of friction.
    denied: float = 60.0  #: Ratio that rejects a file's parameters; among normal rows one of 1e8 exceeds it.
    worse: float = 15.0  #: Factor of the squared residual that rejects them with unmodelled effects, by two real rigs.

    # The filter. Deviations are parts of each unknown's scale; random walks are per root of a second.
    friction_walk: float = 2e-3  #: Grease warms in minutes.
    inertia_walk: float = 5e-6  #: Of everything else, which hardly changes but by steps.
    rate_walk: float = 1e-2  #: Of the rate of a gradual change: it changes as much as it can be within hours.
    fixed: float = 1e-5  #: Of an unknown that is 0, or given, until the motion shows otherwise.
    noise_memory: int = 400  #: Blocks over which the noise is averaged: about three minutes of motion.
    least_noise: float = 0.3  #: Least squared residual of a block, as a part of the usual one.
    relinearise: float = 0.2  #: Change of delay or dead zone, in their scales, beyond which rows are linearised anew.

    # The gate and the tests.
    gate: float = 100.0  #: Ratio beyond which a block waits for the next ones: one in thousands has it by chance.
    change: float = 300.0  #: Ratio beyond which parameters changed: so no change is false in 10 h.
    drift: float = 40.0  #: Ratio beyond which the motor's gain drifts: by chance once in 1e8 tests.
    simpler: float = 12.0  #: Price of an unknown in a ratio: twice the logarithm of the number of rows.
    leaves: float = 40.0  #: A kind of change explains a window of which it leaves no greater ratio,
    part: float = 0.05  #: or no greater part of it.
    explained: float = 4.0  #: Greatest mean square of the rows that one step may leave.
    window: int = 8  #: Blocks over which a change is looked for: 3.2 s.
    agreeing: int = 4  #: Blocks that agree on a change without a name: a hand may look like one for a while.
    clean: float = 8.0  #: Squared residual of a block, of the usual one, above which it has no vote in a change.
    lost: int = 20  #: Blocks in a row that nothing explains, after which all begins anew: 8 s.
    least: float = 0.3  #: Least part of P1 to P5 that a change leaves, but for a tenth of the scale.

    # What is reported.
    lacking: float = 1.5  #: RMS residual over that of quantization, above which a rig has unmodelled effects.
    #: Blocks with a common error where there are unmodelled effects, so that bands are wider by its root: those of one
    #: motion. Two real rigs' recordings, of 6 to 10 s each, differ by about so much more than blocks do.
    common: int = 20
    more: float = 4.0  #: Factor of ratios that show a change then, by the same recordings.
    idle: float = 10.0  #: Time without motion that is reported [s].
    tilt: float = 5e-3  #: Angle of gravity that is reported [rad]: zeros are hardly set more exactly.
