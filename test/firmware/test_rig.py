# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The rig's port, ``rig.c``, ``motor.c`` and ``uart.c``, with memory in place of the registers, which QEMU lacks.

Addresses, bits and pins are from RM0090 and the data sheet of the STM32F405/F407. The tests simulate the hardware:
they set input registers and read output registers. The firmware is compiled for registers at higher addresses, because
a Python process may use theirs.
"""

import ctypes
import re
import threading

import pytest

from pendubot_identification.link.protocol import Arm, Command, Status, encode
from test.conftest import ROOT

from .building import FIRMWARE, compiled

PORTS = {letter: 0x40020000 + 0x400 * k for k, letter in enumerate('ABCD')}
MODER, PUPDR, IDR, BSRR, AFR = 0x00, 0x0C, 0x10, 0x18, 0x20
TIM1, TIM2, TIM3, ADC, USART1 = 0x40010000, 0x40000000, 0x40000400, 0x40012000, 0x40011000
SR, CNT, CCR1, BDTR, BRR, JDR1, JDR2 = 0x10, 0x24, 0x34, 0x44, 0x08, 0x3C, 0x40
RCC_CR, RCC_PLLCFGR, RCC_CFGR = 0x40023800, 0x40023804, 0x40023808
PWR_CSR, RNG_SR, FLASH_ACR = 0x40007004, 0x50060804, 0x40023C00
#: Bits of BDTR: outputs enabled; break input enabled and active high, outputs driven low while off.
MOE, BREAK = 1 << 15, 1 << 13 | 1 << 12 | 1 << 10
BIF, PVDO, RXNE, ORE = 1 << 7, 1 << 2, 1 << 5, 1 << 3
PULL_UP, PULL_DOWN, ANALOG = 1, 2, 3
#: Data sheet, tables "pin definitions" and "alternate function mapping": alternate function and pull, or the mode.
PINS = {
    'PA15': (1, PULL_UP), 'PB3': (1, PULL_UP), 'PB4': (2, PULL_UP), 'PB5': (2, PULL_UP), 'PA8': (1, PULL_DOWN),
    'PB12': (1, PULL_UP), 'PB6': (7, 0), 'PB7': (7, PULL_UP), 'PB0': ANALOG, 'PB1': ANALOG,
}  # fmt: skip
#: The cycle counter, and the register that clears a pending SysTick.
CYCCNT, ICSR, PENDSTCLR, PERIOD_CYCLES = 0xE0001004, 0xE000ED04, 1 << 25, 168_000
REGIONS = (0x40000000, 0x30000), (0x50060000, 0x1000), (0xE0000000, 0x50000)
MOVED, FIXED_NOREPLACE = 1 << 36, 0x100000
SESSION = 17


class Memory:
    """Registers by their addresses on the chip."""

    def __getitem__(self, address):
        return ctypes.c_uint32.from_address(MOVED + address).value

    def __setitem__(self, address, value):
        ctypes.c_uint32.from_address(MOVED + address).value = value

    def set_pin(self, name, high):
        address, bit = PORTS[name[1]] + IDR, 1 << int(name[2:])
        self[address] = self[address] | bit if high else self[address] & ~bit


class Board:
    """A started board with 24 V and the emergency stop closed, and a sender of commands."""

    def __init__(self, library):
        self.registers, self.library, self._seq = Memory(), library, 0
        for start, size in REGIONS:
            ctypes.memset(MOVED + start, 0, size)
        self.registers[RNG_SR] = 1
        self.quiet()
        # The crystal and the PLL are ready at once; the clock switch follows each request.
        self.registers[RCC_CR] = 1 << 17 | 1 << 25
        starting = threading.Thread(target=library.rig_start)
        starting.start()
        while starting.is_alive():
            if self.registers[RCC_CFGR] & 15 == 2:
                self.registers[RCC_CFGR] |= 2 << 2
        library.motor_start()
        library.uart_start()
        library.firmware_boot()
        library.sample_start()
        ctypes.c_uint32.in_dll(library, 'probe_takes').value = 0
        self.sample()  # only in this test the encoders' last counts of the board before are in memory

    def quiet(self):
        """Set all inputs to values without a fault."""
        self.registers.set_pin('PB12', False)
        self.registers.set_pin('PB15', True)
        self.registers[TIM1 + SR] = self.registers[PWR_CSR] = 0
        self.registers[ADC + JDR1], self.registers[ADC + JDR2] = 2048, 2708

    def receive(self, data, overrun_at=None):
        """Receive bytes; with an overrun, the byte after that index is lost."""
        for k, byte in enumerate(data):
            if overrun_at is None or k != overrun_at + 1:
                self.library.probe_hear(byte, RXNE | (ORE if k == overrun_at else 0))

    def command(self, mode, torque=0, **given):
        self._seq += 1
        self.receive(encode(Command(self._seq, 0, mode, 500, torque, session=SESSION)), **given)

    def arm(self):
        self._seq += 1
        boot_id, lock = self.library.probe_boot_id(), self.library.probe_lock()
        self.receive(encode(Arm(self._seq, 0, boot_id, SESSION, lock, 500)))

    def sample(self, line_ready=True):
        return self.library.probe_sample(line_ready)

    @property
    def motor_is_on(self):
        on = bool(self.registers[TIM1 + BDTR] & MOE)
        assert on or self.registers[TIM1 + CCR1] == 0
        assert self.registers[TIM1 + BDTR] & ~MOE == BREAK
        return on

    def drive(self):
        self.arm()
        self.command(1, 300_000)
        assert self.sample() == Status.ARMED
        assert self.motor_is_on
        return self


@pytest.fixture(scope='session')  # the registers are mapped once
def library(tmp_path_factory):
    folder = tmp_path_factory.mktemp('rig')
    path, moved = folder / 'rig.so', folder / 'registers.h'
    registers = (FIRMWARE / 'stm32f4/registers.h').read_text()
    moved.write_text(re.sub(r'0x(?=[45e]0[0-9a-f]{6}u)', '0x10', registers))
    sources = [FIRMWARE / name for name in ('pendubot_link.c', 'firmware.c')]
    sources += [FIRMWARE / 'stm32f4' / name for name in ('rig.c', 'motor.c', 'uart.c', 'fault.c', 'watchdog.c')]
    options = '-shared', '-fPIC', '-fno-sanitize=all', '-include', moved, '-I', FIRMWARE / 'stm32f4'
    compiled(path, *sources, ROOT / 'test/firmware/rig_probe.c', options=options)
    mmap = ctypes.CDLL(None).mmap
    mmap.restype = ctypes.c_size_t
    for start, size in REGIONS:
        place, length, zero = ctypes.c_void_p(MOVED + start), ctypes.c_size_t(size), ctypes.c_size_t(0)
        assert mmap(place, length, 3, 0x22 | FIXED_NOREPLACE, -1, zero) == MOVED + start
    library = ctypes.CDLL(str(path))
    library.probe_hear.argtypes = ctypes.c_uint8, ctypes.c_uint32
    library.probe_sample.argtypes = (ctypes.c_bool,)
    library.probe_boot_id.restype = library.board_micros.restype = ctypes.c_uint32
    library.probe_lock.restype = ctypes.c_uint16
    return library


@pytest.fixture
def board(library):
    return Board(library)


def test_clocks_are_within_the_limits_of_the_manual(board):
    pll, buses = board.registers[RCC_PLLCFGR], board.registers[RCC_CFGR]
    vco = 8e6 / (pll & 63) * (pll >> 6 & 511)
    assert 1e6 <= 8e6 / (pll & 63) <= 2e6
    assert 100e6 <= vco <= 432e6
    core = vco / (2, 4, 6, 8)[pll >> 16 & 3]
    slow, fast = (core / {0: 1, 4: 2, 5: 4, 6: 8, 7: 16}[buses >> at & 7] for at in (10, 13))
    assert (core, slow, fast, vco / (pll >> 24 & 15)) == (168e6, 42e6, 84e6, 48e6)
    assert pll >> 22 & 1, 'the source is not the crystal'
    assert board.registers[RCC_CR] >> 19 & 1, 'the clock security system is off'
    # Five wait states, caches, no prefetch (errata of revision A).
    assert board.registers[FLASH_ACR] == 5 | 1 << 9 | 1 << 10
    assert abs(fast / board.registers[USART1 + BRR] / 921600 - 1) < 0.005


def test_pins_agree_with_the_data_sheet_and_the_wiring_table(board):
    wired = re.findall(
        r'\bP[A-D]\d+\b', re.search(r'\| from \| to pin.*?\n\n', (ROOT / 'firmware/README.md').read_text(), re.S)[0]
    )
    assert set(wired) == {*PINS, 'PB14', 'PB15'}
    for name, expected in PINS.items():
        port, number = PORTS[name[1]], int(name[2:])
        mode = board.registers[port + MODER] >> 2 * number & 3
        if expected == ANALOG:
            assert mode == 3, name
        else:
            function = board.registers[port + AFR + 4 * (number // 8)] >> 4 * (number % 8) & 15
            pull = board.registers[port + PUPDR] >> 2 * number & 3
            assert (mode, function, pull) == (2, *expected), name


FAULTS = {
    'emergency stop pressed': (Status.EMERGENCY_STOP, lambda r: r.set_pin('PB12', True)),
    'emergency stop shorter than a sample': (Status.EMERGENCY_STOP, lambda r: r.__setitem__(TIM1 + SR, BIF)),
    'shoulder encoder': (Status.ENCODER_1, lambda r: r.__setitem__(TIM2 + CNT, r[TIM2 + CNT] ^ 0x100)),
    'elbow encoder': (Status.ENCODER_2, lambda r: r.__setitem__(TIM3 + CNT, r[TIM3 + CNT] ^ 0x100)),
    'current': (Status.OVER_CURRENT, lambda r: r.__setitem__(ADC + JDR1, 4095)),
    'current, negative': (Status.OVER_CURRENT, lambda r: r.__setitem__(ADC + JDR1, 0)),
    'bridge': (Status.OVER_TEMPERATURE, lambda r: r.set_pin('PB15', False)),
    'motor supply': (Status.UNDERVOLTAGE, lambda r: r.__setitem__(ADC + JDR2, 0)),
    'motor supply, too high': (Status.OVERVOLTAGE, lambda r: r.__setitem__(ADC + JDR2, 4095)),
    "processor's supply": (Status.UNDERVOLTAGE, lambda r: r.__setitem__(PWR_CSR, PVDO)),
}


@pytest.mark.parametrize(('bit', 'cause'), FAULTS.values(), ids=FAULTS)
def test_each_fault_switches_the_motor_off_until_the_host_disarms_and_arms_again(board, bit, cause):
    board.drive()
    cause(board.registers)
    assert board.sample() == bit
    assert not board.motor_is_on
    board.quiet()
    persistent = bit & Status.EMERGENCY_STOP
    for _ in range(3):
        board.command(1, 300_000)
        assert board.sample() == bit
        assert not board.motor_is_on
    board.command(0)
    assert board.sample() == persistent
    board.arm()
    board.command(1, 300_000)
    board.sample()
    assert board.motor_is_on == (not persistent)


def test_a_receiver_overrun_damages_a_frame_and_a_transmitter_overrun_is_reported(board):
    board.command(0, overrun_at=3)
    assert board.sample() == Status.DAMAGED_FRAME
    board.drive()
    board.command(1)
    states = [board.sample(line_ready=False) for _ in range(9)]
    assert states[:6] == [Status.ARMED] * 6
    assert board.sample() & Status.OVERRUN
    assert [board.sample() & Status.OVERRUN for _ in range(2)] == [Status.OVERRUN, 0]


def test_a_flood_of_bytes_does_not_overflow_the_receive_buffer(board):
    board.receive(bytes([7]) * 5000)
    buffer = ctypes.create_string_buffer(300)
    assert [board.library.board_receive(buffer, ctypes.c_size_t(300)) for _ in range(2)] == [256, 0]
    assert buffer.raw[:256] == bytes([7]) * 256
    board.drive()


def test_16_bit_counters_are_extended_across_their_wraps(board):
    count = ctypes.c_int32 * 2

    def read():
        reading = (ctypes.c_uint8 * 64)()
        board.library.board_read(reading)
        return tuple(count.from_buffer(reading))

    at = read()
    for step in (100, -90):
        for k in range(1, 1000):
            board.registers[TIM2 + CNT] = (board.registers[TIM2 + CNT] + step) % 65536
            board.registers[TIM3 + CNT] = (board.registers[TIM3 + CNT] - step) % 65536
            assert read() == (at[0] + k * step, at[1] - k * step)
        at = read()


def test_the_watchdog_is_fed_and_does_not_stop_in_a_debugger(board):
    """RM0090: IWDG_KR at 0x40003000; DBG_IWDG_STOP is bit 12 of DBGMCU_APB1_FZ at 0xE0042008."""
    board.registers[0xE0042008] = 0xFFFFFFFF
    board.library.watchdog_feed()
    assert (board.registers[0x40003000], board.registers[0xE0042008]) == (0xAAAA, 0xFFFFFFFF & ~(1 << 12))


def test_a_sample_longer_than_its_period_is_marked_late_and_does_not_delay_the_clock(board):
    takes = ctypes.c_uint32.in_dll(board.library, 'probe_takes')

    def sample(at_period, cycles):
        """Sample so many periods after the start; return time, late bit, and whether a pending tick was cleared."""
        takes.value, board.registers[ICSR] = cycles, 0
        # 50 cycles of latency, near the counter's wrap.
        board.registers[CYCCNT] = (start + at_period * PERIOD_CYCLES + 50) % 2**32
        status = board.sample()
        assert status & ~Status.LATE == 0
        return board.library.board_micros(), bool(status & Status.LATE), board.registers[ICSR] == PENDSTCLR

    board.library.firmware_boot()
    board.registers[CYCCNT] = start = 2**32 - 2 * PERIOD_CYCLES
    board.library.sample_start()
    assert sample(1, 100_000) == (0, False, False)
    assert sample(2, 167_000) == (1000, False, False)
    assert sample(3, 168_100) == (2000, False, True)
    assert sample(5, 600_000) == (4000, True, True)
    assert sample(9, 1000) == (8000, True, False)
    assert sample(10, 1000) == (9000, False, False)


def test_without_a_running_cycle_counter_the_clock_counts_samples(board):
    at = board.library.board_micros()
    assert [board.sample() or board.library.board_micros() - at for _ in range(3)] == [1000, 2000, 3000]
