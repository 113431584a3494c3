/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
/* Exit status 0 if all is well. On a target, semihosting prints. */
#include <stdio.h>

#include "decoupler.h"
#include "decoupler_params.h"
#include "selftest.h"

int main(void)
{
    const uint32_t check = decoupler_check(&decoupler_params);
    const decoupler_selftest_t found = decoupler_selftest();
    const int bits = (decoupler_hash(4096U) == decoupler_hash_short) ? 1 : 0;
    const uint32_t hash = decoupler_hash({{ b.hashed[1] }}U);
    const uint32_t faults = decoupler_missed_faults();
    const uint32_t zeros = decoupler_missed_zeros();
    (void)printf("table %s, %u of %u vectors failed, worst error %u pm or prad\n", (check == 0U) ? "good" : "bad",
                 (unsigned)found.failures, (unsigned)found.vectors, (unsigned)(found.worst * 1e12));
    (void)printf("bits of 4096 samples %s, of {{ b.hashed[1] }} samples %s (0x%08x)\n", bits ? "as stated" : "differ",
                 (hash == decoupler_hash_long) ? "as stated" : "differ", (unsigned)hash);
    (void)printf("%u faults of a table not found, %u zeros wrong\n", (unsigned)faults, (unsigned)zeros);
    return ((check == 0U) && (found.failures == 0U) && bits && (hash == decoupler_hash_long) &&
            (faults == 0U) && (zeros == 0U)) ? 0 : 1;
}
