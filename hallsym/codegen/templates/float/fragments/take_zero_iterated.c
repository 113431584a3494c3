status = 0U;
@ALL_HELD@
const @out.type@ @out.name@ = pose->@out.member@;
@AT_POSE@
if (status == 0U)
{
    p->@out.zero@ = pose->@out.member@ - @out.name@_seen;
}
