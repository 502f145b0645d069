/* What a program that loads the core as a shared library needs besides hpac_hand.h: a size, and a clock that runs. */
#include "library.h"

size_t hpac_library_hand_size(void) { return sizeof(hpac_hand_t); }

uint64_t hpac_library_run(hpac_hand_t *hand, const hpac_config_t *config, uint64_t from_us, uint64_t until_us, uint64_t period_us,
                          uint32_t pulses[HPAC_SERVOS])
{
    uint64_t now_us = from_us;
    do {
        now_us = until_us - now_us > period_us ? now_us + period_us : until_us;
        hpac_hand_tick(hand, config, now_us, pulses);
    } while (now_us < until_us && hand->tx_length == 0u);
    return now_us;
}
