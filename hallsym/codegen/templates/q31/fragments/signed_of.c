/* A binary angle from half a turn below zero to half a turn above, in 2^-31 turns. */
static inline int32_t signed_of(uint32_t angle)
{
    const uint32_t bits = angle >> 1U;
    const int32_t positive = (int32_t)bits;
    return (angle < 0x80000000U) ? positive : ((positive - 2147483647) - 1);
}

