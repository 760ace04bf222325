// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* The H-bridge: duty by TIM1 channel 1, direction by a pin, emergency stop by TIM1's break input. */
#include "port.h"
#include "registers.h"
#include "rig.h"

enum { PWM_STEPS = CORE_HZ / PWM_HZ, DUTY_MAX = PWM_STEPS * DUTY_MAX_PERMILLE / 1000 };

#define BREAK (TIM_BDTR_BKE | TIM_BDTR_BKP | TIM_BDTR_OSSI)

void motor_start(void)
{
    TIM1->ARR = PWM_STEPS - 1;
    TIM1->CCR1 = 0;
    TIM1->CCMR1 = TIM_CCMR1_PWM1;
    TIM1->CCER = TIM_CCER_CC1E;
    TIM1->BDTR = BREAK;
    TIM1->EGR = TIM_EGR_UG;
    TIM1->CR1 = TIM_CR1_CEN;
    TIM1->SR = 0;
}

static void set_direction(char letter, uint32_t number, bool positive)
{
    GPIO(letter)->BSRR = 1u << (positive ? number : number + 16);
}

void motor_torque(int32_t torque, uint32_t vbus_10mv)
{
    if (torque == 0 || vbus_10mv == 0) {
        motor_off();
        return;
    }
    int64_t millivolt = (int64_t)torque * MOTOR_MILLIOHM / MICRO_NM_PER_A;
    bool positive = (millivolt >= 0) == (SIGN_MOTOR > 0);
    int64_t duty = (millivolt < 0 ? -millivolt : millivolt) * PWM_STEPS / (10 * (int64_t)vbus_10mv);
    set_direction(PIN_DIRECTION, positive);
    TIM1->CCR1 = duty < DUTY_MAX ? (uint32_t)duty : DUTY_MAX;
    /* The hardware ignores this while the emergency stop is pressed. */
    TIM1->BDTR = BREAK | TIM_BDTR_MOE;
}

void motor_off(void)
{
    TIM1->BDTR = BREAK;
    TIM1->CCR1 = 0;
}

bool motor_was_stopped(void)
{
    return TIM1->SR & TIM_SR_BIF;
}
