/* The few registers of QEMU's riscv "virt" machine that the board uses. */
#ifndef VIRT_H
#define VIRT_H

#include <stdbool.h>
#include <stdint.h>

/* 16550 UART */
bool virt_read_byte(uint8_t *byte);
bool virt_write_byte(uint8_t byte);

/* CLINT timer, 10 MHz */
uint64_t virt_clock_us(void);

/* The deepest that the stack has been since reset [bytes]. */
uint32_t virt_stack_used(void);

/* Ends QEMU with this exit status. */
void virt_exit(uint32_t status);

#endif
