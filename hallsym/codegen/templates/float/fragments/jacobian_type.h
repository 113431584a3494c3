
/** Slopes of the @QUANTITY@ by the readings. */
typedef struct
{
    @REAL@ @slope.name@; /**< [@slope.unit@] d @slope.of@ / d @slope.by@ */
} decoupler_jacobian_t;
