component volcal_eoffset "Volumetric compensation by external offsets";
description """
Looks up a compensation table at the commanded position of X, Y, Z and requests that external offset. The tables come
from *volcal_tables*. While the machine is off or not homed, *clear* is set and the counts are zero; when it is switched
on, the offset is applied again, no faster than *jump-rate*.
Add the function to the servo thread after motion-controller.""";
pin in float position-#[3] "axis.L.pos-cmd, mm; LinuxCNC shows it without the offset";
pin in float offset-#[3] "axis.L.eoffset, mm";
pin in bit machine-on "motion.motion-enabled";
pin in bit homed "motion.is-all-homed";
pin in bit limited "motion.eoffset-limited: an axis is at its limit, and the offset beyond it is cut off";
pin in u32 bank "the selected bank; 0: none";
pin out s32 counts-#[3] "axis.L.eoffset-counts";
pin out bit clear = true "axis.L.eoffset-clear";
pin out bit enable = true "axis.L.eoffset-enable";
pin out float scale = 0.000001 "axis.L.eoffset-scale, mm";
pin out float correction-#[3] "correction requested for the commanded position, mm";
pin out u32 active-bank "the active bank: the last selected one that holds a complete table";
pin out u32 active-crc "CRC-32 of its table";
pin out bit acting "the offset is applied: machine on and homed";
pin out bit settled "applied, no transition in progress, and the offset as requested or cut off at an axis limit";
pin out u32 fault "0: none; 1: no shared memory; 2: the selected bank is empty; 3: table damaged, last correction held";
pin out bit faulted "fault is not 0";
pin out float age "seconds since the last transition ended";
param rw float jump_rate = 0.5 "mm/s: largest speed of the shift when switching banks or switching the machine on";
param rw float tolerance = 0.0001 "mm: largest deviation of the offset while settled";
option singleton yes;
option extra_setup yes;
option extra_cleanup yes;
include "volcal_acting.h";
function _ fp "look up and request the offset";
license "GPL";
author "volcal";
;;

static volcal_acting table_acting;
static int memory_id;
static double arrival; /* 0 ... 1: progress of applying the correction after the machine was switched on */

EXTRA_SETUP() {
    (void)__comp_inst; (void)prefix; (void)extra_arg;
    volcal_start(&table_acting, volcal_attach(comp_id, &memory_id), VOLCAL_OFFSETS);
    return 0;
}

EXTRA_CLEANUP() {
    if (table_acting.shared) volcal_start(&table_acting, table_acting.shared, VOLCAL_OFFSETS);
    if (memory_id >= 0) rtapi_shmem_delete(memory_id, comp_id);
}

static double arriving(int on, double rate, double dt) {
    if (!on) return arrival = 0.0;
    double duration = volcal_duration(volcal_largest(&table_acting, &table_acting.now), rate);
    arrival = duration > dt ? fmin(1.0, arrival + dt / duration) : 1.0;
    return volcal_smooth(arrival);
}

FUNCTION(_) {
    int on = machine_on && homed;
    double where[3], wanted[3], share, worst = 0.0;
    for (int a = 0; a < 3; a++) where[a] = position(a);
    volcal_step(&table_acting, bank, jump_rate, fperiod);
    share = arriving(on, jump_rate, fperiod);
    volcal_correction(&table_acting, where, wanted);
    for (int a = 0; a < 3; a++) {
        double asked = share * wanted[a];
        table_acting.last[a] = wanted[a];
        correction(a) = asked;
        counts(a) = on ? (rtapi_s32)lround(asked / scale) : 0;
        worst = fmax(worst, fabs(asked - offset(a)));
    }
    enable = 1;
    clear = !on;
    acting = on;
    active_bank = table_acting.now.number;
    active_crc = volcal_active_crc(&table_acting);
    settled = on && !table_acting.blending && arrival >= 1.0 && (worst <= tolerance || limited);
    fault = table_acting.trouble;
    faulted = table_acting.trouble != VOLCAL_NO_FAULT;
    age = table_acting.age_s;
}
