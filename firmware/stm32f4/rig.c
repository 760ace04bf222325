// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* Clocks, pins, encoders and analog inputs of a real rig. */
#include "port.h"
#include "registers.h"
#include "rig.h"

enum { AF_TIM1_TIM2 = 1, AF_TIM3 = 2, AF_USART1 = 7 };
enum { LARGEST_JUMP_SHOULDER = COUNTS_SHOULDER * FASTEST_TURNS_PER_S / SAMPLE_HZ + 1 };
enum { LARGEST_JUMP_ELBOW = COUNTS_ELBOW * FASTEST_TURNS_PER_S / SAMPLE_HZ + 1 };
_Static_assert(LARGEST_JUMP_SHOULDER < 1 << 15 && LARGEST_JUMP_ELBOW < 1 << 15,
    "a 16-bit counter may wrap between two samples: raise SAMPLE_HZ");

static const struct pendubot_settings settings = {
    .cpr1 = COUNTS_SHOULDER,
    .cpr2 = COUNTS_ELBOW,
    .torque_limit = TORQUE_LIMIT_MICRO_NM,
    .sample_period_us = 1000000 / SAMPLE_HZ,
    .watchdog_max_ms = WATCHDOG_MAX_MS,
    .torque_constant = MICRO_NM_PER_A,
    .build = BUILD_ID,
    .limits = {
        .torque_slew = TORQUE_SLEW_MICRO_NM_PER_MS,
        .max_speed = MAX_SPEED_MRAD_S,
        .max_travel1 = MAX_TRAVEL_SHOULDER_MRAD,
        .max_travel2 = MAX_TRAVEL_ELBOW_MRAD,
        .stall_torque = STALL_TORQUE_MICRO_NM,
        .stall_ms = STALL_MS,
        .continuous_ma = CONTINUOUS_MA,
        .overload_ms = OVERLOAD_MS,
        .max_vbus = OVERVOLTAGE_10MV,
    },
    .firmware = "stm32f4 2",
};

static uint32_t vbus_10mv;
static struct encoder {
    uint16_t counter;
    int32_t counts;
} shoulder, elbow;
static uint8_t cause;

/* Keeps its value during a reset; after power-on it is undefined. */
static uint32_t boots __attribute__((section(".noinit")));

const struct pendubot_settings *board_settings(void)
{
    return &settings;
}

/* Starting */

static void start_clocks(void)
{
    /* 168 MHz from the crystal, 42 and 84 for the peripherals, 48 for the random numbers. */
    RCC->CR |= RCC_CR_HSEON;
    while (!(RCC->CR & RCC_CR_HSERDY)) {
    }
    /* From here on a failed crystal causes an NMI, a fault, and a break of TIM1, which would run on for a while. */
    RCC->CR |= RCC_CR_CSSON;
    RCC->CFGR = RCC_CFGR_PPRE1_4 | RCC_CFGR_PPRE2_2;
    RCC->PLLCFGR = CRYSTAL_MHZ | 336u << 6 | RCC_PLLCFGR_HSE | 7u << 24;
    RCC->CR |= RCC_CR_PLLON;
    while (!(RCC->CR & RCC_CR_PLLRDY)) {
    }
    FLASH_ACR = FLASH_ACR_168_MHZ;
    RCC->CFGR |= RCC_CFGR_SW_PLL;
    while ((RCC->CFGR & 3u << 2) != RCC_CFGR_SWS_PLL) {
    }
    RCC->AHB1ENR |= RCC_AHB1ENR_GPIOA_TO_D;
    RCC->AHB2ENR |= RCC_AHB2ENR_RNG;
    RCC->APB1ENR |= RCC_APB1ENR_TIM2_TIM3 | RCC_APB1ENR_PWR;
    RCC->APB2ENR |= RCC_APB2ENR_TIM1 | RCC_APB2ENR_USART1 | RCC_APB2ENR_ADC1;
    (void)RCC->APB2ENR; /* a peripheral accepts writes two cycles after its clock starts */
    PWR->CR |= PWR_CR_PVD_LEVEL_4;
}

