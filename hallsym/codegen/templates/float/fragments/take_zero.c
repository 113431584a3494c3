{{ real }} zeros[{{ pose }}];
decoupler_out_t seen;
status = decoupler_step(p, in, &seen);
{% for o in outputs %}
zeros[{{ o.index }}] = p->{{ o.zero }} + (pose->{{ o.member }} - seen.{{ o.member }});
{% endfor %}
{{ wrapped }}
