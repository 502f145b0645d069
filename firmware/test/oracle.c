#include "oracle.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* The numbers of docs/wire.md, written again. */
enum { VERSION = 2, FRAME_MAX = 59, HEADER = 5, CRC = 4 };
enum { HELLO = 1, ARM, MOVE, HEARTBEAT, ESTOP, CLEAR, STATUS, DEVICE_HELLO = 0x81, ACK, DEVICE_STATUS, FAULT };
enum { BOOT, IDLE, ARMED, IN_FAULT };
enum { NO_FAULT, BY_ESTOP, BY_WATCHDOG, BY_OVERLOAD, BY_INTERNAL, BY_BROWNOUT, BY_CRASH, BY_CONFIG, BY_SUPPLY };
enum { HOLD, RELAX, DETACH };
enum {
    OK, R_STATE, R_STARTING, R_STALE, R_ANGLE, R_RATE, R_DURATION, R_FLAGS, R_LIMITS, R_ACTION, R_PERIOD, R_TYPE, R_LENGTH,
    R_HOT, R_SESSION, R_VERSION, R_SUPPLY, R_ESTOP
};
#define NOBODY 255
#define PERIOD_NS 20000000
#define PULSE_MIN_NS 500000
#define PULSE_MAX_NS 2500000
#define TOLERANCE_URAD 100
#define TOLERANCE_US 1000
#define EXCESS_PERMILLE 10
#define STEP_MAX_US 20000
#define RELAX_PERMILLE 250
#define WATCHDOG_DEFAULT_MS 400
#define WATCHDOG_MIN_MS 100
#define WATCHDOG_MAX_MS 2000
#define HOLD_US 30000000
#define POWER_ON_US 50000
#define SETTLE_US 60000
#define START_SPEED 5.0 /* urad/us */
#define CLOCK_BACK_US 100000
#define SUPPLY_MIN_MV 4500
#define SUPPLY_LOW_US 20000
#define HEAT_LIMIT (750.0 * 750.0)
/* Where the two arithmetics may differ: angles [urad], durations that follow from angles [us], pulses [ns]. */
#define URAD 40.0
#define DOUBT_US 250
#define NS 40.0

static void say(oracle_guard_t *guard, const char *format, ...)
{
    va_list arguments;
    if (guard->broken[0] == '\0') {
        va_start(arguments, format);
        vsnprintf(guard->broken, sizeof guard->broken, format, arguments);
        va_end(arguments);
    }
}

/* --- codec ------------------------------------------------------------------------------------------------------------- */

static uint32_t crc_of(const uint8_t *bytes, size_t length)
{
    uint32_t crc = 0xffffffffu;
    for (size_t bit = 0; bit < 8u * length; bit++) {
        uint32_t in = (uint32_t)bytes[bit / 8u] >> (bit % 8u) & 1u;
        crc = ((crc ^ in) & 1u) != 0u ? (crc >> 1) ^ 0xedb88320u : crc >> 1;
    }
    return crc ^ 0xffffffffu;
}

static uint32_t number(const uint8_t *at, unsigned bytes)
{
    uint32_t value = 0;
    while (bytes-- > 0u) {
        value = value * 256u + at[bytes];
    }
    return value;
}

static void put(uint8_t *at, uint32_t value, unsigned bytes)
{
    for (unsigned i = 0; i < bytes; i++, value /= 256u) {
        at[i] = (uint8_t)(value % 256u);
    }
}

size_t oracle_encode(uint8_t *wire, uint8_t version, uint8_t type, uint16_t seq, uint8_t flags, const uint8_t *payload, size_t length)
{
    uint8_t frame[256] = { version, type, (uint8_t)(seq % 256u), (uint8_t)(seq / 256u), flags };
    size_t size = HEADER + length;
    if (length > 0u) {
        memcpy(frame + HEADER, payload, length);
    }
    put(frame + size, crc_of(frame, size), CRC);
    size += CRC;
    size_t at = 0;
    wire[at++] = 0;
    for (size_t start = 0; start <= size;) { /* runs between zeros, each behind its length and one */
        size_t run = 0;
        while (start + run < size && frame[start + run] != 0u) {
            run++;
        }
        wire[at++] = (uint8_t)(run + 1u);
        memcpy(wire + at, frame + start, run);
        at += run;
        start += run + 1u;
    }
    wire[at++] = 0;
    return at;
}

oracle_verdict_t oracle_decode(const uint8_t *encoded, size_t length, uint8_t *frame, size_t *frame_length)
{
    size_t size = 0;
    for (size_t at = 0; at < length;) {
        size_t run = encoded[at];
        if (run == 0u || at + run > length || memchr(encoded + at, 0, run) != NULL) {
            return ORACLE_NOT_COBS;
        }
        memcpy(frame + size, encoded + at + 1, run - 1u);
        size += run - 1u;
        at += run;
        if (at < length) {
            frame[size++] = 0;
        }
    }
    *frame_length = size;
    if (size < HEADER + CRC) {
        return ORACLE_TOO_SHORT;
    }
    return number(frame + size - CRC, CRC) == crc_of(frame, size - CRC) ? ORACLE_INTACT : ORACLE_DAMAGED;
}

/* --- the table ----------------------------------------------------------------------------------------------------------- */

void oracle_table(oracle_servo_t table[ORACLE_SERVOS], double rate)
{
    static const double max[ORACLE_SERVOS] = { 1.3566, 1.3860, 1.3502, 1.3608, 1.3497, 1.5700 };
    for (int i = 0; i < ORACLE_SERVOS; i++) {
        double urad = round(max[i] * 1e6);
        table[i] = (oracle_servo_t){ 0, urad, 0, urad / 2, rate * 1e6, 636620, 1500000, 0, 1, false };
    }
}

