/* 1 if the terms of a gain can take more than a share of it within the limits. The list has a place in the table
   and what is there: a gain at rest (0), an entry of a term (1), a limit it is multiplied by (2), its other side (3). */
static uint32_t gain_lost(const uint8_t *bytes)
{
    @GAINS@
    uint32_t lost = 0U;
    @REAL@ rest = @ONE@;
    @REAL@ spread = @ZERO@;
    @REAL@ most = @ZERO@;
    @REAL@ factor = @ONE@;
    for (uint32_t k = 0U; k < @COUNT@U; k++)
    {
        const uint32_t what = (uint32_t)gains[k] & 3U;
        const @REAL@ value = number(&bytes[((uint32_t)gains[k] >> 2U) * @SIZE@U]);
        const @REAL@ size = (value < @ZERO@) ? -value : value;
        if (what == 3U)
        {
            factor = (size > factor) ? size : factor;
        }
        else if (what == 2U)
        {
            most *= factor;
            factor = size;
        }
        else
        {
            const @REAL@ term = most * factor;
            spread += term;
            most = size;
            factor = @ONE@;
            if (what == 0U)
            {
                lost |= (spread < (@SHARE@ * rest)) ? 0U : 1U;
                rest = size;
                spread = @ZERO@;
                most = @ZERO@;
            }
        }
    }
    return lost;
}

