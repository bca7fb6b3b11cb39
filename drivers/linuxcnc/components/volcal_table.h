/* Compensation tables shared between the loader (user space) and the correcting components (realtime).
 *
 * The loader is the only writer. It writes a table only while no component uses its bank; the generation is odd
 * meanwhile. A component first marks the bank as used, then checks the generation; the loader first makes the
 * generation odd, then checks the marks. So at least one of the two sees the other and yields.
 *
 * Units: mm, mm/s, s. License: GPL v2 or later (linked with LinuxCNC).
 */
#ifndef VOLCAL_TABLE_H
#define VOLCAL_TABLE_H

#include "rtapi.h"
#include "rtapi_math.h"
#include "rtapi_stdint.h"

#define VOLCAL_KEY 0x564F4C31 /* "VOL1" */
#define VOLCAL_MAGIC 0x564F4C43u
#define VOLCAL_LAYOUT 1u
#define VOLCAL_BANKS 2u
#define VOLCAL_MAX_NODES_PER_AXIS 256u
#define VOLCAL_MAX_NODES 262144u

enum volcal_state { VOLCAL_EMPTY = 0, VOLCAL_COMPLETE = 1, VOLCAL_DAMAGED = 2 };
enum volcal_fault {
    VOLCAL_NO_FAULT = 0,
    VOLCAL_NO_MEMORY = 1,   /* the shared memory is missing or has another layout */
    VOLCAL_BANK_EMPTY = 2,  /* the selected bank holds no complete table; the previous one remains active */
    VOLCAL_TABLE_CHANGED = 3 /* the active table changed or is damaged; its last correction is held */
};
enum volcal_reader { VOLCAL_OFFSETS = 0, VOLCAL_KINEMATICS = 1, VOLCAL_READERS = 2 };

typedef struct {
    volatile rtapi_u32 generation; /* odd: being written */
    volatile rtapi_u32 state;
    rtapi_u32 crc; /* CRC-32 of the counts as big-endian int32 */
    rtapi_u32 nodes[3];
    double origin[3];
    double step[3];
    double resolution;
    double largest; /* largest |correction| of a node */
    rtapi_s32 counts[VOLCAL_MAX_NODES][3]; /* x slowest, z fastest */
} volcal_slot;

typedef struct {
    volatile rtapi_u32 magic;
    volatile rtapi_u32 layout;
    volatile rtapi_u32 used[VOLCAL_READERS][VOLCAL_BANKS];
    volcal_slot slot[VOLCAL_BANKS]; /* bank n is slot[n - 1] */
} volcal_shared;

/* Attaches the memory for `module`; NULL if there is none or it has another layout. */
static inline volcal_shared *volcal_attach(int module, int *id) {
    void *memory = 0;
    *id = rtapi_shmem_new(VOLCAL_KEY, module, sizeof(volcal_shared));
    if (*id < 0 || rtapi_shmem_getptr(*id, &memory) < 0) return 0;
    volcal_shared *shared = memory;
    if (shared->magic == 0) { /* fresh memory is zero */
        shared->layout = VOLCAL_LAYOUT;
        __sync_synchronize();
        shared->magic = VOLCAL_MAGIC;
    }
    return shared->magic == VOLCAL_MAGIC && shared->layout == VOLCAL_LAYOUT ? shared : 0;
}

/* Cell along one axis, and the fraction within it; positions outside the grid get the value at the border. */
static inline rtapi_u32 volcal_cell(double steps, rtapi_u32 nodes, double *share) {
    double last = (double)(nodes - 1);
    if (!(steps > 0.0)) steps = 0.0; /* NaN as well */
    if (steps > last) steps = last;
    rtapi_u32 cell = (rtapi_u32)steps;
    if (nodes > 1 && cell > nodes - 2) cell = nodes - 2;
    *share = steps - (double)cell;
    return cell;
}

/* Trilinear interpolation between the eight nodes around `position`: the correction added to the commanded position. */
static inline void volcal_lookup(const volcal_slot *slot, const double position[3], double correction[3]) {
    rtapi_u32 cell[3], next[3];
    double share[3];
    for (int a = 0; a < 3; a++) {
        cell[a] = volcal_cell((position[a] - slot->origin[a]) / slot->step[a], slot->nodes[a], &share[a]);
        next[a] = slot->nodes[a] > 1 ? cell[a] + 1 : cell[a];
    }
    double sum[3] = {0.0, 0.0, 0.0};
    for (int corner = 0; corner < 8; corner++) {
        rtapi_u32 i = corner & 4 ? next[0] : cell[0];
        rtapi_u32 j = corner & 2 ? next[1] : cell[1];
        rtapi_u32 k = corner & 1 ? next[2] : cell[2];
        double weight = (corner & 4 ? share[0] : 1.0 - share[0]) * (corner & 2 ? share[1] : 1.0 - share[1]) *
                        (corner & 1 ? share[2] : 1.0 - share[2]);
        const rtapi_s32 *node = slot->counts[(i * slot->nodes[1] + j) * slot->nodes[2] + k];
        for (int a = 0; a < 3; a++) sum[a] += weight * (double)node[a];
    }
    for (int a = 0; a < 3; a++) correction[a] = sum[a] * slot->resolution;
}

#endif
