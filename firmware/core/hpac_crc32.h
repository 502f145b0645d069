/* CRC-32 (zlib's, reflected 0xEDB88320): finds every burst up to 32 bits in a frame. */
#ifndef HPAC_CRC32_H
#define HPAC_CRC32_H

#include <stddef.h>
#include <stdint.h>

/* CRC-32 of `length` bytes. */
uint32_t hpac_crc32(const uint8_t *bytes, size_t length);

#endif
