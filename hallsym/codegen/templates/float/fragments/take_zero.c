@REAL@ zeros[@POSE@];
decoupler_out_t seen;
status = decoupler_step(p, in, &seen);
zeros[@out.index@] = p->@out.zero@ + (pose->@out.member@ - seen.@out.member@);
@WRAPPED@
