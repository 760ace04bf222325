/* Copyright 2026 The pendubot_identification authors
 * SPDX-License-Identifier: Apache-2.0 */
/* In the place of stm32f4/main.c, for a computer that has memory where the STM32F4 has registers: test_rig.py. */
#include "port.h"
#include "registers.h"
#include "rig.h"

volatile uint32_t samples_taken, longest_sample_cycles;

uint32_t board_micros(void)
{
    return samples_taken * (1000000 / SAMPLE_HZ);
}

/* One byte arrives, with the flags that the USART raises. */
void probe_hear(uint8_t byte, uint32_t flags)
{
    USART1->DR = byte;
    USART1->SR = flags;
    USART1_IRQHandler();
}

/* Takes a sample, and sends it if the line is ready; returns its status. */
uint32_t probe_sample(bool line_ready)
{
    firmware_sample();
    samples_taken++;
    rig_after_sample();
    if (line_ready) {
        USART1->SR = USART_SR_TXE;
        USART1_IRQHandler();
    }
    return firmware_link.status;
}
