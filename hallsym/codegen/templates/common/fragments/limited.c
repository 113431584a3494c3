{{ "INLINE" if real == "float" else "static inline" }} {{ real }} limited({{ real }} value, {{ real }} low, {{ real }} high, uint32_t bit, uint32_t *status)
{
    {{ real }} result = value;
    if ({{ "UNLIKELY(!(value <= high))) /* NaN goes here too */" if real == "float" else "value > high)" }}
    {
        result = high;
        *status {{ "|=" if d.shared else "+=" }} bit; /* {{ "inputs share bits" if d.shared else "each bit once" }} */
    }
    else if ({{ "UNLIKELY(value < low)" if real == "float" else "value < low" }})
    {
        result = low;
        *status {{ "|=" if d.shared else "+=" }} bit; /* {{ "inputs share bits" if d.shared else "each bit once" }} */
    }
    else
    {
        /* within its range */
    }
    return result;
}
