/** Largest magnitude of FROM_SI and FROM_COUNTS, which saturate there: beyond every range, so a status bit is set. */
#define DECOUPLER_MOST {{ largest }}
/** @cond */
#define DECOUPLER_NEAREST_(type, x) \
    (((x) < (type)DECOUPLER_MOST) \
         ? (((x) > -(type)DECOUPLER_MOST) ? ((int32_t)(x) + (int32_t)(((x) - (type)(int32_t)(x)) * (type)2)) \
                                          : (int32_t)-DECOUPLER_MOST) \
         : (int32_t)DECOUPLER_MOST)
#define DECOUPLER_SCALED_(si, scale) \
    ((sizeof(si) > sizeof(float)) ? DECOUPLER_NEAREST_(double, ((double)(si) * (scale))) \
                                  : DECOUPLER_NEAREST_(float, ((float)(si) * (float)(scale))))
#define DECOUPLER_FACTOR_(x) \
    (((x) < 9e18) ? (((x) > -9e18) ? (int64_t)((x) + (((x) < 0.0) ? -0.5 : 0.5)) : -9000000000000000000) \
                  : 9000000000000000000)
#define DECOUPLER_SIZE_(wide) (((wide) < 0) ? -(wide) : (wide))
#define DECOUPLER_BEYOND_(counts, factor) \
    (DECOUPLER_SIZE_((int64_t)(counts)) > (((int64_t)DECOUPLER_MOST * 16777216) / (DECOUPLER_SIZE_(factor) + 1)))
#define DECOUPLER_TIMES_(counts, factor) \
    (DECOUPLER_BEYOND_(counts, factor) \
         ? ((((counts) < 0) == ((factor) < 0)) ? (int32_t)DECOUPLER_MOST : (int32_t)-DECOUPLER_MOST) \
         : (int32_t)((((int64_t)(counts) * (factor)) + \
                      ((((counts) < 0) == ((factor) < 0)) ? 8388608 : -8388608)) / 16777216))
#define DECOUPLER_COUNTED_(counts, per_count, scale) \
    DECOUPLER_TIMES_(counts, DECOUPLER_FACTOR_(((double)(per_count) * ((scale) * 16777216.0))))
/** @endcond */
