#if !defined(__FRAMAC__)
typedef union
{
    {{ real }} value;
    {{ word }} bits;
} number_t;

/* Numbers of one sign are in the order of their bits, and NaN is above them all; the limit is not negative. */
INLINE {{ real }} within({{ real }} value, {{ real }} limit, uint32_t bit, uint32_t *status)
{
    number_t result;
    number_t most;
    result.value = value;
    most.value = limit;
    if ((result.bits & {{ size_mask }}) > most.bits)
    {
        result.bits = most.bits | (result.bits & {{ sign_mask }});
        *status {{ takes }} bit; /* {{ once }} */
    }
    return result.value;
}
#else /* the same for a tool that does not follow bits; proof/exhaustive.c tries the other */
INLINE {{ real }} within({{ real }} value, {{ real }} limit, uint32_t bit, uint32_t *status)
{
    return limited(value, -limit, limit, bit, status);
}
#endif

