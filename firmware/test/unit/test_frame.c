/* Frames: CRC, COBS, the receiver's judgement of each kind of damage. */
#include <string.h>

#include "bench.h"
#include "check.h"
#include "tests.h"

static void crc_is_zlibs(void)
{
    CHECK(hpac_crc32((const uint8_t *)"123456789", 9) == 0xcbf43926u);
    CHECK(hpac_crc32(NULL, 0) == 0u);
}

static hpac_rx_result_t last_result(const uint8_t *bytes, size_t length)
{
    hpac_rx_t rx;
    hpac_rx_result_t result = HPAC_RX_MORE;
    hpac_rx_init(&rx);
    for (size_t i = 0; i < length; i++) {
        result = hpac_rx_push(&rx, bytes[i]);
    }
    return result;
}

static void receiver_names_the_damage(void)
{
    uint8_t wire[128];
    uint8_t payload[HPAC_FRAME_MAX];
    size_t length = bench_frame(wire, HPAC_VERSION, HPAC_HEARTBEAT, 3, 0, NULL, 0);
    CHECK(last_result(wire, length) == HPAC_RX_FRAME);
    wire[2] ^= 0x40u;
    CHECK(last_result(wire, length) == HPAC_RX_CRC);
    CHECK(last_result((const uint8_t *)"\5abc", 5) == HPAC_RX_BAD); /* a run past the end */
    CHECK(last_result((const uint8_t *)"\4abc", 5) == HPAC_RX_BAD); /* too short */
    CHECK(last_result((const uint8_t *)"\1\1\1\1\1", 6) == HPAC_RX_BAD); /* an empty body with its right CRC, 0 */
    CHECK(last_result((const uint8_t *)"\0\0\0", 3) == HPAC_RX_MORE);
    memset(payload, 1, sizeof payload);
    length = bench_frame(wire, HPAC_VERSION, HPAC_HEARTBEAT, 3, 0, payload, sizeof payload);
    CHECK(last_result(wire, length) == HPAC_RX_OVERRUN);
    length = bench_frame(wire, HPAC_VERSION + 1u, HPAC_HEARTBEAT, 3, 0, NULL, 0);
    CHECK(last_result(wire, length) == HPAC_RX_VERSION);
    for (uint8_t beyond = 0; beyond < 2; beyond++) { /* should a bit flip, nothing beyond the buffer is read */
        hpac_rx_t rx;
        hpac_rx_init(&rx);
        memset(rx.frame, 1, sizeof rx.frame);
        rx.received = (uint8_t)(HPAC_COBS_MAX + beyond);
        CHECK((hpac_rx_push(&rx, 0) == HPAC_RX_OVERRUN) == (beyond != 0));
    }
}

static void every_single_bit_error_is_found(void)
{
    uint8_t payload[HPAC_MOVE_LENGTH] = { 50, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12 };
    uint8_t wire[128];
    size_t length = bench_frame(wire, HPAC_VERSION, HPAC_MOVE, 0x1234, 0, payload, sizeof payload);
    for (size_t bit = 8; bit < 8u * (length - 1u); bit++) {
        hpac_rx_t rx;
        bool accepted = false;
        hpac_rx_init(&rx);
        wire[bit / 8u] = (uint8_t)(wire[bit / 8u] ^ (1u << (bit % 8u)));
        for (size_t i = 0; i < length; i++) {
            accepted = hpac_rx_push(&rx, wire[i]) == HPAC_RX_FRAME || accepted;
        }
        wire[bit / 8u] = (uint8_t)(wire[bit / 8u] ^ (1u << (bit % 8u)));
        CHECK(!accepted);
    }
}

static void fields_are_little_endian(void)
{
    uint8_t bytes[4];
    hpac_put_u32(bytes, 0x89abcdefu);
    CHECK(bytes[0] == 0xefu && bytes[3] == 0x89u);
    CHECK(hpac_get_u32(bytes) == 0x89abcdefu);
    CHECK(hpac_get_u16(bytes) == 0xcdefu);
    CHECK(hpac_get_i16(bytes) == -12817);
    CHECK(hpac_get_i16((const uint8_t[]){ 0x00, 0x80 }) == -32768);
    CHECK(hpac_get_i16((const uint8_t[]){ 0xff, 0x7f }) == 32767);
}

void test_frame(void)
{
    crc_is_zlibs();
    receiver_names_the_damage();
    every_single_bit_error_is_found();
    fields_are_little_endian();
}
