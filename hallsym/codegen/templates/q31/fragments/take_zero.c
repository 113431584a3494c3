uint32_t status = DECOUPLER_STATUS_KNOWN;
int32_t zeros[{{ pose }}];
{% for o in outputs %}
zeros[{{ o.index }}] = p->{{ o.zero }};
{% endfor %}
if ({{ known }})
{
    decoupler_out_t seen;
    status = decoupler_step(p, in, &seen);
{% for o in outputs %}
    zeros[{{ o.index }}] = sum(zeros[{{ o.index }}], difference(pose->{{ o.member }}, seen.{{ o.member }}));
{% endfor %}
}
