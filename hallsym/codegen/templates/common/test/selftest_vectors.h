/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}; do not edit: generate again from the calibration. */
/* Inputs, the pose {{ "that the model gives" if b.type == "float" else "[SI] of the model" }} in double, status. Bounds of the error; hashes. */
{% if b.type == "float" %}
#include <math.h>

{% endif %}
#define DECOUPLER_VECTORS {{ b.vectors.inputs.shape[1] }}U

static const double decoupler_bounds[{{ d.pose | length }}] = {{ bounds | braced }};
{% if slopes %}
static const double decoupler_slope_bounds[{{ slopes | length }}] = {{ slope_bounds | braced }};
{% endif %}
const uint32_t decoupler_hash_short = {{ b.hash(b.hashed[0]) | mask }};
const uint32_t decoupler_hash_long = {{ b.hash(b.hashed[1]) | mask }};

static const vector_t decoupler_vectors[DECOUPLER_VECTORS] = {
    {{ b.vector_rows() }}
};
