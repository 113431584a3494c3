/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
#include "decoupler.h"

{% include "float/fragments/ieee.c" %}

#if defined(__GNUC__)
#define UNLIKELY(condition) (__builtin_expect((condition) ? 1 : 0, 0) != 0)
#define INLINE static inline __attribute__((always_inline))
#else
#define UNLIKELY(condition) (condition)
#define INLINE static inline
#endif
{% if d.suspects or "MAGNITUDE(" in body | join %}
#if defined(__GNUC__) && !defined(__FRAMAC__)
#define MAGNITUDE(value) __builtin_fabsf(value) /* one instruction, and no libm */
#else
#define MAGNITUDE(value) magnitude(value)
static inline float magnitude(float value) /* -0 gives 0, as the instruction does */
{
    return (value > 0.0f) ? value : (0.0f - value);
}
#endif
{% endif %}

{% if by_size == "all" %}
#if defined(__FRAMAC__)
{% endif %}
{% include "common/fragments/limited.c" %}
{% if by_size == "all" %}
#endif
{% endif %}

{% if by_size %}
#if !defined(__FRAMAC__)
typedef union
{
    float value;
    uint32_t bits;
} number_t;

/* Numbers of one sign are in the order of their bits, and NaN is above them all; the limit is not negative. */
INLINE float within(float value, float limit, uint32_t bit, uint32_t *status)
{
    number_t result;
    number_t most;
    result.value = value;
    most.value = limit;
    if ((result.bits & 0x7FFFFFFFUL) > most.bits)
    {
        result.bits = most.bits | (result.bits & 0x80000000UL);
        *status {{ "|=" if d.shared else "+=" }} bit; /* {{ "inputs share bits" if d.shared else "each bit once" }} */
    }
    return result.value;
}
#else /* the same for a tool that does not follow bits; proof/exhaustive.c tries the other */
INLINE float within(float value, float limit, uint32_t bit, uint32_t *status)
{
    return limited(value, -limit, limit, bit, status);
}
#endif

{% endif %}
{% include "common/fragments/signature.c" %}
{
    uint32_t status = 0U;
    {{ clamped }}
    {{ body }}
{% for name in left if d.suspects %}
    left[{{ loop.index0 }}] = {{ name }};
{% endfor %}
{% for f in d.flags %}
    if (!({{ f.step }} >= p->{{ f.least }}))
    {
        status |= {{ f.name | status_bit }};
    }
{% endfor %}
    return status;
}

{% include "common/fragments/suspect.c" %}
{% if slopes %}
uint32_t decoupler_jacobian(const decoupler_params_t *p, const decoupler_in_t *in,
                            decoupler_jacobian_t *slopes)
{
    uint32_t status = 0U;
    {{ slope_body }}
    return status;
}

{% endif %}
uint32_t decoupler_zero(decoupler_params_t *p, const decoupler_in_t *in, const decoupler_out_t *pose)
{
    uint32_t status = DECOUPLER_STATUS_KNOWN;
    if ({{ known_within }})
    {
{% if d.at_pose %}
        float zeros[{{ d.pose | length }}];
        status = 0U;
        {{ all_clamped }}
{% if d.redundancy %}
        decoupler_out_t seen;
        status |= decoupler_step(p, in, &seen);
{% endif %}
{% for o in outputs %}
        const {{ o.type }} {{ o.name }} = pose->{{ o.member }};
{% endfor %}
        {{ at_pose }}
{% for o in outputs %}
        zeros[{{ o.index }}] = pose->{{ o.member }} - {{ o.name }}_seen;
{% endfor %}
{% else %}
        float zeros[{{ d.pose | length }}];
        decoupler_out_t seen;
        status = decoupler_step(p, in, &seen);
{% for o in outputs %}
        zeros[{{ o.index }}] = p->{{ o.zero }} + (pose->{{ o.member }} - seen.{{ o.member }});
{% endfor %}
{% for o in outputs if o.column in d.model.period %}
        const float turns_{{ o.index }} = zeros[{{ o.index }}] / {{ o.period }}; /* at most two: a zero, and what the pose moves by */
        zeros[{{ o.index }}] -= {{ o.period }} * (float)(int32_t)turns_{{ o.index }};
{% endfor %}
{% endif %}
        if (status == 0U)
        {
            const uint32_t crc = decoupler_crc((const uint8_t *)zeros, (uint32_t)sizeof(zeros));
{% for o in outputs %}
            p->{{ o.zero }} = zeros[{{ o.index }}];
{% endfor %}
            p->zeros_crc = crc;
        }
    }
    return status;
}
{% if d.observed %}
{% include "float/fragments/predict.c" %}
{% endif %}
