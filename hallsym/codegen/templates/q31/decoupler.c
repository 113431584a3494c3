/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
#include "decoupler.h"

{% include "q31/fragments/helpers.c" %}
{% if b.limited %}
{% include "common/fragments/limited.c" %}

{% endif %}
{% include "common/fragments/signature.c" %}
{
{% if b.limited or d.flags %}
    uint32_t status = 0U;
{% endif %}
    {{ clamped }}
    {{ body }}
{% for o in outputs %}
    out->{{ o.member }} = {{ o.line }};
{% endfor %}
{% for name in left if d.suspects %}
    left[{{ loop.index0 }}] = {{ name }};
{% endfor %}
{% for flag, (seen, least) in b.program.flags.items() %}
    if ({{ seen }} < p->{{ least }})
    {
        status |= {{ flag | status_bit }};
    }
{% endfor %}
    return {{ "status" if b.limited or d.flags else "0U" }};
}

{% include "common/fragments/suspect.c" %}
uint32_t decoupler_zero(decoupler_params_t *p, const decoupler_in_t *in, const decoupler_out_t *pose)
{
{% if b.program.angles %}
    decoupler_out_t seen;
    const uint32_t status = decoupler_step(p, in, &seen);
    const uint32_t zeros[{{ d.pose | length }}] = {
{% for o in outputs %}
        p->{{ o.zero }} + (pose->{{ o.member }} - seen.{{ o.member }}),
{% endfor %}
    };
{% else %}
    uint32_t status = DECOUPLER_STATUS_KNOWN;
    int32_t zeros[{{ d.pose | length }}];
{% for o in outputs %}
    zeros[{{ o.index }}] = p->{{ o.zero }};
{% endfor %}
    if ({{ known_within }})
    {
        decoupler_out_t seen;
        status = decoupler_step(p, in, &seen);
{% for o in outputs %}
        zeros[{{ o.index }}] = sum(zeros[{{ o.index }}], difference(pose->{{ o.member }}, seen.{{ o.member }}));
{% endfor %}
    }
{% endif %}
    if (status == 0U)
    {
        const uint32_t crc = decoupler_crc((const uint8_t *)zeros, (uint32_t)sizeof(zeros));
{% for o in outputs %}
        p->{{ o.zero }} = zeros[{{ o.index }}];
{% endfor %}
        p->zeros_crc = crc;
    }
    return status;
}
