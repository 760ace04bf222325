# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Real programs in processes, and waiting for their output and messages.

Timeouts end a test that hangs; on a busy machine a program may take half a minute to start.
"""

import contextlib
import os
import queue
import resource
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

NODES = 'bridge', 'recorder', 'player', 'identifier', 'exciter', 'balancer', 'tracker', 'virtual_board'
#: Python module and arguments of each program.
MODULES = {name: ('pendubot_identification.programs', name) for name in NODES}
#: The programs for virtual boards: the package's, and the firmware's Linux program.
BOARDS = {'python': MODULES['virtual_board'], 'c': ('test.firmware.host_board',)}
MODULES |= {'pendubot': ('pendubot_identification.cli.main',)}
MODULES |= {'listener': ('test.listener',)}


def parameters(**values):
    return ['--ros-args', *(word for name, value in values.items() for word in ('-p', f'{name}:={value}'))]


def run_program(name, *args):
    """Run a program to its end; return the completed process with text output."""
    command = [sys.executable, '-m', *MODULES[name], *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, stdin=subprocess.DEVNULL)


@contextlib.contextmanager
def small_disk(size):
    """Limit files to a size [bytes]; writing more fails like on a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


class Program:
    """A program in its own process whose output is collected and can be awaited line by line."""

    def __init__(self, program, *args, env=None, before=(), session=True):
        """Start a program by its name, or a Python file by its path; with ``session``, in a session of its own.

        Beside three busy processes of another session, Linux suspends a program in its own for up to seconds
        (sched_autogroup), ten times as often as in theirs.
        """
        self.name = str(program)
        run = [self.name] if isinstance(program, Path) else ['-m', *MODULES[program]]
        self.lines = []
        self._queue = queue.Queue()
        self.process = subprocess.Popen(
            [*before, sys.executable, '-u', *run, *map(str, args)],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            text=True,
            bufsize=1,
            env={**os.environ, **(env or {})},
            start_new_session=session,
        )
        threading.Thread(target=self._collect, daemon=True).start()

    def _collect(self):
        for line in self.process.stdout:
            self.lines.append(line.rstrip('\n'))
            self._queue.put(line)
        self._queue.put(None)

    def wait_for(self, text, timeout=60.0):
        """Return the next line that contains ``text``; fail with all output after ``timeout`` [s]."""
        deadline = time.monotonic() + timeout
        while True:
            try:
                line = self._queue.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                raise AssertionError(
                    f'{self.name} did not print {text!r} within {timeout} s:\n' + '\n'.join(self.lines)
                ) from None
            if line is None:
                raise AssertionError(f'{self.name} ended without printing {text!r}:\n' + '\n'.join(self.lines))
            if text in line:
                return line.rstrip('\n')

    def stop(self, number=signal.SIGINT, timeout=30.0):
        if self.process.poll() is None:
            self.process.send_signal(number)
        return self.process.wait(timeout)

    def children(self):
        """Return the PIDs of the processes that its threads have started."""
        found = []
        for task in Path(f'/proc/{self.process.pid}/task').iterdir():
            with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # the thread has ended
                found += map(int, (task / 'children').read_text().split())
        return found

    def halt(self):
        """Suspend the program until SIGCONT; return after it has stopped."""
        self.process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, self.process.pid, os.WSTOPPED | os.WNOWAIT)

    def kill(self):
        self.process.kill()
        self.process.wait(10)

    @property
    def output(self):
        return '\n'.join(self.lines)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        try:
            self.stop(signal.SIGTERM, 5)
        except subprocess.TimeoutExpired:
            self.kill()


@contextlib.contextmanager
def repeating(work, every):
    """Call a function periodically in a thread, with a period [s]."""
    ended = threading.Event()

    def repeat():
        while not ended.wait(every):
            work()

    thread = threading.Thread(target=repeat)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def until(condition, timeout=30.0, program=None):
    """Wait until ``condition()`` is true; fail after ``timeout`` [s], or if a program ends before."""
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, program and program.output
        assert program is None or program.process.poll() is None, program.output
        time.sleep(0.005)


def spin_until(node, condition, timeout=30.0):
    """Spin a node until ``condition()`` is true; return False at a timeout."""
    import rclpy

    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            return False
        rclpy.spin_once(node, timeout_sec=0.05)
    return True


def call(node, client, request, timeout=30.0):
    """Call a service until it answers: DDS may lose an answer shortly after discovery."""
    deadline = time.monotonic() + timeout
    assert client.wait_for_service(timeout), f'nobody serves {client.srv_name}'
    while time.monotonic() < deadline:
        future = client.call_async(request)
        if spin_until(node, future.done, 3.0):
            return future.result()
    raise AssertionError(f'{client.srv_name} did not answer within {timeout} s')
