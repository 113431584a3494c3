/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
/* Faults of a table, each by itself, that decoupler_check() must find. */
#include "selftest.h"

{% if b.type == "float" %}
#include <float.h>
#include <math.h>
{% endif %}
#include <stddef.h>

#include "decoupler.h"
#include "decoupler_params.h"

#define LENGTH ((uint32_t)sizeof(decoupler_params_t))
#define COVERED ((uint32_t)offsetof(decoupler_params_t, version))
#define ZEROS_CRC ((uint32_t)offsetof(decoupler_params_t, zeros_crc))
#define ZEROS ((uint32_t)offsetof(decoupler_params_t, {{ b.offsets[0].name }}))

/* Any bit that turns: of a long table every 61st, and all of its ends. */
static uint32_t missed_bits(void)
{
    decoupler_params_t table = decoupler_params;
    uint8_t *bytes = (uint8_t *)&table;
    uint32_t missed = 0U;
    for (uint32_t n = 0U; n < (8U * LENGTH); n++)
    {
        const uint32_t k = n / 8U;
        const uint8_t bit = (uint8_t)(1U << (n % 8U));
        const uint32_t tried = ((k < 64U) || ((k + 64U) >= LENGTH) || (LENGTH < 512U) || ((n % 61U) == 0U)) ? 1U : 0U;
        if (tried != 0U)
        {
            bytes[k] ^= bit;
            missed += (decoupler_check(&table) == 0U) ? 1U : 0U;
            bytes[k] ^= bit;
        }
    }
    return missed;
}

/* 0 if a changed table whose CRC are right again is found to have these faults; the table is then as it was. */
static uint32_t unlike(decoupler_params_t *table, uint32_t faults)
{
    const uint8_t *bytes = (const uint8_t *)table;
    table->crc = decoupler_crc(&bytes[COVERED], ZEROS_CRC - COVERED);
    table->zeros_crc = decoupler_crc(&bytes[ZEROS], LENGTH - ZEROS);
    const uint32_t found = decoupler_check(table);
    *table = decoupler_params;
    return (found == faults) ? 0U : 1U;
}

/* 0 if faults that leave no CRC right are told one by one. */
static uint32_t unlike_together(void)
{
    decoupler_params_t table = decoupler_params;
    uint8_t *bytes = (uint8_t *)&table;
    table.version += 1U;
    table.layout ^= 1U;
    bytes[ZEROS] ^= 1U;
    return (decoupler_check(&table) ==
            (DECOUPLER_BAD_VERSION | DECOUPLER_BAD_LAYOUT | DECOUPLER_BAD_CRC | DECOUPLER_BAD_ZEROS)) ? 0U : 1U;
}

uint32_t decoupler_missed_faults(void)
{
    decoupler_params_t table = decoupler_params;
    uint32_t missed = missed_bits() + unlike_together();
{% for changes, found in b.faults() %}
    {{ changes }}
    missed += unlike(&table, {{ "DECOUPLER_BAD_" ~ found.split() | join(" | DECOUPLER_BAD_") if found else "0U" }});
{% endfor %}
    return missed;
}
