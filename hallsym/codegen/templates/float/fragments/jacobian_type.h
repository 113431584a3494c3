
/** Slopes of the @QUANTITY@ by @BY_KINDS@. */
typedef struct
{
    @REAL@ @slope.name@; /**< [@slope.unit@] d @slope.of@ / d @slope.by@ */
} decoupler_jacobian_t;
