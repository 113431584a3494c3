/* Of readings that contradict one another, the one of the largest normalised residual; the pose without it. */
static uint32_t suspected(const decoupler_params_t *p, {{ in_parameter }}uint32_t status,
                          const {{ real }} *left, decoupler_out_t *out)
{
    static const {{ number_type }} numbers[{{ count }}] = {{ numbers | braced }};
    {{ starts }}
    uint32_t k = 0U;
    uint32_t result = status;
    for (uint32_t n = 1U; n < {{ named }}U; n++)
    {
        k = (size_of(left[n], p->root[n]) > size_of(left[k], p->root[k])) ? n : k;
    }
    out->suspect = numbers[{{ of_suspect }}];
    {{ mend }}
    return result;
}

