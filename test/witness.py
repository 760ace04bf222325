# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Tells a machine that stood still, as a virtual one does at times, from a program that was late."""

import multiprocessing
import time

#: What a sleep of half of it may take on a machine that runs [ns].
TICK = 1_000_000


class Witness:
    """A process that does nothing but sleep, half a millisecond at a time, and says when it overslept."""

    def __enter__(self):
        spawning = multiprocessing.get_context('spawn')
        self._said, says = spawning.Pipe(duplex=False)
        self._process = spawning.Process(target=_watch, args=(says,), daemon=True)
        self._process.start()
        self._said.recv()
        return self

    def __exit__(self, *_):
        self._process.kill()
        self._process.join()

    def longest_pause(self, since):
        """How long [ms] the machine stood still at most at one time after ``since`` [ns, time.monotonic_ns]."""
        longest = 0
        while self._said.poll():
            begun, ended = self._said.recv()
            if ended > since:
                longest = max(longest, ended - begun)
        return longest / 1e6


def _watch(says):
    last = time.monotonic_ns()
    says.send(None)
    while True:
        time.sleep(TICK / 2e9)
        now = time.monotonic_ns()
        if now - last > TICK:
            says.send((last, now))
        last = now
