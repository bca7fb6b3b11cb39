/* An ideal machine with one ball behind libmodbus, written from docs/reference/modbus-register-map.md alone.
 *
 *   ideal_machine tcp PORT ORDER        Modbus TCP on 127.0.0.1
 *   ideal_machine rtu DEVICE ORDER      Modbus RTU, 57600 baud 8N2
 *
 * ORDER: high or low, the order of the registers in a value. Says "ready" on standard output; ends with standard
 * input. Axes go along straight lines at constant speed in real time. What a request writes is acted upon after it
 * has been answered, as in a PLC whose program looks at the registers once in a cycle. */
#include <errno.h>
#include <math.h>
#include <modbus.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { FIRST = 1000, LAST = 2401, COUNT = LAST - FIRST + 1, NODES_MOST = 400, BLOCK = 120, BANKS = 2 };
enum { IDLE, MOVING, HELD, FAULT };
#define RAPID 500.0
#define RESOLUTION 0.0001
#define MOST_COUNTS 5000 /* 0.5 mm */
#define TRAVEL 500.0
#define OVERTRAVEL 0.05
static const double BALL[3] = {250.0, 250.0, 100.0};
#define REACH 15.5 /* radius of the ball and of the tip */

static modbus_mapping_t *map;
static int low_first;
#define REG(address) (map->tab_registers[(address) - FIRST])

static struct { uint16_t descriptor[34]; int32_t counts[3 * NODES_MOST]; int nodes; } bank[BANKS + 1], incoming;

static struct {
    int code, sequence;
    double from[3], to[3], feed, length, done, since;
} motion;
static double heartbeat_seen, armed_until;
static int handled;

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

/* values of several registers */
static void put(int address, uint64_t value, int registers) {
    for (int i = 0; i < registers; i++)
        REG(address + i) = (uint16_t)(value >> 16 * (low_first ? i : registers - 1 - i));
}
static uint64_t get(int address, int registers) {
    uint64_t value = 0;
    for (int i = 0; i < registers; i++)
        value |= (uint64_t)REG(address + i) << 16 * (low_first ? i : registers - 1 - i);
    return value;
}
static void put_f64(int address, double value) {
    uint64_t bits;
    memcpy(&bits, &value, 8);
    put(address, bits, 4);
}
static double get_f64(int address) {
    uint64_t bits = get(address, 4);
    double value;
    memcpy(&value, &bits, 8);
    return value;
}

static uint32_t crc32_of(const int32_t *counts, int number) {
    uint32_t crc = 0xFFFFFFFF;
    for (int i = 0; i < number; i++)
        for (int shift = 24; shift >= 0; shift -= 8) {
            crc ^= (uint32_t)counts[i] >> shift & 0xFF;
            for (int bit = 0; bit < 8; bit++) crc = crc & 1 ? crc >> 1 ^ 0xEDB88320 : crc >> 1;
        }
    return ~crc;
}

static void position(double *here) {
    for (int i = 0; i < 3; i++) here[i] = get_f64(1012 + 4 * i);
}
static double to_ball(const double *p) {
    double d = 0;
    for (int i = 0; i < 3; i++) d += (p[i] - BALL[i]) * (p[i] - BALL[i]);
    return sqrt(d);
}
static int deflected(const double *p) { return to_ball(p) < REACH - 1e-9; }

static void show_motion(int state, int outcome, int fault) {
    REG(1004) = state, REG(1005) = fault, REG(1011) = outcome;
}

/* Distance along the line at which the tip first meets the ball; beyond the end if it does not. */
static double contact(void) {
    double along = 0, off = 0;
    for (int i = 0; i < 3; i++) {
        double unit = (motion.to[i] - motion.from[i]) / motion.length;
        along += (BALL[i] - motion.from[i]) * unit;
        off += (motion.from[i] - BALL[i]) * (motion.from[i] - BALL[i]);
    }
    double half = REACH * REACH - (off - along * along);
    return half > 0 && along - sqrt(half) >= 0 ? along - sqrt(half) : INFINITY;
}

