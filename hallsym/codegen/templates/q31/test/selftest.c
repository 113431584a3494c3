/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
#include "selftest.h"

#include "decoupler.h"
#include "decoupler_params.h"

typedef struct
{
    decoupler_in_t in;
    double pose[{{ d.pose | length }}];
    uint32_t status;
} vector_t;

#include "selftest_vectors.h"

static uint32_t mix(uint32_t x)
{
    x ^= x >> 16U;
    x *= 0x7FEB352DUL;
    x ^= x >> 15U;
    x *= 0x846CA68BUL;
    return x ^ (x >> 16U);
}

/* Any integers, three quarters of them shifted towards the box. */
static int32_t input(uint32_t n, uint32_t k)
{
    const int32_t raw = (int32_t)mix((n * {{ inputs | length }}U) + k);
    return raw >> (mix(n) & 3U);
}

static void sample(uint32_t n, decoupler_in_t *in)
{
{% for i in inputs %}
    in->{{ i.member }} = {{ i.cast }}input(n, {{ i.number }}U);
{% endfor %}
}

uint32_t decoupler_hash(uint32_t count)
{
    uint32_t total = 0U;
    for (uint32_t n = 0U; n < count; n++)
    {
        decoupler_in_t in;
        decoupler_out_t out;
        sample(n, &in);
        total += mix(decoupler_step(&decoupler_params, &in, &out) ^ mix(n * {{ b.width }}U));
{% for o in outputs %}
        total += mix((uint32_t)out.{{ o.member }} ^ mix((n * {{ b.width }}U) + {{ o.number }}U));
{% endfor %}
{% if d.suspects %}
        total += mix(out.suspect ^ mix((n * {{ b.width }}U) + {{ b.width - 1 }}U));
{% endif %}
    }
    return total;
}

static uint32_t differs(double value, double wanted, double bound, double *worst)
{
    const double error = (value > wanted) ? (value - wanted) : (wanted - value);
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
        uint32_t failed = (decoupler_step(&decoupler_params, &wanted->in, &out) == wanted->status) ? 0U : 1U;
{% for o in outputs %}
        failed |= differs((double)out.{{ o.member }} * {{ o.scale }}, wanted->pose[{{ o.index }}], decoupler_bounds[{{ o.index }}], &result.worst);
{% endfor %}
{% if d.flags %}
        failed |= (decoupler_step(&strict, &wanted->in, &out) == ({{ "(wanted->status & ~DECOUPLER_STATUS_DEGRADED)" if d.mends else "wanted->status" }} | {{ d.flags | map(attribute="name") | map("status_bit") | join(" | ") }})) ? 0U : 1U;
{% endif %}
        result.vectors++;
        result.failures += failed;
    }
    return result;
}

uint32_t decoupler_missed_zeros(void)
{
    static const decoupler_out_t known[{{ known | length }}] = {
{% for row in known %}
        {{ (row + ["0U"] if d.suspects else row) | join(", ") | braced }},
{% endfor %}
    };
    uint32_t bad = 0U;
    for (uint32_t k = 0U; k < DECOUPLER_VECTORS; k++)
    {
        const decoupler_in_t *in = &decoupler_vectors[k].in;
        decoupler_params_t table = decoupler_params;
        decoupler_out_t out;
        for (uint32_t n = 0U; n < {{ known | length }}U; n++)
        {
            const uint32_t status = decoupler_zero(&table, in, &known[n]);
            (void)decoupler_step(&table, in, &out);
            bad += (status == decoupler_vectors[k].status) ? 0U : 1U;
            bad += (decoupler_check(&table) == 0U) ? 0U : 1U;
            if (status == 0U)
            {
{% for o in outputs %}
                bad += (out.{{ o.member }} == known[n].{{ o.member }}) ? 0U : 1U;
{% endfor %}
            }
            else
            {
{% for o in outputs %}
                bad += (table.{{ o.zero }} == decoupler_params.{{ o.zero }}) ? 0U : 1U;
{% endfor %}
            }
        }
{% if far %}
        decoupler_out_t pose = {0};
{% endif %}
{% for member, values in far.items() %}
{% for value in values %}
        pose.{{ member }} = {{ value }};
{% if not loop.last %}
        bad += (decoupler_zero(&table, in, &pose) == DECOUPLER_STATUS_KNOWN) ? 0U : 1U;
{% endif %}
{% endfor %}
{% endfor %}
    }
    return bad;
}
