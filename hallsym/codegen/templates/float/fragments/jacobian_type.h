
/** Slopes of the {{ quantity }} by the readings. */
typedef struct
{
{% for s in slope %}
    {{ real }} {{ s.name }}; /**< [{{ s.unit }}] d {{ s.of }} / d {{ s.by }} */
{% endfor %}
} decoupler_jacobian_t;
