{% set float = b.type == "float" %}
/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
{% if float %}
/* Frama-C EVA: every table that decoupler_check() accepts, with every input within its limits; then this table, and
   every input in the box. No alarm means no run-time error, no NaN, no infinity. */
{% else %}
/* Frama-C EVA: every input in the box. No alarm means no overflow and no entry beyond the table. */
#define DECOUPLER_PROOF /* no arithmetic that wraps */

{% endif %}
#include "__fc_builtin.h"

#include "{{ "decoupler.h" if float else "../decoupler.c" }}"
#include "decoupler_params.h"

{% if float %}
static void every_table(void)
{
    decoupler_params_t table = decoupler_params;
    decoupler_in_t in;
    decoupler_out_t out;
{% for e in b.entries %}
{% set kind = "" if e.values.dtype.kind == "i" else "float_" %}
{% if e.values.ndim %}
    for (uint32_t k = 0U; k < {{ e.values | length }}U; k++)
    {
        table.{{ e.name }}[k] = Frama_C_{{ kind }}interval({{ b.ends_in_c(e) | join(", ") }});
    }
{% else %}
    table.{{ e.name }} = Frama_C_{{ kind }}interval({{ b.ends_in_c(e) | join(", ") }});
{% endif %}
{% endfor %}
{% for i in inputs %}
    in.{{ i.member }} = Frama_C_float_interval(-{{ i.far }}, {{ i.far }});
{% endfor %}
    (void)decoupler_step(&table, &in, &out);
}

{% endif %}
int main(void)
{
    decoupler_in_t in;
    decoupler_out_t out;
{% if float %}
    every_table();
{% endif %}
{% for i in inputs %}
    in.{{ i.member }} = {{ "Frama_C_float_interval(%s, %s)" % (i.least, i.greatest) if float else i.interval }};
{% endfor %}
    const uint32_t status = decoupler_step(&decoupler_params, &in, &out);
    //@ assert status_zero: {{ status_or_flags }};
{% for o in outputs if float %}
    //@ assert {{ o.name }}_bounded: {{ o.outer_low }} <= out.{{ o.member }} <= {{ o.outer_high }};
{% endfor %}
{% if slopes %}
    decoupler_jacobian_t slopes;
    const uint32_t slope_status = decoupler_jacobian(&decoupler_params, &in, &slopes);
    //@ assert slope_status_zero: slope_status == 0;
{% endif %}
    return (int)status;
}
