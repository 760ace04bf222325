# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The STM32F4's program in QEMU: faults, hangs and motor output.

QEMU has neither TIM1 nor the independent watchdog: the tests compare the written register values with the manual.
"""

import re
import struct
import subprocess

import pytest

from pendubot_identification.link.protocol import Arm, Command, Hello, HelloRequest, State, Status, encode
from pendubot_identification.link.virtual_board import LIMITS

from .building import FIRMWARE, made, need
from .emulator import Line

#: QEMU's names of TIM1, the watchdog (which another device overlaps) and port B.
TIM1, IWDG, GPIOB = r'timer\[1\]', '(?:IWDG|I2S2ext)', 'GPIOB'
CCR1, BDTR, BSRR = 0x34, 0x44, 0x18
#: TIM1's BDTR while the motor bridge is enabled, and while its output is low.
MAY_SWITCH, OFF = 0xB400, 0x3400
ENDLESS_LOOP = 0xE7FE
FEED = 0xAAAA
SESSION = 17


@pytest.fixture
def line(emulator):
    line = Line(emulator.port)
    yield line
    line.close()


def drive(line, torque=300_000):
    """Arm and command a torque; return HELLO and the first STATE with this torque."""
    line.write(encode(HelloRequest(1, 0)))
    hello = line.events(10, lambda e: isinstance(e, Hello))[-1]
    lock = line.events(10, lambda e: isinstance(e, State))[-1].lock
    line.write(encode(Arm(2, 0, hello.boot_id, SESSION, lock, 500)))
    line.write(encode(Command(3, 0, 1, 500, torque, session=SESSION)))
    return hello, line.events(10, lambda e: isinstance(e, State) and e.torque == torque)[-1]


#: Debugger command and expected fault_pc: a jump to an address without memory, and a stack pointer outside the RAM,
#: where the fault cannot be stored and fault_pc is undefined.
FAULTS = {'no memory': ('Pf=00000060', 0x60000000), 'stack': ('Pd=10000020', None)}
HARD_FAULT = 3


@pytest.mark.parametrize(('fault', 'pc'), FAULTS.values(), ids=FAULTS)
def test_a_processor_fault_switches_the_motor_off_and_restarts_disarmed(emulator, line, fault, pc):
    before = drive(line)[0]
    assert (before.fault_cause, before.fault_pc) == (0, 0)
    assert emulator.written(TIM1, BDTR)[-1] == MAY_SWITCH
    with emulator.debugger() as ask:
        assert ask(fault) == 'OK'
    after = line.events(10, lambda e: isinstance(e, Hello))[-1]
    assert (before.reset_cause, after.reset_cause) == (1, 4)
    assert after.fault_cause == HARD_FAULT
    assert pc in (None, after.fault_pc)
    assert after.boot_id != before.boot_id
    assert after.t_us == 0
    stale = encode(Arm(4, 0, before.boot_id, SESSION, 1, 500))
    line.write(stale + encode(Command(4, 0, 1, 500, 300_000, session=SESSION)) + encode(HelloRequest(5, 0)))
    answers = line.events(10, lambda e: isinstance(e, Hello))
    later = line.events(10, lambda e: isinstance(e, State) and e.t_us > answers[-1].t_us + 50_000)
    states = [e for e in answers + later if isinstance(e, State)]
    assert len(later) > 50
    assert not any(s.torque or s.status & ~Status.REFUSED for s in states)
    assert states[-1].refused == 2
    assert answers[-1].fault_cause == HARD_FAULT
    assert emulator.written(TIM1, BDTR)[-1] == OFF
    assert emulator.written(TIM1, CCR1)[-1] == 0


def test_hello_has_limits_and_commit_and_torque_sets_duty_and_direction(emulator, line):
    """U = R / k * torque = 10 V per N m, of 24 V, in 8400 steps; disarming sets the duty to 0."""
    for torque, duty, pin in (300_000, 1050, 1 << 14), (-1_500_000, 5250, 1 << 30):
        hello, _ = drive(line, torque)
        assert emulator.written(TIM1, CCR1)[-1] == duty
        assert emulator.written(GPIOB, BSRR)[-1] == pin
    states = [e for e in line.events(10, lambda e: e.t_us > 500_000) if isinstance(e, State)]
    assert [s.seq for s in states] == list(range(states[0].seq, states[0].seq + len(states))), 'samples were lost'
    line.write(encode(Command(4, 0, 0)))
    line.events(10, lambda e: isinstance(e, State) and e.cmd_seq == 4)
    assert (emulator.written(TIM1, CCR1)[-1], emulator.written(TIM1, BDTR)[-1]) == (0, OFF)
    assert (hello.firmware, hello.limits, hello.torque_constant) == ('emulated 2', LIMITS, 200_000)
    # 0 without a commit, or after changes since the last one.
    git = ('git', '-C', FIRMWARE)
    log = subprocess.run([*git, 'log', '-1', '--format=%H', '--', '.'], capture_output=True, text=True)
    changed = log.returncode or subprocess.run([*git, 'diff', '--quiet', 'HEAD', '--', '.']).returncode
    assert hello.build == (0 if changed else int(log.stdout[:8], 16))


def test_every_interrupt_vector_except_two_is_the_fault_handler():
    """Also the NMI (exception 2) of a failed crystal, which QEMU cannot raise."""
    need('arm-none-eabi-gcc', 'gcc-arm-none-eabi')
    build = made('arm')
    names = subprocess.run(['arm-none-eabi-nm', build / 'stm32f4.elf'], capture_output=True, text=True, check=True)
    places = {name: int(place, 16) | 1 for place, _, name in map(str.split, names.stdout.splitlines())}
    stack, *vectors = struct.unpack('<98I', (build / 'stm32f4.bin').read_bytes()[: 4 * 98])
    fault = places['Fault_Handler']
    expected = {1: places['Reset_Handler'], 15: places['SysTick_Handler'], 16 + 37: places['USART1_IRQHandler']}
    assert stack == 0x20001000
    assert vectors == [expected.get(number, fault) for number in range(1, 98)]


@pytest.mark.parametrize('where', ['firmware_sample', 'rig_show'])
def test_a_hanging_firmware_stops_feeding_the_watchdog(emulator, line, where):
    """It hangs in the interrupt or in the main loop; without feeding, the watchdog resets the chip."""
    _, driven = drive(line)
    assert emulator.written(IWDG, 0)[:3] == [0xCCCC, 0x5555, FEED]
    assert (emulator.written(IWDG, 4), emulator.written(IWDG, 8)) == ([1], [200])  # 50 ms of 32 kHz / 8
    line.events(10, lambda e: e.t_us > driven.t_us + 30_000)
    assert emulator.written(IWDG, 0).count(FEED) > 20
    assert emulator.log().count('Write of unassigned area of PPB: offset 0x42008') > 20  # a debugger's bit is cleared
    emulator.patch(where, ENDLESS_LOOP)
    for _ in range(200):
        line.events(0.02)  # QEMU waits for a reader
        if emulator.stands_at(where):
            break
    feeds = emulator.written(IWDG, 0).count(FEED)
    line.events(0.3)
    assert emulator.written(IWDG, 0).count(FEED) == feeds


def test_the_deepest_stack_needs_less_than_half_of_its_memory(tmp_path):
    """The deepest chain of calls has the nested interrupts of sample and USART; none is recursive."""
    need('arm-none-eabi-gcc', 'gcc-arm-none-eabi')
    build = made('arm')
    frames = {}
    for path in build.glob('stm32f4.elf-*.su'):
        for name, size, kind in re.findall(r':(\w+)\t(\d+)\t(\S+)$', path.read_text(), re.MULTILINE):
            assert kind == 'static', f'{name}: its stack is {kind}'
            frames[name] = int(size)
    chain = ['main', 'SysTick_Handler', 'firmware_sample', 'pendubot_sample', 'USART1_IRQHandler']
    inlined = max(frames.get(name, 0) for name in ('write_hello', 'write_frame'))
    used = sum(frames[name] for name in chain) + inlined + 2 * 32  # the processor's stack frames of two interrupts
    print(f'stack {used} of 4096 bytes')
    assert used * 2 < 4096
    assert 'stack_size = 4K' in (FIRMWARE / 'stm32f4/stm32f4.ld').read_text()
