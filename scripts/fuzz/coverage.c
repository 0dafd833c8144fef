// Evaluates the counters that -fsanitize-coverage=inline-8bit-counters adds to each branch (https://clang.llvm.org/docs/SanitizerCoverage.html).
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

static uint8_t *counters;
static size_t length;
// The classes of counts that each counter has had, one bit for each class.
static uint8_t *known;

void __sanitizer_cov_8bit_counters_init(uint8_t *start, uint8_t *stop) {
    // Each object file passes the same section.
    if (counters == NULL && start != stop) {
        counters = start;
        length = (size_t)(stop - start);
    }
}

// Classes of counts: a loop that runs twice as often differs, one that runs once more does not.
static uint8_t class(uint8_t count) {
    if (count <= 3) return (uint8_t)(1 << (count - 1));
    if (count < 8) return 8;
    if (count < 16) return 16;
    if (count < 32) return 32;
    return count < 128 ? 64 : 128;
}

// Returns 1 if a counter has a class that it never had. Sets the counters to 0.
int robogate_coverage_grew(void) {
    if (known == NULL) {
        known = calloc(length, 1);
        if (known == NULL) abort();
    }
    int grew = 0;
    size_t i = 0;
    while (i < length) {
        uint64_t eight = 0;
        if (i + 8 <= length) {
            memcpy(&eight, counters + i, 8);
            if (eight == 0) {
                i += 8;
                continue;
            }
        }
        size_t end = i + 8 <= length ? i + 8 : length;
        for (; i < end; i++) {
            if (counters[i] == 0) continue;
            uint8_t bit = class(counters[i]);
            if ((known[i] & bit) == 0) {
                known[i] |= bit;
                grew = 1;
            }
            counters[i] = 0;
        }
    }
    return grew;
}
