#if defined(__GNUC__) && !defined(__FRAMAC__)
#define MAGNITUDE(value) @BUILTIN_FABS@(value) /* one instruction, and no libm */
#else
#define MAGNITUDE(value) magnitude(value)
static inline @REAL@ magnitude(@REAL@ value) /* -0 gives 0, as the instruction does */
{
    return (value > @ZERO@) ? value : (@ZERO@ - value);
}
#endif
