#include "hpac_hand.h"

#include "hpac_dispatch.h"
#include "hpac_load.h"
#include "hpac_motion.h"
#include "hpac_state.h"

void hpac_config_default(hpac_config_t *config)
{
    static const hpac_servo_t table[HPAC_SERVOS] = HPAC_SERVO_TABLE(0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1);
    for (int i = 0; i < HPAC_SERVOS; i++) {
        config->servo[i] = table[i];
    }
}

static void recall(hpac_hand_t *hand, const hpac_memory_t *memory)
{
    for (int i = 0; i < HPAC_SERVOS; i++) { /* more heat than any effort brings is not a memory but noise */
        hand->heat[i] = memory->heat[i] < 2u * HPAC_HEAT_LIMIT ? memory->heat[i] : 2u * HPAC_HEAT_LIMIT;
    }
    hand->placed = (uint8_t)(memory->placed & HPAC_ALL_SERVOS);
    hpac_motion_stand(hand, memory->pose);
}

void hpac_hand_init(hpac_hand_t *hand, const hpac_config_t *config, hpac_reset_t reset, uint16_t boot_count,
                    const hpac_memory_t *memory)
{
    int32_t rest[HPAC_SERVOS];
    *hand = (hpac_hand_t){
        .config = config, .reset = (uint8_t)reset, .boot_count = boot_count, .watchdog_ms = HPAC_WATCHDOG_MS, .state = HPAC_STATE_BOOT
    };
    for (int i = 0; i < HPAC_SERVOS; i++) {
        rest[i] = config->servo[i].rest_urad;
    }
    hpac_motion_stand(hand, rest);
    if (memory != NULL) {
        recall(hand, memory);
    }
    if (!hpac_servo_all_usable(config->servo)) {
        hpac_state_fault(hand, HPAC_FAULT_CONFIG, HPAC_NO_SERVO);
    } else if (reset == HPAC_RESET_BROWNOUT) {
        hpac_state_fault(hand, HPAC_FAULT_BROWNOUT, HPAC_NO_SERVO);
    } else if (reset == HPAC_RESET_CRASH) {
        hpac_state_fault(hand, HPAC_FAULT_CRASH, HPAC_NO_SERVO);
    }
}

void hpac_hand_remember(const hpac_hand_t *hand, hpac_memory_t *memory)
{
    for (int i = 0; i < HPAC_SERVOS; i++) {
        memory->heat[i] = hand->heat[i];
        memory->pose[i] = hand->pose[i];
    }
    memory->placed = hand->placed;
}

void hpac_hand_inputs(hpac_hand_t *hand, bool estop_pressed, uint16_t supply_mv)
{
    hand->estop_pressed = estop_pressed;
    hand->supply_mv = supply_mv;
}

void hpac_hand_output_failed(hpac_hand_t *hand) { hpac_state_fault(hand, HPAC_FAULT_INTERNAL, HPAC_NO_SERVO); }

bool hpac_hand_powered(const hpac_hand_t *hand)
{
    return hand->state == HPAC_STATE_ARMED || hand->attached != 0u;
}

void hpac_hand_tick(hpac_hand_t *hand, const hpac_config_t *config, uint64_t now_us, uint32_t pulses[HPAC_SERVOS])
{
    unsigned servo;
    hand->config = config;
    hpac_state_advance(hand, now_us);
    if (hand->fault != HPAC_FAULT_CONFIG && !hpac_motion_output(hand, &servo)) {
        hpac_state_fault(hand, HPAC_FAULT_INTERNAL, servo);
    }
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        bool attached = (hand->attached & (1u << i)) != 0u;
        pulses[i] = attached ? hpac_servo_pulse(&config->servo[i], hand->pose[i]) : 0u;
    }
}

void hpac_hand_receive(hpac_hand_t *hand, const hpac_config_t *config, uint64_t now_us, const uint8_t *bytes, size_t length)
{
    hand->config = config;
    hpac_state_advance(hand, now_us);
    for (size_t i = 0; i < length; i++) {
        switch (hpac_rx_push(&hand->rx, bytes[i])) {
        case HPAC_RX_MORE:
            break;
        case HPAC_RX_FRAME:
            hpac_dispatch(hand);
            break;
        case HPAC_RX_VERSION:
            hpac_dispatch_other_version(hand);
            break;
        case HPAC_RX_CRC:
            hpac_state_count(&hand->count.bad_crc);
            break;
        case HPAC_RX_BAD:
            hpac_state_count(&hand->count.bad_frame);
            break;
        case HPAC_RX_OVERRUN:
            hpac_state_count(&hand->count.overrun);
            break;
        }
    }
}
