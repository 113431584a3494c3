@CONVERTS@
/* Decode with the value of one reading at which nothing is left of it: along the line through two. */
static uint32_t without(const decoupler_params_t *p, const decoupler_in_t *in, uint32_t k, uint32_t number,
                        @REAL@ *left, decoupler_out_t *out)
{
    decoupler_in_t given;
    uint8_t *bytes = (uint8_t *)&given;
    @REAL@ value = @ZERO@;
    @REAL@ before = @ZERO@;
    @REAL@ last = @ZERO@;
    uint32_t status = 0U;
    /* one by one: a copy of the whole may call memcpy() */
    given.@in.member@ = in->@in.member@;
    for (uint32_t n = 0U; n < @SECANTS@U; n++)
    {
        const uint8_t *own = (const uint8_t *)&value;
        for (uint32_t b = 0U; b < (uint32_t)sizeof(value); b++)
        {
            bytes[((number - 1U) * (uint32_t)sizeof(value)) + b] = own[b];
        }
        status = pose_of(p, &given, left, out);
        const @REAL@ now = left[k];
        @WIDE@ step = @FIRST@;
        if (n > 0U)
        {
            step = @ALONG@;
        }
        before = value;
        last = now;
        value = @MOVED@;
    }
    return status;
}

