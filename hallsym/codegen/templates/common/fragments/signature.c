{% if d.suspects %}
static uint32_t pose_of(const decoupler_params_t *p, const decoupler_in_t *in, {{ real }} *left, decoupler_out_t *out)
{% else %}
uint32_t decoupler_step(const decoupler_params_t *p, const decoupler_in_t *in, decoupler_out_t *out)
{% endif %}
