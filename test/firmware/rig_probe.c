// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* Replaces stm32f4/main.c on a computer with memory in place of the STM32F4's registers: test_rig.py. */
#include "port.h"
#include "registers.h"
#include "rig.h"

static void probe_after_sample(void);

#define rig_after_sample probe_after_sample
#include "stm32f4/sample.c"
#undef rig_after_sample

uint32_t probe_takes; /* duration of a sample in cycles */

static void probe_after_sample(void)
{
    rig_after_sample();
    DWT_CYCCNT += probe_takes;
}

uint32_t probe_boot_id(void)
{
    return firmware_link.boot_id;
}

uint16_t probe_lock(void)
{
    return firmware_link.lock;
}

uint32_t probe_samples(void)
{
    return samples_taken;
}

/* Receives one byte with these flags of the USART. */
void probe_hear(uint8_t byte, uint32_t flags)
{
    USART1->DR = byte;
    USART1->SR = flags;
    USART1_IRQHandler();
}

/* Takes a sample and sends it if the line is ready; returns its status. */
uint32_t probe_sample(bool line_ready)
{
    SysTick_Handler();
    if (line_ready) {
        USART1->SR = USART_SR_TXE;
        USART1_IRQHandler();
    }
    return firmware_link.status;
}
