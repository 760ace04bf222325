// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* The vector table, and the initialisation before main. */
#include "registers.h"

#include <stdint.h>

/* Symbols of stm32f4.ld. */
extern uint32_t stack_top, data_begin, data_end, data_in_flash, bss_begin, bss_end;

int main(void);
void Fault_Handler(void);
void SysTick_Handler(void);
void USART1_IRQHandler(void);

void Reset_Handler(void)
{
    const uint32_t *from = &data_in_flash;
    for (uint32_t *to = &data_begin; to < &data_end;) {
        *to++ = *from++;
    }
    for (uint32_t *to = &bss_begin; to < &bss_end;) {
        *to++ = 0;
    }
    main();
}

/* Handles every unexpected exception and interrupt. It passes the address of the pushed registers and the exception
 * number to fault_begin_again, on an empty stack. */
__attribute__((naked)) void Fault_Handler(void)
{
    __asm__ volatile("mrs r0, msp\n"
                     "mrs r1, ipsr\n"
                     "ldr r2, =stack_top\n"
                     "mov sp, r2\n"
                     "b fault_begin_again\n");
}

typedef void vector(void);

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    vector *core[15];
    vector *interrupts[INTERRUPTS];
} vectors = {
    .stack = &stack_top,
    .core = { Reset_Handler, [1 ... 13] = Fault_Handler, [14] = SysTick_Handler },
    .interrupts = {
        [0 ... USART1_IRQ - 1] = Fault_Handler,
        [USART1_IRQ] = USART1_IRQHandler,
        [USART1_IRQ + 1 ... INTERRUPTS - 1] = Fault_Handler,
    },
};
