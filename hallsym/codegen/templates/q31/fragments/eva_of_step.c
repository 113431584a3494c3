/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
/* Frama-C EVA: every input in the box. No alarm means no overflow and no entry beyond the table. */
#define DECOUPLER_PROOF /* no arithmetic that wraps */

#include "__fc_builtin.h"

#include "../decoupler.c"
#include "decoupler_params.h"

int main(void)
{
    decoupler_in_t in;
    decoupler_out_t out;
{% for i in inputs %}
    in.{{ i.member }} = {{ i.interval }};
{% endfor %}
    const uint32_t status = decoupler_step(&decoupler_params, &in, &out);
    //@ assert status_zero: {{ status_or_flags }};
    return (int)(status & 1U);
}
