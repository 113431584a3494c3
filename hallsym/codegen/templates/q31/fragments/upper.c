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

