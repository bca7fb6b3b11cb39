/* volcal_tables: loads compensation tables from files into the shared memory read by volcal_eoffset and volcal_kins.
 *
 *   loadusr -Wn volcal-tables volcal_tables DIRECTORY [LARGEST_MM]
 *
 * DIRECTORY holds bank1.table, bank2.table, and active-bank, which this program writes. Requests come by pins: set the
 * operands, then a new sequence number; once `done` shows that number, `result` is valid. A table is activated in two
 * steps: arm with its CRC-32, then confirm with the nonce.
 *
 * License: GPL v2 or later (linked with LinuxCNC).
 */
#include <fcntl.h>
#include <signal.h>
#include <time.h>
#include <unistd.h>

#include "hal.h"
#include "rtapi.h"
#include "volcal_table_file.h"

#define POLL_US 2000
#define CHECK_EVERY 500 /* polls between two checks of the memory's CRC-32 */
#define LARGEST_MM 1.0

typedef struct {
    hal_u32_t *load_bank, *load_sequence, *load_done, *load_result;
    hal_u32_t *arm_bank, *arm_crc, *arm_sequence, *arm_done, *arm_result, *armed_bank, *armed_nonce;
    hal_u32_t *confirm_nonce, *bank;
    hal_u32_t *acting_bank, *acting_crc, *acting_fault;
    hal_bit_t *acting, *settled, *limited;
    hal_u32_t *bank_state[VOLCAL_BANKS], *bank_crc[VOLCAL_BANKS], *bank_result[VOLCAL_BANKS];
    hal_bit_t *table_lost;
    hal_u32_t *beat;
    hal_float_t *age;
} pins_t;

static pins_t *pins;
static volcal_shared *shared;
static volcal_slot *scratch;
static const char *directory;
static double largest_mm = LARGEST_MM;
static struct timespec loaded_at[VOLCAL_BANKS];
static rtapi_u32 persisted;
static volatile sig_atomic_t ended;

static void on_signal(int number) {
    (void)number;
    ended = 1;
}

static int export_pins(int id) {
    static const char *const name = "volcal-tables";
    int failed = 0;
#define U32(direction, pin, ...) failed |= hal_pin_u32_newf(direction, &pins->pin, id, __VA_ARGS__, name)
    U32(HAL_IN, load_bank, "%s.load-bank");
    U32(HAL_IN, load_sequence, "%s.load-sequence");
    U32(HAL_OUT, load_done, "%s.load-done");
    U32(HAL_OUT, load_result, "%s.load-result");
    U32(HAL_IN, arm_bank, "%s.arm-bank");
    U32(HAL_IN, arm_crc, "%s.arm-crc");
    U32(HAL_IN, arm_sequence, "%s.arm-sequence");
    U32(HAL_OUT, arm_done, "%s.arm-done");
    U32(HAL_OUT, arm_result, "%s.arm-result");
    U32(HAL_OUT, armed_bank, "%s.armed-bank");
    U32(HAL_OUT, armed_nonce, "%s.armed-nonce");
    U32(HAL_IN, confirm_nonce, "%s.confirm-nonce");
    U32(HAL_OUT, bank, "%s.bank");
    U32(HAL_IN, acting_bank, "%s.acting-bank");
    U32(HAL_IN, acting_crc, "%s.acting-crc");
    U32(HAL_IN, acting_fault, "%s.acting-fault");
    U32(HAL_OUT, beat, "%s.beat");
#undef U32
    failed |= hal_pin_bit_newf(HAL_IN, &pins->acting, id, "%s.acting", name);
    failed |= hal_pin_bit_newf(HAL_IN, &pins->settled, id, "%s.settled", name);
    failed |= hal_pin_bit_newf(HAL_IN, &pins->limited, id, "%s.limited", name);
    failed |= hal_pin_bit_newf(HAL_OUT, &pins->table_lost, id, "%s.table-lost", name);
    failed |= hal_pin_float_newf(HAL_OUT, &pins->age, id, "%s.age", name);
    for (unsigned n = 0; n < VOLCAL_BANKS; n++) {
        failed |= hal_pin_u32_newf(HAL_OUT, &pins->bank_state[n], id, "%s.bank%u-state", name, n + 1);
        failed |= hal_pin_u32_newf(HAL_OUT, &pins->bank_crc[n], id, "%s.bank%u-crc", name, n + 1);
        failed |= hal_pin_u32_newf(HAL_OUT, &pins->bank_result[n], id, "%s.bank%u-result", name, n + 1);
    }
    return failed;
}

