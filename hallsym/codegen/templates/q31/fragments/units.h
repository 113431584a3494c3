/**
 * @name Units of inputs and outputs, and conversions
 *
 * FROM_SI(si): SI to integer, to the nearest (halves away from zero) in the type of its argument, float or double;
 * NaN becomes the largest. TO_SI(value): integer to SI, a double. FROM_COUNTS(counts, per_count): counts of a
 * converter from the zero of its channel, times the constant [SI] that one of them is worth, in 64-bit integers.
 * What does not fit saturates. All are constant expressions of constants, and evaluate an argument more than once.
 */
/** @{ */
{% if scaled %}
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
{% endif %}
{% for s in scaled %}
#define {{ s.macro }}_EXPONENT {{ s.exponent }} /**< {{ s.column }} = value {{ s.unit }} */
{% endfor %}
{% for s in scaled %}
#define {{ s.macro }}_FROM_SI(si) DECOUPLER_SCALED_(si, {{ s.power }})
{% endfor %}
{% for s in scaled %}
#define {{ s.macro }}_TO_SI(value) ((double)(value) * {{ s.step }})
{% endfor %}
{% for s in scaled if s.input %}
#define {{ s.macro }}_FROM_COUNTS(counts, per_count) DECOUPLER_COUNTED_(counts, per_count, {{ s.power }})
{% endfor %}
{% if b.program.angles %}
#define DECOUPLER_RAD_PER_BAM {{ b.bam[0] }} /**< binary angles: {{ b.bam[1] }} */
/** [rad] to a binary angle, to the nearest, wrapped; 0 of NaN and beyond 1e9 rad. */
#define DECOUPLER_BAM_FROM_SI(si) \
    ((((double)(si) > -1e9) && ((double)(si) < 1e9)) \
         ? (uint32_t)(int64_t)(((double)(si) * {{ 1 / b.bam[0] }}) + (((si) < 0) ? -0.5 : 0.5)) \
         : 0U)
#define DECOUPLER_BAM_TO_SI(bam) ((double)(bam) * DECOUPLER_RAD_PER_BAM) /**< binary angle to [0, 2 pi) rad */
/** Counts of an encoder with 2^bits per turn to a binary angle; bits: 1 to 32. */
#define DECOUPLER_BAM_FROM_COUNTS(counts, bits) ((uint32_t)(counts) << (32U - (uint32_t)(bits)))
{% endif %}
/** @} */
