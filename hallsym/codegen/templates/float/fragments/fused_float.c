
/* a * b + c with one rounding: an instruction where the core has it, elsewhere the same bits in double. */
#if defined(__FRAMAC__)
#define FUSED(a, b, c) (((a) * (b)) + (c)) /* for a tool that does not know it */
#elif defined(__FP_FAST_FMAF) || defined(__FMA__) || (defined(__ARM_FEATURE_FMA) && defined(__ARM_FP))
#if defined(__GNUC__)
#define FUSED(a, b, c) __builtin_fmaf((a), (b), (c))
#else
#include <math.h>
#define FUSED(a, b, c) fmaf((a), (b), (c))
#endif
#else
#define FUSED(a, b, c) fused((a), (b), (c))
static inline float fused(float a, float b, float c)
{
    union
    {
        double value;
        uint64_t bits;
    } odd;
    const double product = (double)a * (double)b; /* exact */
    const double sum = product + (double)c;
    const double part = sum - product;
    const double rest = (product - (sum - part)) + ((double)c - part); /* sum + rest is exact */
    odd.value = sum;
    if ((rest != 0.0) && ((odd.bits & 1U) == 0U)) /* rounded to odd, so that rounding once more is right */
    {
        odd.bits = ((rest > 0.0) == (sum > 0.0)) ? (odd.bits + 1U) : (odd.bits - 1U);
    }
    return (float)odd.value;
}
#endif
