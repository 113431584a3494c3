
/**
 * Slopes of the {{ quantity }} at one sample, for a Kalman filter: as decoupler_step().
 * @param[in] p table, as of decoupler_step()
 * @param[in] in sample
 * @param[out] slopes d {{ quantity }} / d reading [{{ slope_units }}]
 * @return 0, or the bits of the inputs that are not within their range
 */
uint32_t decoupler_jacobian(const decoupler_params_t *p, const decoupler_in_t *in,
                            decoupler_jacobian_t *slopes);
