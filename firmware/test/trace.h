#ifndef TRACE_H
#define TRACE_H

#include <stdint.h>

/* Play a fixed session, moves of both kinds, pre-empted and not, refused ones, a watchdog trip, an e-stop, and return
 * the CRC-32 of every pulse of every tick and of every answered byte: one number that is the same on every target. */
uint32_t hpac_trace(void);

#endif
