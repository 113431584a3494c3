{% include b.type ~ "/fragments/in_32_bits.c" ignore missing %}
/* Decode with the value of one reading at which nothing is left of it: along the line through two. */
static uint32_t without(const decoupler_params_t *p, const decoupler_in_t *in, uint32_t k, uint32_t number,
                        {{ real }} *left, decoupler_out_t *out)
{
    decoupler_in_t given;
    uint8_t *bytes = (uint8_t *)&given;
    {{ real }} value = {{ zero }};
    {{ real }} before = {{ zero }};
    {{ real }} last = {{ zero }};
    uint32_t status = 0U;
    /* one by one: a copy of the whole may call memcpy() */
{% for i in inputs %}
    given.{{ i.member }} = in->{{ i.member }};
{% endfor %}
    for (uint32_t n = 0U; n < {{ suspects.secants }}U; n++)
    {
        const uint8_t *own = (const uint8_t *)&value;
        for (uint32_t b = 0U; b < (uint32_t)sizeof(value); b++)
        {
            bytes[((number - 1U) * (uint32_t)sizeof(value)) + b] = own[b];
        }
        status = pose_of(p, &given, left, out);
        const {{ real }} now = left[k];
{% if b.type == "float" %}
        {{ real }} step = now;
{% else %}
        int64_t step = -{{ suspects.nudged }};
{% endif %}
        if (n > 0U)
        {
{% if b.type == "float" %}
            step = ((now < last) || (now > last)) ? ((now * (value - before)) / (now - last)) : {{ zero }};
{% else %}
            step = (now == last) ? 0 : ((now * ((int64_t)value - before)) / ((int64_t)now - last));
{% endif %}
        }
        before = value;
        last = now;
        value = {{ "value - step" if b.type == "float" else "in_32_bits((int64_t)value - step)" }};
    }
    return status;
}

