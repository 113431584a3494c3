/* A number brought within half a period of zero from within three halves of one. */
static inline int32_t wrapped(int32_t value, int32_t half)
{
    int32_t result = value;
    if (value > half)
    {
        result = (value - half) - half;
    }
    else if (value < -half)
    {
        result = (value + half) + half;
    }
    else
    {
        /* within half a period */
    }
    return result;
}

