# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Trials of motor ownership: other programs, false numbers, cut wires, stuck encoders, restarts, stopped programs.

Torques and times are from the board's trace, with a sample every millisecond.
"""

import errno
import itertools
import os
import signal
import time

import numpy as np

from pendubot_identification.link.protocol import Arm, Command, Hello, HelloRequest, Status, encode
from test.processes import Program, parameters, repeating, spin_until
from test.rig import ARMED, ENDLESS, PATIENT, Rig

from .bridge import RADIAN, drive, newest, running_rig
from .table import Trial

#: Torques that the rig's own commander and the other program command [N m].
OWN, FOREIGN = 0.2, 0.7
MICRO = 1_000_000


def stranger(tap, seed):
    """Act as another program on the port: write torque commands of random sessions 200 times a second."""
    rng, seqs = np.random.default_rng(seed), itertools.count(1)

    def inject():
        tap.inject(Command(next(seqs) & 0xFFFF, 0, 1, 500, round(MICRO * FOREIGN), int(rng.integers(0, 2**32))))

    return repeating(inject, 0.005)


def torques_since(rig, begun):
    """Return the set of torques that the motor applied [micro-N m]."""
    return {*rig.trace()[begun:, 3].tolist()}


def until_off(rig, begun):
    """Wait until the motor is off; return the number of samples from ``begun`` until then, and if it stayed off."""
    rig.until(lambda: not newest(rig.trace_file)[3] and not newest(rig.trace_file)[4] & ARMED, 20)
    rig.until_samples(300, OWN)
    rows = rig.trace()[begun:]
    on = np.flatnonzero((rows[:, 3] != 0) | (rows[:, 4] & ARMED != 0))
    # Once off, it is never on again.
    stayed = bool(on.size) and on[-1] - on[0] == len(on) - 1 and on[-1] < len(rows) - 1
    given = np.flatnonzero(rows[:, 3])
    return (int(given[-1]) + 1 if given.size else 0), stayed


def foreign(folder, long):
    """Another program streams commands while the board is locked, disarmed, armed, tripped, and without a bridge."""
    found, seen = {}, {}
    with running_rig(folder, *ENDLESS, bridge=PATIENT, tapped=True) as rig:

        def during(state, torque=None):
            rig.diagnoses.clear()
            begun = len(rig.trace())
            with stranger(rig.tap, 1):
                rig.until_samples(2000 if long else 300, torque)
                rig.until(lambda: rig.diagnosed(1, 'another program sends commands'))
            found[state], seen[state] = torques_since(rig, begun), True

        during('locked')
        rig.disarm()
        during('disarmed')
        # The bridge arms only after a second without other commands.
        rig.until(lambda: spin_until(rig.node, lambda: False, 0.2) or rig.call('arm').success, 60)
        drive(rig, OWN)
        during('armed', OWN)
        drive(rig, OWN)
        rig.programs[-1].process.send_signal(signal.SIGSTOP)
        rig.until(lambda: not newest(rig.trace_file)[4] & ARMED)
        for seed, state in enumerate(('tripped', 'without a bridge'), 2):
            begun = len(rig.trace())
            with stranger(rig.tap, seed):
                spin_until(rig.node, lambda begun=begun: len(rig.trace()) > begun + 300)
            found[state] = torques_since(rig, begun)
            rig.programs[-1].kill()
    own = round(MICRO * OWN)
    for state, given in found.items():
        allowed = {0, own} if state == 'armed' else {0}
        yield f'{state}: no torque of its', f'{sorted(given)} micro-N m', given <= allowed
    yield 'seen on /diagnostics', ', '.join(seen), len(seen) == 3


def usurper(folder, long):
    """A program that knows the protocol arms the board itself, again and again."""
    held = []
    with running_rig(folder, bridge=PATIENT) as rig:
        try:
            port = os.open(rig.port, os.O_WRONLY | os.O_NOCTTY)
        except OSError as error:
            # The bridge holds the port alone, but for root.
            yield 'another program may not open the port', str(error), error.errno == errno.EBUSY and os.geteuid() != 0
            return
        boot_id, order = int(rig.fresh_values()['boot_id']), Command(2, 0, 1, 500, round(MICRO * FOREIGN), 99)
        for k in range(50 if long else 1):
            # It cannot read the board's frames beside the bridge, so it tries all possible lock numbers.
            requests = [Arm(1, 0, boot_id, 99, lock, 500) for lock in range(k + 1, k + 41)]
            rig.diagnoses.clear()
            begun = len(rig.trace())
            os.write(port, b'\0' + b''.join(map(encode, [*requests, order])))
            rig.until(lambda: rig.diagnosed(1, 'another program armed the motor'))
            _, stayed = until_off(rig, begun)
            held.append((np.count_nonzero(rig.trace()[begun:, 3]), stayed))
        os.close(port)
    counts, stays = zip(*held, strict=True)
    yield 'disarmed, and it stays so', f'{sum(stays)} of {len(stays)}', all(stays)
    said = f'torque in {np.median(counts):g} in the median, in {max(counts)} at most'
    yield 'within 3 samples', said, max(counts) <= 3, True


def forged(folder, _):
    """HELLO has a sample period of a second, no speed limit, or an enormous speed limit."""
    refused = 0
    lies = {
        'a sample period of 1000 ms': lambda h: h._replace(sample_period_us=MICRO),
        'no limit': lambda h: h._replace(limits=h.limits._replace(max_speed=0)),
        'a limit of 4': lambda h: h._replace(limits=h.limits._replace(max_speed=4_000_000)),
    }
    with running_rig(folder, bridge=PATIENT, tapped=True) as rig:
        for lie, change in lies.items():
            rig.tap.rewrite = lambda e, change=change: change(e) if isinstance(e, Hello) else e
            rig.tap.inject(HelloRequest(1, 0))
            rig.until(lambda lie=lie: rig.diagnosed(1, lie))
            answer = rig.call('arm')
            refused += not answer.success and lie in answer.message
            rig.until_samples(300, OWN)
        given = torques_since(rig, 0)
    yield 'arming is refused, with the lie', f'{refused} of {len(lies)}', refused == len(lies)
    yield 'no torque', f'{sorted(given)} micro-N m', given == {0}


def wires(folder, long):
    """Either wire is cut while the motor runs, and restored a second later."""
    for wire, watchdog_ms in (('to_host', 100), ('to_board', 100), ('to_board', 300))[: 3 if long else 2]:
        settings = (f'watchdog_ms:={watchdog_ms}',)
        with running_rig(folder / f'{wire}{watchdog_ms}', bridge=settings, tapped=True) as rig:
            last = 0
            while not last:  # tripped by a busy machine before the wire was cut: tried again
                drive(rig, OWN)
                begun = rig.trace_file.read_bytes().count(b'\n') - 1
                rig.tap.cut = {wire}
                deadline = time.monotonic() + 1.0
                while time.monotonic() < deadline:
                    rig.effort(OWN)
                    spin_until(rig.node, lambda: False, 0.01)
                rig.tap.cut = set()
                last, stayed = until_off(rig, begun)
        name = f'{wire.replace("_", " ")} cut, watchdog {watchdog_ms} ms'
        yield f'{name}: off, and it stays so', f'{stayed}', stayed
        wanted = 100 if wire == 'to_host' else watchdog_ms
        yield f'{name}: within {wanted} ms and 20', f'{last} ms', last <= wanted + 20, True


def stuck(folder, _):
    """The shoulder's encoder stands still under a torque that moves the shoulder, gently enough for the elbow."""
    with running_rig(folder, '--fault', 'stuck_at=0', '--limit', 'stall_torque=300000', bridge=PATIENT) as rig:
        drive(rig, 0.1)
        rig.drive_until(0.35, lambda: rig.diagnosed(2, 'stall'))
        begun = int(np.flatnonzero(rig.trace()[:, 3] > 0.3 * MICRO)[0])
        last, stayed = until_off(rig, begun)
    yield 'named, off, and it stays so', f'{stayed}', stayed
    yield 'within the 500 ms of the limit', f'{last} samples', last <= 501


