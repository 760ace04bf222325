// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* The used registers and bits of the STM32F405/F407 (reference manual RM0090) and its Cortex-M4. */
#ifndef REGISTERS_H
#define REGISTERS_H

#include <stdint.h>

typedef volatile uint32_t reg;

struct gpio {
    reg MODER, OTYPER, OSPEEDR, PUPDR, IDR, ODR, BSRR, LCKR, AFR[2];
};
#define GPIO(letter) ((struct gpio *)(0x40020000u + 0x400u * ((uint32_t)(letter) - 'A')))
enum { GPIO_INPUT, GPIO_OUTPUT, GPIO_ALTERNATE, GPIO_ANALOG };
enum { GPIO_FLOATING, GPIO_PULL_UP, GPIO_PULL_DOWN };

struct timer {
    reg CR1, CR2, SMCR, DIER, SR, EGR, CCMR1, CCMR2, CCER, CNT, PSC, ARR, RCR, CCR1, CCR2, CCR3, CCR4, BDTR;
};
#define TIM1 ((struct timer *)0x40010000u)
#define TIM2 ((struct timer *)0x40000000u)
#define TIM3 ((struct timer *)0x40000400u)
#define TIM_CR1_CEN (1u << 0)
#define TIM_SMCR_ENCODER 3u                     /* counts every edge of both channels */
#define TIM_SR_BIF (1u << 7)                    /* a break occurred */
#define TIM_CCMR1_INPUTS (1u << 0 | 1u << 8)    /* channels 1 and 2 are inputs */
#define TIM_CCMR1_FILTER (3u << 4 | 3u << 12)   /* an edge counts after 8 equal samples, 0.1 us */
#define TIM_CCMR1_PWM1 (6u << 4)                /* channel 1 is high while CNT < CCR1 */
#define TIM_CCER_CC1E (1u << 0)
#define TIM_EGR_UG (1u << 0)
#define TIM_BDTR_OSSI (1u << 10) /* while off, the output is driven low, not left open */
#define TIM_BDTR_BKE (1u << 12)  /* the break input clears MOE, without software */
#define TIM_BDTR_BKP (1u << 13)  /* ... while it is high */
#define TIM_BDTR_MOE (1u << 15)

struct usart {
    reg SR, DR, BRR, CR1, CR2, CR3, GTPR;
};
#define USART1 ((struct usart *)0x40011000u)
#define USART_SR_ORE (1u << 3)
#define USART_SR_RXNE (1u << 5)
#define USART_SR_TXE (1u << 7)
#define USART_CR1_RE (1u << 2)
#define USART_CR1_TE (1u << 3)
#define USART_CR1_RXNEIE (1u << 5)
#define USART_CR1_TXEIE (1u << 7)
#define USART_CR1_UE (1u << 13)
enum { USART1_IRQ = 37, INTERRUPTS = 82 };

struct adc {
    reg SR, CR1, CR2, SMPR1, SMPR2, JOFR[4], HTR, LTR, SQR1, SQR2, SQR3, JSQR, JDR[4], DR;
};
#define ADC1 ((struct adc *)0x40012000u)
#define ADC_COMMON_CCR (*(reg *)0x40012304u)
#define ADC_CR1_SCAN (1u << 8)
#define ADC_CR2_ADON (1u << 0)
#define ADC_CR2_JSWSTART (1u << 22)

struct rcc {
    reg CR, PLLCFGR, CFGR, CIR, AHB1RSTR, AHB2RSTR, AHB3RSTR, pad1, APB1RSTR, APB2RSTR, pad2[2], AHB1ENR, AHB2ENR,
        AHB3ENR, pad3, APB1ENR, APB2ENR, pad4[2], AHB1LPENR, AHB2LPENR, AHB3LPENR, pad5, APB1LPENR, APB2LPENR, pad6[2],
        BDCR, CSR;
};
#define RCC ((struct rcc *)0x40023800u)
#define RCC_CR_HSEON (1u << 16)
#define RCC_CR_HSERDY (1u << 17)
#define RCC_CR_CSSON (1u << 19)
#define RCC_CR_PLLON (1u << 24)
#define RCC_CR_PLLRDY (1u << 25)
#define RCC_PLLCFGR_HSE (1u << 22)
#define RCC_CFGR_SW_PLL 2u
#define RCC_CFGR_SWS_PLL (2u << 2)
#define RCC_CFGR_PPRE1_4 (5u << 10)
#define RCC_CFGR_PPRE2_2 (4u << 13)
#define RCC_AHB1ENR_GPIOA_TO_D 15u
#define RCC_AHB2ENR_RNG (1u << 6)
#define RCC_APB1ENR_TIM2_TIM3 3u
#define RCC_APB1ENR_PWR (1u << 28)
#define RCC_APB2ENR_TIM1 (1u << 0)
#define RCC_APB2ENR_USART1 (1u << 4)
#define RCC_APB2ENR_ADC1 (1u << 8)
#define RCC_CSR_RMVF (1u << 24)
#define RCC_CSR_BORRSTF (1u << 25)
#define RCC_CSR_PORRSTF (1u << 27)
#define RCC_CSR_SFTRSTF (1u << 28)
#define RCC_CSR_IWDGRSTF (1u << 29)

#define FLASH_ACR (*(reg *)0x40023c00u)
#define FLASH_ACR_168_MHZ (5u | 1u << 9 | 1u << 10) /* wait states, caches; prefetch fails in revision A */

struct pwr {
    reg CR, CSR;
};
#define PWR ((struct pwr *)0x40007000u)
#define PWR_CR_PVD_LEVEL_4 (1u << 4 | 4u << 5) /* threshold 2.7 V, necessary for 168 MHz */
#define PWR_CSR_PVDO (1u << 2) /* the processor's supply is below it */

struct iwdg {
    reg KR, PR, RLR, SR;
};
#define IWDG ((struct iwdg *)0x40003000u)
enum { IWDG_START = 0xcccc, IWDG_UNLOCK = 0x5555, IWDG_FEED = 0xaaaa };

struct rng {
    reg CR, SR, DR;
};
#define RNG ((struct rng *)0x50060800u)
#define RNG_CR_RNGEN (1u << 2)
#define RNG_SR_DRDY (1u << 0)

struct systick {
    reg CTRL, LOAD, VAL;
};
#define SYSTICK ((struct systick *)0xe000e010u)
#define SYSTICK_ON 7u /* counts core cycles, interrupts */

#define NVIC_ISER ((reg *)0xe000e100u)
#define NVIC_ISPR ((reg *)0xe000e200u)
#define SCB_ICSR (*(reg *)0xe000ed04u)
#define SCB_ICSR_PENDSTCLR (1u << 25) /* SysTick is no longer pending */
#define SCB_AIRCR (*(reg *)0xe000ed0cu)
#define SCB_AIRCR_RESET 0x05fa0004u
#define SCB_SHPR3 (*(reg *)0xe000ed20u)

/* The cycle counter; QEMU has none, it reads 0. */
#define DEMCR (*(reg *)0xe000edfcu)
#define DEMCR_TRCENA (1u << 24)
#define DWT_CTRL (*(reg *)0xe0001000u)
#define DWT_CTRL_CYCCNTENA (1u << 0)
#define DWT_CYCCNT (*(reg *)0xe0001004u)

#define DBGMCU_APB1_FZ (*(reg *)0xe0042008u)
#define DBGMCU_APB1_FZ_IWDG_STOP (1u << 12) /* the independent watchdog stops while a debugger halts the processor */

#define RAM_BEGIN 0x20000000u
#define RAM_END 0x20020000u

#endif
