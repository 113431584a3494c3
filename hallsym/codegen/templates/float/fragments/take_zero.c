@BEFORE@
decoupler_out_t seen;
@CLEAR@
status = decoupler_step(p, in, &seen);
if (status == 0U)
{
    @ADD_ZEROS@
}
else
{
    @RESTORE@
}
