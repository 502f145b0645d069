#include "hpac_load.h"

/* Heat approaches effort squared by this share a step. */
#define STEPS_PER_TIME_CONSTANT (HPAC_LOAD_TIME_CONSTANT_S * (1000000 / (int32_t)HPAC_LOAD_STEP_US))

uint32_t hpac_load_effort(uint32_t travel_permille, uint32_t speed_permille)
{
    uint32_t travel = travel_permille < 1000u ? travel_permille : 1000u;
    uint32_t speed = speed_permille < 1000u ? speed_permille : 1000u;
    return HPAC_LOAD_IDLE_PERMILLE + HPAC_LOAD_HOLD_PERMILLE * travel / 1000u + HPAC_LOAD_MOVE_PERMILLE * speed / 1000u;
}

uint32_t hpac_load_step(uint32_t heat, uint32_t effort)
{
    int64_t difference = (int64_t)effort * effort * 256 - heat;
    return (uint32_t)(heat + difference / STEPS_PER_TIME_CONSTANT);
}

uint8_t hpac_load_percent(uint32_t heat)
{
    uint32_t percent = heat / (HPAC_HEAT_LIMIT / 100u);
    return (uint8_t)(percent < 255u ? percent : 255u);
}

uint16_t hpac_load_rate_permille(uint32_t heat)
{
    uint32_t from = HPAC_HEAT_LIMIT / 100u * HPAC_LOAD_DERATE_FROM_PERCENT;
    if (heat <= from) {
        return 1000u;
    }
    if (heat >= HPAC_HEAT_LIMIT) {
        return HPAC_LOAD_DERATE_TO_PERMILLE;
    }
    uint32_t share = (heat - from) / ((HPAC_HEAT_LIMIT - from) / 1000u);
    return (uint16_t)(1000u - (1000u - HPAC_LOAD_DERATE_TO_PERMILLE) * (share < 1000u ? share : 1000u) / 1000u);
}
