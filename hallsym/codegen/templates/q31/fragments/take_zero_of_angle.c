decoupler_out_t seen;
const uint32_t status = decoupler_step(p, in, &seen);
const uint32_t zeros[@POSE@] = {
    p->@out.zero@ + (pose->@out.member@ - seen.@out.member@),
};
