
static {{ real }} slower({{ real }} speed, {{ real }} most)
{
    return (speed > most) ? most : ((speed < -most) ? -most : speed);
}
{{ around }}

void decoupler_track(const decoupler_params_t *p, decoupler_track_t *track, const decoupler_out_t *pose,
                     uint32_t status, {{ real }} dt)
{
    const {{ real }} gap = track->gap + dt;
    if (!((dt > {{ zero }}) && (gap <= p->longest_gap)))
    {
        track->samples = 0U;
    }
    if (track->samples > 0U)
    {
        {{ ahead_of }}
        track->gap = gap;
        if ({{ usable }})
        {
            {{ updated }}
            track->gap = {{ zero }};
            track->samples += (track->samples < 0xFFFFFFFFUL) ? 1U : 0U;
        }
    }
    else if ({{ usable }})
    {
{% for o in outputs %}
        track->{{ o.member }} = pose->{{ o.member }};
{% endfor %}
{% for o in outputs %}
        track->speed_{{ o.name }} = {{ zero }};
{% endfor %}
        track->gap = {{ zero }};
        track->samples = 1U;
    }
    else
    {
        track->gap = {{ zero }};
    }
}

uint32_t decoupler_predict(const decoupler_params_t *p, const decoupler_track_t *track, {{ real }} ahead,
                           decoupler_out_t *pose)
{
    uint32_t status = (({{ real }})track->samples < p->observer_settled) ? DECOUPLER_PREDICT_STARTING : 0U;
    {{ real }} time = ahead + p->latency;
    if (!((time >= -p->longest_gap) && (time <= p->longest_gap)))
    {
        time = {{ zero }};
        status |= DECOUPLER_PREDICT_AHEAD;
    }
    {{ predicted }}
    return status;
}