static void place(int address, double distance) {
    double share = motion.length > 0 ? distance / motion.length : 1;
    for (int i = 0; i < 3; i++)
        put_f64(address + 4 * i, motion.from[i] + share * (motion.to[i] - motion.from[i]));
}

static void latch(int result, double at) {
    place(1026, at);
    REG(1025) = result;
    REG(1024) = motion.sequence;
}

static void move_on(void) {
    if (REG(1004) != MOVING) return;
    double t = now(), trip = motion.code >= 13 && motion.length > 0 ? contact() : INFINITY;
    motion.done += motion.feed * (t - motion.since);
    motion.since = t;
    if (t - heartbeat_seen > 1.0) {
        show_motion(FAULT, 7, 6);
    } else if (trip <= fmin(motion.done, motion.length)) {
        place(1012, fmin(trip + OVERTRAVEL, motion.length));
        if (motion.code == 15) latch(1, trip), show_motion(IDLE, 3, 0);
        else show_motion(FAULT, 5, 5);
    } else if (motion.done >= motion.length) {
        place(1012, motion.length);
        if (motion.code == 15) latch(2, motion.length), show_motion(IDLE, 4, 0);
        else show_motion(IDLE, 2, 0);
    } else {
        place(1012, motion.done);
    }
}

static int begin_motion(int code, int sequence) {
    double to[3], feed = get_f64(2018), here[3];
    if (REG(1004) != IDLE) return 3;
    position(here);
    for (int i = 0; i < 3; i++) {
        to[i] = get_f64(2006 + 4 * i);
        if (!isfinite(to[i])) return 7;
        if (to[i] < 0 || to[i] > TRAVEL) return 5;
    }
    if (code == 11 || code == 13) feed = RAPID;
    if (!isfinite(feed)) return 7;
    if (feed <= 0 || feed > RAPID) return 6;
    if (code == 15 && deflected(here)) return 10;
    motion.code = code, motion.sequence = sequence, motion.feed = feed;
    memcpy(motion.from, here, sizeof here);
    memcpy(motion.to, to, sizeof to);
    motion.length = 0;
    for (int i = 0; i < 3; i++) motion.length += (to[i] - here[i]) * (to[i] - here[i]);
    motion.length = sqrt(motion.length);
    motion.done = 0;
    motion.since = heartbeat_seen = now();
    REG(1010) = sequence;
    show_motion(MOVING, 1, 0);
    return 1;
}

static void show_bank(int number, int state) {
    REG(1045 + number) = state;
    put(1046 + 2 * number, state == 2 ? crc32_of(bank[number].counts, 3 * bank[number].nodes) : 0, 2);
}

static int table_begin(int number) {
    int nodes = REG(2101) * REG(2102) * REG(2103);
    if (number < 1 || number > BANKS) return 20;
    if (number == REG(1038)) return 21;
    if (REG(2100) != number || nodes < 1 || nodes > NODES_MOST) return 22;
    if (get_f64(2128) != RESOLUTION) return 22;
    for (int i = 0; i < 3; i++)
        if (REG(2101 + i) > 1 && !(get_f64(2116 + 4 * i) > 0)) return 22;
    memset(&incoming, 0, sizeof incoming);
    memcpy(incoming.descriptor, &REG(2100), sizeof incoming.descriptor);
    incoming.nodes = nodes;
    if (REG(1040) && REG(1040) != number) show_bank(REG(1040), 3);
    if (REG(1039) == number) REG(1039) = 0;
    REG(1040) = number;
    REG(1044) = REG(1045) = REG(2320) = 0;
    show_bank(number, 1);
    return 1;
}

static int table_commit(int number, uint32_t crc) {
    int nodes = incoming.nodes;
    if (REG(1040) == 0 || number != REG(1040)) return 27;
    if (20 * REG(1044) < nodes) return 23;
    REG(1040) = 0;
    uint32_t told = (uint32_t)incoming.descriptor[low_first ? 33 : 32] << 16 | incoming.descriptor[low_first ? 32 : 33];
    if (crc32_of(incoming.counts, 3 * nodes) != crc || told != crc) {
        show_bank(number, 3);
        return 24;
    }
    bank[number] = incoming;
    show_bank(number, 2);
    REG(1039) = number;
    return 1;
}

