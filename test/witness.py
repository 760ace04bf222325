# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Measures pauses of the machine, such as of a virtual one, to distinguish them from latency of a program."""

import multiprocessing
import time

#: Longest time for a sleep of half of it on a running machine [ns].
TICK = 1_000_000


class Witness:
    """A process that sleeps half a millisecond at a time and reports longer sleeps."""

    def __enter__(self):
        spawning = multiprocessing.get_context('spawn')
        self._pauses, sender = spawning.Pipe(duplex=False)
        self._process = spawning.Process(target=_watch, args=(sender,), daemon=True)
        self._process.start()
        self._pauses.recv()
        return self

    def __exit__(self, *_):
        self._process.kill()
        self._process.join()

    def longest_pause(self, since):
        """Return the longest pause of the machine [ms] after ``since`` [ns, time.monotonic_ns]."""
        longest = 0
        while self._pauses.poll():
            begun, ended = self._pauses.recv()
            if ended > since:
                longest = max(longest, ended - begun)
        return longest / 1e6


def _watch(sender):
    last = time.monotonic_ns()
    sender.send(None)
    while True:
        time.sleep(TICK / 2e9)
        now = time.monotonic_ns()
        if now - last > TICK:
            sender.send((last, now))
        last = now
