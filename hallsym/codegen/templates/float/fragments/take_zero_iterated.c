{{ real }} zeros[{{ pose }}];
status = 0U;
{{ all_held }}
{{ also_checked }}
{% for o in outputs %}
const {{ o.type }} {{ o.name }} = pose->{{ o.member }};
{% endfor %}
{{ at_pose }}
{% for o in outputs %}
zeros[{{ o.index }}] = pose->{{ o.member }} - {{ o.name }}_seen;
{% endfor %}
