{% set float = b.type == "float" %}
/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
#include "selftest.h"

{% if d.flags and float %}
#include <float.h>
{% endif %}
#include <string.h>

#include "decoupler.h"
#include "decoupler_params.h"

typedef struct
{
    decoupler_in_t in;
    double pose[{{ d.pose | length }}];
{% if slopes %}
    double slopes[{{ slopes | length }}];
{% endif %}
    uint32_t status;
} vector_t;

#include "selftest_vectors.h"

{% if float %}
{% include "float/fragments/ieee.c" %}

{% endif %}
static uint32_t mix(uint32_t x)
{
    x ^= x >> 16U;
    x *= 0x7FEB352DUL;
    x ^= x >> 15U;
    x *= 0x846CA68BUL;
    return x ^ (x >> 16U);
}

{% if float %}
static uint32_t word(float value)
{
    uint32_t bits = 0U;
    (void)memcpy(&bits, &value, sizeof(bits));
    return bits;
}

/* Most samples lie in the box; every 16th has any bits at all, every 16th is four times too large. */
static float input(uint32_t n, uint32_t k, float low, float high)
{
    const uint32_t raw = mix((n * {{ inputs | length }}U) + k);
    const uint32_t kind = mix(n ^ 0x9E3779B9UL) & 15U;
    const float share = (float)(raw >> 8U) * 5.96046448e-08f;
    const float part = (high - low) * share;
    float value = low + part;
    if (kind == 0U)
    {
        (void)memcpy(&value, &raw, sizeof(value));
    }
    else if (kind == 1U)
    {
        value *= 4.0f;
    }
    else
    {
        /* in the box */
    }
    return value;
}

{% else %}
/* Any integers, three quarters of them shifted towards the box. */
static int32_t input(uint32_t n, uint32_t k)
{
    const int32_t raw = (int32_t)mix((n * {{ inputs | length }}U) + k);
    return raw >> (mix(n) & 3U);
}

{% endif %}
static void sample(uint32_t n, decoupler_in_t *in)
{
{% for i in inputs %}
    in->{{ i.member }} = {{ i.cast }}input(n, {{ i.number }}U{{ ", %s, %s" % (i.least, i.greatest) if float }});
{% endfor %}
}

{% if float %}
/* Half of the samples have no zeros, a quarter each those of a reset at one end and at the other. */
static void take(uint32_t n, decoupler_params_t *table)
{
    const uint32_t kind = mix(n ^ 0x85EBCA6BUL) & 3U;
{% for o in outputs %}
    table->{{ o.zero }} = (kind == 2U) ? {{ o.hashed }} : ((kind == 3U) ? -{{ o.hashed }} : 0.0f);
{% endfor %}
}

{% endif %}
uint32_t decoupler_hash(uint32_t count)
{
    decoupler_params_t table = decoupler_params;
    uint32_t total = 0U;
    for (uint32_t n = 0U; n < count; n++)
    {
        decoupler_in_t in;
        decoupler_out_t out;
        sample(n, &in);
{% if float %}
        take(n, &table);
{% endif %}
        total += mix(decoupler_step(&table, &in, &out) ^ mix(n * {{ b.width }}U));
{% for o in outputs %}
        total += mix({{ "word" if float else "(uint32_t)" }}(out.{{ o.member }}) ^ mix((n * {{ b.width }}U) + {{ o.number }}U));
{% endfor %}
{% if d.suspects %}
        total += mix(out.suspect ^ mix((n * {{ b.width }}U) + {{ b.width - 1 }}U));
{% endif %}
    }
    return total;
}

static uint32_t differs({{ b.type if float else "double" }} value, double wanted, double bound, double *worst)
{
    const double error = ((double)value > wanted) ? ((double)value - wanted) : (wanted - (double)value);
    if (error > *worst)
    {
        *worst = error;
    }
    return (error <= bound) ? 0U : 1U;
}

