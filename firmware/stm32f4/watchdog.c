// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* The independent watchdog resets the chip when it is not fed for HUNG_MS. The pins then release the bridge. */
#include "port.h"
#include "registers.h"
#include "rig.h"

void watchdog_start(void)
{
    IWDG->KR = IWDG_START;
    IWDG->KR = IWDG_UNLOCK;
    IWDG->PR = 1; /* 32 kHz / 8 */
    IWDG->RLR = 4 * HUNG_MS;
    while (IWDG->SR != 0) {
    }
    IWDG->KR = IWDG_FEED;
}

/* A debugger may set a bit that stops the watchdog while the processor is halted; the PWM would continue. Each feeding
 * clears the bit, so that it is not set at a later halt. */
void watchdog_feed(void)
{
    IWDG->KR = IWDG_FEED;
    DBGMCU_APB1_FZ &= ~DBGMCU_APB1_FZ_IWDG_STOP;
}
