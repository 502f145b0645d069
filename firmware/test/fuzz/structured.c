/* libFuzzer, structured: the input is a list of whole frames, pauses and inputs, so that the fuzzer need not guess CRCs. */
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

/* One byte says what comes; the payload follows, its session and limits hash the right ones unless a byte says otherwise. */
static void play_frame(judged_t *judged, input_t *input, uint8_t kind)
{
    uint8_t payload[HPAC_MOVE_LENGTH] = { 0 };
    uint8_t type = kind & 7u;
    uint8_t flags = (kind >> 3) & 3u;
    for (uint8_t i = type == HPAC_STATUS ? 0 : 3; i < lengths[type]; i++) {
        payload[i] = take(input);
    }
    if (type != HPAC_STATUS && payload[3] < 0xf0u) {
        hpac_put_u32(payload, SESSION);
    }
    if (type == HPAC_ARM && payload[HPAC_ARM_AT_LIMITS_HASH] < 0x80u) {
        hpac_put_u32(payload + HPAC_ARM_AT_LIMITS_HASH, oracle_hash(judged->oracle.guard.table));
        payload[HPAC_ARM_AT_ACTION] = payload[HPAC_ARM_AT_ACTION] % 4u;
    }
    say(judged, type, flags, payload, lengths[type]);
    pass(judged, 0);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    input_t input = { data, size };
    judged_t judged;
    start(&judged);
    while (input.left > 0u) {
        uint8_t kind = take(&input);
        if ((kind & 0xe0u) == 0xe0u) {
            judged.hand.estop_pressed = judged.oracle.estop_pressed = (kind & 1u) != 0u;
        } else if ((kind & 0xc0u) == 0xc0u) { /* whatever the clock does: 0.1 s late at the most */
            pass(&judged, (kind & 0x1fu) * 3000u);
        } else if ((kind & 0x80u) != 0u) {
            for (unsigned i = 0; i < (kind & 0x3fu); i++) {
                pass(&judged, 10000);
            }
        } else {
            play_frame(&judged, &input, kind);
        }
    }
    return 0;
}
