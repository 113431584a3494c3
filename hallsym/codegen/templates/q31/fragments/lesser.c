static inline int32_t lesser(int32_t a, int32_t b)
{
    return (a < b) ? a : b;
}

