/* By how many bits a number can be shifted and stay below 2^31. */
static uint32_t spare_bits(uint32_t value)
{
    uint32_t rest = value;
    uint32_t count = 0U;
    if (rest < 0x8000U)
    {
        rest <<= 16U;
        count = 16U;
    }
    if (rest < 0x800000U)
    {
        rest <<= 8U;
        count += 8U;
    }
    if (rest < 0x8000000U)
    {
        rest <<= 4U;
        count += 4U;
    }
    if (rest < 0x20000000U)
    {
        rest <<= 2U;
        count += 2U;
    }
    if (rest < 0x40000000U)
    {
        count += 1U;
    }
    return count;
}

/* Natural logarithm of the length of a vector less twice / 2 of that of 2, in 2^-26: shifts, and a polynomial of
   degree @DEGREE@ for the sum of squares between 1 and 2. */
static int32_t logarithm_of(int32_t x, int32_t y, int32_t twice)
{
    const uint32_t across = (x < 0) ? (uint32_t)-x : (uint32_t)x;
    const uint32_t up = (y < 0) ? (uint32_t)-y : (uint32_t)y;
    const uint32_t wide = spare_bits(across | up | 1U);
    const int32_t a = (int32_t)(uint32_t)(across << wide);
    const int32_t b = (int32_t)(uint32_t)(up << wide);
    const uint32_t square = (uint32_t)upper(a, a) + (uint32_t)upper(b, b);
    const uint32_t high = spare_bits(square);
    const uint32_t beyond = (square << high) & 0x3FFFFFFFU;
    const int32_t way = ((int32_t)beyond - 0x20000000) * 4;
    int32_t result = @HIGHEST@;
    @HORNER@
    return (result >> 5) + ((62 - (int32_t)high - (2 * (int32_t)wide) - twice) * @HALF_LOG_2@);
}

