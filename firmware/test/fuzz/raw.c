/* libFuzzer, raw: the input is what comes in on the wire, 16 bytes a millisecond, to a hand that is armed. */
#include <stdlib.h>

#include "bench.h"
#include "promises.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static bench_t armed;
    if (armed.hand.state != HPAC_STATE_ARMED) {
        bench_armed(&armed, HPAC_ACTION_HOLD);
    }
    bench_t bench = armed;
    for (size_t at = 0; at < size; at += 16u) {
        bench_feed(&bench, data + at, size - at < 16u ? size - at : 16u);
        bench_run(&bench, 1);
        promises_kept(&bench);
    }
    return 0;
}
