@REAL@ zeros[@POSE@];
status = 0U;
@ALL_HELD@
@ALSO_CHECKED@
const @out.type@ @out.name@ = pose->@out.member@;
@AT_POSE@
zeros[@out.index@] = pose->@out.member@ - @out.name@_seen;
