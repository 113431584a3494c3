#if defined(__GNUC__) && !defined(__FRAMAC__)
#define MAGNITUDE(value) {{ builtin_fabs }}(value) /* one instruction, and no libm */
#else
#define MAGNITUDE(value) magnitude(value)
static inline {{ real }} magnitude({{ real }} value) /* -0 gives 0, as the instruction does */
{
    return (value > {{ zero }}) ? value : ({{ zero }} - value);
}
#endif
