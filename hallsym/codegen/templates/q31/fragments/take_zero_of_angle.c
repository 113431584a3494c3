decoupler_out_t seen;
const uint32_t status = decoupler_step(p, in, &seen);
if (status == 0U)
{
    p->@out.zero@ += pose->@out.member@ - seen.@out.member@;
}
