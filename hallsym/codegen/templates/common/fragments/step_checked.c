uint32_t decoupler_step(const decoupler_params_t *p, const decoupler_in_t *in, decoupler_out_t *out)
{
    {{ real }} left[{{ d.watched | length }}];
    uint32_t status = pose_of(p, in, left, out);
    out->suspect = 0U;
    if ({{ "UNLIKELY((" if b.type == "float" else "(" }}status & DECOUPLER_STATUS_FAULT) != 0U{{ ")" if b.type == "float" }})
    {
        status = suspected(p, {{ "in, " if d.mends }}status, left, out);
    }
    return status;
}