static int table_arm(int number, uint32_t crc) {
    static uint16_t nonce = 40000;
    if (number > BANKS) return 20;
    if (number && REG(1045 + number) != 2) return 26;
    if (number && crc != get(1046 + 2 * number, 2)) return 24;
    armed_until = now() + 5.0;
    REG(1041) = number;
    nonce = nonce == 0xFFFF ? 1 : nonce + 1;
    REG(1042) = nonce;
    return 1;
}

static int table_activate(int number, int nonce) {
    int armed = REG(1042) && nonce == REG(1042) && number == REG(1041) && now() < armed_until;
    if (!armed) return 25;
    REG(1042) = 0;
    REG(1038) = number;
    if (REG(1039) == number) REG(1039) = 0;
    return 1;
}

static int decide(int code, int sequence) {
    int number = REG(2002), result = 2;
    uint32_t crc = get(2004, 2);
    if (code >= 11 && code <= 15) return begin_motion(code, sequence);
    if ((code == 21 || code == 22) && REG(1004) == FAULT) return 3;
    if (code == 21) { if (REG(1004) == MOVING) REG(1004) = HELD; return 1; }
    if (code == 22) {
        if (REG(1004) == HELD) REG(1004) = MOVING, motion.since = heartbeat_seen = now();
        return 1;
    }
    if (code == 23) { if (REG(1004) == MOVING || REG(1004) == HELD) show_motion(IDLE, 6, 0); return 1; }
    if (code == 24) {
        if (REG(1004) == MOVING || REG(1004) == HELD) return 3;
        REG(1004) = IDLE, REG(1005) = 0;
        return 1;
    }
    if (code >= 31 && code <= 34 && REG(1004) != IDLE) return 3;
    if (code == 31) result = table_begin(number);
    if (code == 32) result = table_commit(number, crc);
    if (code == 33) result = table_arm(number, crc);
    if (code == 34) result = table_activate(number, REG(2003));
    if (result == 1 && code != 33) REG(1042) = 0;
    return result;
}

static void take_block(void) {
    int number = REG(2320), counts = 3 * incoming.nodes;
    if (number == 0 || number == REG(1044)) return;
    if (REG(1040) == 0) { REG(1045) = 27; return; }
    if (number != REG(1044) + 1) { REG(1045) = 23; return; }
    for (int i = 0; i < 60; i++)
        if (abs((int32_t)get(2200 + 2 * i, 2)) > MOST_COUNTS) { REG(1045) = 7; return; }
    for (int i = 0; i < 60 && 60 * (number - 1) + i < counts; i++)
        incoming.counts[60 * (number - 1) + i] = (int32_t)get(2200 + 2 * i, 2);
    REG(1045) = 1;
    REG(1044) = number;
}

static void show_block(void) {
    int number = REG(2400), block = REG(2401);
    int whole = number >= 1 && number <= BANKS && REG(1045 + number) == 2;
    memset(&REG(1202), 0, 2 * BLOCK);
    if (number < 1 || number > BANKS || (block && (!whole || 20 * (block - 1) >= bank[number].nodes))) {
        block = 0xFFFF;
    } else if (block == 0) {
        if (whole) memcpy(&REG(1202), bank[number].descriptor, sizeof bank[number].descriptor);
        REG(1202) = number;
    } else {
        for (int i = 0; i < 60 && 60 * (block - 1) + i < 3 * bank[number].nodes; i++)
            put(1202 + 2 * i, (uint32_t)bank[number].counts[60 * (block - 1) + i], 2);
    }
    REG(1200) = number;
    REG(1201) = block;
}

static void cycle(void) {
    static uint16_t beat, agent;
    double here[3];
    if (REG(2000) != agent) agent = REG(2000), heartbeat_seen = now();
    REG(1003) = agent;
    move_on();
    if (REG(2022) && REG(2022) != handled) {
        handled = REG(2022);
        REG(1009) = decide(REG(2001), handled);
        REG(1008) = handled;
    }
    take_block();
    show_block();
    if (REG(1042) && now() >= armed_until) REG(1042) = 0;
    position(here);
    REG(1007) = 3 | (deflected(here) ? 4 : 0);
    REG(1006) = REG(1004) == FAULT ? 0x5F : 0x7F;
    REG(1002) = REG(1069) = ++beat;
}

