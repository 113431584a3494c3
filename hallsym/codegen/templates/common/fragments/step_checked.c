uint32_t decoupler_step(const decoupler_params_t *p, const decoupler_in_t *in, decoupler_out_t *out)
{
    {{ real }} left[{{ watched }}];
    uint32_t status = pose_of(p, in, left, out);
    out->suspect = 0U;
    if ({{ fault }})
    {
        status = suspected(p, {{ in_argument }}status, left, out);
    }
    return status;
}

