/* Copyright 2026 The pendubot_identification authors
 * SPDX-License-Identifier: Apache-2.0 */
/* Your rig: pins and constants, the only file to change for another one. docs/rig.md has the wiring.
 *
 * What is marked "measure" is of a rig that nobody has measured: with the motor disconnected, begin with it.
 */
#ifndef RIG_H
#define RIG_H

/* Time and line */

#ifndef SAMPLE_HZ
#define SAMPLE_HZ 1000 /* 60 to 1000; at 115200 bit/s at most 100 */
#endif
#define BAUD 921600
#define CRYSTAL_MHZ 8        /* on the board beside the processor; 8 on the Discovery board, 12 or 25 on others */
#define WATCHDOG_MAX_MS 500  /* longest time for which a host's command holds */
#define HUNG_MS 50           /* a firmware that hangs for so long is reset (34 to 94 ms: its own oscillator is rough) */
#define CORE_HZ 168000000u

/* Encoders, quadrature: counts per turn are four times the lines. Measure: turn the joint once. */

#define COUNTS_SHOULDER 4000
#define COUNTS_ELBOW 4000
#define SIGN_SHOULDER 1 /* -1 where it counts clockwise */
#define SIGN_ELBOW 1
#define FASTEST_TURNS_PER_S 30 /* a joint that seems faster than this is an encoder fault */

/* Motor: torque = MICRO_NM_PER_A * current, current = voltage / MOTOR_MILLIOHM, voltage = duty * supply.
 *
 * All at the shoulder, the gear's ratio and its losses included. The voltage that the turning motor induces is not made
 * up for: it brakes like viscous friction, k^2 / R, and identification finds it in b1. Nor is the resistance's rise as
 * the motor warms, 0.4 % per kelvin.
 */

/* Measure: hold the arm level with a spring scale at a known radius, at a few currents; slope of torque over current. */
#define MICRO_NM_PER_A 200000
/* Measure: voltage over current at 1 A with the shaft held, at a few angles; the mean, leads and bridge included. */
#define MOTOR_MILLIOHM 2000
#define SIGN_MOTOR 1                  /* -1 where a positive torque makes the shoulder fall */
#define TORQUE_LIMIT_MICRO_NM 1500000 /* never more, whatever the host asks for */
#define PWM_HZ 20000                  /* what your bridge can switch; above what one hears */
#define DUTY_MAX_PERMILLE 950         /* bridges that charge their high side by switching need a little off time */

/* Analog inputs, 12 bits of 3.3 V: 806 uV per step */

/* Measure: supply at the pin's divider; 10 kOhm below 100 kOhm make 806 uV * 11. */
#define MICROVOLT_PER_STEP 8862
#define UNDERVOLTAGE_10MV 1800
/* Measure: the step count at no current, and a known current; 100 mV/A about the middle make 8057 uA per step. */
#define CURRENT_ZERO_STEPS 2048
#define MICROAMPERE_PER_STEP 8057
#define OVER_CURRENT_MA 10000

/* Pins, as letter of the port and number. Those with a timer, the USART or the ADC behind them are fixed by RM0090's
 * table of alternate functions; what is behind them is set up in rig.c and motor.c. */

#define PIN_SHOULDER_A 'A', 15 /* TIM2 channel 1 */
#define PIN_SHOULDER_B 'B', 3  /* TIM2 channel 2 */
#define PIN_ELBOW_A 'B', 4     /* TIM3 channel 1 */
#define PIN_ELBOW_B 'B', 5     /* TIM3 channel 2 */
#define PIN_PWM 'A', 8         /* TIM1 channel 1 */
#define PIN_EMERGENCY 'B', 12  /* TIM1 break: a closed contact to ground; open or torn off is an emergency stop */
#define PIN_DIRECTION 'B', 14
#define PIN_BRIDGE_FAULT 'B', 15 /* low: the bridge says that it is too hot or overloaded */
#define PIN_TRANSMIT 'B', 6      /* USART1 */
#define PIN_RECEIVE 'B', 7
#define PIN_CURRENT 'B', 0 /* ADC1 input 8 */
#define PIN_SUPPLY 'B', 1  /* ADC1 input 9 */
#define PIN_LED 'D', 12    /* green one of the Discovery board */

_Static_assert(SAMPLE_HZ >= 11 && SAMPLE_HZ <= 1000, "SysTick counts 24 bits of core cycles; 1 kHz is what is tested");
_Static_assert(1000000 % SAMPLE_HZ == 0 && CORE_HZ % SAMPLE_HZ == 0, "a period of whole microseconds and core cycles");
_Static_assert(1ll * CURRENT_ZERO_STEPS * MICROAMPERE_PER_STEP / 1000 <= 32767
        && (4095ll - CURRENT_ZERO_STEPS) * MICROAMPERE_PER_STEP / 1000 <= 32767,
    "a STATE has 16 bits for the current");
_Static_assert((4095ll - CURRENT_ZERO_STEPS) * MICROAMPERE_PER_STEP / 1000 > OVER_CURRENT_MA,
    "the input cannot show an over-current: lower OVER_CURRENT_MA, or mend the sensor");
_Static_assert(1000 / SAMPLE_HZ * 3 <= HUNG_MS, "a firmware that samples in time must not count as hung");
_Static_assert(TORQUE_LIMIT_MICRO_NM >= 0
        && 1ll * TORQUE_LIMIT_MICRO_NM * MOTOR_MILLIOHM / MICRO_NM_PER_A * 1000
               <= 10ll * UNDERVOLTAGE_10MV * DUTY_MAX_PERMILLE,
    "the supply, at its lowest, cannot give the torque limit: lower the limit");

#endif
