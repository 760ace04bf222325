// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* The functions that the files of this port share. */
#ifndef PORT_H
#define PORT_H

#include "board.h"

/* rig.c: clocks, encoders, analog inputs, pins. The emulated port replaces it. */
void rig_start(void);
void rig_after_sample(void); /* work after the sample's bytes are sent */
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
extern volatile uint32_t longest_sample_cycles; /* duration of the sample interrupt */

/* watchdog.c */
void watchdog_start(void);
void watchdog_feed(void); /* while samples are taken */

/* fault.c */
void fault_begin_again(const uint32_t *frame, uint32_t exception) __attribute__((noreturn));
struct pendubot_reset fault_log_read(uint8_t reset_cause);

/* The commit of the source, which the Makefile sets. */
#ifndef BUILD_ID
#define BUILD_ID 0
#endif

#endif
