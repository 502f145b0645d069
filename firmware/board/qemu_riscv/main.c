/* The core on an emulated 32-bit microcontroller (rv32imc, the instruction set of the ESP32-C3), its UART the port.
 * It has no servos: what counts here is that the same code keeps its promises on a small machine. */
#include "hpac_hand.h"
#include "virt.h"

#define TICK_US 1000u

static hpac_hand_t hand;
static const hpac_memory_t at_rest = { .placed = HPAC_ALL_SERVOS }; /* it arms as after a reset, not as after power-on */

int main(void)
{
    hpac_config_t config;
    uint32_t pulses[HPAC_SERVOS];
    uint64_t next_us = 0;
    uint8_t answer = 0;
    bool pending = false;
    hpac_config_default(&config);
    hpac_hand_init(&hand, &config, HPAC_RESET_POWER_ON, 1, &at_rest);
    for (;;) {
        uint8_t byte;
        while (virt_read_byte(&byte)) {
            hpac_hand_receive(&hand, &config, virt_clock_us(), &byte, 1); /* the clock after the byte: never before it came */
        }
        uint64_t now_us = virt_clock_us();
        if (now_us >= next_us) {
            next_us = now_us + TICK_US;
            hpac_hand_tick(&hand, &config, now_us, pulses);
        }
        pending = pending || hpac_hand_transmit(&hand, &answer, 1) == 1u;
        while (pending && virt_write_byte(answer)) {
            pending = hpac_hand_transmit(&hand, &answer, 1) == 1u;
        }
    }
}
