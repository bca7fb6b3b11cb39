component volcal_kins "XYZ kinematics with volumetric compensation";
description """
joint = position + table(position) for X, Y, Z (joints 0, 1, 2); joints 3 ... 8 are A, B, C, U, V, W, uncorrected.
The forward transformation uses fixed-point iteration. The tables come from *volcal_tables*. Add the function to the
servo thread before motion-controller: it follows the selected bank; without it nothing is ever corrected.""";
pin in u32 bank "the selected bank; 0: none";
pin out float correction-#[3] "joint - position, mm";
pin out u32 active-bank "the active bank";
pin out u32 active-crc "CRC-32 of its table";
pin out bit acting = true "always true: the kinematics correct whether the machine is on or off";
pin out bit settled "no transition between banks in progress";
pin out u32 fault "0: none; 1: no shared memory; 2: the selected bank is empty; 3: table damaged, last correction held";
pin out bit faulted "fault is not 0";
pin out float age "seconds since the last transition ended";
pin out u32 iterations "largest number of iterations of a forward transformation so far";
param rw float jump_rate = 0.5 "mm/s: largest speed of the shift when switching banks";
option singleton yes;
option extra_setup yes;
option extra_cleanup yes;
include "volcal_acting.h";
include "kinematics.h";
function _ fp "follow the selected bank";
license "GPL";
author "volcal";
;;

#define MOST_ITERATIONS 20
#define CLOSE_ENOUGH 1e-12 /* mm */

static volcal_acting table_acting;
static int memory_id;
static rtapi_u32 most_iterations;

EXTRA_SETUP() {
    (void)__comp_inst; (void)prefix; (void)extra_arg;
    volcal_start(&table_acting, volcal_attach(comp_id, &memory_id), VOLCAL_KINEMATICS);
    return 0;
}

EXTRA_CLEANUP() {
    if (table_acting.shared) volcal_start(&table_acting, table_acting.shared, VOLCAL_KINEMATICS);
    if (memory_id >= 0) rtapi_shmem_delete(memory_id, comp_id);
}

FUNCTION(_) {
    volcal_step(&table_acting, bank, jump_rate, fperiod);
    for (int a = 0; a < 3; a++) correction(a) = table_acting.last[a];
    active_bank = table_acting.now.number;
    active_crc = volcal_active_crc(&table_acting);
    acting = 1;
    settled = !table_acting.blending;
    fault = table_acting.trouble;
    faulted = table_acting.trouble != VOLCAL_NO_FAULT;
    age = table_acting.age_s;
    iterations = most_iterations;
}

KINEMATICS_TYPE kinematicsType() { return KINEMATICS_IDENTITY; }

/* Solves position = joint - table(position) by fixed-point iteration. The iteration converges because a correction
   changes by far less than the position does (the loader refuses steeper tables). */
int kinematicsForward(const double *joint, EmcPose *pos, const KINEMATICS_FORWARD_FLAGS *fflags,
                      KINEMATICS_INVERSE_FLAGS *iflags) {
    (void)fflags; (void)iflags;
    double where[3] = {joint[0], joint[1], joint[2]}, shift[3], change = 1.0;
    rtapi_u32 n = 0;
    for (; n < MOST_ITERATIONS && change > CLOSE_ENOUGH; n++) {
        volcal_correction(&table_acting, where, shift);
        change = 0.0;
        for (int a = 0; a < 3; a++) {
            change = fmax(change, fabs(joint[a] - shift[a] - where[a]));
            where[a] = joint[a] - shift[a];
        }
    }
    if (n > most_iterations) most_iterations = n;
    pos->tran.x = where[0]; pos->tran.y = where[1]; pos->tran.z = where[2];
    pos->a = joint[3]; pos->b = joint[4]; pos->c = joint[5];
    pos->u = joint[6]; pos->v = joint[7]; pos->w = joint[8];
    return 0;
}

int kinematicsInverse(const EmcPose *pos, double *joint, const KINEMATICS_INVERSE_FLAGS *iflags,
                      KINEMATICS_FORWARD_FLAGS *fflags) {
    (void)iflags; (void)fflags;
    double where[3] = {pos->tran.x, pos->tran.y, pos->tran.z}, shift[3];
    volcal_correction(&table_acting, where, shift);
    for (int a = 0; a < 3; a++) {
        table_acting.last[a] = shift[a];
        joint[a] = where[a] + shift[a];
    }
    joint[3] = pos->a; joint[4] = pos->b; joint[5] = pos->c;
    joint[6] = pos->u; joint[7] = pos->v; joint[8] = pos->w;
    return 0;
}

int kinematicsHome(EmcPose *world, double *joint, KINEMATICS_FORWARD_FLAGS *fflags,
                   KINEMATICS_INVERSE_FLAGS *iflags) {
    *fflags = 0;
    *iflags = 0;
    return kinematicsForward(joint, world, fflags, iflags);
}

EXPORT_SYMBOL(kinematicsType);
EXPORT_SYMBOL(kinematicsForward);
EXPORT_SYMBOL(kinematicsInverse);
EXPORT_SYMBOL(kinematicsHome);
KINS_NOT_SWITCHABLE
