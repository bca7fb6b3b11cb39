/* Strict parser of a compensation table in text form. User space only.
 *
 *   volcal-compensation-table 1
 *   origin_mm X Y Z
 *   step_mm X Y Z
 *   resolution_mm R
 *   nodes NX NY NZ
 *   counts_crc32 HHHHHHHH      over the counts as big-endian int32
 *   DX DY DZ                   one line per node, x slowest, z fastest
 *   file_crc32 HHHHHHHH        over every byte before this line
 *
 * License: GPL v2 or later (linked with LinuxCNC).
 */
#ifndef VOLCAL_TABLE_FILE_H
#define VOLCAL_TABLE_FILE_H

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "volcal_table.h"

#define VOLCAL_STEEPEST_SLOPE 0.1 /* mm of correction per mm of travel: the iteration of the forward kinematics must converge */
#define VOLCAL_LONGEST_FILE (64l << 20)

enum volcal_result {
    VOLCAL_OK = 0,
    VOLCAL_NO_SUCH_BANK = 1,
    VOLCAL_BANK_USED = 2,
    VOLCAL_NO_FILE = 3,
    VOLCAL_MALFORMED = 4,
    VOLCAL_CRC_DIFFERS = 5,
    VOLCAL_BEYOND_LIMITS = 6,
    VOLCAL_HOLDS_NO_TABLE = 7
};

static rtapi_u32 volcal_crc_table[256];

static void volcal_crc_prepare(void) {
    for (rtapi_u32 n = 0; n < 256; n++) {
        rtapi_u32 value = n;
        for (int bit = 0; bit < 8; bit++) value = value & 1 ? 0xEDB88320u ^ (value >> 1) : value >> 1;
        volcal_crc_table[n] = value;
    }
}

static rtapi_u32 volcal_crc_on(rtapi_u32 crc, unsigned char byte) {
    return volcal_crc_table[(crc ^ byte) & 0xFF] ^ (crc >> 8);
}

static rtapi_u32 volcal_crc_of_text(const char *text, size_t length) {
    rtapi_u32 crc = 0xFFFFFFFFu;
    for (size_t n = 0; n < length; n++) crc = volcal_crc_on(crc, (unsigned char)text[n]);
    return ~crc;
}

static rtapi_u32 volcal_node_count(const volcal_slot *slot) {
    return slot->nodes[0] * slot->nodes[1] * slot->nodes[2];
}

static rtapi_u32 volcal_crc_of_counts(const volcal_slot *slot) {
    rtapi_u32 crc = 0xFFFFFFFFu, nodes = volcal_node_count(slot);
    for (rtapi_u32 n = 0; n < nodes; n++)
        for (int a = 0; a < 3; a++) {
            rtapi_u32 count = (rtapi_u32)slot->counts[n][a];
            for (int shift = 24; shift >= 0; shift -= 8) crc = volcal_crc_on(crc, (count >> shift) & 0xFF);
        }
    return ~crc;
}

static int volcal_word(const char **at, const char *word) {
    size_t length = strlen(word);
    if (strncmp(*at, word, length) != 0) return 0;
    *at += length;
    return 1;
}

static int volcal_real(const char **at, double *value) {
    char *end;
    if (!volcal_word(at, " ") || strchr("0123456789-", **at) == 0) return 0;
    *value = strtod(*at, &end);
    if (end == *at || !isfinite(*value)) return 0;
    *at = end;
    return 1;
}

static int volcal_reals(const char **at, const char *name, double *values, int count) {
    if (!volcal_word(at, name)) return 0;
    for (int n = 0; n < count; n++)
        if (!volcal_real(at, &values[n])) return 0;
    return volcal_word(at, "\n");
}

static int volcal_integer(const char **at, long low, long high, long *value) {
    char *end;
    if (strchr("0123456789-", **at) == 0) return 0;
    errno = 0;
    *value = strtol(*at, &end, 10);
    if (end == *at || errno || *value < low || *value > high) return 0;
    *at = end;
    return 1;
}

static int volcal_hexadecimal(const char **at, const char *name, rtapi_u32 *value) {
    if (!volcal_word(at, name) || !volcal_word(at, " ") || strspn(*at, "0123456789ABCDEF") != 8) return 0;
    *value = (rtapi_u32)strtoul(*at, 0, 16);
    *at += 8;
    return volcal_word(at, "\n");
}