def runaway(folder, long):
    """Command 0.6 N m until a limit stops the motor: first limits of the board, then a limit of the user."""
    for name, limits, settings, faults, max_speed, max_travel in (
        ('max_speed', ('--limit', 'max_speed=20000'), (), Status.SPEED, 22, np.inf),
        ('max_travel', ('--limit', 'max_travel1=6000'), ('max_travel:=[6.5, 0.0]',), Status.TRAVEL, np.inf, 6.1),
        ('default_limits', (), (), Status.SPEED | Status.TRAVEL, np.inf, 61),
    )[: 3 if long else 1]:
        with running_rig(folder / name, *limits, bridge=(*PATIENT, *settings)) as rig:
            rig.until(lambda: rig.call('arm').success)
            rig.drive_until(0.6, lambda: rig.diagnosed(2, 'fault'))
            until_off(rig, 0)
            rows = rig.trace()
        moving, named = rows[:, 3] != 0, bool((rows[:, 4] & faults).any())
        speed = np.abs(np.diff(rows[:, 1:3], axis=0)).max(axis=1) * RADIAN * 1000
        fastest, largest = speed[moving[1:]].max(), np.abs(rows[moving, 1]).max() * RADIAN
        figures = f'with torque at most {fastest:.0f} rad/s and {largest:.1f} rad'
        yield f'{name}: off', figures, named and fastest <= max_speed and largest <= max_travel


