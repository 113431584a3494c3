uint32_t decoupler_jacobian(const decoupler_params_t *p, const decoupler_in_t *in,
                            decoupler_jacobian_t *slopes)
{
    uint32_t status = 0U;
    {{ slopes }}
    return status;
}

