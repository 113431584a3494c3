double slope_worst = 0.0;
decoupler_jacobian_t slopes;
const uint32_t status = decoupler_jacobian(&decoupler_params, &wanted->in, &slopes);
