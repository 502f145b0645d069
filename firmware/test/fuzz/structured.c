/* libFuzzer, structured: the input is a list of whole frames and pauses, so that the fuzzer need not guess CRCs. */
#include <stdlib.h>
#include <string.h>

#include "bench.h"
#include "promises.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

typedef struct {
    const uint8_t *at;
    size_t left;
} input_t;

static uint8_t take(input_t *input)
{
    if (input->left == 0u) {
        return 0;
    }
    input->left--;
    return *input->at++;
}

static const uint8_t lengths[] = { 0,
                                   HPAC_HELLO_LENGTH,
                                   HPAC_ARM_LENGTH,
                                   HPAC_MOVE_LENGTH,
                                   HPAC_HEARTBEAT_LENGTH,
                                   HPAC_ESTOP_LENGTH,
                                   HPAC_CLEAR_LENGTH,
                                   HPAC_STATUS_LENGTH };

/* One byte says what comes; the payload follows, but for an ARM, whose hash is right unless its top bit says otherwise. */
static void play_frame(bench_t *bench, input_t *input, uint8_t kind)
{
    uint8_t payload[HPAC_MOVE_LENGTH] = { 0 };
    uint8_t type = kind & 7u;
    uint8_t flags = (kind >> 3) & 3u;
    for (uint8_t i = 0; i < lengths[type]; i++) {
        payload[i] = take(input);
    }
    if (type == HPAC_ARM && (payload[0] & 0x80u) == 0u) {
        hpac_put_u32(payload + HPAC_ARM_AT_LIMITS_HASH, HPAC_LIMITS_HASH);
        payload[HPAC_ARM_AT_ACTION] = payload[HPAC_ARM_AT_ACTION] % 4u;
    }
    uint32_t accepted = bench->hand.count.accepted;
    bench_send(bench, type, flags, payload, lengths[type]);
    bool carried_out = bench->hand.count.accepted != accepted;
    if (carried_out && (type == HPAC_CLEAR || type == HPAC_ESTOP)) {
        promise(bench_silent(bench));
        promise(!hpac_ramp_moving(&bench->hand.ramp, bench->now_us));
    }
    if (carried_out && type == HPAC_MOVE) {
        promise(bench->hand.state == HPAC_STATE_ARMED);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    input_t input = { data, size };
    bench_t bench;
    bench_start(&bench);
    while (input.left > 0u) {
        uint8_t kind = take(&input);
        if ((kind & 0x80u) != 0u) {
            bench_skip(&bench, (kind & 0x7fu) * 5u);
        } else {
            play_frame(&bench, &input, kind);
        }
        promises_kept(&bench);
    }
    return 0;
}
