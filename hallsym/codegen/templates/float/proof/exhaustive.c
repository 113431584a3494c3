/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
/* Every bit pattern of every input through the range test: the result lies in the range, is the input itself
   where that does, and the status bit says which. */
#include <stdio.h>
#include <string.h>

#include "../decoupler.c"
#include "decoupler_params.h"

{% for by in inputs | map(attribute="by") | unique | sort(reverse=true) %}
static unsigned long all_{{ by }}({{ "float low, " if by == "limited" }}float high)
{
{% if by == "within" %}
    const float low = -high;
{% endif %}
    unsigned long bad = 0UL;
    uint32_t bits = 0U;
    do
    {
        float value;
        uint32_t status = 0U;
        (void)memcpy(&value, &bits, sizeof(value));
        const float held = {{ by }}(value, {{ "low, " if by == "limited" }}high, 1U, &status);
{% include "common/fragments/tried.c" %}

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
