// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* A fault of the processor, or an interrupt that nobody expects: motor off, write it down, begin again disarmed. */
#include "port.h"
#include "registers.h"

/* It keeps its value while the processor resets; after power it is any number. */
static struct {
    uint32_t exception, pc, check;
} record __attribute__((section(".noinit")));

static uint32_t check_word(void)
{
    return record.exception * 0x9e3779b9u ^ record.pc ^ 0x70656e64u;
}

/* `frame`: where the processor has pushed its registers, if the stack was in the RAM. Fault_Handler in startup.c calls
 * this on an empty stack, because the fault may be that the stack has left the RAM. If even this does not run, the
 * independent watchdog resets. */
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

/* Returns why the board booted, and the last processor fault since power came. */
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