static int volcal_nodes(const char **at, volcal_slot *slot) {
    if (!volcal_word(at, "nodes")) return 0;
    for (int a = 0; a < 3; a++) {
        long count;
        if (!volcal_word(at, " ") || !volcal_integer(at, 1, VOLCAL_MAX_NODES_PER_AXIS, &count)) return 0;
        slot->nodes[a] = (rtapi_u32)count;
    }
    return volcal_node_count(slot) <= VOLCAL_MAX_NODES && volcal_word(at, "\n");
}

static int volcal_counts(const char **at, volcal_slot *slot) {
    rtapi_u32 nodes = volcal_node_count(slot);
    for (rtapi_u32 n = 0; n < nodes; n++)
        for (int a = 0; a < 3; a++) {
            long count;
            if (!volcal_integer(at, -2147483647l - 1, 2147483647l, &count)) return 0;
            if (!volcal_word(at, a < 2 ? " " : "\n")) return 0;
            slot->counts[n][a] = (rtapi_s32)count;
        }
    return 1;
}

static int volcal_steps_sound(const volcal_slot *slot) {
    return slot->step[0] > 0.0 && slot->step[1] > 0.0 && slot->step[2] > 0.0 && slot->resolution > 0.0;
}

/* Determines the largest correction; returns 0 if it or a slope between neighbouring nodes exceeds its limit. */
static int volcal_within(volcal_slot *slot, double largest) {
    rtapi_u32 stride[3] = {slot->nodes[1] * slot->nodes[2], slot->nodes[2], 1}, nodes = volcal_node_count(slot);
    slot->largest = 0.0;
    for (rtapi_u32 n = 0; n < nodes; n++)
        for (int a = 0; a < 3; a++) {
            double size = fabs((double)slot->counts[n][a]) * slot->resolution;
            if (size > slot->largest) slot->largest = size;
            for (int along = 0; along < 3; along++) {
                if ((n / stride[along]) % slot->nodes[along] + 1 == slot->nodes[along]) continue;
                double rise = (double)slot->counts[n + stride[along]][a] - (double)slot->counts[n][a];
                if (fabs(rise) * slot->resolution > VOLCAL_STEEPEST_SLOPE * slot->step[along]) return 0;
            }
        }
    return slot->largest <= largest * (1.0 + 1e-9);
}

/* Parses zero-terminated `text`; fills all of `slot` except its generation and state. */
static enum volcal_result volcal_parse(const char *text, size_t length, double largest, volcal_slot *slot) {
    const size_t last_line = strlen("file_crc32 HHHHHHHH\n");
    rtapi_u32 stated;
    if (length < last_line || strlen(text) != length) return VOLCAL_MALFORMED;
    const char *tail = text + length - last_line, *end = tail;
    if (!volcal_hexadecimal(&end, "file_crc32", &stated)) return VOLCAL_MALFORMED;
    if (volcal_crc_of_text(text, length - last_line) != stated) return VOLCAL_CRC_DIFFERS;
    if (!volcal_word(&text, "volcal-compensation-table 1\n") || !volcal_reals(&text, "origin_mm", slot->origin, 3) ||
        !volcal_reals(&text, "step_mm", slot->step, 3) || !volcal_reals(&text, "resolution_mm", &slot->resolution, 1) ||
        !volcal_nodes(&text, slot) || !volcal_hexadecimal(&text, "counts_crc32", &slot->crc) ||
        !volcal_counts(&text, slot) || text != tail || !volcal_steps_sound(slot))
        return VOLCAL_MALFORMED;
    if (volcal_crc_of_counts(slot) != slot->crc) return VOLCAL_CRC_DIFFERS;
    return volcal_within(slot, largest) ? VOLCAL_OK : VOLCAL_BEYOND_LIMITS;
}

/* Returns the whole file, zero-terminated, to be freed by the caller; NULL if it cannot be read. */
static char *volcal_slurp(const char *path, size_t *length) {
    FILE *file = fopen(path, "rb");
    char *text = 0;
    long size = -1;
    if (!file) return 0;
    if (fseek(file, 0, SEEK_END) == 0) size = ftell(file);
    if (size >= 0 && size <= VOLCAL_LONGEST_FILE && fseek(file, 0, SEEK_SET) == 0) text = malloc((size_t)size + 1);
    if (text && fread(text, 1, (size_t)size, file) != (size_t)size) {
        free(text);
        text = 0;
    }
    fclose(file);
    if (!text) return 0;
    text[size] = 0;
    *length = (size_t)size;
    return text;
}

#endif
