/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
/* Frama-C EVA: every input in the box, each reciprocal within its range (exhaustive.c). No alarm means
   no overflow. */
#define DECOUPLER_PROOF /* no arithmetic that wraps */

#include "__fc_builtin.h"

#include "decoupler.h"
#include "decoupler_params.h"

{% include "q31/fragments/helpers.c" %}
int main(void)
{
{% for i in inputs %}
    const int32_t {{ i.name }} = {{ i.interval }};
{% endfor %}
    {{ eva_lines }}
    return 0;
}
