#if defined(__GNUC__) && !defined(__FRAMAC__)
#define MAGNITUDE(value) @BUILTIN_FABS@(value) /* one instruction, and no libm */
#else
#define MAGNITUDE(value) (((value) < @ZERO@) ? -(value) : (value))
#endif
