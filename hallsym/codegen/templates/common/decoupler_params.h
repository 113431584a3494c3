/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
#ifndef DECOUPLER_PARAMS_H
#define DECOUPLER_PARAMS_H

#include "decoupler.h"

#ifdef __cplusplus
extern "C" {
#endif

/** SHA-256 of the calibration that the table was made from. */
#define DECOUPLER_PARAMS_SHA256 "{{ sha256 }}"

extern const decoupler_params_t decoupler_params; /**< the fitted machine */

#ifdef __cplusplus
}
#endif

#endif /* DECOUPLER_PARAMS_H */
