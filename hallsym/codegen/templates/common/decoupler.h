/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
/**
 * @file decoupler.h
{% if b.type == "float" %}
 * @brief From the readings of {{ d.model.channels | length }} probe{{ 's' if d.model.channels | length != 1 }} to the {{ d.quantity }} of the {{ d.model.family }}: model {{ d.model.name | commented }}.
{% else %}
 * @brief From readings to {{ d.quantity }} in 32-bit integers: model {{ d.model.name | commented }}.
{% endif %}
 *
{% if b.type == "float" %}
 * Units are SI: {{ (d.inputs + d.pose) | units(" and ") }}. No heap, no libm, no static data; reentrant.
{% else %}
 * Every quantity is an integer times a power of two of its SI unit (m, rad); the exponents are below. No heap, no
 * 64-bit arithmetic and no division per sample{{ " but of a sample that is decoded without a reading" if d.mends }}, no static data; reentrant.
{% if b.program.angles %}
 *
 * A binary angle counts 2^-32 of a turn, unsigned: it wraps by itself, and every bit pattern is an angle. Counts of
 * an encoder with 2^b per turn are shifted left by 32 - b.
{% endif %}
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
#define {{ i.bit }} {{ i.mask }} /**< {{ i.column }} outside its range{{ ", or not finite" if b.type == "float" }} */
{% endfor %}
{% for f in d.flags %}
#define {{ f.name | status_bit }} {{ flag_bit(loop.index0) | mask }} /**< {{ f.meaning }} */
{% endfor %}
{% if not (b.limited or d.flags) %}

{% endif %}
{% if d.mends %}
#define DECOUPLER_STATUS_DEGRADED {{ d.degraded_bit | mask }} /**< one reading contradicts the others: the {{ d.quantity }} is decoded without it */
{% endif %}
{% if far %}
#define DECOUPLER_STATUS_KNOWN 0x80000000UL /**< decoupler_zero(): known pose {{ "not within " ~ reach if b.type == "float" else "beyond 2^29" }} */
{% endif %}
/** @} */

{% if b.type == "q31" %}
{% include "q31/fragments/units.h" %}

{% endif %}
/** @name Findings of decoupler_check(): 0, or what is wrong with a table */
/** @{ */
#define DECOUPLER_BAD_VERSION 0x01UL /**< made for another interface */
#define DECOUPLER_BAD_LAYOUT 0x02UL /**< made for other code, or of another length */
#define DECOUPLER_BAD_CRC 0x04UL /**< something but the zeros has changed */
#define DECOUPLER_BAD_NUMBER 0x08UL /**< an entry is beyond its least or greatest value{{ ", or no number" if b.type == "float" }} */
#define DECOUPLER_BAD_LIMITS 0x10UL /**< a range is empty, or wider than the code is for */
#define DECOUPLER_BAD_ZEROS 0x40UL /**< zeros have changed otherwise than by decoupler_zero() */
/** @} */

{% include "common/fragments/params.h" %}

/** Input of one sample. */
typedef struct
{
{% for i in inputs %}
    {{ i.type }} {{ i.member }}; /**< [{{ i.unit }}]{{ " " ~ i.kind if b.type == "float" }} */
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
{% if slopes %}

/** Slopes of the {{ d.quantity }} by the readings. */
typedef struct
{
{% for s in slopes %}
    {{ real }} {{ s.name }}; /**< [{{ s.unit }}] d {{ s.of }} / d {{ s.by }} */
{% endfor %}
} decoupler_jacobian_t;
{% endif %}

/**
 * Decouple one sample.
 * @param[in] p table that decoupler_check() found nothing wrong with
{% if b.type == "float" %}
 * @param[in] in readings [{{ d.model.channels | units }}]{{ " and state [" ~ (d.model.state | units) ~ "]" if d.model.state }}
 * @param[out] out {{ d.quantity }} [{{ d.pose | units }}]: always finite; inputs outside their range are brought back to its end
 * @return 0 if every input is finite and within its range, else the bits of those that are not
{% else %}
 * @param[in] in readings and state, in units of their last bits
 * @param[out] out {{ d.quantity }}; inputs outside their range are brought back to its end
 * @return 0 if every input is within its range, else the bits of those that are not
{% endif %}
{% if d.flags %}
 *         (and {{ d.flags | map(attribute="name") | map("status_bit") | join(", ") }})
{% endif %}
 */
uint32_t decoupler_step(const decoupler_params_t *p, const decoupler_in_t *in, decoupler_out_t *out);
{% if slopes %}

/**
 * Slopes of the {{ d.quantity }} at one sample, for a Kalman filter: as decoupler_step().
 * @param[in] p table, as of decoupler_step()
 * @param[in] in sample
 * @param[out] slopes d {{ d.quantity }} / d reading [{{ slopes | map(attribute="unit") | unique | join(", ") }}]
 * @return 0, or the bits of the inputs that are not within their range
 */
uint32_t decoupler_jacobian(const decoupler_params_t *p, const decoupler_in_t *in,
                            decoupler_jacobian_t *slopes);
{% endif %}
{% if d.observed %}
{% include "float/fragments/predict.h" %}
{% endif %}

/**
{% if b.type == "float" %}
 * Take the zero at a known pose, after a reset: later poses are counted from it.
{% else %}
 * Take the zero at a known pose, after a reset, into a table in RAM; unchanged unless the result is 0.
{% endif %}
 * The zeros are computed first and stored last, one by one: an interrupt that calls decoupler_step() on the same
 * table meanwhile can see some new and some old ones. Where that matters, take the zero in a second table.
 * @param[in,out] p table in RAM; only its zeros change, and only if the result is 0
 * @param[in] in sample taken at the known pose
{% if b.type == "float" %}
 * @param[in] pose where the machine is [{{ d.pose | units }}]; within {{ reach }}
 * @return as decoupler_step(), or DECOUPLER_STATUS_KNOWN
{% else %}
 * @param[in] pose where the machine is, in units of its last bits
 * @return as decoupler_step(), or the bit of a known pose that is too large where there is one
{% endif %}
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
