INLINE @REAL@ limited(@REAL@ value, @REAL@ low, @REAL@ high, uint32_t bit, uint32_t *status)
{
    @REAL@ result = value;
    if (UNLIKELY(!(value <= high))) /* NaN goes here too */
    {
        result = high;
        *status @TAKES@ bit; /* @ONCE@ */
    }
    else if (UNLIKELY(value < low))
    {
        result = low;
        *status @TAKES@ bit; /* @ONCE@ */
    }
    else
    {
        /* within its range */
    }
    return result;
}

