/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
/* Every angle through decoupler_step(), compiled to stop where an integer overflows: the angle moves by no
   more than the largest entry of the table. */
#define DECOUPLER_PROOF /* no arithmetic that wraps */

#include <stdio.h>

#include "../decoupler.c"
#include "decoupler_params.h"

int main(void)
{
    const int64_t most = {{ turned }};
    unsigned long bad = 0UL;
    decoupler_in_t in;
    decoupler_out_t out;
    in.{{ inputs[0].member }} = 0U;
    do
    {
        const uint32_t status = decoupler_step(&decoupler_params, &in, &out);
        const uint32_t moved = out.{{ outputs[0].member }} - in.{{ inputs[0].member }} - {{ "decoupler_params.shift" if "shift" in b.program.unsigned else "0U" }};
        const int64_t by = (moved < 0x80000000U) ? (int64_t)moved : ((int64_t)moved - 4294967296);
        bad += ((status == 0U) && (by <= most) && (by >= -most)) ? 0UL : 1UL;
        in.{{ inputs[0].member }}++;
    } while (in.{{ inputs[0].member }} != 0U);
    (void)printf("exhaustive: %lu of 2^32 angles fail\n", bad);
    return (bad == 0UL) ? 0 : 1;
}
