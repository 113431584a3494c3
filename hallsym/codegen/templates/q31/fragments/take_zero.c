uint32_t status = DECOUPLER_STATUS_KNOWN;
int32_t zeros[@POSE@];
zeros[@out.index@] = p->@out.zero@;
if (@KNOWN@)
{
    decoupler_out_t seen;
    status = decoupler_step(p, in, &seen);
    zeros[@out.index@] = sum(zeros[@out.index@], difference(pose->@out.member@, seen.@out.member@));
}
