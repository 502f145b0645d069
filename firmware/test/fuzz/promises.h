/* What must hold after anything at all; abort() tells the fuzzer. */
#ifndef PROMISES_H
#define PROMISES_H

#include <stdlib.h>

#include "bench.h"

static inline void promise(bool holds)
{
    if (!holds) {
        abort();
    }
}

static inline void promises_kept(const bench_t *bench)
{
    promise(bench->hand.fault != HPAC_FAULT_INTERNAL);
    promise(bench->hand.state <= HPAC_STATE_FAULT && bench->hand.tx_length <= HPAC_TX_CAPACITY);
    promise((bench->hand.state == HPAC_STATE_FAULT) == (bench->hand.fault != HPAC_FAULT_NONE));
    for (int i = 0; i < HPAC_SERVOS; i++) {
        const hpac_servo_t *servo = &bench->hand.config.servo[i];
        uint32_t pulse = bench->pulses[i];
        promise(pulse == 0u || bench->hand.state >= HPAC_STATE_ARMED);
        promise(pulse == 0u || pulse >= hpac_servo_pulse(servo, servo->min_urad));
        promise(pulse == 0u || pulse <= hpac_servo_pulse(servo, servo->max_urad));
    }
}

#endif
