INLINE {{ real }} limited({{ real }} value, {{ real }} low, {{ real }} high, uint32_t bit, uint32_t *status)
{
    {{ real }} result = value;
    if (UNLIKELY(!(value <= high))) /* NaN goes here too */
    {
        result = high;
        *status {{ takes }} bit; /* {{ once }} */
    }
    else if (UNLIKELY(value < low))
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

