/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
/* Calibration {{ sha256 }} */
#include "decoupler_params.h"

const decoupler_params_t decoupler_params = {
    .crc = {{ b.crc | mask }},
    .version = {{ version }}UL,
    .layout = {{ b.layout | mask }},
    .length = {{ b.length }}UL,
    .calibration = {{ b.identity | map("mask") | join(", ") | braced }},
{{ b.listed(b.constant) }}
    .zeros_crc = {{ b.zeros_crc | mask }},
{{ b.listed(b.offsets) }}
};
