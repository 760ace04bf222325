// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* USART1: an interrupt moves bytes between the line and two rings; a sample empties one ring and fills the other.
 *
 * A ring has one writer and one reader, each with its own index, which wraps at 2^32, so that no lock is necessary. The
 * interrupt has priority over the sample's: at 921600 bit/s the next byte comes within 11 us.
 */
#include "port.h"
#include "registers.h"
#include "rig.h"

enum { RING = 256 };

struct ring {
    uint8_t bytes[RING];
    volatile uint32_t written, read;
};

static struct ring received, transmitted;

void uart_start(void)
{
    USART1->BRR = (CORE_HZ / 2 + BAUD / 2) / BAUD;
    USART1->CR1 = USART_CR1_UE | USART_CR1_TE | USART_CR1_RE | USART_CR1_RXNEIE;
    NVIC_ISER[USART1_IRQ / 32] = 1u << USART1_IRQ % 32;
}

static uint32_t filled(const struct ring *ring)
{
    return ring->written - ring->read;
}

static void put(struct ring *ring, uint8_t byte)
{
    uint32_t at = ring->written;
    ring->bytes[at % RING] = byte;
    ring->written = at + 1;
}

static uint8_t get(struct ring *ring)
{
    uint32_t at = ring->read;
    uint8_t byte = ring->bytes[at % RING];
    ring->read = at + 1;
    return byte;
}

void USART1_IRQHandler(void)
{
    uint32_t status = USART1->SR;
    if (status & (USART_SR_RXNE | USART_SR_ORE)) {
        /* Reading also clears the error flags; a damaged or lost byte makes its frame's CRC wrong. */
        uint8_t byte = (uint8_t)USART1->DR;
        if (status & USART_SR_RXNE && filled(&received) < RING) {
            put(&received, byte);
        }
    }
    while (filled(&transmitted) > 0 && USART1->SR & USART_SR_TXE) {
        USART1->DR = get(&transmitted);
    }
    if (filled(&transmitted) == 0) {
        USART1->CR1 &= ~USART_CR1_TXEIE;
    }
}

size_t board_receive(uint8_t *data, size_t room)
{
    size_t size = 0;
    while (size < room && filled(&received) > 0) {
        data[size++] = get(&received);
    }
    return size;
}

size_t board_room(void)
{
    return RING - filled(&transmitted);
}

bool board_send(const uint8_t *data, size_t size)
{
    if (size > board_room()) {
        return false;
    }
    for (size_t k = 0; k < size; k++) {
        put(&transmitted, data[k]);
    }
    USART1->CR1 |= USART_CR1_TXEIE;
    /* The chip raises the interrupt itself, but QEMU 7.2, whose transmitter is always empty, does not. */
    NVIC_ISPR[USART1_IRQ / 32] = 1u << USART1_IRQ % 32;
    return true;
}
