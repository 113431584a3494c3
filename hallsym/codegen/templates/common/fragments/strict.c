{% if d.flags %}
    decoupler_params_t strict = decoupler_params;
{% for f in d.flags %}
    strict.{{ f.least }} = {{ most }};
{% endfor %}
{% endif %}
