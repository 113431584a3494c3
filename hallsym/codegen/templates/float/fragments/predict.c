
static @REAL@ slower(@REAL@ speed, @REAL@ most)
{
    return (speed > most) ? most : ((speed < -most) ? -most : speed);
}
@AROUND@

void decoupler_track(const decoupler_params_t *p, decoupler_track_t *track, const decoupler_out_t *pose,
                     uint32_t status, @REAL@ dt)
{
    const @REAL@ gap = track->gap + dt;
    if (!((dt > @ZERO@) && (gap <= p->longest_gap)))
    {
        track->samples = 0U;
    }
    if (track->samples > 0U)
    {
        @AHEAD_OF@
        track->gap = gap;
        if (@USABLE@)
        {
            @UPDATED@
            track->gap = @ZERO@;
            track->samples += (track->samples < 0xFFFFFFFFUL) ? 1U : 0U;
        }
    }
    else if (@USABLE@)
    {
        track->@out.member@ = pose->@out.member@;
        track->speed_@out.name@ = @ZERO@;
        track->gap = @ZERO@;
        track->samples = 1U;
    }
    else
    {
        track->gap = @ZERO@;
    }
}

uint32_t decoupler_predict(const decoupler_params_t *p, const decoupler_track_t *track, @REAL@ ahead,
                           decoupler_out_t *pose)
{
    uint32_t status = ((@REAL@)track->samples < p->observer_settled) ? DECOUPLER_PREDICT_STARTING : 0U;
    @REAL@ time = ahead + p->latency;
    if (!((time >= -p->longest_gap) && (time <= p->longest_gap)))
    {
        time = @ZERO@;
        status |= DECOUPLER_PREDICT_AHEAD;
    }
    @PREDICTED@
    return status;
}
