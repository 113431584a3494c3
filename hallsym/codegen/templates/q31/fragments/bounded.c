static inline int32_t bounded(int32_t value, int32_t most)
{
    return (value > most) ? most : ((value < -most) ? -most : value);
}

