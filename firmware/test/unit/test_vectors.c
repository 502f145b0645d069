/* The test vectors of docs/wire_vectors.csv, held against the core's codec, the hand's judgement, and the oracle's codec. */
#include <string.h>

#include "bench.h"
#include "check.h"
#include "oracle.h"
#include "tests.h"
#include "vectors.h"

#define SESSION 0x12345678u

static bool is(const char *verdict, const char *name) { return strcmp(verdict, name) == 0; }

static hpac_rx_result_t received(const uint8_t *wire, size_t length, hpac_rx_t *rx)
{
    hpac_rx_result_t result = HPAC_RX_MORE;
    hpac_rx_init(rx);
    for (size_t i = 0; i < length; i++) {
        result = hpac_rx_push(rx, wire[i]);
    }
    return result;
}

static hpac_rx_result_t result_of(const char *verdict)
{
    if (is(verdict, "crc")) {
        return HPAC_RX_CRC;
    }
    if (is(verdict, "cobs") || is(verdict, "short")) {
        return HPAC_RX_BAD;
    }
    if (is(verdict, "overrun")) {
        return HPAC_RX_OVERRUN;
    }
    return is(verdict, "version") || is(verdict, "look") || is(verdict, "estop") ? HPAC_RX_VERSION : HPAC_RX_FRAME;
}

static void codecs_agree(size_t i)
{
    hpac_rx_t rx;
    uint8_t frame[128];
    uint8_t wire[128];
    size_t size = 0;
    CHECK(received(vectors[i].wire, vectors[i].length, &rx) == result_of(vectors[i].verdict));
    oracle_verdict_t verdict = oracle_decode(vectors[i].wire + 1, vectors[i].length - 2u, frame, &size);
    CHECK(verdict == (is(vectors[i].verdict, "crc")     ? ORACLE_DAMAGED
                      : is(vectors[i].verdict, "cobs")  ? ORACLE_NOT_COBS
                      : is(vectors[i].verdict, "short") ? ORACLE_TOO_SHORT
                                                        : ORACLE_INTACT));
    if (verdict != ORACLE_INTACT) {
        return;
    }
    const uint8_t *payload = frame + HPAC_HEADER_LENGTH;
    size_t length = size - HPAC_HEADER_LENGTH - HPAC_CRC_LENGTH;
    uint16_t seq = (uint16_t)(frame[2] + 256u * frame[3]);
    CHECK(oracle_encode(wire, frame[0], frame[1], seq, frame[4], payload, length) == vectors[i].length);
    CHECK(memcmp(wire, vectors[i].wire, vectors[i].length) == 0);
    CHECK(is(vectors[i].verdict, "overrun") || (rx.length == size && memcmp(rx.frame, frame, size) == 0));
    if (frame[1] >= 0x80u) { /* the hand writes what it says itself */
        uint8_t again[HPAC_FRAME_MAX];
        memcpy(again, frame, size);
        CHECK(hpac_frame_encode(again, frame[1], seq, length, wire) == vectors[i].length);
        CHECK(memcmp(wire, vectors[i].wire, vectors[i].length) == 0);
    }
}

/* What a hand armed in that session answers. */
static void the_hand_judges_as_stated(size_t i)
{
    static const struct { const char *verdict; int reason; } refusals[] = {
        { "length", HPAC_REASON_LENGTH },   { "type", HPAC_REASON_TYPE },       { "flags", HPAC_REASON_FLAGS },
        { "session", HPAC_REASON_SESSION }, { "version", HPAC_REASON_VERSION }, { "estop", HPAC_REASON_OK },
    };
    bench_t bench;
    int reason = -1;
    bench_start(&bench);
    bench.session = SESSION;
    bench_send(&bench, HPAC_HELLO, 0, NULL, 0);
    bench.acks = 0;
    bench_feed(&bench, vectors[i].wire, vectors[i].length);
    for (size_t k = 0; k < sizeof refusals / sizeof refusals[0]; k++) {
        reason = is(vectors[i].verdict, refusals[k].verdict) ? refusals[k].reason : reason;
    }
    CHECK(is(vectors[i].verdict, "ok") || (reason >= 0 ? bench.acks == 1 && bench.reason == reason : bench.acks == 0));
}

void test_vectors(void)
{
    for (size_t i = 0; i < sizeof vectors / sizeof vectors[0]; i++) {
        codecs_agree(i);
        the_hand_judges_as_stated(i);
    }
}
