#ifndef HPAC_LIBRARY_H
#define HPAC_LIBRARY_H

#include "hpac_hand.h"

size_t hpac_library_hand_size(void);

/* Tick every `period_us` after `from_us`, until `until_us` or until the hand has something to say; returns when. */
uint64_t hpac_library_run(hpac_hand_t *hand, const hpac_config_t *config, uint64_t from_us, uint64_t until_us, uint64_t period_us,
                          uint32_t pulses[HPAC_SERVOS]);

#endif
