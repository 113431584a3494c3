static unsigned long wrong_{{ b }}(int32_t {{ b }})
{
    {{ lines }}
    const double share = ((double){{ b }} * {{ b_unit }}) * ((double){{ r }} * {{ r_unit }});
    const double off = ((share > 1.0) ? (share - 1.0) : (1.0 - share)) / ((double){{ b }} * {{ b_unit }});
    const double size = (off < 0.0) ? -off : off;
    return ((size <= {{ error }}) && ({{ r }} >= {{ least }}) && ({{ r }} <= {{ most }})) ? 0UL : 1UL;
}