uint32_t oracle_hash(const oracle_servo_t table[ORACLE_SERVOS])
{
    double numbers[9 + 9 * ORACLE_SERVOS] = { VERSION,        PERIOD_NS,    PULSE_MIN_NS,    PULSE_MAX_NS,  TOLERANCE_URAD,
                                              TOLERANCE_US, EXCESS_PERMILLE, STEP_MAX_US / 1000, RELAX_PERMILLE };
    uint8_t bytes[4 * (9 + 9 * ORACLE_SERVOS)];
    for (int i = 0; i < ORACLE_SERVOS; i++) {
        const oracle_servo_t *s = &table[i];
        const double row[9] = { s->min, s->max, s->rest, s->centre, s->rate, s->ns_per_rad, s->centre_ns, s->trim_ns, s->direction };
        memcpy(numbers + 9 + 9 * i, row, sizeof row);
    }
    for (size_t i = 0; i < 9u + 9u * ORACLE_SERVOS; i++) {
        put(bytes + 4u * i, (uint32_t)(int32_t)numbers[i], 4);
    }
    return crc_of(bytes, sizeof bytes);
}

static double pulse_of(const oracle_servo_t *s, double urad)
{
    return s->centre_ns + s->trim_ns + s->direction * (urad - s->centre) * 1e-6 * s->ns_per_rad;
}

static double credit_most(const oracle_servo_t *s) { return s->rate * 1e-6 * TOLERANCE_US + TOLERANCE_URAD; }

/* --- the guard ------------------------------------------------------------------------------------------------------------ */

void oracle_guard_start(oracle_guard_t *guard, const oracle_servo_t table[ORACLE_SERVOS])
{
    memset(guard, 0, sizeof *guard);
    memcpy(guard->table, table, sizeof guard->table);
    for (int i = 0; i < ORACLE_SERVOS; i++) {
        guard->credit[i] = credit_most(&table[i]);
    }
}

bool oracle_guard(oracle_guard_t *guard, uint64_t now_us, const uint32_t pulses[ORACLE_SERVOS])
{
    double elapsed = guard->seen && now_us > guard->last_us ? (double)(now_us - guard->last_us) : 0.0;
    double step = elapsed < STEP_MAX_US ? elapsed : STEP_MAX_US;
    for (int i = 0; i < ORACLE_SERVOS; i++) {
        const oracle_servo_t *s = &guard->table[i];
        double ends[2] = { pulse_of(s, s->min), pulse_of(s, s->max) };
        double credit = guard->credit[i] + s->rate * 1e-6 * step * (1 + EXCESS_PERMILLE * 1e-3);
        if (pulses[i] != 0u && (pulses[i] < fmin(ends[0], ends[1]) - 1 || pulses[i] > fmax(ends[0], ends[1]) + 1)) {
            guard->outside++;
            say(guard, "servo %d: a pulse of %lu ns, the table has %.0f to %.0f", i, (unsigned long)pulses[i], ends[0], ends[1]);
        }
        if (pulses[i] != 0u && guard->last[i] != 0u) {
            double way = fabs((double)pulses[i] - guard->last[i]) / s->ns_per_rad * 1e6;
            credit -= way;
            if (credit < -2 * URAD) {
                guard->fast++;
                say(guard, "servo %d: %.0f urad within %.0f us, %.0f beyond the slew limit", i, way, elapsed, -credit);
            }
        }
        guard->credit[i] = fmin(credit, credit_most(s));
        guard->last[i] = pulses[i];
    }
    guard->last_us = now_us;
    guard->seen = true;
    return guard->broken[0] == '\0';
}

/* --- motion --------------------------------------------------------------------------------------------------------------- */

static bool moving(const oracle_t *o) { return o->ramp.elapsed_us < o->ramp.duration_us; }

static double angle_of(const oracle_t *o, int i)
{
    const oracle_ramp_t *r = &o->ramp;
    if (!moving(o)) {
        return r->to[i];
    }
    double s = (double)r->elapsed_us / (double)r->duration_us;
    double d = r->to[i] - r->from[i];
    if (!r->minimum_jerk) {
        return r->from[i] + d * s;
    }
    double v = r->speed[i] * (double)r->duration_us * 1e-6;
    double x = r->from[i] + v * s + (10 * d - 6 * v) * pow(s, 3) + (8 * v - 15 * d) * pow(s, 4) + (6 * d - 3 * v) * pow(s, 5);
    return fmin(fmax(x, o->guard.table[i].min), o->guard.table[i].max);
}

static double speed_of(const oracle_t *o, int i)
{
    const oracle_ramp_t *r = &o->ramp;
    double seconds = (double)r->duration_us * 1e-6;
    double d = r->to[i] - r->from[i];
    if (!moving(o) || !r->minimum_jerk) {
        return moving(o) ? d / seconds : 0.0;
    }
    double s = (double)r->elapsed_us / (double)r->duration_us;
    double v = r->speed[i] * seconds;
    return (v + 3 * (10 * d - 6 * v) * s * s + 4 * (8 * v - 15 * d) * pow(s, 3) + 5 * (6 * d - 3 * v) * pow(s, 4)) / seconds;
}

/* How far the way to rest may be behind [urad]. */
static double late_doubt(const oracle_t *o) { return o->guard.table[0].rate * RELAX_PERMILLE * 1e-9 * (double)o->ramp.late_us; }

/* How far the pose may be off [urad]: a motion that has ended is exact again, one that was stopped is not. */
static double pose_doubt(const oracle_t *o)
{
    return late_doubt(o) + (moving(o) || o->ramp.duration_us == 0 ? o->ramp.doubt : 0);
}

