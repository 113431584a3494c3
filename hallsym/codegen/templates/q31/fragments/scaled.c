static inline int32_t scaled(int32_t a, int32_t factor)
{
#if defined(DECOUPLER_PROOF)
    return a * factor;
#else
    const uint32_t bits = (uint32_t)a * (uint32_t)factor;
    return (int32_t)bits;
#endif
}

