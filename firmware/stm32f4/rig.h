// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* Your rig: pins, constants and limits. It is the only file to change for another rig. firmware/README.md has the wiring.
 *
 * Values marked "measure" are guesses. Measure them on your rig, with the motor disconnected, before you arm it.
 */
#ifndef RIG_H
#define RIG_H

#include <stdint.h>

/* Time and line */

#ifndef SAMPLE_HZ
#define SAMPLE_HZ 1000 /* 60 to 1000; at 115200 bit/s at most 100 */
#endif
#define BAUD 921600
#define CRYSTAL_MHZ 8        /* on the board beside the processor; 8 on the Discovery board, 12 or 25 on others */
#define WATCHDOG_MAX_MS 500  /* longest time for which a host's command holds */
#define HUNG_MS 50           /* watchdog time for hung firmware (34 to 94 ms: its RC oscillator is inaccurate) */
#define CORE_HZ 168000000u

/* Encoders, quadrature: counts per turn are four times the lines. Measure: turn the joint once. */

#define COUNTS_SHOULDER 4000
#define COUNTS_ELBOW 4000
#define SIGN_SHOULDER 1 /* -1 if it counts clockwise */
#define SIGN_ELBOW 1
#define FASTEST_TURNS_PER_S 30 /* a joint that seems faster than this is an encoder fault */

/* Motor: torque = MICRO_NM_PER_A * current, current = voltage / MOTOR_MILLIOHM, voltage = duty * supply.
 *
 * All at the shoulder, including the gear's ratio and its losses. The induced voltage of the turning motor is not
 * compensated: it acts like viscous friction, k^2 / R, and identification includes it in b1. The resistance's rise with
 * the motor's temperature, 0.4 % per kelvin, is not compensated either.
 */

/* Measure: hold the arm level with a spring scale at a known radius, at a few currents; slope of torque over current. */
#define MICRO_NM_PER_A 200000
/* Measure: voltage over current at 1 A with the shaft held, at a few angles; take the mean, with leads and bridge. */
#define MOTOR_MILLIOHM 2000
#define SIGN_MOTOR 1                  /* -1 if a positive torque makes the shoulder fall */
#define TORQUE_LIMIT_MICRO_NM 1500000 /* upper limit of the host's commands */
/* Largest change of the torque per ms. Measure: the largest value without shaking links. */
#define TORQUE_SLEW_MICRO_NM_PER_MS 300000
#define PWM_HZ 20000                  /* within the range of your bridge, and above the audible range */
#define DUTY_MAX_PERMILLE 950         /* bridges with a bootstrap supply need some off time */

/* Analog inputs, 12 bits of 3.3 V: 806 uV per step */

/* Measure: supply at the pin's divider; 10 kOhm below 100 kOhm make 806 uV * 11. */
#define MICROVOLT_PER_STEP 8862
#define UNDERVOLTAGE_10MV 1800
/* Measure: the step count at no current, and a known current; 100 mV/A about the middle make 8057 uA per step. */
#define CURRENT_ZERO_STEPS 2048
#define MICROAMPERE_PER_STEP 8057
#define OVER_CURRENT_MA 10000

/* Limits at which the board switches the motor off. HELLO reports them to the host. */

/* Measure: 1.2 times the fastest motion that an experiment needs, of either joint. */
#define MAX_SPEED_MRAD_S 60000
/* Measure: how far each joint turns from its place at boot before a cable pulls or a stop is hit. */
#define MAX_TRAVEL_SHOULDER_MRAD 25000
#define MAX_TRAVEL_ELBOW_MRAD 100000
/* From this torque on the shoulder has to move within STALL_MS; else it is blocked, or its encoder is unplugged.
 * Measure: 1.5 times the torque that holds both links level and overcomes friction. */
#define STALL_TORQUE_MICRO_NM 500000
#define STALL_MS 500
/* Measure, or take from the motor's data sheet: the continuous current, and the permitted time of twice as much. */
#define CONTINUOUS_MA 5000
#define OVERLOAD_MS 2000
#define OVERVOLTAGE_10MV 3000 /* below the ratings of the bridge, the motor and a regenerative supply */

/* Pins, as letter of the port and number. RM0090's table of alternate functions fixes the pins of the timers, the USART
 * and the ADC; rig.c and motor.c set up these peripherals. */

