
/** Slopes of the pose by the readings. */
typedef struct
{
    @SLOPE_MEMBERS@
} decoupler_jacobian_t;
