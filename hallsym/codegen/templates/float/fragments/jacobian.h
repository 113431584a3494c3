
/**
 * Slopes of the @QUANTITY@ at one sample, for a Kalman filter: as decoupler_step().
 * @param slopes d @QUANTITY@ / d reading [@SLOPE_UNITS@]
 */
uint32_t decoupler_jacobian(const decoupler_params_t *p, const decoupler_in_t *in,
                            decoupler_jacobian_t *slopes);