static void stop(oracle_t *o)
{
    oracle_ramp_t here = { .duration_us = 0, .doubt = pose_doubt(o) };
    for (int i = 0; i < ORACLE_SERVOS; i++) {
        here.to[i] = here.from[i] = trunc(angle_of(o, i));
    }
    o->ramp = here;
}

static void go_to_rest(oracle_t *o)
{
    double longest = 0;
    stop(o);
    for (int i = 0; i < ORACLE_SERVOS; i++) {
        const oracle_servo_t *s = &o->guard.table[i];
        o->ramp.to[i] = (o->attached >> i & 1) != 0 ? s->rest : o->ramp.from[i];
        longest = fmax(longest, fabs(o->ramp.to[i] - o->ramp.from[i]) / (s->rate * RELAX_PERMILLE * 1e-3) * 1e6);
    }
    o->ramp.duration_us = (int64_t)longest;
}

static double credit_now(const oracle_t *o, int i)
{
    const oracle_servo_t *s = &o->guard.table[i];
    return o->credit[i] + s->rate * 1e-6 * (double)o->step_us * (1 + EXCESS_PERMILLE * 1e-3) - fabs(angle_of(o, i) - o->pose[i]);
}

static double rate_share(double heat)
{
    double percent = heat / HEAT_LIMIT * 100;
    return percent <= 80 ? 1.0 : percent >= 100 ? 0.25 : 1.0 - 0.75 * (percent - 80) / 20;
}

/* --- states --------------------------------------------------------------------------------------------------------------- */

static const uint8_t *next_answer(oracle_t *o)
{
    return o->answers_expected < o->answers_heard ? o->answers[o->answers_expected] : NULL;
}

/* The next answer must be of this type and number; returns its payload, or NULL if it is not. */
static const uint8_t *answered(oracle_t *o, uint8_t type, uint16_t seq, size_t length)
{
    const uint8_t *a = next_answer(o);
    o->answers_expected++;
    if (a == NULL) {
        say(&o->guard, "no answer 0x%02x to %u", type, seq);
    } else if (a[0] != HEADER + length + CRC || a[1] != VERSION || a[2] != type || number(a + 3, 2) != seq || a[5] != 0u) {
        say(&o->guard, "answer 0x%02x to %lu (%u bytes), expected 0x%02x to %u", a[2], (unsigned long)number(a + 3, 2), a[0], type, seq);
    } else {
        return a + 1 + HEADER;
    }
    return NULL;
}

static void check(oracle_t *o, const char *what, long is, long must, long tolerance)
{
    if (labs(is - must) > tolerance) {
        say(&o->guard, "%s is %ld, expected %ld (state %u, fault %u)", what, is, must, o->state, o->fault);
    }
}

static void detach(oracle_t *o)
{
    o->placed |= o->attached;
    o->attached = 0;
    o->starting = o->relaxing = o->repeatable = false;
    o->due = 0;
    o->holding = false;
}

/* From anywhere in the table; neither what late calls hold back nor a second relax makes it longer. */
static void relax(oracle_t *o)
{
    double longest = 0;
    for (int i = 0; i < ORACLE_SERVOS; i++) {
        const oracle_servo_t *s = &o->guard.table[i];
        longest = fmax(longest, fmax(s->max - s->rest, s->rest - s->min) / (s->rate * RELAX_PERMILLE * 1e-3) * 1e6);
    }
    o->safe_until_us = o->relaxing ? o->safe_until_us : o->now_us + (uint64_t)longest;
    o->holding = false;
    o->relaxing = true;
    go_to_rest(o);
}

static void enter_fault(oracle_t *o, uint8_t fault, uint8_t servo)
{
    uint8_t action = fault == BY_WATCHDOG ? o->action : fault == BY_OVERLOAD ? RELAX : DETACH;
    stop(o);
    for (int i = 0; i < ORACLE_SERVOS && fault == BY_INTERNAL; i++) {
        o->ramp.to[i] = o->ramp.from[i] = o->pose[i]; /* the last output is all that can be trusted */
    }
    o->state = IN_FAULT;
    o->fault = fault;
    o->faults++;
    o->starting = false;
    if ((o->attached == 0u && o->due == 0u) || action == DETACH) {
        detach(o);
    } else if (action == HOLD) {
        o->holding = true;
        o->safe_until_us = o->now_us + HOLD_US;
    } else {
        relax(o);
    }
    const uint8_t *p = answered(o, FAULT, 0, 6);
    if (p != NULL) {
        check(o, "FAULT's fault", p[0], fault, 0);
        check(o, "FAULT's servo", p[1], servo, 0);
        check(o, "FAULT's uptime", (long)number(p + 2, 4), (long)(uint32_t)(o->now_us / 1000u), 0);
    }
}

static void check_status(oracle_t *o, uint16_t seq)
{
    const uint8_t *p = answered(o, DEVICE_STATUS, seq, 50);
    double share = 1;
    if (p == NULL) {
        return;
    }
    check(o, "uptime", (long)number(p, 4), (long)(uint32_t)(o->now_us / 1000u), 0);
    check(o, "state", p[4], o->state, 0);
    check(o, "fault", p[5], o->fault, 0);
    if (!o->in_doubt) {
        check(o, "attached", p[6], o->attached, 0);
        check(o, "moving", p[7], moving(o) || o->starting, 0);
    }
    for (int i = 0; i < ORACLE_SERVOS; i++) {
        check(o, "servo angle", (int16_t)number(p + 8 + 2 * i, 2), lround(angle_of(o, i) / 100), 1 + (long)((o->ramp.doubt + late_doubt(o)) / 100));
        check(o, "heat", p[20 + i], lround(floor(fmin(o->heat[i] / HEAT_LIMIT * 100, 255))), 1);
        share = fmin(share, rate_share(o->heat[i]));
    }
    check(o, "rate", (long)number(p + 26, 2), lround(share * 1000), 3);
    check(o, "supply", (long)number(p + 28, 2), o->supply_mv, 0);
    check(o, "last_seq", (long)number(p + 30, 2), o->last_seq, 0);
    check(o, "accepted", (long)number(p + 32, 4), (long)o->accepted, 0);
    const unsigned counted[] = { o->refused, o->bad_crc, o->bad_frame, o->bad_version, o->overrun, 0, o->trips };
    for (int i = 0; i < 7; i++) {
        check(o, "a counter", (long)number(p + 36 + 2 * i, 2), counted[i] < 65535u ? (long)counted[i] : 65535, 0);
    }
}

