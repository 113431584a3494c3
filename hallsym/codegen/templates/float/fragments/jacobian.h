
/**
 * Slopes of the pose at one sample, for a Kalman filter: as decoupler_step().
 * @param slopes d pose / d reading [m/m, rad/m]
 */
uint32_t decoupler_jacobian(const decoupler_params_t *p, const decoupler_in_t *in,
                            decoupler_jacobian_t *slopes);
