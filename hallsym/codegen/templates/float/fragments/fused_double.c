
/* a * b + c with one rounding, by an instruction or by a library that is right (those of hosts are). */
#if defined(__FRAMAC__)
#define FUSED(a, b, c) (((a) * (b)) + (c)) /* for a tool that does not know it */
#elif defined(__arm__) && (!defined(__ARM_FEATURE_FMA) || !defined(__ARM_FP) || ((__ARM_FP & 8) == 0))
#error "no fused multiply-add of doubles on this core, and newlib's rounds twice: generate without --fma"
#elif defined(__GNUC__)
#define FUSED(a, b, c) __builtin_fma((a), (b), (c))
#else
#include <math.h>
#define FUSED(a, b, c) fma((a), (b), (c))
#endif