/* Take over the angle that a standing servo's pulse shows, if it may be. True if it is known now. */
static bool learn(oracle_t *o, int i)
{
    const oracle_servo_t *s = &o->guard.table[i];
    if (o->pulses == NULL || o->pulses[i] == 0u || o->ramp.duration_us != 0) {
        return false;
    }
    double shown = s->centre + s->direction * (o->pulses[i] - s->centre_ns - s->trim_ns) / s->ns_per_rad * 1e6;
    bool possible = fabs(shown - o->ramp.to[i]) <= URAD + o->ramp.doubt;
    if (possible && fabs(shown - o->ramp.to[i]) > 2) { /* a pulse tells no more than that */
        o->ramp.from[i] = o->ramp.to[i] = fabs(shown - s->rest) > 2 ? shown : s->rest;
    }
    return possible;
}

/* A servo is due. The moment follows from an angle, so it is known to a few microseconds only: the pulses tell whether the
 * servo has begun. Of a call without pulses that is a guess, which the next pulses mend; the servo after it then starts in
 * between what is possible. */
static void watch_start(oracle_t *o)
{
    const int i = o->due - 1;
    const oracle_servo_t *s = &o->guard.table[i];
    const uint8_t bit = (uint8_t)(1u << i);
    bool over = o->passed_us >= o->due_until_us || o->state != ARMED;
    bool shown = o->pulses != NULL && o->pulses[i] != 0u;
    bool begun = o->pulses != NULL ? shown || (over && o->state == ARMED) : 2 * o->passed_us >= o->due_from_us + o->due_until_us;
    if (o->state != ARMED && o->pulses == NULL) {
        return; /* it keeps what it had at the fault */
    }
    bool learnt = s->holds_unpowered && learn(o, i);
    double slack = learnt ? 1 : (URAD + (s->holds_unpowered ? pose_doubt(o) : o->stood_doubt)) / START_SPEED;
    double stood = s->holds_unpowered ? angle_of(o, i) : o->stood[i];
    bool placed = (o->placed & bit) != 0;
    double takes = SETTLE_US + (placed ? fabs(stood - s->rest) : s->max - s->min) / START_SPEED;
    o->chance_us = o->pulses != NULL && !begun ? o->passed_us : o->chance_us;
    o->start_from_us = o->chance_us + (int64_t)(takes - (placed ? slack : 0));
    o->start_until_us = o->passed_us + (int64_t)(takes + (placed ? slack : 0));
    o->attached = (uint8_t)(begun ? o->attached | bit : o->attached & ~bit);
    if (!s->holds_unpowered) { /* the springs have taken it to rest, where its first pulse finds it */
        o->pose[i] = o->ramp.to[i] = o->ramp.from[i] = begun ? s->rest : o->stood[i];
    }
    if (shown || over) {
        o->due = 0;
        o->placed |= begun ? bit : 0u;
    }
    if (o->state != ARMED && o->attached == 0) {
        detach(o);
    } else if (o->relaxing) { /* with or without this servo */
        int64_t elapsed_us = o->ramp.elapsed_us;
        o->ramp.elapsed_us = 0;
        go_to_rest(o);
        o->ramp.elapsed_us = elapsed_us;
    }
}

static void start_servos(oracle_t *o)
{
    if (o->state != ARMED || !o->starting || o->due != 0u || moving(o) || o->passed_us < o->start_from_us) {
        return;
    }
    for (uint8_t i = 0; i < ORACLE_SERVOS; i++) {
        if ((o->attached >> i & 1) == 0) {
            o->due = (uint8_t)(i + 1u);
            o->chance_us = o->passed_us;
            o->due_from_us = o->start_from_us;
            o->due_until_us = o->start_until_us;
            watch_start(o);
            return;
        }
    }
    bool at_rest = true;
    bool nearly = true; /* a last microradian may be left in the hand, or in here */
    for (int i = 0; i < ORACLE_SERVOS; i++) {
        double off = fabs(angle_of(o, i) - o->guard.table[i].rest);
        at_rest = at_rest && off < 0.5;
        nearly = nearly && off < 3;
    }
    if (at_rest && o->passed_us < o->start_until_us) {
        return; /* it may be done, or not yet */
    }
    o->in_doubt = o->in_doubt || (nearly && !at_rest);
    o->starting = !at_rest || (o->in_doubt && o->ramp.late_us > 0 && o->ramp.elapsed_us < o->ramp.duration_us + o->ramp.late_us);
    if (!at_rest) {
        go_to_rest(o);
        if (o->in_doubt) { /* with this call or a later one */
            o->ramp.late_us = STEP_MAX_US + o->start_until_us - o->start_from_us;
        }
    }
}

