#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && (__FINITE_MATH_ONLY__ != 0))
#error "NaN must be told from numbers: compile without -ffast-math and -ffinite-math-only"
#elif defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__)
#error "bounds and bits are those of IEEE 754: compile without -fassociative-math and -freciprocal-math"
#endif

#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF /* gcc: -std=c99 or -ffp-contract=off */
#if __clang_major__ >= 11
#pragma clang fp reassociate(off) /* clang does not tell that it was asked for */
#endif
#if __clang_major__ >= 18
#pragma clang fp reciprocal(off)
#endif
#endif
