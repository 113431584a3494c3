uint32_t decoupler_step(const decoupler_params_t *p, const decoupler_in_t *in, decoupler_out_t *out)
{
    @REAL@ left[@WATCHED@];
    uint32_t status = pose_of(p, in, left, out);
    out->suspect = 0U;
    if (@FAULT@)
    {
        status = suspected(p, @IN_ARGUMENT@status, left, out);
    }
    return status;
}