static void warm(oracle_t *o)
{
    for (int steps = 0; o->now_us - o->load_us >= 10000u; steps++) {
        if (steps == 100) {
            o->load_us = o->now_us;
            break;
        }
        o->load_us += 10000u;
        for (int i = 0; i < ORACLE_SERVOS; i++) {
            const oracle_servo_t *s = &o->guard.table[i];
            double travel = fmin(fabs(angle_of(o, i) - s->rest) / (s->max - s->min), 1);
            double effort = (o->attached >> i & 1) != 0 ? 200 + 600 * travel + 300 * fmin(fabs(speed_of(o, i)) / s->rate, 1) : 0;
            o->heat[i] += (effort * effort - o->heat[i]) / 12000;
        }
    }
    for (uint8_t i = 0; i < ORACLE_SERVOS && o->attached != 0u && o->fault != BY_OVERLOAD; i++) {
        const uint8_t *a = next_answer(o);
        bool told = a != NULL && a[2] == FAULT && a[6] == BY_OVERLOAD && a[7] == i;
        if (o->heat[i] >= HEAT_LIMIT * 1.002 || (o->heat[i] >= HEAT_LIMIT * 0.998 && told)) {
            enter_fault(o, BY_OVERLOAD, i);
        }
    }
}

/* Time passes. What depends on an angle's last digits may happen a moment earlier or later in the hand: within that
 * moment the oracle is in doubt, and believes the hand. */
static void advance(oracle_t *o, uint64_t now_us)
{
    if (!o->started) {
        o->started = true;
        o->now_us = o->load_us = now_us;
    }
    if (o->now_us > now_us + CLOCK_BACK_US) {
        o->now_us = now_us;
        enter_fault(o, BY_INTERNAL, NOBODY);
    }
    int64_t late = now_us > o->now_us ? (int64_t)(now_us - o->now_us) : 0;
    int64_t step = late < STEP_MAX_US - o->step_us ? late : STEP_MAX_US - o->step_us;
    o->now_us += (uint64_t)late;
    o->step_us += step;
    o->behind_us += late - step;
    o->ramp.elapsed_us += moving(o) ? step : 0;
    if (!moving(o)) {
        o->behind_us = 0;
    }
    o->passed_us += step;
    int64_t left = o->ramp.duration_us - o->ramp.elapsed_us;
    bool may_start = o->passed_us >= o->start_from_us && o->passed_us < o->start_until_us;
    bool may_end = left < DOUBT_US && left > -DOUBT_US - step - o->ramp.late_us;
    o->in_doubt = ((o->starting || o->relaxing) && o->ramp.duration_us > 0 && may_end) || (o->starting && (may_start || o->due != 0u))
                  || (o->in_doubt && step < DOUBT_US);
    if (o->estop_pressed && o->fault != BY_ESTOP) {
        enter_fault(o, BY_ESTOP, NOBODY);
    }
    if (o->state == ARMED && o->now_us - o->heard_us >= o->watchdog_ms * 1000ull) {
        o->trips++;
        enter_fault(o, BY_WATCHDOG, NOBODY);
    }
    o->supply_low_us = o->supply_mv != 0u && o->supply_mv < SUPPLY_MIN_MV ? o->supply_low_us + step : 0;
    if (o->state == ARMED && o->supply_low_us >= SUPPLY_LOW_US) {
        enter_fault(o, BY_SUPPLY, NOBODY);
    }
    if (o->due != 0u && (late > 0 || o->pulses != NULL)) { /* in the call of a fault, and without time, no servo starts */
        watch_start(o);
    }
    start_servos(o);
    o->in_doubt = o->in_doubt || (o->relaxing && o->ramp.duration_us < DOUBT_US); /* in the hand there may be no way left */
    bool over = o->now_us >= o->safe_until_us;
    if (o->relaxing && (over || !moving(o))) {
        detach(o);
    } else if (o->holding && over) {
        relax(o);
    }
    warm(o);
    if (o->status_period_us != 0 && o->now_us - o->status_us >= (uint64_t)o->status_period_us) {
        o->status_us = o->now_us;
        check_status(o, 0);
    }
}

/* --- frames --------------------------------------------------------------------------------------------------------------- */

typedef struct {
    int reason, servo;
    bool doubtful; /* so near to a bound that the hand may have taken it otherwise */
} verdict_t;

static verdict_t judge_arm(const oracle_t *o, const uint8_t *p)
{
    verdict_t v = { OK, NOBODY, false };
    unsigned watchdog_ms = number(p + 8, 2);
    if (o->state != IDLE && o->state != ARMED) {
        v.reason = R_STATE;
    } else if (number(p + 4, 4) != oracle_hash(o->guard.table)) {
        v.reason = R_LIMITS;
    } else if (p[10] > DETACH) {
        v.reason = R_ACTION;
    } else if (watchdog_ms < WATCHDOG_MIN_MS || watchdog_ms > WATCHDOG_MAX_MS) {
        v.reason = R_PERIOD;
    } else if (o->supply_low_us > 0) {
        v.reason = R_SUPPLY;
    }
    for (int i = 0; i < ORACLE_SERVOS && v.reason == OK && o->state == IDLE; i++) {
        v.doubtful = v.doubtful || fabs(o->heat[i] / HEAT_LIMIT - 0.8) < 0.002;
        if (rate_share(o->heat[i]) < 1) {
            v.reason = R_HOT;
            v.servo = i;
        }
    }
    return v;
}

static void plan(const oracle_t *o, const uint8_t *p, bool minimum_jerk, oracle_ramp_t *ramp)
{
    *ramp = (oracle_ramp_t){ .minimum_jerk = minimum_jerk };
    ramp->duration_us = (int64_t)number(p + 4, 2) * 1000 + (o->behind_us < WATCHDOG_MAX_MS * 1000 ? o->behind_us : WATCHDOG_MAX_MS * 1000);
    /* speeds are computed to a few urad per move: the shorter the move before, the coarser */
    ramp->doubt = pose_doubt(o);
    ramp->speed_doubt = moving(o) ? o->ramp.speed_doubt + 4e6 / (double)o->ramp.duration_us : 0;
    ramp->doubt += minimum_jerk ? 0.2e-6 * ramp->speed_doubt * (double)ramp->duration_us : 0;
    ramp->speed_doubt = minimum_jerk ? ramp->speed_doubt : 1e6 * ramp->doubt / (double)ramp->duration_us;
    for (int i = 0; i < ORACLE_SERVOS; i++) {
        ramp->from[i] = trunc(angle_of(o, i));
        ramp->speed[i] = speed_of(o, i);
        ramp->to[i] = 100.0 * (int16_t)number(p + 6 + 2 * i, 2);
    }
}