decoupler_selftest_t decoupler_selftest(void)
{
    decoupler_selftest_t result = {0U, 0U, 0.0};
{% include "common/fragments/strict.c" %}
    for (uint32_t k = 0U; k < DECOUPLER_VECTORS; k++)
    {
        const vector_t *wanted = &decoupler_vectors[k];
        decoupler_out_t out;
{% if slopes %}
        double slope_worst = 0.0;
        decoupler_jacobian_t slopes;
        const uint32_t status = decoupler_jacobian(&decoupler_params, &wanted->in, &slopes);
{% endif %}
        uint32_t failed = (decoupler_step(&decoupler_params, &wanted->in, &out) == wanted->status) ? 0U : 1U;
{% for o in outputs %}
        failed |= differs({{ "out.%s" % o.member if float else "(double)out.%s * %s" % (o.member, o.scale) }}, wanted->pose[{{ o.index }}], decoupler_bounds[{{ o.index }}], &result.worst);
{% endfor %}
{% if d.flags %}
        failed |= (decoupler_step(&strict, &wanted->in, &out) == ({{ "(wanted->status & ~DECOUPLER_STATUS_DEGRADED)" if d.mends else "wanted->status" }} | {{ d.flags | map(attribute="name") | map("status_bit") | join(" | ") }})) ? 0U : 1U;
{% endif %}
{% if slopes %}
        failed |= (status == {{ "(wanted->status & " ~ (d.input_bits | unique | sum | mask) ~ ")" if d.flags else "wanted->status" }}) ? 0U : 1U;
{% endif %}
{% for s in slopes %}
        failed |= differs(slopes.{{ s.name }}, wanted->slopes[{{ s.index }}], decoupler_slope_bounds[{{ s.index }}], &slope_worst);
{% endfor %}
        result.vectors++;
        result.failures += failed;
    }
    return result;
}

{% if float %}
/* 0 if a value is the wanted one, or one period from it. */
static uint32_t away(float value, float wanted, float period)
{
    const float error = (value > wanted) ? (value - wanted) : (wanted - value);
    const float other = (error > period) ? (error - period) : (period - error);
    return ((error < {{ near }}) || (other < {{ near }})) ? 0U : 1U;
}

{% endif %}
/* 0 if a zero is taken at each pose of a few, after another one, and the pose is the known one then. */
static uint32_t not_taken(const decoupler_in_t *in, {{ real }} before)
{
    static const decoupler_out_t known[{{ known | length }}] = {
{% for row in known %}
        {{ (row + ["0U"] if d.suspects else row) | join(", ") | braced }},
{% endfor %}
    };
    decoupler_params_t table = decoupler_params;
    uint32_t bad = 0U;
{% for o in outputs %}
    table.{{ o.zero }} = {{ o.cast }}before * {{ o.hashed }};
{% endfor %}
    for (uint32_t k = 0U; k < {{ known | length }}U; k++)
    {
        decoupler_out_t out;
        bad |= (decoupler_zero(&table, in, &known[k]) == 0U) ? 0U : 1U;
        bad |= (decoupler_step(&table, in, &out) == 0U) ? 0U : 1U;
        bad |= (decoupler_check(&table) == 0U) ? 0U : 1U;
{% for o in outputs %}
        bad |= {{ "away(out.%s, known[k].%s, %s)" % (o.member, o.member, o.period) if float else "(out.%s == known[k].%s) ? 0U : 1U" % (o.member, o.member) }};
{% endfor %}
    }
    return bad;
}

/* 0 if a zero is refused with this status, and the table stays as it is. */
static uint32_t not_refused(const decoupler_in_t *in, const decoupler_out_t *pose, uint32_t status)
{
    decoupler_params_t table = decoupler_params;
{% for o in outputs %}
    table.{{ o.zero }} = {{ some_zero }};
{% endfor %}
    const decoupler_params_t before = table;
    uint32_t bad = (decoupler_zero(&table, in, pose) == status) ? 0U : 1U;
    bad |= (memcmp(&table, &before, sizeof(table)) == 0) ? 0U : 1U;
    return bad;
}

uint32_t decoupler_missed_zeros(void)
{
    uint32_t bad = 0U;
    for (uint32_t k = 0U; k < DECOUPLER_VECTORS; k++)
    {
        const decoupler_in_t *in = &decoupler_vectors[k].in;
        decoupler_out_t pose = {0};
        if (decoupler_vectors[k].status == 0U)
        {
            bad += not_taken(in, {{ one }}) + not_taken(in, -{{ one }});
{% for member, values in far.items() %}
{% for value in values %}
            pose.{{ member }} = {{ value }};
{% if not loop.last %}
            bad += not_refused(in, &pose, DECOUPLER_STATUS_KNOWN);
{% endif %}
{% endfor %}
{% endfor %}
        }
        else
        {
            bad += not_refused(in, &pose, decoupler_vectors[k].status);
        }
    }
    return bad;
}
