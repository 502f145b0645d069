/* libFuzzer, raw: the input is what comes in on the wire, 16 bytes a millisecond, to a hand that is armed. */
#include "promises.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static judged_t armed;
    if (armed.now_us == 0u) {
        start_armed(&armed);
    }
    judged_t judged = armed;
    judged.hand.config = &judged.config;
    for (size_t at = 0; at < size; at += 16u) {
        feed(&judged, data + at, size - at < 16u ? size - at : 16u);
        pass(&judged, 1000);
    }
    return 0;
}
