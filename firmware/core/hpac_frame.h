/* Frames: COBS between zero bytes, header, payload of a fixed length, CRC-32. Pure functions and one receiver. */
#ifndef HPAC_FRAME_H
#define HPAC_FRAME_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "hpac_protocol.h"

/* Longest encoded frame: a zero, one COBS code byte, the frame (shorter than 254 bytes), a zero. */
#define HPAC_WIRE_MAX (HPAC_FRAME_MAX + 3u)
/* Longest encoded frame without its zeros. */
#define HPAC_COBS_MAX (HPAC_FRAME_MAX + 1u)

typedef enum {
    HPAC_RX_MORE,    /* no frame ended with this byte */
    HPAC_RX_FRAME,   /* rx->frame is intact and of our version; its type, flags and length are not yet judged */
    HPAC_RX_VERSION, /* intact, of another version */
    HPAC_RX_CRC,     /* damaged: dropped */
    HPAC_RX_BAD,     /* not COBS, or too short for a frame: dropped */
    HPAC_RX_OVERRUN, /* longer than any frame: dropped */
} hpac_rx_result_t;

typedef struct {
    uint8_t frame[HPAC_COBS_MAX]; /* encoded while it comes in, decoded in place when it is whole */
    uint8_t received;                  /* encoded bytes of the frame that is coming in */
    uint8_t length;                    /* bytes of the last whole frame, decoded */
    bool overrun;                      /* the present frame is too long; waiting for its end */
} hpac_rx_t;

/* Forget a half-received frame. */
void hpac_rx_init(hpac_rx_t *rx);

/* Feed one received byte. Never blocks; safe with any byte in any state. A damaged frame costs that frame and no
 * other. With HPAC_RX_FRAME and HPAC_RX_VERSION, rx->frame and rx->length hold header, payload and CRC until the
 * next call. */
hpac_rx_result_t hpac_rx_push(hpac_rx_t *rx, uint8_t byte);

/* Put header and CRC around a payload that already lies at frame + HPAC_HEADER_LENGTH, and encode it to `wire`, which
 * has room for HPAC_WIRE_MAX bytes. Returns the bytes written, zeros at both ends included. */
size_t hpac_frame_encode(uint8_t frame[HPAC_FRAME_MAX], uint8_t type, uint16_t seq, size_t payload_length, uint8_t *wire);

/* CRC-32 (zlib's, reflected 0xEDB88320): finds every burst up to 32 bits in a frame. */
uint32_t hpac_crc32(const uint8_t *bytes, size_t length);

/* Little-endian fields. */
uint16_t hpac_get_u16(const uint8_t *at);
int16_t hpac_get_i16(const uint8_t *at);
uint32_t hpac_get_u32(const uint8_t *at);
void hpac_put_u16(uint8_t *at, uint16_t value);
void hpac_put_u32(uint8_t *at, uint32_t value);

#endif
