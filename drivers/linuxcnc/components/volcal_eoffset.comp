component volcal_eoffset "Volumetric compensation by external offsets";
description """
Looks a compensation table up at the commanded position of X, Y, Z and asks motion for that offset. The tables come from *volcal_tables*. While the machine is off or not homed, *clear* is held and the
counts are zero; from the instant it is on, the offset comes in again, no faster than *jump-rate*.
Add the function to the servo thread after motion-controller.""";
pin in float position-#[3] "axis.L.pos-cmd, mm; LinuxCNC shows it without the offset";
pin in float offset-#[3] "axis.L.eoffset, mm";
pin in bit machine-on "motion.motion-enabled";
pin in bit homed "motion.is-all-homed";
pin in bit limited "motion.eoffset-limited: an axis stands at its end, the offset beyond it is cut off";
pin in u32 bank "the bank that shall act; 0: none";
pin out s32 counts-#[3] "axis.L.eoffset-counts";
pin out bit clear = true "axis.L.eoffset-clear";
pin out bit enable = true "axis.L.eoffset-enable";
pin out float scale = 0.000001 "axis.L.eoffset-scale, mm";
pin out float correction-#[3] "what shall be added to the commanded position, mm";
pin out u32 active-bank "the bank that was chosen last and holds a complete table";
pin out u32 active-crc "CRC-32 of its table";
pin out bit acting "the offset is applied: machine on and homed";
pin out bit settled "acting, no change under way, and the offset is what it shall be, or cut off at the end of an axis";
pin out u32 fault "0: none; 1: no shared memory; 2: the chosen bank is empty; 3: table damaged, last correction held";
pin out bit faulted "fault is not 0";
pin out float age "seconds since the present bank acts alone";
param rw float jump_rate = 0.5 "mm/s: fastest shift by switching banks or the machine on";
param rw float tolerance = 0.0001 "mm: how far the offset may be off while settled";
option singleton yes;
option extra_setup yes;
option extra_cleanup yes;
include "volcal_acting.h";
function _ fp "look up, and ask for the offset";
license "GPL";
author "volcal";
;;

static volcal_acting table_acting;
static int memory_id;
static double arrival; /* 0 ... 1: how much of the correction is in since the machine is on */

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
