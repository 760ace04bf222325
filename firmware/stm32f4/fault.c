// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* A processor fault or an unexpected interrupt: motor off, record the fault, restart disarmed. */
#include "port.h"
#include "registers.h"

/* It keeps its value during a reset; after power-on it is undefined. */
static struct {
    uint32_t exception, pc, check;
} record __attribute__((section(".noinit")));

static uint32_t check_word(void)
{
    return record.exception * 0x9e3779b9u ^ record.pc ^ 0x70656e64u;
}

/* `frame`: the registers that the processor pushed, if the stack was in the RAM. Fault_Handler in startup.c calls this
 * on an empty stack, because a stack overflow may be the fault. If this function does not run, the independent watchdog
 * resets. */
void fault_begin_again(const uint32_t *frame, uint32_t exception)
{
    motor_off();
    bool readable = (uintptr_t)frame >= RAM_BEGIN && (uintptr_t)frame <= RAM_END - 8 * sizeof *frame;
    record.exception = exception;
    record.pc = readable ? frame[6] : 0;
    record.check = check_word();
    SCB_AIRCR = SCB_AIRCR_RESET;
    for (;;) {
    }
}

/* Returns the cause of the boot, and the last processor fault since power-on. */
struct pendubot_reset fault_log_read(uint8_t reset_cause)
{
    struct pendubot_reset reset = { .cause = reset_cause };
    if (reset_cause == 1) {
        record.check = ~check_word();
    }
    if (record.check == check_word()) {
        reset.fault_cause = (uint8_t)record.exception;
        reset.fault_pc = record.pc;
    }
    return reset;
}
