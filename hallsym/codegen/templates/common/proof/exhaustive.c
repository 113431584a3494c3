{% set float = b.type == "float" %}
/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
/* Every bit pattern of every input through the range test: the result lies in the range, is the input itself
   where that does, and the status bit says which.{{ "\n   Every divisor in its range through its reciprocal, which is as near to 1 / divisor as stated." if reciprocals }} */
{% if not float %}
#define DECOUPLER_PROOF /* no arithmetic that wraps; compiled to stop where an integer overflows */

{% endif %}
#include <stdio.h>
#include <string.h>

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
{% for by in inputs | map(attribute="by") | select | unique | sort(reverse=true) %}
static unsigned long all_{{ by }}({{ "%s low, " % real if by == "limited" }}{{ real }} high)
{
{% if by == "within" %}
    const float low = -high;
{% endif %}
    unsigned long bad = 0UL;
    uint32_t bits = 0U;
    do
    {
        {{ real }} value;
        uint32_t status = 0U;
        (void)memcpy(&value, &bits, sizeof(value));
        const {{ real }} held = {{ by }}(value, {{ "low, " if by == "limited" }}high, 1U, &status);
{% include "common/fragments/tried.c" %}

{% endfor %}
int main(void)
{
    unsigned long bad = 0UL;
{% for i in inputs if i.by %}
    bad += all_{{ i.by }}({{ i.least ~ ", " if i.by == "limited" }}{{ i.greatest }});
{% endfor %}
{% for r in reciprocals %}
    for (int32_t b = {{ r.low }}; b <= {{ r.high }}; b++) { bad += wrong_{{ r.b }}(b); }
{% endfor %}
    (void)printf("exhaustive: %lu of {{ inputs | length }} x 2^32 bit patterns{{ " and all divisors" if reciprocals }} fail\n", bad);
    return (bad == 0UL) ? 0 : 1;
}
