/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
/* Every bit pattern of every input through the range test; every divisor in its range through its
   reciprocal, which is as near to 1 / divisor as stated. Compiled to stop where an integer overflows. */
#define DECOUPLER_PROOF /* no arithmetic that wraps */

#include <stdio.h>

#include "../decoupler.c"
#include "decoupler_params.h"

{% for r in reciprocals %}
static unsigned long wrong_{{ r.b }}(int32_t {{ r.b }})
{
    {{ r.lines }}
    const double share = ((double){{ r.b }} * {{ r.b_unit }}) * ((double){{ r.r }} * {{ r.r_unit }});
    const double off = ((share > 1.0) ? (share - 1.0) : (1.0 - share)) / ((double){{ r.b }} * {{ r.b_unit }});
    const double size = (off < 0.0) ? -off : off;
    return ((size <= {{ r.error }}) && ({{ r.r }} >= {{ r.least }}) && ({{ r.r }} <= {{ r.most }})) ? 0UL : 1UL;
}

{% endfor %}
static unsigned long all_limited(int32_t low, int32_t high)
{
    unsigned long bad = 0UL;
    uint32_t bits = 0U;
    do
    {
        const int32_t value = (int32_t)bits;
        uint32_t status = 0U;
        const int32_t held = limited(value, low, high, 1U, &status);
{% include "common/fragments/tried.c" %}

int main(void)
{
    unsigned long bad = 0UL;
    unsigned long divisors = 0UL;
{% for i in inputs if i.by %}
    bad += all_limited({{ i.least }}, {{ i.greatest }});
{% endfor %}
{% for r in reciprocals %}
    for (int32_t b = {{ r.low }}; b <= {{ r.high }}; b++) { bad += wrong_{{ r.b }}(b); divisors++; }
{% endfor %}
    (void)printf("exhaustive: %lu of {{ inputs | length }} x 2^32 bit patterns and %lu divisors fail\n", bad, divisors);
    return (bad == 0UL) ? 0 : 1;
}
