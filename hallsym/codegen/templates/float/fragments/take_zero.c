const @out.type@ before_@out.name@ = p->@out.zero@;
decoupler_out_t seen;
p->@out.zero@ = @ZERO@;
status = decoupler_step(p, in, &seen);
if (status == 0U)
{
    p->@out.zero@ = pose->@out.member@ - seen.@out.member@;
}
else
{
    p->@out.zero@ = before_@out.name@;
}
