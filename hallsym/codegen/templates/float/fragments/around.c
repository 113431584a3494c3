
static {{ real }} around({{ real }} value, {{ real }} period)
{
    const {{ real }} half = period * {{ half }};
    return (value > half) ? (value - period) : ((value < -half) ? (value + period) : value);
}
