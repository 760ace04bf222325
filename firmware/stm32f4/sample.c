// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* SysTick: takes a sample every period, and determines its time.
 *
 * The cycle counter gives the number of periods since the last sample, so that a sample that takes longer than its
 * period does not delay the clock. The sample that was due meanwhile is omitted: the next one follows after a whole
 * number of periods, two or more, and the link sets its bit 12. If the counter does not run, as in QEMU, each sample
 * counts as one period.
 */
#include "port.h"
#include "registers.h"
#include "rig.h"

#define PERIOD_US (1000000u / SAMPLE_HZ)
#define PERIOD_CYCLES (CORE_HZ / SAMPLE_HZ)

volatile uint32_t samples_taken, longest_sample_cycles;

static uint32_t begun_at; /* cycles */
static uint32_t time_us;

void sample_start(void)
{
    DEMCR |= DEMCR_TRCENA;
    DWT_CTRL |= DWT_CTRL_CYCCNTENA;
    SCB_SHPR3 = 0x10u << 24; /* SysTick has a lower priority than the USART, which keeps 0, the highest */
    SYSTICK->LOAD = PERIOD_CYCLES - 1;
    SYSTICK->VAL = 0;
    SYSTICK->CTRL = SYSTICK_ON;
    begun_at = DWT_CYCCNT;
    time_us = 0u - PERIOD_US; /* the first sample is at 0 */
}

uint32_t board_micros(void)
{
    return time_us;
}

void SysTick_Handler(void)
{
    uint32_t now = DWT_CYCCNT;
    uint32_t periods = (now - begun_at + PERIOD_CYCLES / 2) / PERIOD_CYCLES;
    time_us += (periods > 0 ? periods : 1) * PERIOD_US;
    begun_at = now;
    firmware_sample();
    samples_taken++;
    rig_after_sample();
    uint32_t cycles = DWT_CYCCNT - begun_at;
    if (cycles > longest_sample_cycles) {
        longest_sample_cycles = cycles;
    }
    if (cycles >= PERIOD_CYCLES) {
        SCB_ICSR = SCB_ICSR_PENDSTCLR;
    }
}
