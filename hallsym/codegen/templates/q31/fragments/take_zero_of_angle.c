decoupler_out_t seen;
const uint32_t status = decoupler_step(p, in, &seen);
const uint32_t zeros[{{ pose }}] = {
{% for o in outputs %}
    p->{{ o.zero }} + (pose->{{ o.member }} - seen.{{ o.member }}),
{% endfor %}
};
