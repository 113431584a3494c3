uint32_t status = DECOUPLER_POSE;
if (@KNOWN@)
{
    decoupler_out_t seen;
    status = decoupler_step(p, in, &seen);
    if (status == 0U)
    {
        p->@out.zero@ += pose->@out.member@ - seen.@out.member@;
    }
}