static int in_use(rtapi_u32 bank) {
    for (int reader = 0; reader < VOLCAL_READERS; reader++)
        if (shared->used[reader][bank - 1]) return 1;
    return 0;
}

/* Copies the scratch table into the bank; refused while a component uses the bank. */
static enum volcal_result publish(rtapi_u32 bank) {
    volcal_slot *slot = &shared->slot[bank - 1];
    rtapi_u32 writing = slot->generation | 1u;
    slot->generation = writing;
    __sync_synchronize();
    if (in_use(bank)) {
        slot->generation = writing - 1u;
        return VOLCAL_BANK_USED;
    }
    slot->state = VOLCAL_EMPTY;
    if (volcal_node_count(scratch)) {
        slot->crc = scratch->crc;
        memcpy(slot->nodes, scratch->nodes, sizeof slot->nodes);
        memcpy(slot->origin, scratch->origin, sizeof slot->origin);
        memcpy(slot->step, scratch->step, sizeof slot->step);
        slot->resolution = scratch->resolution;
        slot->largest = scratch->largest;
        memcpy(slot->counts, scratch->counts, sizeof slot->counts[0] * volcal_node_count(scratch));
        slot->state = volcal_crc_of_counts(slot) == scratch->crc ? VOLCAL_COMPLETE : VOLCAL_DAMAGED;
    }
    __sync_synchronize();
    slot->generation = writing + 1u;
    return VOLCAL_OK;
}

/* Loads the file of a bank. An unusable file leaves the bank empty, since a restart would find the same file. */
static enum volcal_result load(rtapi_u32 bank) {
    char path[4096];
    size_t length;
    enum volcal_result read = VOLCAL_NO_FILE;
    if (bank < 1 || bank > VOLCAL_BANKS) return VOLCAL_NO_SUCH_BANK;
    if (in_use(bank)) return VOLCAL_BANK_USED;
    snprintf(path, sizeof path, "%s/bank%u.table", directory, bank);
    char *text = volcal_slurp(path, &length);
    if (text) read = volcal_parse(text, length, largest_mm, scratch);
    free(text);
    if (read != VOLCAL_OK) memset(scratch->nodes, 0, sizeof scratch->nodes);
    enum volcal_result published = publish(bank);
    if (published != VOLCAL_OK) return published;
    clock_gettime(CLOCK_MONOTONIC, &loaded_at[bank - 1]);
    return *pins->bank_result[bank - 1] = read;
}

static enum volcal_result arm(rtapi_u32 bank, rtapi_u32 crc) {
    *pins->armed_bank = *pins->armed_nonce = 0;
    if (bank > VOLCAL_BANKS) return VOLCAL_NO_SUCH_BANK;
    if (bank != 0) {
        const volcal_slot *slot = &shared->slot[bank - 1];
        if (slot->state != VOLCAL_COMPLETE) return VOLCAL_HOLDS_NO_TABLE;
        if (slot->crc != crc || volcal_crc_of_counts(slot) != crc) return VOLCAL_CRC_DIFFERS;
    }
    *pins->armed_bank = bank;
    *pins->armed_nonce = ((rtapi_u32)random() & 0x7FFFFFFFu) | 1u;
    return VOLCAL_OK;
}

static void confirm(void) {
    if (*pins->armed_nonce == 0 || *pins->confirm_nonce != *pins->armed_nonce) return;
    *pins->bank = *pins->armed_bank;
    *pins->table_lost = 0;
    *pins->armed_bank = *pins->armed_nonce = 0;
}

static void answer_requests(void) {
    if (*pins->load_sequence != *pins->load_done) {
        rtapi_u32 sequence = *pins->load_sequence;
        *pins->load_result = load(*pins->load_bank);
        *pins->load_done = sequence;
    }
    if (*pins->arm_sequence != *pins->arm_done) {
        rtapi_u32 sequence = *pins->arm_sequence;
        *pins->arm_result = arm(*pins->arm_bank, *pins->arm_crc);
        *pins->arm_done = sequence;
    }
    confirm();
}

/* Writes the file active-bank atomically, also across a power cut. */
static int write_active(rtapi_u32 bank, rtapi_u32 crc) {
    char part[4096], path[4096], text[64];
    snprintf(part, sizeof part, "%s/active-bank.part", directory);
    snprintf(path, sizeof path, "%s/active-bank", directory);
    int length = snprintf(text, sizeof text, "volcal-active-bank 1\nbank %u\ncrc32 %08X\nend\n", bank, crc);
    int file = open(part, O_WRONLY | O_CREAT | O_TRUNC, 0664);
    if (file < 0) return 0;
    int written = write(file, text, (size_t)length) == length && fsync(file) == 0;
    close(file);
    if (!written || rename(part, path) != 0) return 0;
    int folder = open(directory, O_RDONLY | O_DIRECTORY);
    if (folder < 0) return 0;
    int durable = fsync(folder) == 0;
    close(folder);
    return durable;
}

