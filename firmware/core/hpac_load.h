/* How hot each servo may be. No sensor is there: effort is what the commands alone allow, heat follows the square of
 * the effort (as in I2t) with one time constant. Integers only. */
#ifndef HPAC_LOAD_H
#define HPAC_LOAD_H

#include <stdint.h>

#include "hpac_protocol.h"

/* Heat is effort squared (permille squared) with 8 fractional bits; this much is admissible. */
#define HPAC_HEAT_LIMIT ((uint32_t)HPAC_LOAD_CONTINUOUS_PERMILLE * HPAC_LOAD_CONTINUOUS_PERMILLE * 256u)
/* hpac_load_step() stands for this much time. */
#define HPAC_LOAD_STEP_US 10000u

/* Effort of an attached servo [permille]: idle, plus its share of travel from rest, plus its share of the rate limit. */
uint32_t hpac_load_effort(uint32_t travel_permille, uint32_t speed_permille);

/* Heat after one step at `effort` (0 for a servo without pulses). */
uint32_t hpac_load_step(uint32_t heat, uint32_t effort);

/* Heat as a share of what is admissible [percent], at most 255. */
uint8_t hpac_load_percent(uint32_t heat);

/* What is left of the rate limit at this heat [permille]: 1000 when cool. */
uint16_t hpac_load_rate_permille(uint32_t heat);

#endif
