// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* The STM32F4's program: two interrupts do all work; the main loop feeds the watchdog while samples are taken. */
#include "port.h"

int main(void)
{
    /* First, so that a board with a failed crystal, for example, resets repeatedly with the motor off. */
    watchdog_start();
    rig_start();
    motor_start();
    uart_start();
    firmware_boot();
    sample_start();
    for (uint32_t seen = 0;;) {
        __asm__ volatile("wfi");
        if (samples_taken != seen) {
            seen = samples_taken;
            watchdog_feed();
            rig_show();
        }
    }
}
