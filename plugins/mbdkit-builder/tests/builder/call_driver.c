/* Repeats calls of kernels that `call_recorder.py` has recorded, which describes the file, with libraries of this
 * platform, and compares all memory afterwards, to the bit.
 *
 * Usage: call_driver FILE LIBRARY...
 *
 * It prints a line for each call whose results differ, and at the end the number of equal calls. */

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>
static void *opened(const char *path) { return (void *)LoadLibraryA(path); }
static void *function_in(void *library, const char *name) { return (void *)GetProcAddress((HMODULE)library, name); }
static const char *failure(void) {
    static char text[32];
    snprintf(text, sizeof text, "error %lu", GetLastError());
    return text;
}
#else
#include <dlfcn.h>
static void *opened(const char *path) { return dlopen(path, RTLD_NOW); }
static void *function_in(void *library, const char *name) { return dlsym(library, name); }
static const char *failure(void) { return dlerror(); }
#endif

typedef int64_t (*Kernel)(int64_t *);

static void **libraries;
static int library_count;

static void stop(const char *what, const char *name) {
    fprintf(stderr, "%s %s\n", what, name);
    exit(2);
}

static void *function_named(const char *name) {
    for (int i = 0; i < library_count; i++) {
        void *found = function_in(libraries[i], name);
        if (found) return found;
    }
    stop("no library has", name);
    return NULL;
}

static const int64_t *next; /* word of the recording that is read next */

static int64_t word(void) { return *next++; }

static const void *bytes(int64_t size) {
    const void *found = next;
    next += (size + 7) / 8;
    return found;
}

static const char *text(void) {
    int64_t size = word();
    char *found = calloc(1, (size_t)size + 1);
    memcpy(found, bytes(size), (size_t)size);
    return found;
}

/* Writes the addresses that the recording lists into blocks. */
static void place_addresses(char **blocks, char **targets, const char **names) {
    for (int64_t count = word(); count > 0; count--) {
        int64_t block = word(), at = word(), target = word(), offset = word();
        char *address = target < 0 ? function_named(names[-1 - target]) : targets[target] + offset;
        memcpy(blocks[block] + at, &address, sizeof address);
    }
}

/* Returns the first word that differs, or -1. */
static int64_t first_difference(const char *found, const char *expected, int64_t size) {
    for (int64_t at = 0; at < size; at += 8)
        if (memcmp(found + at, expected + at, size - at < 8 ? (size_t)(size - at) : 8)) return at / 8;
    return -1;
}

int main(int argc, char **argv) {
    if (argc < 3) stop("usage:", "call_driver FILE LIBRARY...");
    library_count = argc - 2;
    libraries = calloc((size_t)library_count, sizeof *libraries);
    for (int i = 0; i < library_count; i++)
        if (!(libraries[i] = opened(argv[i + 2]))) stop(argv[i + 2], failure());

    FILE *file = fopen(argv[1], "rb");
    if (!file) stop("cannot read", argv[1]);
    fseek(file, 0, SEEK_END);
    size_t length = (size_t)ftell(file);
    rewind(file);
    int64_t *recording = malloc(length);
    if (!recording || fread(recording, 1, length, file) != length) stop("cannot read", argv[1]);
    next = recording;

    int64_t count = word(), equal = 0;
    for (int64_t call = 0; call < count; call++) {
        const char *symbol = text();
        int64_t name_count = word();
        const char **names = calloc((size_t)name_count + 1, sizeof *names);
        for (int64_t i = 0; i < name_count; i++) names[i] = text();

        int64_t block_count = word();
        int64_t *sizes = calloc((size_t)block_count, sizeof *sizes);
        char **memory = calloc((size_t)block_count, sizeof *memory);
        char **blocks = calloc((size_t)block_count, sizeof *blocks);
        char **expected = calloc((size_t)block_count, sizeof *expected);
        for (int64_t i = 0; i < block_count; i++) {
            sizes[i] = word();
            int64_t remainder = word();
            memory[i] = malloc((size_t)sizes[i] + 128);
            blocks[i] = memory[i] + (64 - (uintptr_t)memory[i] % 64) + remainder;
            expected[i] = malloc((size_t)sizes[i]);
            memcpy(blocks[i], bytes(sizes[i]), (size_t)sizes[i]);
            memcpy(expected[i], blocks[i], (size_t)sizes[i]);
        }
        for (int64_t changed = word(); changed > 0; changed--) {
            int64_t block = word(), at = word(), value = word();
            memcpy(expected[block] + at, &value, sizes[block] - at < 8 ? (size_t)(sizes[block] - at) : 8);
        }
        place_addresses(blocks, blocks, names);
        place_addresses(expected, blocks, names);

        int64_t status = ((Kernel)function_named(symbol))((int64_t *)blocks[0]);
        int differs = status != word();
        if (differs) printf("%s returns %lld\n", symbol, (long long)status);
        for (int64_t i = 0; i < block_count; i++) {
            int64_t at = differs ? -1 : first_difference(blocks[i], expected[i], sizes[i]);
            if (at < 0) continue;
            differs = 1;
            double values[2] = {0};
            size_t size = sizes[i] - 8 * at < 8 ? (size_t)(sizes[i] - 8 * at) : 8;
            memcpy(&values[0], blocks[i] + 8 * at, size);
            memcpy(&values[1], expected[i] + 8 * at, size);
            printf("%s writes %.17g (%a) instead of %.17g (%a) into word %lld of block %lld\n", symbol, values[0],
                   values[0], values[1], values[1], (long long)at, (long long)i);
        }
        equal += !differs;
        for (int64_t i = 0; i < block_count; i++) free(memory[i]), free(expected[i]);
        free(sizes), free(memory), free(blocks), free(expected), free(names);
    }
    printf("%lld of %lld calls are equal\n", (long long)equal, (long long)count);
    return equal != count;
}
