{% macro around(o, text) %}
{{ "around(" ~ text ~ ", " ~ o.period ~ ")" if o.column in d.model.period else text }}
{%- endmacro %}
{% set usable = "(status == 0U) || (status == DECOUPLER_STATUS_DEGRADED)" if d.mends else "status == 0U" %}

static float slower(float speed, float most)
{
    return (speed > most) ? most : ((speed < -most) ? -most : speed);
}
{% if d.model.period %}

static float around(float value, float period)
{
    const float half = period * 0.5f;
    return (value > half) ? (value - period) : ((value < -half) ? (value + period) : value);
}
{% endif %}

void decoupler_track(const decoupler_params_t *p, decoupler_track_t *track, const decoupler_out_t *pose,
                     uint32_t status, float dt)
{
    const float gap = track->gap + dt;
    if (!((dt > 0.0f) && (gap <= p->longest_gap)))
    {
        track->samples = 0U;
    }
    if (track->samples > 0U)
    {
{% for o in outputs %}
        track->{{ o.member }} = {{ around(o, "track->" ~ o.member ~ " + (track->speed_" ~ o.name ~ " * dt)") }};
{% endfor %}
        track->gap = gap;
        if ({{ usable }})
        {
{% for o in outputs %}
            const float off_{{ o.name }} = {{ around(o, "pose->" ~ o.member ~ " - track->" ~ o.member) }};
            track->{{ o.member }} = {{ around(o, "track->" ~ o.member ~ " + (p->observer_position * off_" ~ o.name ~ ")") }};
            track->speed_{{ o.name }} = slower(track->speed_{{ o.name }} + (p->observer_speed * off_{{ o.name }}), p->fastest_{{ o.name }});
{% endfor %}
            track->gap = 0.0f;
            track->samples += (track->samples < 0xFFFFFFFFUL) ? 1U : 0U;
        }
    }
    else if ({{ usable }})
    {
{% for o in outputs %}
        track->{{ o.member }} = pose->{{ o.member }};
{% endfor %}
{% for o in outputs %}
        track->speed_{{ o.name }} = 0.0f;
{% endfor %}
        track->gap = 0.0f;
        track->samples = 1U;
    }
    else
    {
        track->gap = 0.0f;
    }
}

uint32_t decoupler_predict(const decoupler_params_t *p, const decoupler_track_t *track, float ahead,
                           decoupler_out_t *pose)
{
    uint32_t status = ((float)track->samples < p->observer_settled) ? DECOUPLER_PREDICT_STARTING : 0U;
    float time = ahead + p->latency;
    if (!((time >= -p->longest_gap) && (time <= p->longest_gap)))
    {
        time = 0.0f;
        status |= DECOUPLER_PREDICT_AHEAD;
    }
{% for o in outputs %}
    pose->{{ o.member }} = {{ around(o, "track->" ~ o.member ~ " + (track->speed_" ~ o.name ~ " * time)") }};
{% endfor %}
{% if d.suspects %}
    pose->suspect = 0U;
{% endif %}
    return status;
}
