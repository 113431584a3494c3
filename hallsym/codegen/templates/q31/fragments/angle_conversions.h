/** [rad] to a binary angle, to the nearest, wrapped; 0 of NaN and beyond 1e9 rad. */
#define DECOUPLER_BAM_FROM_SI(si) \
    ((((double)(si) > -1e9) && ((double)(si) < 1e9)) \
         ? (uint32_t)(int64_t)(((double)(si) * {{ per_rad }}) + (((si) < 0) ? -0.5 : 0.5)) \
         : 0U)
#define DECOUPLER_BAM_TO_SI(bam) ((double)(bam) * DECOUPLER_RAD_PER_BAM) /**< binary angle to [0, 2 pi) rad */
/** Counts of an encoder with 2^bits per turn to a binary angle; bits: 1 to 32. */
#define DECOUPLER_BAM_FROM_COUNTS(counts, bits) ((uint32_t)(counts) << (32U - (uint32_t)(bits)))
