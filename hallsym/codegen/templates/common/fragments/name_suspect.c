/* Of readings that contradict one another, the one of the largest normalised residual; the pose without it. */
static uint32_t suspected(const decoupler_params_t *p, {{ "const decoupler_in_t *in, " if d.mends }}uint32_t status,
                          const {{ real }} *left, decoupler_out_t *out)
{
    static const {{ "uint8_t" if suspects.numbers | max < 256 else "uint16_t" }} numbers[{{ suspects.numbers | length }}] = {{ suspects.numbers | join(", ") | braced }};
{% if suspects.several %}
    static const uint8_t first[{{ suspects.starts | length }}] = {{ suspects.starts | join(", ") | braced }};
{% endif %}
    uint32_t k = 0U;
    uint32_t result = status;
    for (uint32_t n = 1U; n < {{ suspects.named }}U; n++)
    {
        k = (size_of(left[n], p->root[n]) > size_of(left[k], p->root[k])) ? n : k;
    }
    out->suspect = numbers[{{ "first[k]" if suspects.several else "k" }}];
{% if d.mends %}
{% include "common/fragments/" ~ ("mend_least.c" if suspects.several else "mend.c") %}
{% endif %}
    return result;
}

