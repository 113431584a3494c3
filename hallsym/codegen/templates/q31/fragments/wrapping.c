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