static verdict_t judge_servo(const oracle_t *o, const oracle_ramp_t *ramp, int i)
{
    verdict_t v = { OK, i, false };
    const oracle_servo_t *s = &o->guard.table[i];
    double seconds = (double)ramp->duration_us * 1e-6;
    double d = ramp->to[i] - ramp->from[i];
    double coast = ramp->minimum_jerk ? ramp->speed[i] * seconds : 0;
    double turning = ramp->from[i] + 0.4 * coast;
    double peak = (ramp->minimum_jerk ? fabs(coast) + fabs(5 * d - 2 * coast) * 0.375 : fabs(d)) / seconds;
    double credit = fmax(fmin(credit_now(o, i), credit_most(s)), 0) / seconds;
    double slack = (3 * URAD + ramp->doubt) / seconds + 200;
    if (ramp->to[i] < s->min || ramp->to[i] > s->max) {
        v.reason = R_ANGLE;
        return v;
    }
    v.doubtful = fmin(fabs(turning - s->min), fabs(turning - s->max)) < 2 * (URAD + ramp->doubt);
    v.doubtful = v.doubtful && coast != 0;
    if (turning < s->min || turning > s->max) {
        v.reason = R_ANGLE;
        return v;
    }
    v.doubtful = v.doubtful || fabs(peak - s->rate - credit) < slack;
    if (peak > s->rate + credit) {
        v.reason = R_RATE;
        return v;
    }
    double derated = s->rate * rate_share(o->heat[i]) + credit;
    v.doubtful = v.doubtful || fabs(peak - derated) < slack + s->rate * (rate_share(o->heat[i]) < 1 ? 0.02 : 0);
    v.reason = peak > derated ? R_HOT : OK;
    return v;
}

static verdict_t judge_move(const oracle_t *o, const uint8_t *frame, const uint8_t *p, uint32_t crc, bool *repeat)
{
    verdict_t v = { OK, NOBODY, o->in_doubt };
    uint16_t seq = (uint16_t)number(frame + 2, 2);
    int16_t ahead = (int16_t)(uint16_t)(seq - o->last_seq);
    unsigned ms = number(p + 4, 2);
    *repeat = o->repeatable && seq == o->last_seq && crc == o->last_crc;
    if (o->state != ARMED) {
        v.reason = R_STATE;
    } else if (o->starting) {
        v.reason = R_STARTING;
    } else if (*repeat) {
        v.reason = OK;
    } else if (o->any_move && ahead <= 0) {
        v.reason = R_STALE;
    } else if (ms < 10u || ms > 10000u) {
        v.reason = R_DURATION;
    } else {
        oracle_ramp_t ramp;
        plan(o, p, (frame[4] & 1u) != 0u, &ramp);
        for (int i = 0; i < ORACLE_SERVOS && v.reason == OK; i++) {
            verdict_t one = judge_servo(o, &ramp, i);
            v.doubtful = v.doubtful || one.doubtful;
            v.reason = one.reason;
            v.servo = one.reason == OK ? NOBODY : i;
        }
    }
    return v;
}

static verdict_t judge_frame(const oracle_t *o, const uint8_t *frame, size_t length, uint32_t crc, bool *repeat)
{
    static const struct { size_t length; uint8_t flags; bool tied; } rules[] = {
        { 0, 0, false }, { 4, 0, false }, { 11, 0, true }, { 18, 3, true }, { 4, 2, true }, { 0, 0, false }, { 4, 0, true }, { 2, 0, false },
    };
    const uint8_t *p = frame + HEADER;
    uint8_t type = frame[1];
    unsigned period = length >= 2u ? number(p, 2) : 0;
    verdict_t v = { OK, NOBODY, false };
    if (type == 0u || type > STATUS) {
        v.reason = R_TYPE;
    } else if (length != rules[type].length) {
        v.reason = R_LENGTH;
    } else if ((frame[4] & (uint8_t)~rules[type].flags) != 0u) {
        v.reason = R_FLAGS;
    } else if (rules[type].tied && (o->session == 0u || number(p, 4) != o->session)) {
        v.reason = R_SESSION;
    } else if (type == ARM) {
        v = judge_arm(o, p);
    } else if (type == MOVE) {
        v = judge_move(o, frame, p, crc, repeat);
    } else if (type == CLEAR && o->fault == BY_CONFIG) {
        v.reason = R_STATE;
    } else if (type == CLEAR && o->estop_pressed) {
        v.reason = R_ESTOP;
    } else if (type == STATUS && period != 0u && period < 10u) {
        v.reason = R_PERIOD;
    }
    return v;
}

static void check_ack(oracle_t *o, uint8_t type, uint16_t seq, int reason, int servo, bool doubtful)
{
    const uint8_t *p = answered(o, ACK, seq, 4);
    if (p != NULL && !doubtful) {
        check(o, "ACK's type", p[0], type, 0);
        check(o, "ACK's reason", p[1], reason, 0);
        check(o, "ACK's servo", p[2], servo, 0);
    }
    if (p != NULL) {
        check(o, "ACK's state", p[3], o->state, 0);
    }
}

