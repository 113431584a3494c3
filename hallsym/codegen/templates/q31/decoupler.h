/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
/**
 * @file decoupler.h
 * @brief From readings to {{ d.quantity }} in 32-bit integers: model {{ d.model.name | commented }}.
 *
 * Every quantity is an integer times a power of two of its SI unit (m, rad); the exponents are below. No heap, no
 * 64-bit arithmetic and no division per sample{{ " but of a sample that is decoded without a reading" if d.mends }}, no static data; reentrant.
{% if b.program.angles %}
 *
 * A binary angle counts 2^-32 of a turn, unsigned: it wraps by itself, and every bit pattern is an angle. Counts of
 * an encoder with 2^b per turn are shifted left by 32 - b.
{% endif %}
{% for text in b.said %}
{% for line in text | wrapped %}
 * {{ line }}
{% endfor %}
{% endfor %}
 */
#ifndef DECOUPLER_H
#define DECOUPLER_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define DECOUPLER_VERSION {{ version }}UL /**< of interface and table */
#define DECOUPLER_LAYOUT {{ b.layout | mask }} /**< of the table this code reads */

/** @name Status of decoupler_step(): 0, or the inputs that were brought back into their range */
/** @{ */
{% for i in inputs if i.by %}
#define {{ i.bit }} {{ i.mask }} /**< {{ i.column }} outside its range */
{% endfor %}
{% for f in d.flags %}
#define {{ f.name | status_bit }} {{ flag_bit(loop.index0) | mask }} /**< {{ f.meaning }} */
{% endfor %}
{% if not (b.limited or d.flags) %}

{% endif %}
{% if d.mends %}
#define DECOUPLER_STATUS_DEGRADED {{ d.degraded_bit | mask }} /**< one reading contradicts the others: the {{ d.quantity }} is decoded without it */
{% endif %}
{% if not b.program.angles %}
#define DECOUPLER_STATUS_KNOWN 0x80000000UL /**< decoupler_zero(): known pose beyond 2^29 */
{% endif %}
/** @} */

/**
 * @name Units of inputs and outputs, and conversions
 *
 * FROM_SI(si): SI to integer, to the nearest (halves away from zero) in the type of its argument, float or double;
 * NaN becomes the largest. TO_SI(value): integer to SI, a double. FROM_COUNTS(counts, per_count): counts of a
 * converter from the zero of its channel, times the constant [SI] that one of them is worth, in 64-bit integers.
 * What does not fit saturates. All are constant expressions of constants, and evaluate an argument more than once.
 */
/** @{ */
{% if scaled %}
/** Largest magnitude of FROM_SI and FROM_COUNTS, which saturate there: beyond every range, so a status bit is set. */
#define DECOUPLER_MOST {{ largest }}
/** @cond */
#define DECOUPLER_NEAREST_(type, x) \
    (((x) < (type)DECOUPLER_MOST) \
         ? (((x) > -(type)DECOUPLER_MOST) ? ((int32_t)(x) + (int32_t)(((x) - (type)(int32_t)(x)) * (type)2)) \
                                          : (int32_t)-DECOUPLER_MOST) \
         : (int32_t)DECOUPLER_MOST)
#define DECOUPLER_SCALED_(si, scale) \
    ((sizeof(si) > sizeof(float)) ? DECOUPLER_NEAREST_(double, ((double)(si) * (scale))) \
                                  : DECOUPLER_NEAREST_(float, ((float)(si) * (float)(scale))))
#define DECOUPLER_FACTOR_(x) \
    (((x) < 9e18) ? (((x) > -9e18) ? (int64_t)((x) + (((x) < 0.0) ? -0.5 : 0.5)) : -9000000000000000000) \
                  : 9000000000000000000)
#define DECOUPLER_SIZE_(wide) (((wide) < 0) ? -(wide) : (wide))
#define DECOUPLER_BEYOND_(counts, factor) \
    (DECOUPLER_SIZE_((int64_t)(counts)) > (((int64_t)DECOUPLER_MOST * 16777216) / (DECOUPLER_SIZE_(factor) + 1)))
#define DECOUPLER_TIMES_(counts, factor) \
    (DECOUPLER_BEYOND_(counts, factor) \
         ? ((((counts) < 0) == ((factor) < 0)) ? (int32_t)DECOUPLER_MOST : (int32_t)-DECOUPLER_MOST) \
         : (int32_t)((((int64_t)(counts) * (factor)) + \
                      ((((counts) < 0) == ((factor) < 0)) ? 8388608 : -8388608)) / 16777216))
#define DECOUPLER_COUNTED_(counts, per_count, scale) \
    DECOUPLER_TIMES_(counts, DECOUPLER_FACTOR_(((double)(per_count) * ((scale) * 16777216.0))))
