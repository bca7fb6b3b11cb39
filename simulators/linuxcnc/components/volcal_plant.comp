component volcal_plant "A machine with errors, and balls for its probe to touch, in front of a real LinuxCNC";
description """
Position of the stylus tip of a machine with errors for the motor positions that LinuxCNC commands, and the state of the
probe on the balls. The simulated state comes from a file written by another process and mapped into memory by both
(layout in *simulators/linuxcnc/memory.py*).
Add the function to the servo thread after motion-controller: its result is read in the next cycle, together with the
position that it belongs to.
Module parameter *path*: that file.""";
pin in float motor-#[3] "joint.N.motor-pos-cmd, mm";
pin out bit probe "to motion.probe-input";
pin out bit ready "the file is present and valid";
pin out float temperature-#[3] "artefact, machine, ambient; degrees Celsius";
pin out float tip-position-#[3] "workpiece frame, mm";
pin out u32 trips "number of probe trips";
pin out u32 overrun "number of times the tip was pressed beyond the overtravel";
param rw float bounce-s = 0 "time for which the contact of the probe bounces after a trip, s";
option singleton yes;
option extra_setup yes;
option extra_cleanup yes;
function _ fp "compute the tip position and the probe state";
license "GPL";
author "volcal";
;;

#include <fcntl.h>
#include <math.h>
#include <stddef.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>
#include "volcal_plant.h"

static char *path = "";
RTAPI_MP_STRING(path, "file with the simulated state");

static plant_memory *memory;
static size_t mapped;
static plant_scene scene; /* last consistent scene */
static double before[3], lag[3], scatter[3], travelled, tip_before[3];
static int begun, touching = -1, over, tripped, cycles_since_trip;
static double since_trip_s;
static rtapi_u32 motions, touches, trip_count, overrun_count;
static int was_moving[3];

EXTRA_SETUP() {
    struct stat status;
    (void)__comp_inst; (void)prefix; (void)extra_arg;
    int file = open(path, O_RDWR | O_CLOEXEC);
    if (file < 0 || fstat(file, &status) < 0) {
        rtapi_print_msg(RTAPI_MSG_ERR, "volcal_plant: %s cannot be read\n", path);
        return -ENOENT;
    }
    mapped = (size_t)status.st_size;
    void *mapping = mmap(NULL, mapped, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    close(file);
    if (mapping == MAP_FAILED) return -ENOMEM;
    memory = mapping;
    if (mapped < sizeof(plant_memory) || memory->magic != PLANT_MAGIC || plant_bytes(memory) > mapped) {
        rtapi_print_msg(RTAPI_MSG_ERR, "volcal_plant: %s holds no plant\n", path);
        munmap(mapping, mapped);
        memory = NULL;
        return -EINVAL;
    }
    return 0;
}

EXTRA_CLEANUP() {
    if (memory) munmap(memory, mapped);
}

/* Play operator: the slide lags its drive by at most half the backlash; plus a random error for each motion. */
static void update_lost_motion(const double *motor) {
    for (int a = 0; a < 3; a++) {
        double step = begun ? motor[a] - before[a] : 0.0, half = 0.5 * scene.backlash_mm[a];
        lag[a] = fmin(fmax(lag[a] - step, -half), half);
        if (step != 0.0 && !was_moving[a]) scatter[a] = scene.repeatability_mm * plant_normal(scene.seed, 1 + a, motions++);
        was_moving[a] = step != 0.0;
        before[a] = motor[a];
    }
    begun = 1;
}

/* Return the ball that the tip overlaps most, or -1. */
static int overlapped(const double *tip, double *depth) {
    int found = -1;
    *depth = 0.0;
    for (int n = 0; n < (int)scene.balls && n < PLANT_BALLS; n++) {
        double inside = scene.reach_mm - plant_distance(tip, scene.ball_mm[n]);
        if (inside > *depth) *depth = inside, found = n;
    }
    return found;
}

/* Return the travel of the tip from contact to trip in its direction of motion; the probe points along +Y. */
static double pretravel(const double *motion, double length) {
    double x = motion[0] / length, z = motion[2] / length;
    return scene.pretravel_mm + scene.lobing_mm * hypot(x, z) * cos(3.0 * atan2(z, x)) +
           scene.touch_sigma_mm * plant_normal(scene.seed, 0, touches);
}

/* Return the share of this cycle's path that lies inside the ball. */
static double share_inside(const double *tip, int ball) {
    double outside = plant_distance(tip_before, scene.ball_mm[ball]) - scene.reach_mm;
    double inside = scene.reach_mm - plant_distance(tip, scene.ball_mm[ball]);
    return outside > 0.0 ? inside / (inside + outside) : 1.0;
}

/* Trip once for each contact with a ball; the seats close again when the tip is free. */
static void update_probe(const double *tip, const double *motion, double length) {
    double depth;
    int ball = overlapped(tip, &depth);
    if (ball < 0) {
        touches += touching >= 0 ? 1 : 0;
        touching = -1, travelled = 0.0, over = 0, tripped = 0;
        return;
    }
    travelled += length * (ball == touching ? 1.0 : share_inside(tip, ball));
    touching = ball;
    if (!tripped && length > 0.0 && travelled >= pretravel(motion, length)) tripped = 1, trip_count++;
    if (!over && depth > scene.overtravel_mm) over = 1, overrun_count++;
}

/* Return the signal of the probe, whose contact opens in every other cycle while it bounces. */
static int contact(double period_s, double bouncing_s) {
    since_trip_s = tripped ? since_trip_s + period_s : 0.0;
    cycles_since_trip = tripped ? cycles_since_trip + 1 : 0;
    return tripped && (since_trip_s > bouncing_s || cycles_since_trip % 2 == 1);
}

FUNCTION(_) {
    double bare[3], deviation[3], tip[3], motion[3];
    ready = memory && plant_read_scene(memory, &scene);
    if (!ready) return;
    for (int a = 0; a < 3; a++) bare[a] = motor(a);
    int first = !begun;
    update_lost_motion(bare);
    plant_deviation(memory, bare, deviation);
    for (int a = 0; a < 3; a++) {
        tip[a] = bare[a] + scene.tool_mm[a] + deviation[a] + scene.drift_mm[a] + lag[a] + scatter[a];
        motion[a] = first ? 0.0 : tip[a] - tip_before[a];
        temperature(a) = scene.temperature_c[a];
        tip_position(a) = tip[a];
    }
    update_probe(tip, motion, sqrt(motion[0] * motion[0] + motion[1] * motion[1] + motion[2] * motion[2]));
    probe = contact(fperiod, bounce_s), trips = trip_count, overrun = overrun_count;
    memcpy(tip_before, tip, sizeof tip);
    plant_trace(memory, tip);
}
