/* Which pin drives which servo, in the order thumb_mp, index_mcp, middle_mcp, ring_mcp, pinky_mcp, thumb_cmc, and what
 * this copy of the hand needs: change it to your wiring, then run `hpac wiggle` to see that names and fingers agree. */
#ifndef PINS_H
#define PINS_H

#include "sdkconfig.h"

#if CONFIG_IDF_TARGET_ESP32
#define SERVO_PINS { 16, 17, 18, 19, 21, 22 }
#elif CONFIG_IDF_TARGET_ESP32C6
#define SERVO_PINS { 18, 19, 20, 21, 22, 23 }
#else
#define SERVO_PINS { 3, 4, 5, 6, 7, 10 }
#endif

/* Zero trims [ns], added to every pulse, and directions, -1 for a servo mounted the other way round. */
#define SERVO_TRIMS_NS { 0, 0, 0, 0, 0, 0 }
#define SERVO_DIRECTIONS { 1, 1, 1, 1, 1, 1 }

#endif