static void set_pin(char letter, uint32_t number, uint32_t mode, uint32_t pull, uint32_t function)
{
    struct gpio *gpio = GPIO(letter);
    gpio->PUPDR = (gpio->PUPDR & ~(3u << 2 * number)) | pull << 2 * number;
    gpio->AFR[number / 8] = (gpio->AFR[number / 8] & ~(15u << 4 * (number % 8))) | function << 4 * (number % 8);
    gpio->MODER = (gpio->MODER & ~(3u << 2 * number)) | mode << 2 * number;
}

static bool is_high(char letter, uint32_t number)
{
    return GPIO(letter)->IDR >> number & 1;
}

static void start_pins(void)
{
    set_pin(PIN_SHOULDER_A, GPIO_ALTERNATE, GPIO_PULL_UP, AF_TIM1_TIM2);
    set_pin(PIN_SHOULDER_B, GPIO_ALTERNATE, GPIO_PULL_UP, AF_TIM1_TIM2);
    set_pin(PIN_ELBOW_A, GPIO_ALTERNATE, GPIO_PULL_UP, AF_TIM3);
    set_pin(PIN_ELBOW_B, GPIO_ALTERNATE, GPIO_PULL_UP, AF_TIM3);
    set_pin(PIN_EMERGENCY, GPIO_ALTERNATE, GPIO_PULL_UP, AF_TIM1_TIM2);
    set_pin(PIN_BRIDGE_FAULT, GPIO_INPUT, GPIO_PULL_UP, 0);
    set_pin(PIN_DIRECTION, GPIO_OUTPUT, GPIO_FLOATING, 0);
    set_pin(PIN_PWM, GPIO_ALTERNATE, GPIO_PULL_DOWN, AF_TIM1_TIM2);
    set_pin(PIN_TRANSMIT, GPIO_ALTERNATE, GPIO_FLOATING, AF_USART1);
    set_pin(PIN_RECEIVE, GPIO_ALTERNATE, GPIO_PULL_UP, AF_USART1);
    set_pin(PIN_CURRENT, GPIO_ANALOG, GPIO_FLOATING, 0);
    set_pin(PIN_SUPPLY, GPIO_ANALOG, GPIO_FLOATING, 0);
    set_pin(PIN_LED, GPIO_OUTPUT, GPIO_FLOATING, 0);
}

static void start_encoder(struct timer *timer)
{
    timer->ARR = 0xffff;
    timer->CCMR1 = TIM_CCMR1_INPUTS | TIM_CCMR1_FILTER;
    timer->SMCR = TIM_SMCR_ENCODER;
    timer->EGR = TIM_EGR_UG;
    timer->CR1 = TIM_CR1_CEN;
}

static void start_analog(void)
{
    ADC_COMMON_CCR = 1u << 16;              /* 84 MHz / 4 */
    ADC1->SMPR2 = 4u << 3 * 8 | 4u << 3 * 9; /* 84 cycles each: 9 us for both */
    ADC1->CR1 = ADC_CR1_SCAN;
    ADC1->JSQR = 1u << 20 | 8u << 10 | 9u << 15; /* two, injected: inputs 8 and 9 into JDR 1 and 2 */
    ADC1->CR2 = ADC_CR2_ADON;
}

static void note_reset_cause(void)
{
    uint32_t flags = RCC->CSR;
    RCC->CSR |= RCC_CSR_RMVF;
    cause = flags & RCC_CSR_IWDGRSTF ? 3 : flags & RCC_CSR_SFTRSTF ? 4 : flags & (RCC_CSR_PORRSTF | RCC_CSR_BORRSTF) ? 1 : 2;
}