#define PIN_SHOULDER_A 'A', 15 /* TIM2 channel 1 */
#define PIN_SHOULDER_B 'B', 3  /* TIM2 channel 2 */
#define PIN_ELBOW_A 'B', 4     /* TIM3 channel 1 */
#define PIN_ELBOW_B 'B', 5     /* TIM3 channel 2 */
#define PIN_PWM 'A', 8         /* TIM1 channel 1 */
#define PIN_EMERGENCY 'B', 12  /* TIM1 break: a contact to ground; an open contact or wire is an emergency stop */
#define PIN_DIRECTION 'B', 14
#define PIN_BRIDGE_FAULT 'B', 15 /* low: the bridge is too hot or overloaded */
#define PIN_TRANSMIT 'B', 6      /* USART1 */
#define PIN_RECEIVE 'B', 7
#define PIN_CURRENT 'B', 0 /* ADC1 input 8 */
#define PIN_SUPPLY 'B', 1  /* ADC1 input 9 */
#define PIN_LED 'D', 12    /* green one of the Discovery board */

_Static_assert(SAMPLE_HZ >= 11 && SAMPLE_HZ <= 1000, "SysTick counts 24 bits of core cycles; 1 kHz is tested");
_Static_assert(1000000 % SAMPLE_HZ == 0 && CORE_HZ % SAMPLE_HZ == 0, "a period of whole microseconds and core cycles");
_Static_assert(1ll * CURRENT_ZERO_STEPS * MICROAMPERE_PER_STEP / 1000 <= 32767
        && (4095ll - CURRENT_ZERO_STEPS) * MICROAMPERE_PER_STEP / 1000 <= 32767,
    "a STATE has 16 bits for the current");
_Static_assert((4095ll - CURRENT_ZERO_STEPS) * MICROAMPERE_PER_STEP / 1000 > OVER_CURRENT_MA,
    "the input cannot show an over-current: lower OVER_CURRENT_MA, or correct the sensor");
_Static_assert(1000 / SAMPLE_HZ * 3 <= HUNG_MS, "a firmware that samples in time must not count as hung");
_Static_assert(TORQUE_LIMIT_MICRO_NM >= 0
        && 1ll * TORQUE_LIMIT_MICRO_NM * MOTOR_MILLIOHM / MICRO_NM_PER_A * 1000
               <= 10ll * UNDERVOLTAGE_10MV * DUTY_MAX_PERMILLE,
    "the supply, at its lowest, cannot give the torque limit: lower the limit");
_Static_assert(TORQUE_SLEW_MICRO_NM_PER_MS > 0 && 100ll * TORQUE_SLEW_MICRO_NM_PER_MS >= TORQUE_LIMIT_MICRO_NM,
    "the slew takes more than 0.1 s to the torque limit: no controller balances with that");
_Static_assert(1ll * MAX_SPEED_MRAD_S * COUNTS_SHOULDER >= 2 * 6284ll * SAMPLE_HZ
        && 1ll * MAX_SPEED_MRAD_S * COUNTS_ELBOW >= 2 * 6284ll * SAMPLE_HZ,
    "two counts in a sample are beyond MAX_SPEED_MRAD_S: raise it, or sample more slowly");
_Static_assert(MAX_SPEED_MRAD_S < 6283ll * FASTEST_TURNS_PER_S, "a joint at MAX_SPEED_MRAD_S is an encoder fault");
_Static_assert(MAX_TRAVEL_SHOULDER_MRAD > 0 && 1ll * MAX_TRAVEL_SHOULDER_MRAD * COUNTS_SHOULDER / 6283 < INT32_MAX
        && MAX_TRAVEL_ELBOW_MRAD > 0 && 1ll * MAX_TRAVEL_ELBOW_MRAD * COUNTS_ELBOW / 6283 < INT32_MAX,
    "a travel of more counts than 31 bits hold is no limit");
_Static_assert(STALL_TORQUE_MICRO_NM > 0 && STALL_TORQUE_MICRO_NM < TORQUE_LIMIT_MICRO_NM,
    "the motor never reaches STALL_TORQUE_MICRO_NM: a blocked joint would not be noticed");
_Static_assert(STALL_MS * SAMPLE_HZ >= 10 * 1000 && STALL_MS <= 65535, "a stall takes at least ten samples");
_Static_assert(CONTINUOUS_MA > 0 && CONTINUOUS_MA < OVER_CURRENT_MA && OVERLOAD_MS > 0 && OVERLOAD_MS <= 65535,
    "CONTINUOUS_MA has to be above 0 and below OVER_CURRENT_MA, OVERLOAD_MS above 0 and within 16 bits");
_Static_assert(OVERVOLTAGE_10MV > UNDERVOLTAGE_10MV && 4095ll * MICROVOLT_PER_STEP / 10000 > OVERVOLTAGE_10MV,
    "the input cannot show OVERVOLTAGE_10MV, or it lies below UNDERVOLTAGE_10MV");

#endif
