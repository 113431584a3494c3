/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
#ifndef DECOUPLER_SELFTEST_H
#define DECOUPLER_SELFTEST_H

#include <stdint.h>

/** Largest deviation that the self-test met, and how many of its vectors failed. */
typedef struct
{
    uint32_t vectors;  /**< run */
    uint32_t failures; /**< wrong status, not finite, or further from the model than the stated bound */
    double worst;      /**< largest deviation from the model in double [m, rad] */
} decoupler_selftest_t;

/**
 * Run the listed vectors.
 * @return how many ran and failed, and the largest deviation
 */
decoupler_selftest_t decoupler_selftest(void);

/**
 * Faults of a table.
 * @return how many are not found
 */
uint32_t decoupler_missed_faults(void);

/**
 * Zeros that are taken or refused.
 * @return how many are wrong
 */
uint32_t decoupler_missed_zeros(void);

/**
 * Hash of status and bits of the pose over samples that include any bit pattern.
 * @param[in] count samples
 * @return the hash
 */
uint32_t decoupler_hash(uint32_t count);

extern const uint32_t decoupler_hash_short; /**< expected of decoupler_hash(4096) */
extern const uint32_t decoupler_hash_long;  /**< expected of decoupler_hash({{ b.hashed[1] }}) */

#endif /* DECOUPLER_SELFTEST_H */