void rig_start(void)
{
    note_reset_cause();
    start_clocks();
    start_pins();
    start_encoder(TIM2);
    start_encoder(TIM3);
    start_analog();
    /* The first sample needs a supply voltage; switching on takes 3 us, a conversion 9 us. */
    for (volatile uint32_t wait = 0; wait < 1000; wait++) {
    }
    rig_after_sample();
    boots++;
}

uint32_t board_boot_id(void)
{
    RNG->CR = RNG_CR_RNGEN;
    for (uint32_t tries = 0; tries < 10000 && !(RNG->SR & RNG_SR_DRDY); tries++) {
    }
    return RNG->DR ^ boots * 0x9e3779b9u;
}

struct pendubot_reset board_reset(void)
{
    return fault_log_read(cause);
}

/* Sampling */

/* Reads an encoder's 16-bit counter; returns whether it moved further than any joint can in a sample. */
static bool read_encoder(struct encoder *encoder, const struct timer *timer, int32_t sign, int32_t largest)
{
    uint16_t counter = (uint16_t)timer->CNT;
    int32_t moved = (int16_t)(counter - encoder->counter);
    encoder->counter = counter;
    /* Unsigned, because the sum may wrap after many turns. */
    encoder->counts = (int32_t)((uint32_t)encoder->counts + (uint32_t)(sign * moved));
    return moved > largest || moved < -largest;
}

void board_read(struct pendubot_reading *reading)
{
    bool jump1 = read_encoder(&shoulder, TIM2, SIGN_SHOULDER, LARGEST_JUMP_SHOULDER);
    bool jump2 = read_encoder(&elbow, TIM3, SIGN_ELBOW, LARGEST_JUMP_ELBOW);
    reading->enc1 = shoulder.counts;
    reading->enc2 = elbow.counts;
    vbus_10mv = ADC1->JDR[1] * MICROVOLT_PER_STEP / 10000;
    int32_t current_ma = ((int32_t)ADC1->JDR[0] - CURRENT_ZERO_STEPS) * MICROAMPERE_PER_STEP / 1000;
    reading->vbus_10mv = (uint16_t)vbus_10mv;
    reading->current_ma = (int16_t)(SIGN_MOTOR * current_ma); /* positive with a positive torque */
    uint32_t faults = 0;
    /* Also a stop shorter than a sample, or a bouncing contact. */
    faults |= is_high(PIN_EMERGENCY) || motor_was_stopped() ? PENDUBOT_EMERGENCY_STOP : 0u;
    faults |= jump1 ? PENDUBOT_ENCODER_1 : 0u;
    faults |= jump2 ? PENDUBOT_ENCODER_2 : 0u;
    faults |= current_ma > OVER_CURRENT_MA || current_ma < -OVER_CURRENT_MA ? PENDUBOT_OVER_CURRENT : 0u;
    faults |= is_high(PIN_BRIDGE_FAULT) ? 0u : PENDUBOT_OVER_TEMPERATURE;
    faults |= vbus_10mv < UNDERVOLTAGE_10MV || PWR->CSR & PWR_CSR_PVDO ? PENDUBOT_UNDERVOLTAGE : 0u;
    reading->faults = faults;
}

void board_torque(int32_t torque)
{
    motor_torque(torque, vbus_10mv);
}

void rig_after_sample(void)
{
    ADC1->CR2 = ADC_CR2_ADON | ADC_CR2_JSWSTART;
}

static void set_led(char letter, uint32_t number, bool on)
{
    GPIO(letter)->BSRR = 1u << (on ? number : number + 16);
}

/* On: armed. Blinking slowly: disarmed. Blinking quickly: a fault or a tripped watchdog. Dark: no firmware runs. */
void rig_show(void)
{
    uint32_t status = firmware_link.status;
    uint32_t ms = samples_taken * 1000 / SAMPLE_HZ;
    bool quick = status & (PENDUBOT_FAULTS | PENDUBOT_WATCHDOG);
    set_led(PIN_LED, status & PENDUBOT_ARMED || ms % (quick ? 200u : 1000u) < 100u);
}
