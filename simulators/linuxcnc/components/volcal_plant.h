/* Simulated state in memory that the plant's process writes and the servo thread reads.
 *
 * Every field is 8 bytes in the computer's byte order; simulators/linuxcnc/memory.py writes the same layout. A scene is
 * valid if read between two equal, even values of `sequence`; the grid never changes. The trace is written here: the
 * corners of the tip's path and a point every few millimetres, for the collision search.
 *
 * License: GPL v2 or later (linked with LinuxCNC).
 */
#ifndef VOLCAL_PLANT_H
#define VOLCAL_PLANT_H

#include <math.h>
#include <string.h>

#include "rtapi.h"
#include "rtapi_stdint.h"

#define PLANT_MAGIC 0x31746e616c507656ull
#define PLANT_BALLS 32
#define PLANT_TRACE 8192
#define PLANT_TRACE_MM 2.0

typedef struct {
    double balls;
    double seed;
    double reach_mm; /* distance between the centres at contact */
    double overtravel_mm;
    double pretravel_mm, lobing_mm, touch_sigma_mm;
    double repeatability_mm;
    double backlash_mm[3];
    double tool_mm[3];
    double drift_mm[3];
    double temperature_c[3];
    double ball_mm[PLANT_BALLS][3];
} plant_scene;

typedef struct {
    rtapi_u64 magic;
    rtapi_u64 sequence; /* odd while the scene is written */
    plant_scene scene;
    rtapi_u64 traced; /* points written so far */
    double trace_mm[PLANT_TRACE][3];
    rtapi_u64 nodes[3];
    double origin_mm[3], step_mm[3];
    double deviation_mm[]; /* x slowest, then y, z, and the three components */
} plant_memory;

static unsigned long plant_bytes(const plant_memory *memory) {
    return sizeof *memory + 24ul * memory->nodes[0] * memory->nodes[1] * memory->nodes[2];
}

/* Return true if there is a scene: a new one, or the previous one while a new one is being written. */
static int plant_read_scene(plant_memory *memory, plant_scene *scene) {
    rtapi_u64 began = __atomic_load_n(&memory->sequence, __ATOMIC_ACQUIRE);
    if (began && !(began & 1)) {
        plant_scene read;
        memcpy(&read, &memory->scene, sizeof read);
        __atomic_thread_fence(__ATOMIC_ACQUIRE);
        if (__atomic_load_n(&memory->sequence, __ATOMIC_RELAXED) == began) *scene = read;
    }
    return scene->reach_mm > 0.0;
}

/* Trilinear interpolation; the border value outside the grid. */
static void plant_deviation(const plant_memory *memory, const double *at, double *deviation) {
    rtapi_u64 cell[3], stride[3];
    double share[3];
    stride[2] = 3, stride[1] = 3 * memory->nodes[2], stride[0] = stride[1] * memory->nodes[1];
    for (int a = 0; a < 3; a++) {
        double last = (double)memory->nodes[a] - 1.0;
        double place = fmin(fmax((at[a] - memory->origin_mm[a]) / memory->step_mm[a], 0.0), last);
        cell[a] = (rtapi_u64)fmin(place, last - 1.0);
        share[a] = place - (double)cell[a];
    }
    deviation[0] = deviation[1] = deviation[2] = 0.0;
    for (int corner = 0; corner < 8; corner++) {
        double weight = 1.0;
        rtapi_u64 index = 0;
        for (int a = 0; a < 3; a++) {
            int far = corner >> a & 1;
            weight *= far ? share[a] : 1.0 - share[a];
            index += (cell[a] + (rtapi_u64)far) * stride[a];
        }
        for (int a = 0; a < 3; a++) deviation[a] += weight * memory->deviation_mm[index + (rtapi_u64)a];
    }
}

static double plant_distance(const double *a, const double *b) {
    double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
    return sqrt(x * x + y * y + z * z);
}

/* Uniform number in (0, 1) for a counter: splitmix64. */
static double plant_uniform(rtapi_u64 counter) {
    rtapi_u64 z = counter * 0x9E3779B97F4A7C15ull + 0x9E3779B97F4A7C15ull;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
    z ^= z >> 31;
    return ((double)(z >> 11) + 0.5) / 9007199254740992.0;
}

/* Standard normal number (Box-Muller) that depends only on seed, stream and counter. */
static double plant_normal(double seed, int stream, rtapi_u32 counter) {
    rtapi_u64 key = ((rtapi_u64)seed << 40) ^ ((rtapi_u64)stream << 36) ^ ((rtapi_u64)counter << 1);
    return sqrt(-2.0 * log(plant_uniform(key))) * cos(2.0 * M_PI * plant_uniform(key + 1));
}

/* Append the tip position at corners of its path and every few millimetres. */
static void plant_trace(plant_memory *memory, const double *tip) {
    static double last[3], standing[3];
    static int stood;
    int stands = plant_distance(tip, standing) == 0.0;
    memcpy(standing, tip, sizeof standing);
    if (plant_distance(tip, last) < PLANT_TRACE_MM && !(stands && !stood)) {
        stood = stands;
        return;
    }
    stood = stands;
    memcpy(memory->trace_mm[memory->traced % PLANT_TRACE], tip, sizeof standing);
    memcpy(last, tip, sizeof last);
    __atomic_store_n(&memory->traced, memory->traced + 1, __ATOMIC_RELEASE);
}

#endif