def restart(folder, _):
    """The board restarts while the rig moves; the zeros have to be confirmed at rest."""
    with Rig(folder, 1000, *ENDLESS) as rig:
        rig.start_bridge(*PATIENT, 'confirm_zeros:=true')
        for seconds in (8, 20, 60):
            board = rig.start_board('--fault', f'reset_at={seconds}')
            rig.until_samples(1200)
            rig.diagnoses.clear()
            assert not rig.call('arm').success
            confirmed = rig.call('confirm_zeros')
            drive(rig, OWN)
            # On a busy machine the board may restart before the zeros are confirmed: tried again.
            if not rig.diagnosed(1, 'the board restarted: '):
                break
            board.stop()
        rig.drive_until(OWN, lambda: rig.diagnosed(1, 'the board restarted: '))
        begun = len(rig.trace())
        refused = rig.call('arm')
        moving = rig.call('confirm_zeros')
        rig.until_samples(300, OWN)
        given = torques_since(rig, begun)
    at_rest = confirmed.success and 'q1 = -1.57' in confirmed.message
    yield 'confirmed at rest, with the angles', confirmed.message, at_rest
    yield 'not armed after the restart', refused.message, not refused.success and 'confirm_zeros' in refused.message
    yield 'not confirmed while it moves', moving.message, not moving.success and 'were not at rest' in moving.message
    yield 'no torque', f'{sorted(given)} micro-N m', given == {0}


def stopped(folder, long):
    """SIGSTOP of bridge and exciter at each watchdog setting; after SIGCONT, earlier commands are too old."""
    for watchdog_ms, pause in ((500, 0.35), (50, 0.35), (100, 0.35), (500, 0.8))[: 4 if long else 1]:
        with running_rig(folder / f'{watchdog_ms}{pause}', bridge=(f'watchdog_ms:={watchdog_ms}',)) as rig:
            bridge = rig.programs[-1]
            drive(rig, OWN)
            bridge.halt()
            rig.effort(FOREIGN)  # is pending until SIGCONT
            time.sleep(pause)
            begun = len(rig.trace())
            bridge.process.send_signal(signal.SIGCONT)
            end = len(rig.trace()) + 400
            rig.until(lambda end=end: len(rig.trace()) > end)
            after = rig.trace()[begun:]
            given = np.flatnonzero(after[:, 3])
        old = np.count_nonzero(after[:, 3] == round(MICRO * FOREIGN))
        last = int(given[-1]) + 1 if given.size else 0
        name = f'bridge, watchdog {watchdog_ms} ms, stopped for {pause:g} s'
        yield f'{name}: nothing of the old command', f'{old} samples', old == 0
        yield f'{name}: off within 20 ms of SIGCONT', f'{last} ms', last <= 20, True
    with running_rig(folder, bridge=('watchdog_ms:=500', 'link_timeout:=2.0')) as rig:
        values = {'duration': 0.0, 'width': 1.0, 'amplitude_min': 0.1, 'amplitude_max': 0.2, 'arm': 'true'}
        rig.node.destroy_publisher(rig.effort_publisher)
        with Program('exciter', *parameters(**values)) as exciter:
            exciter.wait_for('exciting')
            rig.until(lambda: newest(rig.trace_file)[3])
            begun, resumed = len(rig.trace()), time.monotonic() + 3
            exciter.process.send_signal(signal.SIGSTOP)
            rig.until(lambda: not newest(rig.trace_file)[3])
            # On a busy machine the board may make 3000 samples at once.
            rig.until(lambda: len(rig.trace()) > begun + 3000 and time.monotonic() > resumed, 20)
            stop = len(rig.trace())
            exciter.process.send_signal(signal.SIGCONT)
            ended = spin_until(rig.node, lambda: exciter.process.poll() is not None, 20)
            rows = rig.trace()
    late = int(np.flatnonzero(rows[begun:stop, 3])[-1]) + 1
    # If SIGSTOP interrupted a command, the exciter sends it afterwards, followed by 0.
    more = np.count_nonzero(rows[stop:, 3])
    yield 'exciter: ends', f'{ended}', ended
    yield 'exciter: moves nothing more, but for the command on its way', f'{more} samples', more <= 20
    yield 'exciter: off within 100 ms and 20', f'{late} ms', late <= 120, True


TRIALS = [
    Trial('foreign', 'another program on the port streams commands', foreign, True),
    Trial('usurper', 'another program on the port arms the board itself', usurper, True),
    Trial('forged', 'HELLO with false numbers', forged),
    Trial('wires', 'either wire cut alone', wires, True),
    Trial('stuck', 'encoder that stands still under torque', stuck, True),
    Trial('runaway', 'constant torque', runaway, True),
    Trial('restart', 'board restarts while the rig moves', restart),
    Trial('stopped', 'bridge or exciter SIGSTOPped, then SIGCONT', stopped),
]
