decoupler_jacobian_t slopes;
const uint32_t slope_status = decoupler_jacobian(&decoupler_params, &in, &slopes);
//@ assert slope_status_zero: slope_status == 0;
