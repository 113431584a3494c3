/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
/* Every bit pattern of every input through the range test: the result lies in the range, is the input itself
   where that does, and the status bit says which. */
#include <stdio.h>
#include <string.h>

#include "../decoupler.c"
#include "decoupler_params.h"

{% for by in inputs | map(attribute="by") | unique | sort(reverse=true) %}
static unsigned long all_{{ by }}({{ real ~ " low, " if by == "limited" }}{{ real }} high)
{
{% if by == "within" %}
    const {{ real }} low = -high;
{% endif %}
    unsigned long bad = 0UL;
    uint32_t bits = 0U;
    do
    {
        {{ real }} value;
        uint32_t status = 0U;
        (void)memcpy(&value, &bits, sizeof(value));
        const {{ real }} held = {{ by }}(value, {{ "low, " if by == "limited" }}high, 1U, &status);
        const uint32_t inside = ((value >= low) && (value <= high)) ? 1U : 0U;
        const uint32_t good = ((held >= low) && (held <= high)) ? 1U : 0U;
        const uint32_t same = ((inside == 0U) || (held == value)) ? 1U : 0U;
        bad += ((good & same & (status ^ inside)) == 1U) ? 0UL : 1UL;
        bits++;
    } while (bits != 0U);
    return bad;
}

{% endfor %}
int main(void)
{
    unsigned long bad = 0UL;
{% for i in inputs %}
    bad += all_{{ i.by }}({{ i.least ~ ", " if i.by == "limited" }}{{ i.greatest }});
{% endfor %}
    (void)printf("exhaustive: %lu of {{ inputs | length }} x 2^32 bit patterns fail\n", bad);
    return (bad == 0UL) ? 0 : 1;
}
