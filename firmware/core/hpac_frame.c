#include "hpac_frame.h"

/* The CRC of each value of four bits: two steps a byte, 64 bytes of flash instead of 1 KiB. */
static const uint32_t nibble_crc[16] = {
    0x00000000u, 0x1db71064u, 0x3b6e20c8u, 0x26d930acu, 0x76dc4190u, 0x6b6b51f4u, 0x4db26158u, 0x5005713cu,
    0xedb88320u, 0xf00f9344u, 0xd6d6a3e8u, 0xcb61b38cu, 0x9b64c2b0u, 0x86d3d2d4u, 0xa00ae278u, 0xbdbdf21cu,
};

uint32_t hpac_crc32(const uint8_t *bytes, size_t length)
{
    uint32_t crc = 0xffffffffu;
    for (size_t i = 0; i < length; i++) {
        crc ^= bytes[i];
        crc = (crc >> 4) ^ nibble_crc[crc & 15u];
        crc = (crc >> 4) ^ nibble_crc[crc & 15u];
    }
    return ~crc;
}

uint16_t hpac_get_u16(const uint8_t *at) { return (uint16_t)(at[0] | (at[1] << 8)); }

int16_t hpac_get_i16(const uint8_t *at)
{
    int32_t value = hpac_get_u16(at);
    return (int16_t)(value < 0x8000 ? value : value - 0x10000);
}

uint32_t hpac_get_u32(const uint8_t *at) { return hpac_get_u16(at) | ((uint32_t)hpac_get_u16(at + 2) << 16); }

void hpac_put_u16(uint8_t *at, uint16_t value)
{
    at[0] = (uint8_t)(value & 0xffu);
    at[1] = (uint8_t)(value >> 8);
}

void hpac_put_u32(uint8_t *at, uint32_t value)
{
    hpac_put_u16(at, (uint16_t)(value & 0xffffu));
    hpac_put_u16(at + 2, (uint16_t)(value >> 16));
}

/* Decode COBS of fewer than 254 bytes in place: the output never overtakes the input. Returns the decoded length, or 0 if it is not COBS. */
static size_t cobs_decode(uint8_t *bytes, size_t length)
{
    size_t in = 0;
    size_t out = 0;
    while (in < length) {
        size_t code = bytes[in++];
        if (code == 0u || in + code - 1u > length) {
            return 0;
        }
        for (size_t i = 1; i < code; i++) {
            bytes[out++] = bytes[in++];
        }
        if (in < length) {
            bytes[out++] = 0;
        }
    }
    return out;
}

/* Encode fewer than 254 bytes: one code byte more, no zeros. Returns the encoded length. */
static size_t cobs_encode(const uint8_t *bytes, size_t length, uint8_t *out)
{
    size_t code_at = 0;
    size_t written = 1;
    for (size_t i = 0; i < length; i++) {
        if (bytes[i] == 0u) {
            out[code_at] = (uint8_t)(written - code_at);
            code_at = written++;
        } else {
            out[written++] = bytes[i];
        }
    }
    out[code_at] = (uint8_t)(written - code_at);
    return written;
}

void hpac_rx_init(hpac_rx_t *rx)
{
    rx->received = 0;
    rx->length = 0;
    rx->overrun = false;
}

static hpac_rx_result_t judge(hpac_rx_t *rx, size_t encoded)
{
    size_t length = cobs_decode(rx->frame, encoded);
    if (length < HPAC_HEADER_LENGTH + HPAC_CRC_LENGTH) {
        return HPAC_RX_BAD;
    }
    size_t body = length - HPAC_CRC_LENGTH;
    if (hpac_get_u32(rx->frame + body) != hpac_crc32(rx->frame, body)) {
        return HPAC_RX_CRC;
    }
    rx->length = (uint8_t)length;
    return rx->frame[HPAC_AT_VERSION] == HPAC_VERSION ? HPAC_RX_FRAME : HPAC_RX_VERSION;
}

hpac_rx_result_t hpac_rx_push(hpac_rx_t *rx, uint8_t byte)
{
    if (byte != 0u) {
        if (rx->received < HPAC_COBS_MAX) {
            rx->frame[rx->received++] = byte;
        } else {
            rx->overrun = true;
        }
        return HPAC_RX_MORE;
    }
    size_t encoded = rx->received;
    bool overrun = rx->overrun;
    hpac_rx_init(rx);
    if (overrun || encoded > HPAC_COBS_MAX) {
        return HPAC_RX_OVERRUN;
    }
    return encoded == 0 ? HPAC_RX_MORE : judge(rx, encoded);
}

size_t hpac_frame_encode(uint8_t frame[HPAC_FRAME_MAX], uint8_t type, uint16_t seq, size_t payload_length, uint8_t *wire)
{
    size_t body = HPAC_HEADER_LENGTH + payload_length;
    frame[HPAC_AT_VERSION] = HPAC_VERSION;
    frame[HPAC_AT_TYPE] = type;
    hpac_put_u16(frame + HPAC_AT_SEQ, seq);
    frame[HPAC_AT_FLAGS] = 0;
    hpac_put_u32(frame + body, hpac_crc32(frame, body));
    wire[0] = 0;
    size_t encoded = cobs_encode(frame, body + HPAC_CRC_LENGTH, wire + 1);
    wire[1 + encoded] = 0;
    return encoded + 2u;
}
