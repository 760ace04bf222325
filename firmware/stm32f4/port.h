// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* What the files of this port give each other. */
#ifndef PORT_H
#define PORT_H

#include "board.h"

/* rig.c: clocks, encoders, analog inputs, pins. The emulated port has its own in its place. */
void rig_start(void);
void rig_after_sample(void); /* what can wait until the sample's bytes are on their way */
void rig_show(void);         /* the LED */

/* motor.c: the bridge. */
void motor_start(void);
void motor_torque(int32_t torque, uint32_t vbus_10mv);
void motor_off(void);         /* at any time, also before motor_start */
bool motor_was_stopped(void); /* by TIM1's break input, since motor_start */

/* uart.c */
void uart_start(void);
void USART1_IRQHandler(void);

/* sample.c */
void sample_start(void);
void SysTick_Handler(void);
extern volatile uint32_t samples_taken;
extern volatile uint32_t longest_sample_cycles; /* from the interrupt of a sample until it returns */

/* watchdog.c */
void watchdog_start(void);
void watchdog_feed(void); /* while samples come */

/* fault.c */
void fault_begin_again(const uint32_t *frame, uint32_t exception) __attribute__((noreturn));
struct pendubot_reset fault_log_read(uint8_t reset_cause);

/* Which source this is built from; the Makefile knows. */
#ifndef BUILD_ID
#define BUILD_ID 0
#endif

#endif