/* Reactivates the bank active before the restart, if its table is unchanged. */
static void resume_active(void) {
    char path[4096];
    size_t length;
    unsigned bank, crc;
    int read = 0;
    snprintf(path, sizeof path, "%s/active-bank", directory);
    char *text = volcal_slurp(path, &length);
    if (!text) return;
    int fields = sscanf(text, "volcal-active-bank 1\nbank %u\ncrc32 %8X\nend\n%n", &bank, &crc, &read);
    int whole = fields == 2 && read == (int)length;
    free(text);
    if (whole && bank == 0) return;
    if (whole && bank <= VOLCAL_BANKS && arm(bank, crc) == VOLCAL_OK) {
        *pins->bank = persisted = bank;
        *pins->armed_bank = *pins->armed_nonce = 0;
        return;
    }
    *pins->table_lost = 1;
    rtapi_print_msg(RTAPI_MSG_ERR, "volcal_tables: the active table is lost; nothing is compensated\n");
}

static void look_at_memory(void) {
    for (rtapi_u32 bank = 1; bank <= VOLCAL_BANKS; bank++) {
        volcal_slot *slot = &shared->slot[bank - 1];
        if (slot->state != VOLCAL_COMPLETE || volcal_crc_of_counts(slot) == slot->crc) continue;
        slot->state = VOLCAL_DAMAGED;
        rtapi_print_msg(RTAPI_MSG_ERR, "volcal_tables: the table of bank %u is damaged in memory\n", bank);
    }
}

static void show(void) {
    struct timespec now;
    rtapi_u32 bank = *pins->acting_bank;
    for (unsigned n = 0; n < VOLCAL_BANKS; n++) {
        *pins->bank_state[n] = shared->slot[n].state;
        *pins->bank_crc[n] = shared->slot[n].state == VOLCAL_COMPLETE ? shared->slot[n].crc : 0;
    }
    if (bank == *pins->bank && bank != persisted && bank <= VOLCAL_BANKS &&
        write_active(bank, bank ? shared->slot[bank - 1].crc : 0))
        persisted = bank;
    clock_gettime(CLOCK_MONOTONIC, &now);
    *pins->age = bank >= 1 && bank <= VOLCAL_BANKS ? (double)(now.tv_sec - loaded_at[bank - 1].tv_sec) : 0.0;
    ++*pins->beat;
}

static void serve(void) {
    for (unsigned polls = 1; !ended; polls++) {
        answer_requests();
        if (polls % CHECK_EVERY == 0) look_at_memory();
        show();
        usleep(POLL_US);
    }
}

static int prepare(int id, int *memory_id) {
    struct timespec now;
    shared = volcal_attach(id, memory_id);
    scratch = malloc(sizeof *scratch);
    pins = hal_malloc(sizeof *pins);
    if (!shared || !scratch || !pins || export_pins(id)) return 0;
    volcal_crc_prepare();
    clock_gettime(CLOCK_MONOTONIC, &now);
    srandom((unsigned)(now.tv_nsec ^ now.tv_sec ^ getpid()));
    for (rtapi_u32 bank = 1; bank <= VOLCAL_BANKS; bank++) load(bank);
    resume_active();
    show();
    return 1;
}

int main(int argc, char **argv) {
    int memory_id = -1;
    if (argc < 2 || argc > 3 || (argc == 3 && !((largest_mm = atof(argv[2])) > 0.0))) {
        fprintf(stderr, "usage: volcal_tables DIRECTORY [LARGEST_MM]\n");
        return 2;
    }
    directory = argv[1];
    signal(SIGTERM, on_signal);
    signal(SIGINT, on_signal);
    int id = hal_init("volcal-tables");
    if (id < 0) return 1;
    int ready = prepare(id, &memory_id) && hal_ready(id) == 0;
    if (ready)
        serve();
    else
        fprintf(stderr, "volcal_tables: no memory or no pins\n");
    if (memory_id >= 0) rtapi_shmem_delete(memory_id, id);
    hal_exit(id);
    free(scratch);
    return ready ? 0 : 1;
}
