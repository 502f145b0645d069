#include "loop.h"

static uint32_t crc_of(const loop_memory_t *kept)
{
    return hpac_crc32((const uint8_t *)kept, offsetof(loop_memory_t, crc));
}

void loop_start(loop_t *loop, const hpac_config_t *config, hpac_reset_t reset, loop_memory_t *kept)
{
    bool known = reset != HPAC_RESET_POWER_ON && kept->crc == crc_of(kept);
    *loop = (loop_t){ .config = config, .kept = kept };
    kept->boots = known ? kept->boots + 1u : 1u;
    if (known) { /* for a reset before the first output */
        kept->crc = crc_of(kept);
    }
    hpac_hand_init(&loop->hand, config, reset, (uint16_t)kept->boots, known ? &kept->hand : NULL);
}

static void receive(loop_t *loop)
{
    uint8_t bytes[128];
    size_t length = board_read(bytes, sizeof bytes);
    if (length > 0u) {
        hpac_hand_receive(&loop->hand, loop->config, board_clock_us(), bytes, length);
    }
}

/* Only as much as the port takes without waiting. */
static void transmit(loop_t *loop)
{
    uint8_t bytes[128];
    size_t room = board_room();
    size_t length = hpac_hand_transmit(&loop->hand, bytes, room < sizeof bytes ? room : sizeof bytes);
    if (length > 0u) {
        board_write(bytes, length);
    }
}

static bool some_pulse_ended(const uint32_t pulses[HPAC_SERVOS], const uint32_t written[HPAC_SERVOS])
{
    for (int i = 0; i < HPAC_SERVOS; i++) {
        if (pulses[i] == 0u && written[i] != 0u) {
            return true;
        }
    }
    return false;
}

/* Pulses that end do so at the next period's start, whenever that is; all else changes in step with it. */
static void put_out(loop_t *loop, uint64_t now_us)
{
    uint32_t pulses[HPAC_SERVOS];
    hpac_hand_tick(&loop->hand, loop->config, now_us, pulses);
    board_power(hpac_hand_powered(&loop->hand));
    if (now_us < loop->next_us && !some_pulse_ended(pulses, loop->written)) {
        return;
    }
    if (!servo_output_write(pulses)) {
        hpac_hand_output_failed(&loop->hand);
        board_power(false);
    }
    for (int i = 0; i < HPAC_SERVOS; i++) {
        loop->written[i] = pulses[i];
    }
    hpac_hand_remember(&loop->hand, &loop->kept->hand);
    loop->kept->crc = crc_of(loop->kept);
    while (now_us >= loop->next_us) {
        loop->next_us += loop->period_us;
    }
}

void loop_once(loop_t *loop)
{
    receive(loop);
    hpac_hand_inputs(&loop->hand, board_estop_pressed(), board_supply_mv());
    put_out(loop, board_clock_us());
    transmit(loop);
}