static void check_hello(oracle_t *o, uint16_t seq)
{
    const uint8_t *p = answered(o, DEVICE_HELLO, seq, 30);
    if (p == NULL) {
        return;
    }
    check(o, "HELLO's firmware version", p[4] * 10000 + p[5] * 100 + p[6], 200, 0);
    check(o, "HELLO's session", (long)number(p, 4), (long)o->session, 0);
    check(o, "HELLO's hash", (long)number(p + 7, 4), (long)oracle_hash(o->guard.table), 0);
    for (int i = 0; i < ORACLE_SERVOS; i++) {
        check(o, "HELLO's trim", (int16_t)number(p + 11 + 2 * i, 2), lround(o->guard.table[i].trim_ns), 0);
        check(o, "HELLO's direction", p[23] >> i & 1, o->guard.table[i].direction < 0, 0);
    }
    check(o, "HELLO's watchdog", (long)number(p + 24, 2), (long)o->watchdog_ms, 0);
    check(o, "HELLO's reset", p[26], o->reset, 0);
    check(o, "HELLO's boot count", (long)number(p + 27, 2), (long)o->boot_count, 0);
    check(o, "HELLO's state", p[29], o->state, 0);
}

static void carry_out(oracle_t *o, const uint8_t *frame, uint32_t crc, bool repeat)
{
    const uint8_t *p = frame + HEADER;
    uint8_t type = frame[1];
    if (type == HELLO && number(p, 4) != 0u) {
        o->session = number(p, 4);
        o->any_move = false;
        o->watchdog_ms = WATCHDOG_DEFAULT_MS;
        o->status_period_us = 0;
    }
    if (type == CLEAR || (type == HELLO && number(p, 4) != 0u && o->state != IN_FAULT)) {
        stop(o);
        detach(o);
        o->state = IDLE;
        o->fault = NO_FAULT;
    } else if (type == ARM) {
        o->action = p[10];
        o->watchdog_ms = number(p + 8, 2);
        if (o->state == IDLE) {
            o->arms++;
            o->state = ARMED;
            o->starting = true;
            o->stood_doubt = pose_doubt(o);
            for (int i = 0; i < ORACLE_SERVOS; i++) {
                o->stood[i] = angle_of(o, i);
            }
            o->start_from_us = o->start_until_us = o->passed_us + POWER_ON_US;
        }
    } else if (type == MOVE && !repeat) {
        oracle_ramp_t ramp;
        plan(o, p, (frame[4] & 1u) != 0u, &ramp);
        o->ramp = ramp;
        o->any_move = o->repeatable = true;
        o->last_seq = (uint16_t)number(frame + 2, 2);
        o->last_crc = crc;
        o->moves++;
    } else if (type == STATUS) {
        o->status_period_us = 1000 * (int64_t)number(p, 2);
        o->status_us = o->now_us;
    }
    o->accepted++;
    if (type == ARM || type == MOVE || type == HEARTBEAT || type == CLEAR) {
        o->heard_us = o->now_us;
    }
}

static void take_frame(oracle_t *o, const uint8_t *frame, size_t size)
{
    uint8_t type = frame[1];
    uint16_t seq = (uint16_t)number(frame + 2, 2);
    uint32_t crc = number(frame + size - CRC, CRC);
    bool other = frame[0] != VERSION;
    bool repeat = false;
    o->bad_version += other;
    if (type >= 0x80u) {
        o->bad_frame += !other;
        return;
    }
    if (type == ESTOP) {
        o->accepted++;
        if (o->fault != BY_CONFIG) {
            enter_fault(o, BY_ESTOP, NOBODY);
        } else {
            answered(o, FAULT, 0, 6);
        }
        check_ack(o, type, seq, OK, NOBODY, false);
        return;
    }
    if (other) {
        if (type == HELLO) {
            check_hello(o, seq);
        } else {
            check_ack(o, type, seq, R_VERSION, NOBODY, false);
        }
        return;
    }
    verdict_t v = judge_frame(o, frame, size - HEADER - CRC, crc, &repeat);
    if (v.doubtful) {
        const uint8_t *a = next_answer(o);
        bool refused = a != NULL && a[2] == ACK && number(a + 3, 2) == seq && a[6] == type && a[7] != OK;
        if (!refused && v.reason == R_STARTING) { /* the hand is at rest a moment earlier */
            o->starting = false;
            o->ramp.elapsed_us = o->ramp.duration_us;
            v = judge_frame(o, frame, size - HEADER - CRC, crc, &repeat);
        }
        v.reason = !refused ? OK : v.reason == OK ? a[7] : v.reason;
    }
    if (v.reason == OK) {
        carry_out(o, frame, crc, repeat);
    } else {
        o->refused++;
        o->refusals++;
    }
    if (v.reason != OK) {
        check_ack(o, type, seq, v.reason, v.servo, v.doubtful);
    } else if (type == HELLO) {
        check_hello(o, seq);
    } else if (type == STATUS) {
        check_status(o, seq);
    } else if ((frame[4] & 2u) == 0u) {
        check_ack(o, type, seq, OK, NOBODY, false);
    }
}

static void hear(oracle_t *o, uint8_t byte)
{
    oracle_decoder_t *d = &o->host;
    uint8_t frame[64];
    size_t size = 0;
    if (byte != 0u) {
        d->overrun = d->overrun || d->length == FRAME_MAX + 1u;
        if (!d->overrun) {
            d->bytes[d->length++] = byte;
        }
        return;
    }
    size_t length = d->length;
    bool overrun = d->overrun;
    d->length = 0;
    d->overrun = false;
    if (overrun) {
        o->overrun++;
    } else if (length > 0u) {
        oracle_verdict_t verdict = oracle_decode(d->bytes, length, frame, &size);
        o->bad_crc += verdict == ORACLE_DAMAGED;
        o->bad_frame += verdict == ORACLE_NOT_COBS || verdict == ORACLE_TOO_SHORT;
        if (verdict == ORACLE_INTACT) {
            take_frame(o, frame, size);
        }
    }
}

