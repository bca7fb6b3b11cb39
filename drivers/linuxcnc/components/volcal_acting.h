/* The active bank, and the smooth transition from one bank to another; shared by the correcting components.
 *
 * License: GPL v2 or later (linked with LinuxCNC).
 */
#ifndef VOLCAL_ACTING_H
#define VOLCAL_ACTING_H

#include "volcal_table.h"

#define VOLCAL_STEEPEST 1.5 /* largest slope of 3 t^2 - 2 t^3, at t = 1/2 */

/* One end of a transition: a bank (0: none) with its generation when it was selected, or a held correction. */
typedef struct {
    rtapi_u32 number;
    rtapi_u32 generation;
    int held;
    double constant[3];
} volcal_source;

typedef struct {
    volcal_shared *shared;
    int reader;
    volcal_source now, next;
    int blending;
    double progress; /* 0 ... 1 while blending */
    double duration_s;
    double age_s; /* since the last transition ended */
    rtapi_u32 trouble;
    double last[3];
} volcal_acting;

static inline volcal_slot *volcal_slot_of(const volcal_acting *acting, rtapi_u32 bank) {
    return &acting->shared->slot[bank - 1];
}

static inline void volcal_mark(volcal_acting *acting, rtapi_u32 bank, rtapi_u32 used) {
    if (bank == 0 || bank > VOLCAL_BANKS) return;
    acting->shared->used[acting->reader][bank - 1] = used;
    __sync_synchronize();
}

static inline void volcal_start(volcal_acting *acting, volcal_shared *shared, int reader) {
    volcal_acting fresh = {.shared = shared, .reader = reader, .trouble = shared ? VOLCAL_NO_FAULT : VOLCAL_NO_MEMORY};
    *acting = fresh;
    for (rtapi_u32 bank = 1; shared && bank <= VOLCAL_BANKS; bank++) volcal_mark(acting, bank, 0);
}

static inline int volcal_sound(const volcal_acting *acting, const volcal_source *source) {
    if (source->held || source->number == 0) return 1;
    const volcal_slot *slot = volcal_slot_of(acting, source->number);
    return slot->generation == source->generation && slot->state == VOLCAL_COMPLETE;
}

/* Marks the bank as used and stores its generation; returns 0 if it holds no complete table. */
static inline int volcal_take(volcal_acting *acting, rtapi_u32 bank, volcal_source *source) {
    volcal_source taken = {.number = bank};
    if (bank > VOLCAL_BANKS) return 0;
    if (bank != 0) {
        volcal_mark(acting, bank, 1);
        taken.generation = volcal_slot_of(acting, bank)->generation;
        if ((taken.generation & 1) || !volcal_sound(acting, &taken)) {
            if (acting->now.number != bank) volcal_mark(acting, bank, 0);
            return 0;
        }
    }
    *source = taken;
    return 1;
}

static inline double volcal_largest(const volcal_acting *acting, const volcal_source *source) {
    if (source->held) return fmax(fabs(source->constant[0]), fmax(fabs(source->constant[1]), fabs(source->constant[2])));
    return source->number ? volcal_slot_of(acting, source->number)->largest : 0.0;
}

/* Duration of a transition of at most `jump` mm in which no axis shifts faster than `rate`:
   v_max = VOLCAL_STEEPEST * jump / duration. */
static inline double volcal_duration(double jump, double rate) {
    return rate > 0.0 ? VOLCAL_STEEPEST * jump / rate : 0.0;
}

static inline double volcal_smooth(double t) { return t * t * (3.0 - 2.0 * t); }

/* The active table has changed in memory: hold the last correction. */
static inline void volcal_hold(volcal_acting *acting) {
    volcal_source held = {.number = acting->now.number, .held = 1};
    for (int a = 0; a < 3; a++) held.constant[a] = acting->last[a];
    if (acting->blending && acting->next.number != acting->now.number) volcal_mark(acting, acting->next.number, 0);
    acting->now = held;
    acting->blending = 0;
    acting->trouble = VOLCAL_TABLE_CHANGED;
}

static inline void volcal_advance(volcal_acting *acting, double dt) {
    acting->progress += acting->duration_s > 0.0 ? dt / acting->duration_s : 1.0;
    if (acting->progress < 1.0) return;
    if (acting->now.number != acting->next.number) volcal_mark(acting, acting->now.number, 0);
    acting->now = acting->next;
    acting->blending = 0;
    acting->age_s = 0.0;
}

static inline void volcal_begin(volcal_acting *acting, rtapi_u32 wanted, double rate) {
    if (!volcal_take(acting, wanted, &acting->next)) {
        if (!acting->now.held) acting->trouble = VOLCAL_BANK_EMPTY;
        return;
    }
    acting->trouble = VOLCAL_NO_FAULT;
    acting->blending = 1;
    acting->progress = 0.0;
    acting->duration_s =
        volcal_duration(volcal_largest(acting, &acting->now) + volcal_largest(acting, &acting->next), rate);
}

/* Called once per servo period: follows `wanted` and detects damage. Only the selection of another bank ends a held
   correction. */
static inline void volcal_step(volcal_acting *acting, rtapi_u32 wanted, double rate, double dt) {
    if (!acting->shared) return;
    acting->age_s += dt;
    if (!volcal_sound(acting, &acting->now) || (acting->blending && !volcal_sound(acting, &acting->next)))
        volcal_hold(acting);
    if (acting->blending)
        volcal_advance(acting, dt);
    else if (wanted != acting->now.number)
        volcal_begin(acting, wanted, rate);
    else if (!acting->now.held)
        acting->trouble = VOLCAL_NO_FAULT;
}

static inline void volcal_value(const volcal_acting *acting, const volcal_source *source, const double position[3],
                                double value[3]) {
    if (!source->held && source->number) {
        volcal_lookup(volcal_slot_of(acting, source->number), position, value);
        return;
    }
    for (int a = 0; a < 3; a++) value[a] = source->held ? source->constant[a] : 0.0;
}

/* Correction added to the commanded position at present, mm. */
static inline void volcal_correction(const volcal_acting *acting, const double position[3], double correction[3]) {
    double next[3];
    volcal_value(acting, &acting->now, position, correction);
    if (!acting->blending) return;
    volcal_value(acting, &acting->next, position, next);
    double share = volcal_smooth(acting->progress);
    for (int a = 0; a < 3; a++) correction[a] += share * (next[a] - correction[a]);
}

static inline rtapi_u32 volcal_active_crc(const volcal_acting *acting) {
    return acting->now.number && !acting->now.held ? volcal_slot_of(acting, acting->now.number)->crc : 0;
}

#endif