/** @endcond */
{% endif %}
{% for s in scaled %}
#define {{ s.macro }}_EXPONENT {{ s.exponent }} /**< {{ s.column }} = value {{ s.unit }} */
{% endfor %}
{% for s in scaled %}
#define {{ s.macro }}_FROM_SI(si) DECOUPLER_SCALED_(si, {{ s.power }})
{% endfor %}
{% for s in scaled %}
#define {{ s.macro }}_TO_SI(value) ((double)(value) * {{ s.step }})
{% endfor %}
{% for s in scaled if s.input %}
#define {{ s.macro }}_FROM_COUNTS(counts, per_count) DECOUPLER_COUNTED_(counts, per_count, {{ s.power }})
{% endfor %}
{% if b.program.angles %}
#define DECOUPLER_RAD_PER_BAM {{ b.bam[0] }} /**< binary angles: {{ b.bam[1] }} */
/** [rad] to a binary angle, to the nearest, wrapped; 0 of NaN and beyond 1e9 rad. */
#define DECOUPLER_BAM_FROM_SI(si) \
    ((((double)(si) > -1e9) && ((double)(si) < 1e9)) \
         ? (uint32_t)(int64_t)(((double)(si) * {{ 1 / b.bam[0] }}) + (((si) < 0) ? -0.5 : 0.5)) \
         : 0U)
#define DECOUPLER_BAM_TO_SI(bam) ((double)(bam) * DECOUPLER_RAD_PER_BAM) /**< binary angle to [0, 2 pi) rad */
/** Counts of an encoder with 2^bits per turn to a binary angle; bits: 1 to 32. */
#define DECOUPLER_BAM_FROM_COUNTS(counts, bits) ((uint32_t)(counts) << (32U - (uint32_t)(bits)))
{% endif %}
/** @} */

/** @name Findings of decoupler_check(): 0, or what is wrong with a table */
/** @{ */
#define DECOUPLER_BAD_VERSION 0x01UL /**< made for another interface */
#define DECOUPLER_BAD_LAYOUT 0x02UL /**< made for other code, or of another length */
#define DECOUPLER_BAD_CRC 0x04UL /**< something but the zeros has changed */
#define DECOUPLER_BAD_NUMBER 0x08UL /**< an entry is beyond its least or greatest value */
#define DECOUPLER_BAD_LIMITS 0x10UL /**< a range is empty, or wider than the code is for */
#define DECOUPLER_BAD_ZEROS 0x40UL /**< zeros have changed otherwise than by decoupler_zero() */
/** @} */

{% include "common/fragments/params.h" %}

/** Input of one sample. */
typedef struct
{
{% for i in inputs %}
    {{ i.type }} {{ i.member }}; /**< [{{ i.unit }}] */
{% endfor %}
} decoupler_in_t;

/** {{ "Decoupled" if d.pose | length > 1 else "Corrected" }} {{ d.quantity }}. */
typedef struct
{
{% for o in outputs %}
    {{ o.type }} {{ o.member }}; /**< [{{ o.unit }}] */
{% endfor %}
{% if d.suspects %}
    uint32_t suspect; /**< number of the reading that contradicts the others, from 1; 0: none */
{% endif %}
} decoupler_out_t;

/**
 * Decouple one sample.
 * @param[in] p table that decoupler_check() found nothing wrong with
 * @param[in] in readings and state, in units of their last bits
 * @param[out] out {{ d.quantity }}; inputs outside their range are brought back to its end
 * @return 0 if every input is within its range, else the bits of those that are not
{% if d.flags %}
 *         (and {{ d.flags | map(attribute="name") | map("status_bit") | join(", ") }})
{% endif %}
 */
uint32_t decoupler_step(const decoupler_params_t *p, const decoupler_in_t *in, decoupler_out_t *out);

/**
 * Take the zero at a known pose, after a reset, into a table in RAM; unchanged unless the result is 0.
 * The zeros are computed first and stored last, one by one: an interrupt that calls decoupler_step() on the same
 * table meanwhile can see some new and some old ones. Where that matters, take the zero in a second table.
 * @param[in,out] p table in RAM; only its zeros change, and only if the result is 0
 * @param[in] in sample taken at the known pose
 * @param[in] pose where the machine is, in units of its last bits
 * @return as decoupler_step(), or the bit of a known pose that is too large where there is one
 */
uint32_t decoupler_zero(decoupler_params_t *p, const decoupler_in_t *in, const decoupler_out_t *pose);

/**
 * Check a table when it is loaded.
 * @param[in] p table, in flash or in RAM
 * @return 0 if nothing is wrong with it, else DECOUPLER_BAD_* bits
 */
uint32_t decoupler_check(const decoupler_params_t *p);

/**
 * CRC-32 (IEEE 802.3) of bytes, as the table has it.
 * @param[in] bytes first of them
 * @param[in] count how many there are
 * @return their CRC
 */
uint32_t decoupler_crc(const uint8_t *bytes, uint32_t count);

#ifdef __cplusplus
}
#endif

#endif /* DECOUPLER_H */