static void take_answers(oracle_t *o, const uint8_t *bytes, size_t length)
{
    size_t start = 0;
    o->answers_heard = o->answers_expected = 0;
    for (size_t i = 0; i < length; i++) {
        size_t size = 0;
        if (bytes[i] != 0u) {
            continue;
        }
        if (i > start) {
            if (i - start > FRAME_MAX + 1u || o->answers_heard == sizeof o->answers / sizeof o->answers[0]
                || oracle_decode(bytes + start, i - start, o->answers[o->answers_heard] + 1, &size) != ORACLE_INTACT) {
                say(&o->guard, "an answer is no frame");
                return;
            }
            o->answers[o->answers_heard++][0] = (uint8_t)size;
        }
        start = i + 1u;
    }
    if (start != length) {
        say(&o->guard, "an answer has no end");
    }
}

/* The way to rest may have begun a moment later than it has in here: take over how far the pulses have come. */
static void watch_way_to_rest(oracle_t *o, const uint32_t *pulses)
{
    oracle_ramp_t *r = &o->ramp;
    int far = 0;
    for (int i = 1; i < ORACLE_SERVOS; i++) {
        far = fabs(r->to[i] - r->from[i]) > fabs(r->to[far] - r->from[far]) ? i : far;
    }
    double way = r->to[far] - r->from[far];
    if (r->late_us == 0 || !o->starting || pulses[far] == 0u || fabs(way) < URAD || r->doubt > 3 * URAD) {
        return;
    }
    double gone = (pulses[far] - pulse_of(&o->guard.table[far], r->from[far])) / o->guard.table[far].ns_per_rad * 1e6
                  * o->guard.table[far].direction;
    int64_t behind_us = r->elapsed_us - (int64_t)(gone / way * (double)r->duration_us);
    bool begun = fabs(gone) > 2 * (URAD + r->doubt);
    if (begun && behind_us > -DOUBT_US && behind_us < r->late_us + DOUBT_US) {
        r->elapsed_us -= behind_us; /* known from now on */
        r->late_us = 0;
        r->doubt += URAD;
    } else if (!begun && r->elapsed_us <= r->late_us) {
        r->late_us -= r->elapsed_us;
        r->elapsed_us = 0;
    }
}

/* In doubt about the end of a relax, take over what the pulses show. */
static void watch_end(oracle_t *o, const uint32_t *pulses)
{
    bool silent = true;
    for (int i = 0; i < ORACLE_SERVOS; i++) {
        silent = silent && pulses[i] == 0u;
    }
    if (o->in_doubt && silent && o->relaxing) {
        o->ramp.elapsed_us = o->ramp.duration_us;
        detach(o);
    } /* or a moment later, it will */
}

static void check_pulses(oracle_t *o, const uint32_t *pulses)
{
    bool known = true;
    for (int i = 0; i < ORACLE_SERVOS; i++) {
        known = learn(o, i) && known;
    }
    o->ramp.doubt = known ? fmin(2, o->ramp.doubt) : o->ramp.doubt;
    watch_end(o, pulses);
    watch_way_to_rest(o, pulses);
    for (int i = 0; i < ORACLE_SERVOS; i++) {
        double must = (o->attached >> i & 1) != 0 ? pulse_of(&o->guard.table[i], angle_of(o, i)) : 0;
        if (!(o->in_doubt && (pulses[i] == 0u) != (must == 0)) && fabs(pulses[i] - must) > (must == 0 ? 0 : NS + o->ramp.doubt + late_doubt(o))) {
            say(&o->guard, "servo %d: a pulse of %lu ns, expected %.1f (state %u, fault %u)", i, (unsigned long)pulses[i], must, o->state,
                o->fault);
        }
        o->credit[i] = fmin(credit_now(o, i), credit_most(&o->guard.table[i]));
        o->pose[i] = angle_of(o, i);
    }
    o->step_us = 0;
    oracle_guard(&o->guard, o->now_us, pulses);
}

void oracle_start(oracle_t *o, const oracle_servo_t table[ORACLE_SERVOS], uint8_t reset, unsigned boot_count)
{
    memset(o, 0, sizeof *o);
    oracle_guard_start(&o->guard, table);
    o->reset = reset;
    o->boot_count = boot_count;
    o->watchdog_ms = WATCHDOG_DEFAULT_MS;
    for (int i = 0; i < ORACLE_SERVOS; i++) {
        o->pose[i] = o->ramp.to[i] = o->ramp.from[i] = table[i].rest;
    }
    if (reset == 2u || reset == 3u) {
        o->state = IN_FAULT;
        o->fault = reset == 2u ? BY_BROWNOUT : BY_CRASH;
    }
}

bool oracle_judge(oracle_t *o, uint64_t now_us, const uint8_t *bytes, size_t length, const uint8_t *answers,
                  size_t answers_length, const uint32_t *pulses)
{
    o->pulses = pulses;
    take_answers(o, answers, answers_length);
    if (o->state == IN_FAULT && !o->started) {
        const uint8_t *p = answered(o, FAULT, 0, 6); /* what a suspicious reset made */
        if (p != NULL) {
            check(o, "FAULT's fault", p[0], o->fault, 0);
            check(o, "FAULT's servo", p[1], NOBODY, 0);
        }
    }
    advance(o, now_us);
    for (size_t i = 0; i < length; i++) {
        hear(o, bytes[i]);
    }
    if (o->answers_expected < o->answers_heard) {
        say(&o->guard, "an answer 0x%02x that nobody expected", o->answers[o->answers_expected][2]);
    }
    if (pulses != NULL) {
        check_pulses(o, pulses);
    }
    return o->guard.broken[0] == '\0';
}
