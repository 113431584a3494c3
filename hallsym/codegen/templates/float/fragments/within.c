INLINE @REAL@ within(@REAL@ value, @REAL@ limit, uint32_t bit, uint32_t *status)
{
    @REAL@ result = value;
    if (UNLIKELY(!(MAGNITUDE(value) <= limit)))
    {
        result = (value < @ZERO@) ? -limit : limit;
        *status += bit;
    }
    return result;
}