static void prepare(void) {
    REG(1000) = 0x5643, REG(1001) = 0x0100;
    put_f64(1012, 100), put_f64(1016, 100), put_f64(1020, 100);
    REG(1043) = 0xFFFF;
    REG(1052) = 1;
    for (int i = 0; i < 8; i++) put(1053 + 2 * i, i ? 0x80000000 : 20125, 2);
    for (int i = 0; i < 3; i++) {
        put_f64(1112 + 4 * i, TRAVEL), put_f64(1124 + 4 * i, RAPID), put_f64(1136 + 4 * i, 1e9);
        REG(1149 + i) = 20;
    }
    REG(1148) = BANKS;
    put(1152, NODES_MOST, 2);
    put_f64(1154, RESOLUTION), put_f64(1158, RESOLUTION * MOST_COUNTS);
}

static int inside(int address, int count, int writing) {
    static const int blocks[7][3] = {{1000, 70, 0}, {1100, 63, 0},  {1200, 122, 0}, {2000, 23, 1},
                                     {2100, 34, 1}, {2200, 121, 1}, {2400, 2, 1}};
    for (int i = 0; i < 7; i++)
        if (address >= blocks[i][0] && address + count <= blocks[i][0] + blocks[i][1]) return !writing || blocks[i][2];
    return 0;
}

static int word(const uint8_t *at) { return at[0] << 8 | at[1]; }

static int allowed(const uint8_t *pdu) {
    if (pdu[0] == 3) return inside(word(pdu + 1), word(pdu + 3), 0);
    if (pdu[0] == 16) return inside(word(pdu + 1), word(pdu + 3), 1);
    return pdu[0] != 23 || (inside(word(pdu + 1), word(pdu + 3), 0) && inside(word(pdu + 5), word(pdu + 7), 1));
}

/* Cycles until something has come at `end`; ends the program with its standard input. */
static void await(int end) {
    struct pollfd ends[2] = {{.fd = end, .events = POLLIN}, {.fd = 0, .events = POLLIN}};
    for (;;) {
        if (poll(ends, 2, 20) < 0 || ends[1].revents) exit(0);
        cycle();
        if (ends[0].revents) return;
    }
}

static void serve(modbus_t *context) {
    uint8_t query[MODBUS_MAX_ADU_LENGTH];
    for (;;) {
        await(modbus_get_socket(context));
        int length = modbus_receive(context, query);
        if (length == -1 && errno == EMBBADCRC) { modbus_flush(context); continue; }
        if (length == -1) return;
        if (length == 0) continue;
        if (allowed(query + modbus_get_header_length(context))) modbus_reply(context, query, length, map);
        else modbus_reply_exception(context, query, MODBUS_EXCEPTION_ILLEGAL_DATA_ADDRESS);
        cycle();
    }
}

int main(int count, char **words) {
    if (count != 4) return 2;
    low_first = !strcmp(words[3], "low");
    map = modbus_mapping_new_start_address(0, 0, 0, 0, FIRST, COUNT, 0, 0);
    prepare();
    cycle();
    if (!strcmp(words[1], "rtu")) {
        modbus_t *context = modbus_new_rtu(words[2], 57600, 'N', 8, 2);
        modbus_set_slave(context, 1);
        if (modbus_connect(context)) return 3;
        puts("ready"), fflush(stdout);
        serve(context);
        return 4;
    }
    modbus_t *context = modbus_new_tcp("127.0.0.1", atoi(words[2]));
    int listener = modbus_tcp_listen(context, 1);
    if (listener < 0) return 3;
    puts("ready"), fflush(stdout);
    for (;;) {
        await(listener);
        modbus_tcp_accept(context, &listener);
        serve(context);
        modbus_close(context);
    }
}
