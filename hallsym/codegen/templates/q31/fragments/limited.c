static inline int32_t limited(int32_t value, int32_t low, int32_t high, uint32_t bit, uint32_t *status)
{
    int32_t result = value;
    if (value > high)
    {
        result = high;
        *status {{ takes }} bit; /* {{ once }} */
    }
    else if (value < low)
    {
        result = low;
        *status {{ takes }} bit; /* {{ once }} */
    }
    else
    {
        /* within its range */
    }
    return result;
}

