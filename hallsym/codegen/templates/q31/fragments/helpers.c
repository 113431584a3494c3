/* Arithmetic that wraps where a table that no calibration made would overflow; a proof looks for overflow. */
static inline int32_t sum(int32_t a, int32_t b)
{
#if defined(DECOUPLER_PROOF)
    return a + b;
#else
    const uint32_t bits = (uint32_t)a + (uint32_t)b;
    return (int32_t)bits;
#endif
}

static inline int32_t difference(int32_t a, int32_t b)
{
#if defined(DECOUPLER_PROOF)
    return a - b;
#else
    const uint32_t bits = (uint32_t)a - (uint32_t)b;
    return (int32_t)bits;
#endif
}

{% if "left" in operations %}
static inline int32_t scaled(int32_t a, int32_t factor)
{
#if defined(DECOUPLER_PROOF)
    return a * factor;
#else
    const uint32_t bits = (uint32_t)a * (uint32_t)factor;
    return (int32_t)bits;
#endif
}

{% endif %}
{% if "mul" in operations %}
/* Upper 32 bits of a product, low by at most 2: three 16-bit products. */
static inline int32_t upper(int32_t a, int32_t b)
{
    const int32_t a_high = a >> 16;
    const int32_t b_high = b >> 16;
    const uint32_t a_bits = (uint32_t)a & 0xFFFFU;
    const uint32_t b_bits = (uint32_t)b & 0xFFFFU;
    const int32_t a_low = (int32_t)a_bits;
    const int32_t b_low = (int32_t)b_bits;
    return (a_high * b_high) + ((a_high * b_low) >> 16) + ((a_low * b_high) >> 16);
}

{% endif %}
{% if "bounded" in operations %}
static inline int32_t bounded(int32_t value, int32_t most)
{
    return (value > most) ? most : ((value < -most) ? -most : value);
}

{% endif %}
{% if arctangents %}
/* Angle of a vector in 2^-32 turns by CORDIC: step k turns it by atan 2^-k towards the x axis. */
static uint32_t angle_of(int32_t x, int32_t y)
{
    static const uint32_t arctangents[{{ arctangents | length }}] = {
{% for row in arctangents | batch(8) %}
        {{ row | join("U, ") }}U{{ "};" if loop.last else "," }}
{% endfor %}
    int32_t across = x;
    int32_t up = y;
    uint32_t angle = 0U;
    if (x < 0)
    {
        across = difference(0, x);
        up = difference(0, y);
        angle = 0x80000000U;
    }
    //@ loop unroll {{ arctangents | length }};
    for (uint32_t k = 0U; k < {{ arctangents | length }}U; k++)
    {
        const int32_t a = across >> k;
        const int32_t b = up >> k;
        if (up < 0)
        {
            across = difference(across, b);
            up = sum(up, a);
            angle -= arctangents[k];
        }
        else
        {
            across = sum(across, b);
            up = difference(up, a);
            angle += arctangents[k];
        }
    }
    return angle;
}

{% endif %}
{% for a in b.program.arrays.values() %}
/* Correction at a phase, both in 2^-32 turns: a line between two of its {{ a.values | length }} entries (int{{ a.bits }}_t). */
static int32_t {{ a.name }}_at(const decoupler_params_t *p, uint32_t phase)
{
    const uint32_t cell = phase >> {{ a.first }}U;
    const uint32_t way = (phase >> {{ a.first - fine }}U) & {{ "0x%X" % (2**fine - 1) }}U;
    const int32_t rest = (int32_t)way;
    const int32_t left = {{ "(int32_t)" if a.bits == 16 }}p->{{ a.name }}[cell];
    const int32_t rise = difference({{ "(int32_t)" if a.bits == 16 }}p->{{ a.name }}[(cell + 1U) & {{ a.values | length - 1 }}U], left);
{% if a.bits == 16 %}
    return sum(left{{ " * %d" % 2**a.shift if a.shift }}, {{ "(rise * rest) >> %d" % (fine - a.shift) if a.shift < fine else "rise * rest" }});
{% else %}
    const uint32_t rise_bits = (uint32_t)rise & {{ "0x%X" % (2**fine - 1) }}U;
    const int32_t rise_low = (int32_t)rise_bits;
    return sum(left, sum((rise >> {{ fine }}) * rest, (rise_low * rest) >> {{ fine }}));
{% endif %}
}

{% endfor %}
