/* Copyright 2026 The pendubot_identification authors
 * SPDX-License-Identifier: Apache-2.0 */
/* The STM32F4's program: everything happens in two interrupts, and the main loop only says that they still come. */
#include "port.h"
#include "registers.h"
#include "rig.h"

volatile uint32_t samples_taken, longest_sample_cycles;

uint32_t board_micros(void)
{
    return samples_taken * (1000000 / SAMPLE_HZ);
}

void SysTick_Handler(void)
{
    firmware_sample();
    uint32_t cycles = SYSTICK->LOAD - SYSTICK->VAL;
    if (cycles > longest_sample_cycles) {
        longest_sample_cycles = cycles;
    }
    samples_taken++;
    rig_after_sample();
}

static __attribute__((used, noreturn)) void begin_again(void)
{
    motor_off();
    SCB_AIRCR = SCB_AIRCR_RESET;
    for (;;) {
    }
}

/* Any fault of the processor, and any interrupt that nobody expects: motor off, and begin again, disarmed and locked.
 * On an empty stack, because the fault may be that the stack has left the RAM. Where even this does not run, the
 * independent watchdog resets. */
__attribute__((naked)) void Fault_Handler(void)
{
    __asm__ volatile("ldr r0, =stack_top\n"
                     "mov sp, r0\n"
                     "b begin_again\n");
}

static void start_independent_watchdog(void)
{
    IWDG->KR = IWDG_START;
    IWDG->KR = IWDG_UNLOCK;
    IWDG->PR = 1; /* 32 kHz / 8 */
    IWDG->RLR = 4 * HUNG_MS;
    while (IWDG->SR != 0) {
    }
    IWDG->KR = IWDG_FEED;
}

int main(void)
{
    /* First: a crystal that does not start, for example, makes a board that resets again and again, motor off. */
    start_independent_watchdog();
    rig_start();
    motor_start();
    uart_start();
    firmware_boot();
    SCB_SHPR3 = 0x10u << 24; /* SysTick below the USART, which keeps 0, the highest */
    SYSTICK->LOAD = CORE_HZ / SAMPLE_HZ - 1;
    SYSTICK->VAL = 0;
    SYSTICK->CTRL = SYSTICK_ON;
    for (uint32_t seen = 0;;) {
        __asm__ volatile("wfi");
        if (samples_taken != seen) {
            seen = samples_taken;
            IWDG->KR = IWDG_FEED;
            rig_show();
        }
    }
}
