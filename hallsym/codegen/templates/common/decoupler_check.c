/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
#include "decoupler.h"

#include <stddef.h>

{% include b.type ~ "/fragments/ieee.c" ignore missing %}

{% include "common/fragments/crc.c" %}
{% if ends %}

#define NUMBERS ((uint32_t)offsetof(decoupler_params_t, {{ ends.first }}))
#define ZEROS_LESS (ZEROS - {{ ends.limits_to }}U) /* so that the zeros are counted on from the limits */

typedef struct
{
    {{ ends.number }} least;
    {{ ends.number }} greatest;
} ends_t;

static {{ ends.number }} number(const uint8_t *bytes)
{
    union
    {
        {{ ends.number }} value;
        uint8_t bytes[4];
    } found;
    for (uint32_t k = 0U; k < 4U; k++)
    {
        found.bytes[k] = bytes[k];
    }
    return found.value;
}

{% endif %}
uint32_t decoupler_check(const decoupler_params_t *p)
{
{% if ends %}
    /* {{ b.why_ends }} */
    static const ends_t ends[{{ ends.listed | length }}] = {
        {{ ends.listed }}
    };
{% endif %}
    const uint8_t *bytes = (const uint8_t *)p;
    uint32_t found = 0U;
    if (p->version != DECOUPLER_VERSION)
    {
        found |= DECOUPLER_BAD_VERSION;
    }
    if ((p->layout != DECOUPLER_LAYOUT) || (p->length != LENGTH))
    {
        found |= DECOUPLER_BAD_LAYOUT;
    }
    if (decoupler_crc(&bytes[COVERED], ZEROS_CRC - COVERED) != p->crc)
    {
        found |= DECOUPLER_BAD_CRC;
    }
    if (decoupler_crc(&bytes[ZEROS], LENGTH - ZEROS) != p->zeros_crc)
    {
        found |= DECOUPLER_BAD_ZEROS;
    }
{% if ends %}
    for (uint32_t k = 0U; k < {{ ends.listed | length }}U; k++)
    {
        const {{ ends.number }} value = number(&bytes[(k * 4U) + {{ ends.place }}]);
        if (!((value >= ends[k].least) && (value <= ends[k].greatest)))
        {
            found |= {{ ends.kind }};
        }
    }
{% endif %}
{% for e in b.rows %}
    for (uint32_t k = 0U; k < {{ e.values | length }}U; k++)
    {
        found |= ((p->{{ e.name }}[k] >= {{ b.ends_in_c(e)[0] }}) && (p->{{ e.name }}[k] <= {{ b.ends_in_c(e)[1] }})) ? 0U : DECOUPLER_BAD_NUMBER;
    }
{% endfor %}
{% set filled = inputs | selectattr("by") | rejectattr("symmetric") | map(attribute="filled") | join(" && ") %}
{% if filled %}
    if (!({{ filled }}))
    {
        found |= DECOUPLER_BAD_LIMITS;
    }
{% endif %}
    return found;
}
