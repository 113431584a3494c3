@REAL@ zeros[@POSE@];
decoupler_out_t seen;
status = pose_of(p, in, @NO_ZEROS@, &seen);
zeros[@out.index@] = pose->@out.member@ - seen.@out.member@;
